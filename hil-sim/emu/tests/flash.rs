//! What the image keeps in the chip's flash: over restarts, over power cuts in each step of a save, and with words whose
//! error correction fails.

mod emulated;

use std::pin::pin;

use emulated::{
    Setup,
    harness::{HostClock, MS, ROTARY, within},
};
use r4_driver::Board;
use r4_protocol::{Parameter, ParameterKey};
use r4_sim::flash::{Flash, Tear};

const KP: ParameterKey = ParameterKey { channel: Some(ROTARY), parameter: Parameter::PositionKp };
const NAME: &str = "Ada";

async fn active(host: &Board<HostClock>, key: ParameterKey) -> f32 {
    let all = host.parameters().await.expect("they are told");
    all.into_iter().find(|info| info.key == key).expect("the bench has it").active
}

/// Starts a board with `flash`, and gives the gain and the name that it starts with.
fn start(flash: Flash) -> (f32, String) {
    let (told, misuse) = Setup::osmc_bench().with_flash(flash).bench_with_misuse(async |emu| {
        assert!(emu.board.failure().is_none());
        (active(emu.host, KP).await, emu.host.info().robot.to_string())
    });
    assert_eq!(misuse, Vec::<String>::new());
    told
}

/// What is in flash after a save of `kp` on a board that had `flash`, and how many steps that took.
fn save(flash: Option<Flash>, kp: f32) -> (Flash, u64) {
    let setup = Setup::osmc_bench();
    let setup = match flash {
        Some(flash) => setup.with_flash(flash),
        None => setup,
    };
    let steps = setup.bench(async |emu| {
        emu.host.set_parameter(KP, kp).await.expect("in range");
        emu.host.set_name(NAME).await.expect("short");
        let before = emu.board.flash().steps();
        emu.host.save_parameters().await.expect("there is room");
        emu.board.flash().steps() - before
    });
    (kept(&setup), steps)
}

fn saved(flash: Option<Flash>, kp: f32) -> Flash {
    save(flash, kp).0
}

/// What the board has kept, with its power on again.
fn kept(setup: &Setup) -> Flash {
    let mut flash = setup.last().flash().clone();
    flash.power_up();
    flash
}

#[test]
fn parameters_survive_a_power_cycle() {
    let flash = saved(None, 5.5);
    assert!(flash.programmed_twice().is_empty());
    assert_eq!(start(flash), (5.5, NAME.to_owned()));
}

/// A restart that the host asks for: the processor resets, the world and the cable stay.
#[test]
fn parameters_survive_a_restart_that_the_host_asks_for() {
    use r4_protocol::{Reply, Request};
    let (_, misuse) = Setup::osmc_bench().raw(async |host, device, board| {
        host.hello().await;
        host.ask(Request::SetParameter { key: KP, value: 5.5 }).await.expect("in range");
        assert_eq!(host.ask(Request::Restart).await, Ok(Reply::Done));
        device.clock.sleep(100 * MS).await;
        host.listen(1).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        // Not a bad end: nothing is tripped.
        assert_eq!(info.causes, r4_protocol::Causes::NONE);
        assert!(info.device_us < 200_000, "its clock began anew: {} us", info.device_us);
        assert!(board.flash().steps() == 0, "nothing was saved");
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// The power goes in each step of a save: the next start has the old or the new, all of it, and a save works again.
#[test]
fn a_power_cut_in_any_step_of_a_save_leaves_the_old_or_the_new() {
    const TEARS: [Tear; 6] = [
        Tear::Nothing,
        Tear::Unreadable,
        Tear::FirstHalf,
        Tear::SecondHalf,
        Tear::Bits { seed: 1 },
        Tear::Bits { seed: 2 },
    ];
    let old = saved(None, 5.5);
    let (_, steps) = save(Some(old.clone()), 6.5);
    let mut seen = [0, 0];
    for step in 0..steps {
        for tear in TEARS {
            let setup = Setup::osmc_bench().with_flash(old.clone());
            let (_, misuse) = setup.bench_with_misuse(async |emu| {
                emu.host.set_parameter(KP, 6.5).await.expect("in range");
                emu.board.flash().cut_after(step, tear);
                // Nobody answers any more: the chip has no power either.
                let mut save = pin!(emu.host.save_parameters());
                while emu.board.flash().has_power() {
                    if within(&emu.clock, MS / 10, save.as_mut()).await.is_some() {
                        break;
                    }
                }
                assert!(!emu.board.flash().has_power(), "step {step}: there is no such step");
            });
            assert_eq!(misuse, Vec::<String>::new(), "step {step}, {tear:?}");
            let flash = kept(&setup);
            let (kp, name) = start(flash.clone());
            assert!(kp == 5.5 || kp == 6.5, "step {step}, {tear:?}: {kp}");
            assert_eq!(name, NAME, "step {step}, {tear:?}");
            seen[usize::from(kp == 6.5)] += 1;
            if tear == Tear::Unreadable {
                assert_eq!(start(saved(Some(flash), 7.5)), (7.5, NAME.to_owned()), "step {step}, {tear:?}");
            }
        }
    }
    eprintln!("{steps} steps, {} tears each: old after {}, new after {}", TEARS.len(), seen[0], seen[1]);
    assert!(seen[0] > 0, "no cut came before the end");
}

/// Words with two wrong bits read as a bus error on the chip. The firmware reads the whole flash at its start and must take
/// each such word for lost, never for a fault.
#[test]
fn words_that_fail_their_error_correction_do_not_fault() {
    let whole = saved(None, 5.5);
    let robot = r4_boards::load("osmc-bench").expect("built in").config;
    // The first words, where the marks and the item are; then whole sectors of parameters and of trips.
    let first = (0..4).map(|word| (32 * word, 1));
    let sectors = (0..4).map(|sector| (sector * 128 * 1024, 128 * 1024 / 32));
    for (address, words) in first.chain(sectors) {
        let mut flash = whole.clone();
        flash.spoil(address, words);
        let (kp, name) = start(flash);
        let built_in = (4.0, &robot.robot[..]);
        let told = (kp, &name[..]);
        assert!(told == (5.5, NAME) || told == built_in, "{words} words at {address:#x}: {told:?}");
        // What is in other sectors does no harm.
        if address >= 128 * 1024 {
            assert_eq!(told, (5.5, NAME), "{words} words at {address:#x}");
        }
    }
}
