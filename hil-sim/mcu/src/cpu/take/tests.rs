//! Entry and return on a core that executes nothing: frames word by word, and refused cases.

use super::super::fake::FakeCore;
use super::*;

const TABLE: u32 = 0x0800_0000;
const STACK: u32 = 0x2000_1000;
const PROCESS: u32 = 0x2000_2000;
const THREAD_PC: u32 = 0x0800_1000;

/// Returns the address of an exception's handler.
fn handler(exception: u16) -> u32 {
    0x0800_4000 + 0x10 * u32::from(exception)
}

struct Bench {
    core: FakeCore,
    cpu: Processor,
    memory: Memory,
}

impl Bench {
    /// Starts in thread mode on the main stack, with distinct values in R0 to R3, R12 and LR.
    fn new() -> Self {
        let memory = Memory::new();
        for exception in 1..48_u16 {
            memory.write(TABLE + 4 * u32::from(exception), Size::Word, handler(exception) | 1).unwrap();
        }
        let mut core = FakeCore::default();
        for (index, register) in (0_u32..).zip(CALLER_SAVED) {
            core.set(register, 0x1000 + index);
        }
        core.set(Register::Xpsr, 0x6100_0000);
        core.set(Register::Msp, STACK);
        core.set(Register::Psp, PROCESS);
        core.set(Register::Pc, THREAD_PC);
        Self { core, cpu: Processor::new(0, 1_000_000, TABLE), memory }
    }

    fn taker(&mut self) -> Taker<'_, FakeCore> {
        Taker { core: &mut self.core, cpu: &mut self.cpu, memory: &self.memory, protection: None }
    }

    fn pend(&mut self, irq: u16, priority: u8) -> u16 {
        let exception = number::IRQ0 + irq;
        self.cpu.exceptions.set_enabled(exception, true);
        self.cpu.exceptions.set_priority_field(exception, priority);
        self.cpu.exceptions.set_pending(exception);
        exception
    }

    fn enter(&mut self, exception: u16) {
        self.taker().enter(exception).unwrap();
        assert_eq!((active(&self.core), self.core.get(Register::Pc)), (exception, handler(exception)));
    }

    fn leave(&mut self) -> bool {
        let exc_return = self.core.get(Register::Lr);
        self.taker().leave(exc_return).unwrap()
    }

    fn word(&self, address: u32) -> u32 {
        self.memory.read(address, Size::Word).unwrap()
    }
}

#[test]
fn a_basic_frame_holds_what_the_manual_says_and_comes_back() {
    let mut bench = Bench::new();
    let irq = bench.pend(0, 0x40);
    bench.enter(irq);
    let frame = bench.core.get(Register::Sp);
    assert_eq!(frame, STACK - 0x20);
    let words: Vec<_> = (0..8).map(|index| bench.word(frame + 4 * index)).collect();
    assert_eq!(words, [0x1000, 0x1001, 0x1002, 0x1003, 0x1004, 0x1005, THREAD_PC, 0x6100_0000]);
    assert_eq!(bench.core.get(Register::Lr), 0xFFFF_FFF9);
    assert!(bench.cpu.exceptions.is_active(irq) && !bench.cpu.exceptions.is_pending(irq));
    bench.core.set(Register::R(0), 0);
    bench.core.set(Register::Xpsr, 0x9100_0000 | u32::from(irq));
    assert!(!bench.leave());
    assert_eq!((bench.core.get(Register::R(0)), bench.core.get(Register::Sp)), (0x1000, STACK));
    assert_eq!((bench.core.get(Register::Pc), bench.core.get(Register::Xpsr)), (THREAD_PC, 0x6100_0000));
    assert_eq!(bench.core.get(Register::Lr), 0x1005);
    assert!(bench.cpu.event && bench.core.monitor_cleared == 2);
}

#[test]
fn an_extended_frame_has_floating_point_and_its_address_in_fpcar() {
    let mut bench = Bench::new();
    bench.core.set(Register::Control, FLOAT_ACTIVE);
    for index in 0..32 {
        bench.core.set(Register::S(index), 0x2000 + u32::from(index));
    }
    bench.core.set(Register::Fpscr, 0x0100_0000);
    // The stack is aligned to four bytes only, so the frame needs padding.
    bench.core.set(Register::Msp, STACK - 4);
    let irq = bench.pend(0, 0x40);
    bench.enter(irq);
    let frame = bench.core.get(Register::Sp);
    assert_eq!((frame, bench.core.get(Register::Lr)), (STACK - 4 - 0x68 - 4, 0xFFFF_FFE9));
    assert_eq!(
        (bench.word(frame + 0x20), bench.word(frame + 0x5C), bench.word(frame + 0x60)),
        (0x2000, 0x200F, 0x0100_0000)
    );
    assert_eq!(bench.word(frame + 0x1C), 0x6100_0200, "padding is told");
    assert_eq!(bench.core.get(Register::Control), 0, "a handler begins without a context of floating point");
    assert_eq!(bench.cpu.read(0xE000_EF38, Size::Word, 0, 0), Ok(frame + 0x20));
    for clobbered in [0, 3, 15] {
        bench.core.set(Register::S(clobbered), 0);
    }
    bench.core.set(Register::S(16), 7);
    bench.core.set(Register::Fpscr, 0);
    bench.leave();
    let restored = [0, 3, 15].map(|index| bench.core.get(Register::S(index)));
    assert_eq!((restored, bench.core.get(Register::Fpscr)), ([0x2000, 0x2003, 0x200F], 0x0100_0000));
    assert_eq!(bench.core.get(Register::S(16)), 7, "the callee's to keep");
    assert_eq!((bench.core.get(Register::Control), bench.core.get(Register::Sp)), (FLOAT_ACTIVE, STACK - 4));
}

#[test]
fn without_automatic_saving_the_frame_is_basic() {
    let mut bench = Bench::new();
    bench.cpu.write(0xE000_EF34, Size::Word, 0, 0).unwrap();
    bench.core.set(Register::Control, FLOAT_ACTIVE);
    let irq = bench.pend(0, 0x40);
    bench.enter(irq);
    assert_eq!(bench.core.get(Register::Lr), 0xFFFF_FFF9);
}

#[test]
fn the_process_stack_holds_the_frame_of_the_thread_and_the_main_stack_that_of_handlers() {
    let mut bench = Bench::new();
    bench.core.set(Register::Control, PROCESS_STACK);
    let outer = bench.pend(0, 0x40);
    bench.enter(outer);
    assert_eq!((bench.core.get(Register::Psp), bench.core.get(Register::Sp)), (PROCESS - 0x20, STACK));
    assert_eq!(bench.core.get(Register::Lr), 0xFFFF_FFFD);
    let inner = bench.pend(1, 0x20);
    bench.enter(inner);
    assert_eq!((bench.core.get(Register::Sp), bench.core.get(Register::Lr)), (STACK - 0x20, 0xFFFF_FFF1));
    bench.leave();
    assert_eq!((active(&bench.core), bench.core.get(Register::Sp)), (outer, STACK));
    bench.leave();
    assert_eq!((active(&bench.core), bench.core.get(Register::Sp)), (0, PROCESS));
    assert_eq!(bench.core.get(Register::Control), PROCESS_STACK);
}

#[test]
fn what_is_pending_at_a_return_is_taken_on_the_same_frame() {
    let mut bench = Bench::new();
    let first = bench.pend(0, 0x40);
    bench.enter(first);
    let second = bench.pend(1, 0x40);
    bench.leave();
    assert_eq!((active(&bench.core), bench.core.get(Register::Sp)), (second, STACK - 0x20));
    assert_eq!(bench.core.get(Register::Lr), 0xFFFF_FFF9);
    assert!(!bench.cpu.exceptions.is_active(first));
    bench.leave();
    assert_eq!((active(&bench.core), bench.core.get(Register::Pc)), (0, THREAD_PC));
}

#[test]
fn a_return_that_makes_no_sense_is_a_usage_fault_on_the_frame_that_is_there() {
    for exc_return in [0xFFFF_FFF5, 0xFFFF_FFF1, 0xF000_0009] {
        let mut bench = Bench::new();
        bench.cpu.exceptions.set_enabled(number::USAGE_FAULT, true);
        let irq = bench.pend(0, 0x40);
        bench.enter(irq);
        bench.taker().leave(exc_return).unwrap();
        assert_eq!(active(&bench.core), number::USAGE_FAULT, "{exc_return:#x}");
        assert_eq!(
            (bench.cpu.faults.to_string(), bench.core.get(Register::Sp)),
            ("CFSR 0x00040000".into(), STACK - 0x20)
        );
    }
    // Return to thread mode while another handler is preempted; NONBASETHRDENA allows it.
    for (allowed, expected) in [(false, number::HARD_FAULT), (true, 0)] {
        let mut bench = Bench::new();
        bench.cpu.write(0xE000_ED14, Size::Word, allowed.into(), 0).unwrap();
        let outer = bench.pend(0, 0x40);
        bench.enter(outer);
        let inner = bench.pend(1, 0x20);
        bench.enter(inner);
        bench.memory.write(bench.core.get(Register::Sp) + 0x1C, Size::Word, 0x0100_0000).unwrap();
        bench.taker().leave(0xFFFF_FFF9).unwrap();
        assert_eq!(active(&bench.core), expected);
    }
}

#[test]
fn a_frame_whose_exception_number_does_not_fit_is_refused() {
    let mut bench = Bench::new();
    let irq = bench.pend(0, 0x40);
    bench.enter(irq);
    bench.memory.write(bench.core.get(Register::Sp) + 0x1C, Size::Word, 0x0100_0010).unwrap();
    bench.leave();
    assert_eq!(bench.cpu.faults.to_string(), "CFSR 0x00040000, HFSR 0x40000000");
}

#[test]
fn faults_escalate_when_they_are_disabled_or_not_urgent_enough() {
    let mut bench = Bench::new();
    bench.taker().fault(Cause::Undefined).unwrap();
    assert_eq!((active(&bench.core), bench.cpu.faults.to_string()), (3, "CFSR 0x00010000, HFSR 0x40000000".into()));
    let mut bench = Bench::new();
    bench.cpu.exceptions.set_enabled(number::USAGE_FAULT, true);
    bench.cpu.exceptions.set_priority_field(number::USAGE_FAULT, 0x80);
    bench.taker().fault(Cause::Undefined).unwrap();
    assert_eq!((active(&bench.core), bench.cpu.faults.to_string()), (6, "CFSR 0x00010000".into()));
    // Within UsageFault's handler a bus error becomes a HardFault, because BusFault is not enabled; within HardFault no
    // fault can be taken.
    bench.taker().fault(Cause::Load { address: 0x9000_0000 }).unwrap();
    assert_eq!(active(&bench.core), number::HARD_FAULT);
    let failure = bench.taker().fault(Cause::Undefined).unwrap_err();
    assert_eq!(failure, Failure::LockUp("undefined instruction (UNDEFINSTR)".into()));
    assert!(matches!(bench.taker().supervisor_call(), Err(Failure::LockUp(_))));
    assert!(matches!(bench.taker().breakpoint(), Err(Failure::LockUp(_))));
}

#[test]
fn svc_escalates_under_primask() {
    let mut bench = Bench::new();
    bench.core.set(Register::Primask, 1);
    bench.taker().supervisor_call().unwrap();
    assert_eq!((active(&bench.core), bench.cpu.faults.hard), (number::HARD_FAULT, FORCED));
}

#[test]
fn faultmask_is_cleared_by_a_return_but_not_from_nmi() {
    for (exception, left) in [(number::SYS_TICK, 0), (number::NMI, 1)] {
        let mut bench = Bench::new();
        bench.enter(exception);
        bench.core.set(Register::Faultmask, 1);
        bench.leave();
        assert_eq!(bench.core.get(Register::Faultmask), left);
    }
}

#[test]
fn a_vector_that_cannot_be_read_or_is_no_thumb_code_is_a_fault() {
    let mut bench = Bench::new();
    // The table is in the last words of DTCM: it contains HardFault's vector, but not that of interrupt 0.
    bench.cpu.write(0xE000_ED08, Size::Word, 0x2001_FF80, 0).unwrap();
    let vectors: Vec<u32> = (0..32_u16).map(|exception| handler(exception) | 1).collect();
    for (at, vector) in (0x2001_FF80..).step_by(4).zip(&vectors) {
        bench.memory.write(at, Size::Word, *vector).unwrap();
    }
    let irq = bench.pend(16, 0x40);
    bench.taker().enter(irq).unwrap();
    assert_eq!((active(&bench.core), bench.cpu.faults.to_string()), (3, "HFSR 0x00000002".into()));
    let mut bench = Bench::new();
    bench.memory.write(TABLE + 4 * 16, Size::Word, handler(16)).unwrap();
    let irq = bench.pend(0, 0x40);
    bench.taker().enter(irq).unwrap();
    assert_eq!((active(&bench.core), bench.cpu.faults.to_string()), (3, "CFSR 0x00020000, HFSR 0x40000000".into()));
    assert_eq!(bench.word(bench.core.get(Register::Sp) + 0x18), handler(16));
}

#[test]
fn sleep_on_exit_is_only_of_thread_mode() {
    let mut bench = Bench::new();
    bench.cpu.write(0xE000_ED10, Size::Word, 2, 0).unwrap();
    let outer = bench.pend(0, 0x40);
    bench.enter(outer);
    let inner = bench.pend(1, 0x20);
    bench.enter(inner);
    assert!(!bench.leave());
    assert!(bench.leave());
}

#[test]
fn a_stack_that_cannot_be_read_on_return_is_a_fault() {
    let mut bench = Bench::new();
    let irq = bench.pend(0, 0x40);
    bench.enter(irq);
    bench.core.set(Register::Msp, 0x3FFF_0000);
    bench.leave();
    assert_eq!(bench.cpu.faults.to_string(), "CFSR 0x00000800, HFSR 0x40000000");
}
