//! Quirks: behaviour of the translator, or of this crate's core around it, that differs from the architecture. Each is
//! identified by the outcomes and the instructions; the affected part is excluded from the comparison, or the whole
//! case if everything may be affected. In addition, `case` never samples these:
//!
//! - Floating point that is not allowed, in an IT block: the core cannot stop within one.
//! - A first use of floating point (CONTROL.FPCA zero) in an IT block: if it is not carried out, the translator takes
//!   the next for the second one.
//! - CPS and MSR of FAULTMASK at priority -1 (HardFault): the translator sets it.

use r4_mcu::cpu::{Access, CoreStop, Fault, Register, Why};

use super::case::Case;
use super::machine::Outcome;

/// IT bits of the EPSR in xPSR.
const IT: u32 = 0x0600_FC00;
/// Thumb bit of the EPSR in xPSR.
const THUMB: u32 = 1 << 24;
/// Q flag of the APSR in xPSR.
const SATURATED: u32 = 1 << 27;
/// Rounding mode bits of the FPSCR.
const ROUNDING: u32 = 3 << 22;

type Quirk = (&'static str, fn(&Case, &Outcome, &mut Outcome) -> bool);

/// Quirks in the order of application: a name, and a function that makes the second outcome equal to the first where
/// they may differ.
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
    ("low bits of BASEPRI", low_priority),
    ("IT state that skipped instructions", skipped),
    ("IT state left behind", left_behind),
    ("an even address without code", even_address),
    ("EXC_RETURN of no kind", exception_return),
    ("SEV that is skipped", event),
    ("Q of two products", two_products),
    ("a byte after an unaligned store", swallowed),
    ("count of an access before floating point that is not allowed", count),
];

/// Makes permitted differences equal, and returns the reason, the first one if there are several.
pub(crate) fn excuse(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> Option<&'static str> {
    let applies = |(name, quirk): &Quirk| (ours != theirs && quirk(case, ours, theirs)).then_some(*name);
    QUIRKS.iter().filter_map(applies).reduce(|first, _| first)
}

fn why(outcome: &Outcome) -> Option<Why> {
    outcome.stop.as_ref().map(|stop| stop.why).ok()
}

/// Excludes the whole case from the comparison.
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

/// Access beyond the last address is UNPREDICTABLE (A3.1.1).
fn end_of_addresses(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let at_end = theirs.accesses.iter().any(|(_, access, _)| access.address > 0xFFFF_FFFC - 4);
    dropped(at_end, ours, theirs)
}

/// A branch into ITCM executes data that earlier cases stored there, which may be UNPREDICTABLE instructions.
fn data_as_code(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let there = [&*theirs, ours].into_iter().any(|outcome| outcome.register(Register::Pc) < 0x0001_0000);
    dropped(there, ours, theirs)
}

/// The core has instructions of its own in a reserved area.
fn own_page(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let inside = ours.accesses.iter().any(|(_, access, _)| (0x1F00_0000..0x1F00_1000).contains(&access.address));
    dropped(inside, ours, theirs)
}

/// The translator compares values, too: an exclusive store reads first, which a bus sees; and a store of another width
/// than the load has a different result, which is IMPLEMENTATION DEFINED (A3.4.5).
fn exclusive(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    // The first halfword of load and store, and some bits of the second, give the width.
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

/// Conversion from fixed point rounds to the nearest regardless of FPSCR (A7.7.228); the translator uses FPSCR.
fn rounding(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let writes_fpscr = |bits: &&str| bits.starts_with("1110 1110 1110 0001");
    let rounds = case.fpscr & ROUNDING != 0 || case.templates.iter().any(writes_fpscr);
    // VCVT to single precision.
    let from_fixed = |(first, second)| first & 0xFFBE == 0xEEBA && second & 0x0F50 == 0x0A40;
    dropped(rounds && case.words().any(from_fixed), ours, theirs)
}

/// To an unprivileged program the translator shows masks of zero, and also to the core, which takes that for a change.
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

/// The chip's priorities have four bits, and so has BASEPRI (B1.4.3); the translator's has eight.
fn low_priority(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    dropped(theirs.register(Register::Basepri) & 0xF != 0, ours, theirs)
}

/// README.md: an access leaves the state of an IT block behind. The following block of code was taken for conditional.
fn skipped(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let later = |stop: &CoreStop| {
        ours.stop.as_ref().is_ok_and(|ours| ours.why == Why::Wfi && stop.instructions > ours.instructions)
    };
    // An MSR also begins a block with the instructions that follow it.
    let begins = case.templates.iter().any(|bits| bits.starts_with("11110 0111"));
    // Or it ends with a branch, which is not allowed in such a block.
    let undefined = [why(theirs), why(ours)].map(|why| why == Some(Why::Fault(Fault::Undefined))) == [true, false];
    let applies = case.is_conditional && (theirs.stop.as_ref().is_ok_and(later) || begins || undefined);
    dropped(applies, ours, theirs)
}

/// Like [`skipped`], with no instruction following.
fn left_behind(_: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let (ours, xpsr) = (ours.register(Register::Xpsr), theirs.register(Register::Xpsr));
    let applies = ours & IT == 0 && xpsr & IT != 0;
    if applies {
        theirs.set_register(Register::Xpsr, xpsr & !IT);
    }
    applies
}

/// Both InvalidState and Fetch apply; the architecture leaves their order open. A step to an address that cannot be
/// executed may already end with that.
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

/// EXC_RETURN begins with 0xF (B1.5.8), in the translator with 0xFF. For an even one it has also set T to zero.
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

/// SMLAD sets Q if the whole sum overflows (A7.7.134), the translator if that of the products does.
fn two_products(case: &Case, ours: &Outcome, theirs: &mut Outcome) -> bool {
    let ours = ours.register(Register::Xpsr);
    let is_smlad = |(first, second): (u16, u16)| first & 0xFFF0 == 0xFB20 && second & 0x00E0 == 0;
    let applies = theirs.register(Register::Xpsr) == ours | SATURATED && case.words().any(is_smlad);
    if applies {
        theirs.set_register(Register::Xpsr, ours);
    }
    applies
}

/// The translator repeats an unaligned store byte by byte, for which the core mistakes the next byte store there, too.
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
