//! Firmware that hangs, faults or overflows its stack: in every case the outputs go safe by themselves, and the next start
//! knows why. The program is broken from outside, as a debugger would: an instruction of the image is overwritten in the
//! middle of the run.

use crate::emulated::{
    Board, LOOP_FOR_EVER, Setup, UNDEFINED, address_of,
    harness::{Device, LINEAR, MS, ROTARY, RawHost, US},
    patch,
};
use r4_mcu::{Chip, Level, Pin};
use r4_protocol::{Cause, Causes, Mode, Refusal, Reply, Request, SafetyState, Setpoint, ToDevice};

/// The watchdog's period: 104 times 4 cycles of 32 kHz (see `watchdog.rs` of the firmware), exact here.
const WATCHDOG_NS: u64 = 13 * MS;
/// It is fed this often.
const FEED_NS: u64 = 10 * MS;
/// The supervisor runs this often: a hang shows at its next run.
const SUPERVISOR_NS: u64 = MS;
/// From the reset to the first instruction that drives the stop lines, behind start-up's clearing of 100 KB. The lines float meanwhile, and the carrier's resistors hold the bridges off.
const CLAIM_NS: u64 = 2 * MS;
/// The control loop counts as dead after five periods without an end, seen at the supervisor's next look.
const CONTROL_DEAD_NS: u64 = MS + 5 * MS + 2 * MS;

/// Where the control task goes on in each of its periods, each time that it is woken there.
const CONTROL: &str = "r4_firmware::control::task::Control<B,P>::tick::{{closure}}";

/// Backup registers that hold the record of an end (see `reset.rs` of the firmware): PC or location, and CFSR or line.
const RECORD_PC: usize = 17;
const RECORD_DETAIL: usize = 19;

/// Gets the rotary motor to run for a host without a driver; its session's number.
async fn run_rotary(host: &mut RawHost, device: &Device) -> u16 {
    let info = host.hello().await;
    host.ask(Request::Arm).await.expect("nothing is wrong");
    let setpoint = Setpoint { mode: Mode::Duty, value: 0.8 };
    host.ask(Request::Set { channel: ROTARY, setpoint, sent_us: info.device_us, ttl_ms: 500 }).await.expect("armed");
    keep_alive(host, info.session, 200).await;
    assert!(!device.is_off(ROTARY), "it must run before it can be stopped");
    info.session
}

/// Heartbeats for `ms`, four in each link timeout.
async fn keep_alive(host: &mut RawHost, session: u16, ms: u64) {
    for _ in 0..ms / 50 {
        host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
        host.listen(50).await;
    }
}

/// The moment at which both bridges are off, to 1 us.
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

/// How the chip drives DISABLE of the bridges.
fn disable(board: &Board) -> Level {
    let carrier = r4_boards::load_carrier("r4-carrier").expect("built in");
    let pin = carrier.pin("osmc_dis").expect("it has it").stm32;
    board.machine().chip.gpio().driven(Pin::new(pin.port, pin.number))
}

/// After a bad end the board is tripped by the watchdog's cause, is left by clearing, and works as new.
async fn starts_tripped_and_works(host: &mut RawHost, device: &Device, board: &Board) {
    // What was under way on the cable when the processor ended is a damaged frame.
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

/// However the supervisor hangs: in its own interrupt, with all interrupts off, or because no time comes to it any more.
#[test]
fn a_hung_supervisor_is_reset_by_the_watchdog() {
    // cpsid i; b .
    const MASKED: [u8; 4] = [0x72, 0xB6, 0xFE, 0xE7];
    let (mut worst_ns, mut worst_claim_ns) = (0, 0);
    for (function, code) in [("SAI1", &LOOP_FOR_EVER[..]), ("SAI1", &MASKED[..]), ("TIM5", &LOOP_FOR_EVER[..])] {
        for phase_us in [0, 400] {
            let (_, misuse) = Setup::osmc_bench().raw(async |host, device, board| {
                run_rotary(host, device).await;
                device.clock.sleep(phase_us * US).await;
                let at = address_of(board, function);
                let mut code4 = patch(board, at, [0; 4]);
                let before = code4;
                code4[..code.len()].copy_from_slice(code);
                patch(board, at, code4);
                let at_ns = device.clock.now_ns();
                let limit_ns = SUPERVISOR_NS + WATCHDOG_NS;
                let off_ns = off_after(device, at_ns, limit_ns).await;
                let off_ns = off_ns.unwrap_or_else(|| panic!("{function}: not off after {limit_ns} ns"));
                assert!(
                    off_ns >= WATCHDOG_NS - FEED_NS - SUPERVISOR_NS,
                    "{function}: {off_ns} ns are before the watchdog's time"
                );
                // What hung is whole again: the same program as after a passing fault.
                patch(board, at, before);
                let reset_ns = device.clock.now_ns();
                let claimed = device.wait_until(reset_ns, CLAIM_NS, || disable(board) == Level::High).await;
                worst_claim_ns = worst_claim_ns.max(claimed.expect("the start drives the line"));
                worst_ns = worst_ns.max(off_ns);
                starts_tripped_and_works(host, device, board).await;
            });
            assert_eq!(misuse, Vec::<String>::new(), "{function}");
        }
    }
    eprintln!(
        "hung supervisor: outputs off after at most {} us, DISABLE driven {} us after the reset",
        worst_ns / US,
        worst_claim_ns / US
    );
}

/// The control task alone: the supervisor sees it, and no reset is needed.
#[test]
fn a_hung_control_task_trips_without_a_reset() {
    let mut worst_ns = 0;
    for phase_us in [0, 250, 500, 750] {
        Setup::osmc_bench().raw(async |host, device, board| {
            run_rotary(host, device).await;
            device.clock.sleep(phase_us * US).await;
            let at = address_of(board, CONTROL);
            let before = patch(board, at, LOOP_FOR_EVER);
            let at_ns = device.clock.now_ns();
            let off_ns = off_after(device, at_ns, CONTROL_DEAD_NS).await;
            worst_ns = worst_ns.max(off_ns.expect("the supervisor drives DISABLE"));
            // The lights follow the lines, in the same pass of the supervisor.
            device.clock.sleep(100 * US).await;
            assert!(board.lights().red && !board.lights().green);
            // For as long as it hangs, far beyond the watchdog's time; it is not reset, and goes on when it is let go.
            device.clock.sleep(3 * WATCHDOG_NS).await;
            assert_eq!(disable(board), Level::High);
            patch(board, at, before);
            // The time without heartbeats was below the link's timeout.
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

/// Breaks the control task with `code` in the middle of a run; where that is, and two registers of the record.
async fn end(host: &mut RawHost, device: &Device, board: &Board, name: &str, code: &[u8]) -> (u32, u32, u32) {
    run_rotary(host, device).await;
    let at = address_of(board, CONTROL);
    let write = |bytes: &[u8]| board.machine().chip.memory().write_slice(at, bytes).expect("code is in flash");
    let mut before = vec![0; code.len()];
    board.machine().chip.memory().read_slice(at, &mut before).expect("code is in flash");
    write(code);
    let at_ns = device.clock.now_ns();
    // At its next run, which is a period away at most. The handler drives the lines first; a stack has to fill before.
    let off_ns = off_after(device, at_ns, 2 * MS).await;
    let off_ns = off_ns.unwrap_or_else(|| panic!("{name}: the outputs are not off"));
    write(&before);
    eprintln!("{name}: outputs off after {} us", off_ns / US);
    starts_tripped_and_works(host, device, board).await;
    let register = |index| board.machine().chip.backup_register(index).expect("0 to 31");
    (at, register(RECORD_PC), register(RECORD_DETAIL))
}

fn ended_by(name: &str, code: &[u8]) -> (u32, u32, u32) {
    Setup::osmc_bench().raw(async |host, device, board| end(host, device, board, name, code).await).0
}

#[test]
fn a_fault_stops_leaves_a_record_and_restarts() {
    let (at, pc, cfsr) = ended_by("undefined instruction", &UNDEFINED);
    // CFSR: UNDEFINSTR is bit 16 (DDI0403E, B3.2.15).
    assert_eq!((pc, cfsr), (at, 1 << 16));
}

#[test]
fn a_panic_stops_leaves_a_record_and_restarts() {
    // A location as rustc makes it: the file's name (pointer, length), line, column; in a part of flash that is not used.
    const LOCATION: u32 = 0x080F_0000;
    const LINE: u32 = 4711;
    let panics = {
        let setup = Setup::osmc_bench();
        let (address, _) =
            setup.raw(async |_, _, board| address_of(board, "core::panicking::panic_const::panic_const_div_by_zero"));
        address
    };
    // movw r0, #0; movt r0, #0x080F; movw r3, #low; movt r3, #high; bx r3 (A7.7.76, A7.7.79, A7.7.20).
    let mov = |register: u32, value: u32, top: bool| {
        let first = if top { 0xF2C0 } else { 0xF240 } | value >> 12 & 0xF | (value >> 11 & 1) << 10;
        let second = (value >> 8 & 7) << 12 | register << 8 | value & 0xFF;
        (first | second << 16).to_le_bytes()
    };
    let mut code = Vec::new();
    for (register, value) in [(0, LOCATION), (3, panics | 1)] {
        code.extend(mov(register, value & 0xFFFF, false));
        code.extend(mov(register, value >> 16, true));
    }
    code.extend(0x4718_u16.to_le_bytes());
    let (result, _) = Setup::osmc_bench()
        .prepared(|board| {
            let machine = board.machine();
            let memory = machine.chip.memory();
            let words: Vec<u8> =
                [LOCATION + 16, 7, LINE, 1].into_iter().flat_map(u32::to_le_bytes).chain(*b"hung.rs").collect();
            memory.write_slice(LOCATION, &words).expect("flash");
        })
        .raw(async |host, device, board| end(host, device, board, "panic", &code).await);
    let (_, location, line) = result;
    assert_eq!((location, line), (LOCATION, LINE));
}

/// The stack ends at a guard that nobody may write, and must end there, and not in what the tasks know.
#[test]
fn a_stack_overflow_ends_safely() {
    // push {r0-r7}; b to it (A7.7.101, A7.7.12): 96 KiB are full after 3072 times.
    let (_, _, cfsr) = ended_by("stack overflow", &[0xFF, 0xB4, 0xFD, 0xE7]);
    // A store that the guard refused, or a frame that could not be stacked there: DACCVIOL, MSTKERR (DDI0403E, B3.2.15).
    assert!(cfsr & 0x12 != 0, "{cfsr:#x}");
}

#[test]
fn a_null_pointer_ends_safely() {
    // movs r0, #0; ldr r0, [r0, #64] (A7.7.76, A7.7.43): a field of a structure that is not there.
    let (at, pc, cfsr) = ended_by("null pointer", &[0x00, 0x20, 0x00, 0x6C]);
    // DACCVIOL; MMARVALID says that its address is known.
    assert_eq!((pc, cfsr & 0xFFFF), (at + 2, 0x82));
}
