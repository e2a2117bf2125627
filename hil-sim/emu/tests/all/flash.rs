//! Storage of the image in the chip's flash: over restarts, over power cuts in each step of a save, and with words
//! whose error correction fails.

use std::pin::pin;

use crate::emulated::{
    BOOT_MS, Setup,
    harness::{HostClock, MS, within},
};
use r4_driver::Board;
use r4_protocol::{Causes, Parameter, ParameterKey, Reply, Request};
use r4_sim::flash::{Flash, Tear};

const TIMEOUT: ParameterKey = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };

/// Robot name and link time-out, which are saved together and reported in the board's first answer.
type Kept = (&'static str, u16);
const BUILT_IN: Kept = ("osmc-bench", 200);
const OLD: Kept = ("Ada", 400);
const NEW: Kept = ("Grace", 500);

/// Starts a board with `flash`; returns the values it starts with.
fn start(flash: Flash) -> Kept {
    let (told, misuse) = Setup::osmc_bench().with_flash(flash).bench_with_misuse(async |emu| {
        assert_eq!(emu.board.failure(), None);
        let info = emu.host.info();
        let known = [BUILT_IN, OLD, NEW].into_iter().find(|kept| *kept == (&info.robot[..], info.link_timeout_ms));
        known.unwrap_or_else(|| panic!("{} and {} ms were never kept", info.robot, info.link_timeout_ms))
    });
    assert_eq!(misuse, Vec::<String>::new());
    told
}

async fn change(host: &Board<HostClock>, (name, timeout_ms): Kept) {
    host.set_parameter(TIMEOUT, timeout_ms.into()).await.expect("in range");
    host.set_name(name).await.expect("short");
}

/// Saves on a board with `flash`; returns the flash afterwards and the number of steps.
fn save(flash: Option<Flash>, kept_then: Kept) -> (Flash, u64) {
    let setup = Setup::osmc_bench();
    let setup = match flash {
        Some(flash) => setup.with_flash(flash),
        None => setup,
    };
    let steps = setup.bench(async |emu| {
        change(emu.host, kept_then).await;
        let before = emu.board.flash().steps();
        emu.host.save_parameters().await.expect("there is room");
        emu.board.flash().steps() - before
    });
    (kept(&setup), steps)
}

/// Returns the flash of the last board, with its power on again.
fn kept(setup: &Setup) -> Flash {
    let mut flash = setup.last().flash().clone();
    flash.power_up();
    flash
}

#[test]
fn parameters_survive_a_power_cycle() {
    let (flash, _) = save(None, OLD);
    assert!(flash.programmed_twice().is_empty());
    assert_eq!(start(flash), OLD);
}

/// A restart at the host's request: the processor resets; the world and the cable stay.
#[test]
fn parameters_survive_a_restart_that_the_host_asks_for() {
    let (flash, _) = save(None, OLD);
    let (_, misuse) = Setup::osmc_bench().with_flash(flash).raw(async |host, _, _| {
        host.hello().await;
        let set = Request::SetParameter { key: TIMEOUT, value: NEW.1.into() };
        host.ask(set).await.expect("in range");
        assert_eq!(host.ask(Request::Restart).await, Ok(Reply::Done));
        // The answer comes first, 20 ms later the reset, then the start.
        host.listen(20 + BOOT_MS).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        // The end was not a bad one, so nothing is tripped. Unsaved changes are lost.
        assert_eq!(info.causes, Causes::NONE);
        assert!(info.device_us < 150_000, "its clock began anew: {} us", info.device_us);
        assert_eq!((&info.robot[..], info.link_timeout_ms), OLD);
    });
    // The reset may interrupt the read-back of a chip, which then holds a bit that is not clocked out.
    let cut = |line: &&String| line.contains("read of no bytes");
    assert_eq!(misuse.iter().filter(|line| !cut(line)).collect::<Vec<_>>(), Vec::<&String>::new());
    assert!(misuse.iter().filter(cut).count() <= 1, "{misuse:?}");
}

/// The power fails in each step of a save: the next start has the old or the new values, complete, and saving works
/// again.
#[test]
fn a_power_cut_in_any_step_of_a_save_leaves_the_old_or_the_new() {
    const TEARS: [Tear; 5] =
        [Tear::Nothing, Tear::Unreadable, Tear::FirstHalf, Tear::SecondHalf, Tear::Bits { seed: 1 }];
    let (old, _) = save(None, OLD);
    // The cases run on a used flash; on a new one, whose erasure takes a second, only one kind of tear is tried.
    for (flash, before, tears) in [(Some(old), OLD, &TEARS[..]), (None, BUILT_IN, &TEARS[1..2])] {
        let (_, steps) = save(flash.clone(), NEW);
        let mut seen = [0, 0];
        for (step, tear) in (0..steps).flat_map(|step| tears.iter().map(move |tear| (step, *tear))) {
            let told = format!("from {before:?}, step {step}, {tear:?}");
            let setup = match &flash {
                Some(flash) => Setup::osmc_bench().with_flash(flash.clone()),
                None => Setup::osmc_bench(),
            };
            let (_, misuse) = setup.bench_with_misuse(async |emu| {
                change(emu.host, NEW).await;
                emu.board.flash().cut_after(step, tear);
                // The board cannot answer any more: its chip has no power either.
                let mut save = pin!(emu.host.save_parameters());
                while emu.board.flash().has_power() {
                    if within(&emu.clock, MS / 5, save.as_mut()).await.is_some() {
                        break;
                    }
                }
                assert!(!emu.board.flash().has_power(), "{told}: there is no such step");
            });
            assert_eq!(misuse, Vec::<String>::new(), "{told}");
            let flash = kept(&setup);
            let kept = start(flash.clone());
            assert!(kept == before || kept == NEW, "{told}: {kept:?}");
            seen[usize::from(kept == NEW)] += 1;
            if tear == Tear::Unreadable && before == OLD {
                assert_eq!(start(save(Some(flash), NEW).0), NEW, "{told}");
            }
        }
        eprintln!(
            "{steps} steps from {before:?}, {} tears each: old after {}, new after {}",
            TEARS.len(),
            seen[0],
            seen[1]
        );
        // The item becomes valid when its last word is complete, and not before.
        assert!(seen[0] > 0);
    }
}

/// Words with two wrong bits cause a bus error on the chip. The firmware reads the flash at its start and must treat
/// each such word as lost, not as a fault.
#[test]
fn words_that_fail_their_error_correction_do_not_fault() {
    const SECTOR_BYTES: u32 = 128 * 1024;
    let (whole, _) = save(None, OLD);
    // Cases: the first words, with the marks and the item; then whole sectors of parameters and of trips.
    let first = (0..4).map(|word| (32 * word, 1));
    let sectors = (0..4).map(|sector| (sector * SECTOR_BYTES, SECTOR_BYTES / 32));
    for (address, words) in first.chain(sectors) {
        let mut flash = whole.clone();
        flash.spoil(address, words);
        let told = start(flash);
        assert!(told == OLD || told == BUILT_IN, "{words} words at {address:#x}: {told:?}");
        // Damage in other sectors does no harm.
        assert!(told == OLD || address < SECTOR_BYTES, "{words} words at {address:#x}: {told:?}");
    }
}
