//! What the image keeps in the chip's flash: over restarts, over power cuts in each step of a save, and with words whose
//! error correction fails.

use std::pin::pin;

use crate::emulated::{
    BOOT_MS, Setup,
    harness::{HostClock, MS, within},
};
use r4_driver::Board;
use r4_protocol::{Causes, Parameter, ParameterKey, Reply, Request};
use r4_sim::flash::{Flash, Tear};

const TIMEOUT: ParameterKey = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };

/// A name and a number, which are saved together and which a board tells in its first answer.
type Kept = (&'static str, u16);
const BUILT_IN: Kept = ("osmc-bench", 200);
const OLD: Kept = ("Ada", 400);
const NEW: Kept = ("Grace", 500);

/// Starts a board with `flash`, and gives what it starts with.
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

/// What is in flash after a save on a board that had `flash`, and how many steps that took.
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

/// What the board has kept, with its power on again.
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

/// A restart that the host asks for: the processor resets, the world and the cable stay.
#[test]
fn parameters_survive_a_restart_that_the_host_asks_for() {
    let (flash, _) = save(None, OLD);
    let (_, misuse) = Setup::osmc_bench().with_flash(flash).raw(async |host, _, _| {
        host.hello().await;
        let set = Request::SetParameter { key: TIMEOUT, value: NEW.1.into() };
        host.ask(set).await.expect("in range");
        assert_eq!(host.ask(Request::Restart).await, Ok(Reply::Done));
        // The answer, 20 ms later the reset, and the start.
        host.listen(20 + BOOT_MS).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        // Not a bad end: nothing is tripped. What was not saved is forgotten.
        assert_eq!(info.causes, Causes::NONE);
        assert!(info.device_us < 150_000, "its clock began anew: {} us", info.device_us);
        assert_eq!((&info.robot[..], info.link_timeout_ms), OLD);
    });
    // The reset may fall into the read-back of a chip, which then holds a bit that nobody reads.
    let cut = |line: &&String| line.contains("read of no bytes");
    assert_eq!(misuse.iter().filter(|line| !cut(line)).collect::<Vec<_>>(), Vec::<&String>::new());
    assert!(misuse.iter().filter(cut).count() <= 1, "{misuse:?}");
}

/// The power goes in each step of a save: the next start has the old or the new, all of it, and a save works again.
#[test]
fn a_power_cut_in_any_step_of_a_save_leaves_the_old_or_the_new() {
    const TEARS: [Tear; 5] =
        [Tear::Nothing, Tear::Unreadable, Tear::FirstHalf, Tear::SecondHalf, Tear::Bits { seed: 1 }];
    let (old, _) = save(None, OLD);
    // On a flash that has been used; and on a new one, which is erased first, for a second: not with all of them.
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
                // Nobody answers any more: the chip has no power either.
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
        // The item counts once its last word is whole, and not before.
        assert!(seen[0] > 0);
    }
}

/// Words with two wrong bits read as a bus error on the chip. The firmware reads the flash at its start and must take each
/// such word for lost, never for a fault.
#[test]
fn words_that_fail_their_error_correction_do_not_fault() {
    const SECTOR_BYTES: u32 = 128 * 1024;
    let (whole, _) = save(None, OLD);
    // The first words, where the marks and the item are; then whole sectors of parameters and of trips.
    let first = (0..4).map(|word| (32 * word, 1));
    let sectors = (0..4).map(|sector| (sector * SECTOR_BYTES, SECTOR_BYTES / 32));
    for (address, words) in first.chain(sectors) {
        let mut flash = whole.clone();
        flash.spoil(address, words);
        let told = start(flash);
        assert!(told == OLD || told == BUILT_IN, "{words} words at {address:#x}: {told:?}");
        // What is in other sectors does no harm.
        assert!(told == OLD || address < SECTOR_BYTES, "{words} words at {address:#x}: {told:?}");
    }
}
