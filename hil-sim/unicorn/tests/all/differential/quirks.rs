//! What the translator, or this crate's core around it, does otherwise than the architecture. Each is told apart by what
//! came out and by the instructions; what it concerns is left out of the comparison, or the whole case is where it may
//! concern everything. Besides, `case` draws nothing of these:
//!
//! - Floating point that is not allowed, in an IT block: the core cannot stop within one.
//! - A first use of floating point (CONTROL.FPCA zero) in an IT block: if it is not carried out, the translator takes the next
//!   for the second one.
//! - CPS and MSR of FAULTMASK at priority -1 (HardFault): the translator sets it.

use r4_mcu::cpu::{Access, CoreStop, Fault, Register, Why};

use super::case::Case;
use super::machine::Outcome;

/// EPSR.IT in xPSR.
const IT: u32 = 0x0600_FC00;
/// EPSR.T in xPSR.
const THUMB: u32 = 1 << 24;
/// APSR.Q in xPSR.
const SATURATED: u32 = 1 << 27;
/// FPSCR.RMode.
const ROUNDING: u32 = 3 << 22;

type Quirk = (&'static str, fn(&Case, &Outcome, &mut Outcome) -> bool);

/// In this order: why two outcomes may differ, and what makes the second one as the first where they may.
const QUIRKS: &[Quirk] = &[
    ("code in RAM", code_in_ram),
    ("unaligned", unaligned),
    ("end of the address space", end_of_addresses),
    ("the page of the core", own_page),
    ("data in ITCM as instructions", data_as_code),
    ("exclusive stores that read", exclusive),
    ("rounding from fixed point", rounding),
    ("masks of an unprivileged program", masks),
    ("low bits of SP", low_bits),
    ("IT state that skipped instructions", skipped),
    ("IT state left behind", left_behind),
    ("an even address without code", even_address),
    ("EXC_RETURN of no kind", exception_return),
    ("SEV that is skipped", event),
    ("Q of two products", two_products),
    ("a byte after an unaligned store", swallowed),
    ("count of an access before floating point that is not allowed", count),
];

/// Makes equal what may differ, and says why that is, the first reason if there are several.
pub(crate) fn excuse(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> Option<&'static str> {
    let applies = |(name, quirk): &Quirk| (ours != theirs && quirk(case, ours, theirs)).then_some(*name);
    QUIRKS.iter().filter_map(applies).reduce(|first, _| first)
}

fn why(outcome: &Outcome) -> Option<Why> {
    outcome.stop.as_ref().map(|stop| stop.why).ok()
}

/// Nothing of the case is compared.
fn dropped(applies: bool, ours: &Outcome, theirs: &mut Outcome) -> bool {
    if applies {
        theirs.clone_from(ours);
    }
    applies
}

/// This crate's core executes from ITCM and flash only (`mapping::executes`).
fn code_in_ram(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let pc = theirs.register(Register::Pc);
    let ram = (0x2000_0000..0x4000_0000).contains(&pc);
    dropped(ram && why(theirs) == Some(Why::Fault(Fault::Fetch)), ours, theirs)
}

/// README.md: unaligned LDM, LDRD, VLDR work there, and are UsageFaults on hardware (DDI0403E A3.2.1).
fn unaligned(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    dropped(why(ours) == Some(Why::Fault(Fault::Unaligned)), ours, theirs)
}

/// What goes on past the last address is UNPREDICTABLE (A3.1.1).
fn end_of_addresses(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let at_end = theirs.accesses.iter().any(|(_, access, _)| access.address > 0xFFFF_FFFC - 4);
    dropped(at_end, ours, theirs)
}

/// A branch into ITCM executes what the cases before stored there, UNPREDICTABLE instructions among it.
fn data_as_code(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let there = [&*theirs, ours].into_iter().any(|outcome| outcome.register(Register::Pc) < 0x0001_0000);
    dropped(there, ours, theirs)
}

/// The core has instructions of its own in an area that is reserved.
fn own_page(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let inside = ours.accesses.iter().any(|(_, access, _)| (0x1F00_0000..0x1F00_1000).contains(&access.address));
    dropped(inside, ours, theirs)
}

/// The translator compares values, too: an exclusive store reads first, which a bus sees; and of one that is not as wide as the
/// load it thinks otherwise, which is IMPLEMENTATION DEFINED (A3.4.5).
fn exclusive(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    // The load's and the store's first halfword, and which bytes of the second one tell the width.
    let width = |first: u16, second: u16, load: u16| match first & 0xFFE0 | first & 0x10 {
        0xE840 if load == 0 => Some(4),
        0xE850 if load == 1 => Some(4),
        0xE8C0 if load == 0 => Some(1 + (second >> 4 & 1)),
        0xE8D0 if load == 1 => Some(1 + (second >> 4 & 1)),
        _ => None,
    };
    let of = |load| case.words().filter_map(move |(first, second)| width(first, second, load));
    let reads = of(0).next().is_some() && !theirs.accesses.is_empty();
    dropped(reads || of(1).any(|load| of(0).any(|store| load != store)), ours, theirs)
}

/// From fixed point it is to the nearest whatever FPSCR says (A7.7.228); the translator asks FPSCR.
fn rounding(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let writes_fpscr = |bits: &&str| bits.starts_with("1110 1110 1110 0001");
    let rounds = case.fpscr & ROUNDING != 0 || case.templates.iter().any(writes_fpscr);
    // VCVT to single precision.
    let from_fixed = |(first, second)| first & 0xFFBE == 0xEEBA && second & 0x0F50 == 0x0A40;
    dropped(rounds && case.words().any(from_fixed), ours, theirs)
}

/// To an unprivileged program the translator shows masks of zero, and so it does to the core, which takes that for a change.
fn masks(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let unprivileged = theirs.register(Register::Control) & 1 != 0 && case.control & 1 == 0;
    dropped(unprivileged && case.mask_changes && why(theirs) == Some(Why::MaskChanged), ours, theirs)
}

/// On the Cortex-M7 the low bits of SP are zero (B1.4.1); ADD and MSR of the translator leave others in it.
fn low_bits(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let stacks = [Register::Sp, Register::Msp, Register::Psp];
    let applies =
        stacks.into_iter().any(|register| matches!(theirs.register(register) ^ ours.register(register), 1..=3));
    dropped(applies, ours, theirs)
}

/// README.md: an access leaves the state of an IT block behind. The block of code that followed was taken for conditional.
fn skipped(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let later = |stop: &CoreStop| {
        ours.stop.as_ref().is_ok_and(|ours| ours.why == Why::Wfi && stop.instructions > ours.instructions)
    };
    // An MSR, too, begins a block with what follows it.
    let begins = case.templates.iter().any(|bits| bits.starts_with("11110 0111"));
    // Or it ends with a branch, which is not allowed in such a block.
    let undefined = [why(theirs), why(ours)].map(|why| why == Some(Why::Fault(Fault::Undefined))) == [true, false];
    let applies = case.is_conditional && (theirs.stop.as_ref().is_ok_and(later) || begins || undefined);
    dropped(applies, ours, theirs)
}

/// As before, and nothing followed.
fn left_behind(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let (ours, xpsr) = (ours.register(Register::Xpsr), theirs.register(Register::Xpsr));
    let applies = ours & IT == 0 && xpsr & IT != 0;
    if applies {
        theirs.set_register(Register::Xpsr, xpsr & !IT);
    }
    applies
}

/// InvalidState and Fetch are both true of it; which is first, the architecture leaves open. A step to where nothing can be
/// executed may end with that already.
fn even_address(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let applies = matches!(
        (why(ours), why(theirs)),
        (Some(Why::Fault(Fault::InvalidState)), Some(Why::Fault(Fault::Fetch)))
            | (Some(Why::Observed), Some(Why::Fault(Fault::Fetch | Fault::InvalidState)))
    );
    if applies {
        theirs.stop.clone_from(&ours.stop);
    }
    applies
}

/// EXC_RETURN begins with 0xF (B1.5.8), in the translator with 0xFF. Of an even one it has also made T zero.
fn exception_return(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let Some(Why::ExceptionReturn(value)) = why(ours) else { return false };
    let applies = value < 0xFF00_0000 && why(theirs) == Some(Why::Fault(Fault::Fetch)) || why(theirs) == why(ours);
    if applies {
        theirs.stop.clone_from(&ours.stop);
        theirs.set_register(Register::Xpsr, theirs.register(Register::Xpsr) | THUMB);
    }
    applies
}

/// The core reports SEV when its block begins.
fn event(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let stopped = matches!(why(ours), Some(Why::Fault(_)));
    let applies = (case.is_conditional || stopped) && theirs.events > ours.events;
    if applies {
        theirs.events = ours.events;
    }
    applies
}

/// SMLAD says whether the whole sum overflows (A7.7.134); the translator, whether that of the products does.
fn two_products(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let ours = ours.register(Register::Xpsr);
    let is_smlad = |(first, second): (u16, u16)| first & 0xFFF0 == 0xFB20 && second & 0x00E0 == 0;
    let applies = theirs.register(Register::Xpsr) == ours | SATURATED && case.words().any(is_smlad);
    if applies {
        theirs.set_register(Register::Xpsr, ours);
    }
    applies
}

/// The translator repeats an unaligned store byte by byte, for which the core takes the next store of a byte there, too.
fn swallowed(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let unaligned =
        |(kind, access, _): &(char, Access, u32)| *kind == 'w' && access.address & (access.size.bytes() - 1) != 0;
    dropped(theirs.accesses.len() < ours.accesses.len() && theirs.accesses.iter().any(unaligned), ours, theirs)
}

/// The core runs such a block a second time, and counts from there on.
fn count(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let applies = !case.fpu && ours.accesses.len() == theirs.accesses.len();
    if applies {
        for ((_, ours, _), (_, theirs, _)) in ours.accesses.iter().zip(&mut theirs.accesses) {
            theirs.instructions = ours.instructions;
        }
    }
    applies
}
