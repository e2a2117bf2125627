//! Firmware that hangs, faults or overflows its stack: the outputs always go safe by themselves, and the next start
//! knows the reason. The program is broken from outside, as a debugger would: an instruction of the image is
//! overwritten in the middle of the run.

use crate::emulated::{
    Board, Setup,
    harness::{Device, LINEAR, MS, ROTARY, RawHost, US},
};
use r4_emu::fault::{Fault, Lasting, PANIC_LINE, PANIC_LOCATION};
use r4_mcu::{Level, Pin};
use r4_protocol::{Cause, Causes, Mode, Refusal, Reply, Request, SafetyState, Setpoint, ToDevice};

/// Period of the watchdog, ns: 104 times 4 cycles of 32 kHz (see `watchdog.rs` of the firmware), exact here.
const WATCHDOG_NS: u64 = 13 * MS;
/// Feeding interval of the watchdog, ns.
const FEED_NS: u64 = 10 * MS;
/// Period of the supervisor, ns: a hang shows at its next run.
const SUPERVISOR_NS: u64 = MS;
/// Time limit from the reset to the first instruction that drives the stop lines, after start-up's clearing of 100 KB,
/// ns. The lines float meanwhile, and the carrier's resistors hold the bridges off.
const CLAIM_NS: u64 = 2 * MS;
/// Time limit for detecting a dead control loop, ns: five periods without an end, noticed at the supervisor's next
/// pass.
const CONTROL_DEAD_NS: u64 = MS + 5 * MS + 2 * MS;

/// Backup registers with the record of an end (see `reset.rs` of the firmware): PC or location, and CFSR or line.
const RECORD_PC: usize = 17;
const RECORD_DETAIL: usize = 19;

/// Starts the rotary motor from a host without a driver; returns the session's number.
async fn run_rotary(host: &mut RawHost, device: &Device) -> u16 {
    let info = host.hello().await;
    host.ask(Request::Arm).await.expect("nothing is wrong");
    let setpoint = Setpoint { mode: Mode::Duty, value: 0.8 };
    host.ask(Request::Set { channel: ROTARY, setpoint, sent_us: info.device_us, ttl_ms: 500 }).await.expect("armed");
    keep_alive(host, info.session, 200).await;
    assert!(!device.is_off(ROTARY), "it must run before it can be stopped");
    info.session
}

/// Sends heartbeats for `ms`, four per link time-out.
async fn keep_alive(host: &mut RawHost, session: u16, ms: u64) {
    for _ in 0..ms / 50 {
        host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
        host.listen(50).await;
    }
}

/// Returns the time after `since_ns` at which both bridges are off, accurate to 1 µs.
async fn off_after(device: &Device, since_ns: u64, limit_ns: u64) -> Option<u64> {
    loop {
        let after_ns = device.clock.now_ns() - since_ns;
        if device.is_off(ROTARY) && device.is_off(LINEAR) {
            return Some(after_ns);
        }
        if after_ns > limit_ns {
            return None;
        }
        device.clock.sleep(US).await;
    }
}

/// Returns the chip's level at DISABLE of the bridges.
fn disable(board: &Board) -> Level {
    let carrier = r4_boards::load_carrier("r4-carrier").expect("built in");
    let pin = carrier.pin("osmc_dis").expect("it has it").stm32;
    board.machine().chip.gpio().driven(Pin::new(pin.port, pin.number))
}

/// Checks that after a bad end the board is tripped by the watchdog's cause, can be cleared, and works again.
async fn starts_tripped_and_works(host: &mut RawHost, device: &Device, board: &Board) {
    // Bytes on the cable when the processor was reset form a damaged frame.
    host.listen(100).await;
    host.bad_frames = 0;
    let info = host.hello().await;
    assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::WatchdogReset)));
    assert!(matches!(host.ask(Request::Arm).await, Err(Refusal::Tripped { .. })));
    assert!(device.is_off(ROTARY) && device.is_off(LINEAR));
    host.ask(Request::Clear).await.expect("over");
    assert_eq!(host.ask(Request::Arm).await, Ok(Reply::Done));
    keep_alive(host, info.session, 100).await;
    assert!(board.lights().green, "it stays armed");
}

/// The supervisor hangs in its own interrupt, with all interrupts masked, or because the time driver no longer wakes
/// it.
#[test]
fn a_hung_supervisor_is_reset_by_the_watchdog() {
    let (mut worst_ns, mut worst_claim_ns) = (0, 0);
    for fault in [Fault::SupervisorHangs, Fault::SupervisorHangsMasked, Fault::TimeDriverHangs] {
        for phase_us in [0, 400] {
            let (_, misuse) = Setup::osmc_bench().raw(async |host, device, board| {
                run_rotary(host, device).await;
                device.clock.sleep(phase_us * US).await;
                // After the reset the program is restored, as after a transient fault.
                board.inject(fault, Lasting::UntilReset).expect("the image has it");
                let at_ns = device.clock.now_ns();
                let limit_ns = SUPERVISOR_NS + WATCHDOG_NS;
                let off_ns = off_after(device, at_ns, limit_ns).await;
                let off_ns = off_ns.unwrap_or_else(|| panic!("{fault:?}: not off after {limit_ns} ns"));
                assert!(
                    off_ns >= WATCHDOG_NS - FEED_NS - SUPERVISOR_NS,
                    "{fault:?}: {off_ns} ns are before the watchdog's time"
                );
                let reset_ns = device.clock.now_ns();
                let claimed = device.wait_until(reset_ns, CLAIM_NS, || disable(board) == Level::High).await;
                worst_claim_ns = worst_claim_ns.max(claimed.expect("the start drives the line"));
                worst_ns = worst_ns.max(off_ns);
                starts_tripped_and_works(host, device, board).await;
            });
            assert_eq!(misuse, Vec::<String>::new(), "{fault:?}");
        }
    }
    eprintln!(
        "hung supervisor: outputs off after at most {} us, DISABLE driven {} us after the reset",
        worst_ns / US,
        worst_claim_ns / US
    );
}

/// Only the control task hangs: the supervisor detects it, and no reset is needed.
#[test]
fn a_hung_control_task_trips_without_a_reset() {
    let mut worst_ns = 0;
    for phase_us in [0, 250, 500, 750] {
        Setup::osmc_bench().raw(async |host, device, board| {
            run_rotary(host, device).await;
            device.clock.sleep(phase_us * US).await;
            let patch = board.inject(Fault::ControlHangs, Lasting::Always).expect("the image has it");
            let at_ns = device.clock.now_ns();
            let off_ns = off_after(device, at_ns, CONTROL_DEAD_NS).await;
            worst_ns = worst_ns.max(off_ns.expect("the supervisor drives DISABLE"));
            // The lights follow the lines in the same pass of the supervisor.
            device.clock.sleep(100 * US).await;
            assert!(board.lights().red && !board.lights().green);
            // The hang lasts far beyond the watchdog's period without a reset, and the board continues when it ends.
            device.clock.sleep(3 * WATCHDOG_NS).await;
            assert_eq!(disable(board), Level::High);
            patch.undo(&mut board.machine()).expect("code is in flash");
            // The time without heartbeats was below the link time-out.
            let told = host.ask(Request::Stats).await;
            assert!(matches!(told, Ok(Reply::Stats(_))), "the session is the same: {told:?}");
            let info = host.hello().await;
            assert_eq!(info.state, SafetyState::Tripped);
            assert!(info.causes.contains(Cause::ControlOverrun), "{}", info.causes);
            assert!(!info.causes.contains(Cause::WatchdogReset), "{}", info.causes);
        });
    }
    eprintln!("hung control: outputs off after at most {} us", worst_ns / US);
}

/// Breaks the control task in the middle of a run; returns the address, and two registers of the record.
fn ended_by(fault: Fault) -> (u32, u32, u32) {
    let (result, _) = Setup::osmc_bench().raw(async |host, device, board| {
        run_rotary(host, device).await;
        let patch = board.inject(fault, Lasting::UntilReset).expect("the image has it");
        let at_ns = device.clock.now_ns();
        // The fault acts at the task's next run, at most one period away. The handler drives the lines first; a stack
        // has to fill before.
        let off_ns = off_after(device, at_ns, 2 * MS).await;
        let off_ns = off_ns.unwrap_or_else(|| panic!("{fault:?}: the outputs are not off"));
        eprintln!("{fault:?}: outputs off after {} us", off_ns / US);
        starts_tripped_and_works(host, device, board).await;
        let register = |index| board.machine().chip.backup_register(index).expect("0 to 31");
        (patch.address, register(RECORD_PC), register(RECORD_DETAIL))
    });
    result
}

#[test]
fn a_fault_stops_leaves_a_record_and_restarts() {
    let (at, pc, cfsr) = ended_by(Fault::UndefinedInstruction);
    // Bit 16 of CFSR is UNDEFINSTR (DDI0403E, B3.2.15).
    assert_eq!((pc, cfsr), (at, 1 << 16));
}

#[test]
fn a_panic_stops_leaves_a_record_and_restarts() {
    let (_, location, line) = ended_by(Fault::Panic);
    assert_eq!((location, line), (PANIC_LOCATION, PANIC_LINE));
}

/// The stack ends at a guard region without write access: an overflow must end there, and not in the tasks' data.
#[test]
fn a_stack_overflow_ends_safely() {
    // The stack of 96 KiB is full after 3072 pushes of eight registers.
    let (_, _, cfsr) = ended_by(Fault::StackOverflow);
    // Either the guard refused a store, or a frame could not be stacked there: DACCVIOL, MSTKERR (DDI0403E, B3.2.15).
    assert!(cfsr & 0x12 != 0, "{cfsr:#x}");
}

#[test]
fn a_null_pointer_ends_safely() {
    let (at, pc, cfsr) = ended_by(Fault::NullPointer);
    // Expected are DACCVIOL, and MMARVALID for a known address.
    assert_eq!((pc, cfsr & 0xFFFF), (at + 2, 0x82));
}
