//! Safety promises of `hil-sim/board/tests/all/safety.rs`, kept by the image as flashed: with interrupts, DMA and the
//! processor's own time. The limits are the same, except where a comment gives the reason.
//!
//! "Off" is the moment at which no transistor of a bridge conducts; "written" is the STOP of the transfer that turns
//! all outputs of the PWM chip off. The tests print the measured times (`--nocapture`).

use crate::emulated::{
    Setup,
    harness::{
        Bench, Device, LINEAR, MS, ROTARY, SUPPLY_24, US,
        trip::{CHECK_EVERY, CHECKS, PERIOD_NS, Trip, bench_with_rod_at, nothing},
    },
};
use r4_boards::Robot;
use r4_protocol::{Cause, ChannelId, ChannelKind, Mode, SafetyState};
use r4_sim::{i2c::Disturbance, world::BoardChip};
use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

/// Time limit for writing all motor channels safe after a stop, ns.
const WRITTEN_SAFE_NS: u64 = 5 * MS;
/// Time limit of the relays' write, which switches off the motors' supply, ns.
const RELAYS_NS: u64 = MS;
/// Time limit from the handle's edge to DISABLE, ns: EXTI's interrupt, the supervisor's, its pass over all causes. The
/// measured time is below 20 µs at the emulator's 240 million instructions a second; 100 µs leave room for another
/// compiler.
const LINE_NS: u64 = 100 * US;
/// Braking time of the bench's rotary motor at a stop that leaves the board working, ns; the supervisor's next pass
/// switches it off.
const BRAKED_NS: u64 = 500 * MS + SUPERVISOR_NS;
/// Interval of the supervisor's checks of causes without a line of their own, ns.
const SUPERVISOR_NS: u64 = MS;

/// Returns the end of the first successful write to `address` after `since_ns`, relative to it, ns.
fn first_write(device: &Device, address: u8, since_ns: u64) -> Option<u64> {
    let mut writes = device.wire_since(since_ns).filter(|record| record.address == address && record.read.is_empty());
    writes.find(|record| record.fault.is_none() && !record.written.is_empty()).map(|record| record.end_ns - since_ns)
}

/// Returns the time after `since_ns` at which both bridges are off, accurate to 0.5 µs.
async fn off_after(device: &Device, since_ns: u64, limit_ns: u64) -> Option<u64> {
    loop {
        let after_ns = device.clock.now_ns() - since_ns;
        if device.is_off(ROTARY) && device.is_off(LINEAR) {
            return Some(after_ns);
        }
        if after_ns > limit_ns {
            return None;
        }
        device.clock.sleep(US / 2).await;
    }
}

/// Release of the dead-man's handle at random moments of the control loop's period and in every kind of motion.
#[test]
fn dead_man_released_at_any_moment() {
    const SEED: u64 = 0x5AFE;
    const CASES: u32 = 60;
    let mut random = Pcg64::seed_from_u64(SEED);
    let mut between = move |low: u64, high: u64| low + random.next_u64() % (high - low);
    let (mut off, mut relays, mut written) = (Vec::new(), Vec::new(), Vec::new());
    Setup::osmc_bench().with_robot(|robot| *robot = bench_with_rod_at(0.05)).bench(async |emu| {
        let device = emu.device();
        for case in 0..CASES {
            emu.host.arm().await.expect("nothing is wrong");
            let (mode, rotary, linear) = match between(0, 3) {
                0 => (Mode::Duty, 0.9, 0.78),
                1 => (Mode::Speed, 2.0, 0.008),
                _ => (Mode::Position, 6.0, 0.0),
            };
            let sign = if between(0, 2) == 0 { 1.0 } else { -1.0 };
            let linear = if mode == Mode::Position { 0.05 + sign * 0.04 } else { sign * linear };
            emu.set(ROTARY, mode, sign * rotary).await.expect("armed");
            emu.set(LINEAR, mode, linear).await.expect("armed");
            // Power is on after 50 ms; from then on both move.
            emu.clock.sleep(between(55 * MS, 75 * MS)).await;
            assert!(!emu.is_off(ROTARY), "case {case}: nothing to stop");
            device.record_wire();
            let at_ns = emu.clock.now_ns();
            emu.board.dead_man().set(false);
            let told = format!("seed {SEED:#x}, case {case}");
            off.push(off_after(&device, at_ns, LINE_NS).await.unwrap_or_else(|| panic!("{told}: not off")));
            let all_off = device.wait_all_off_written(at_ns, WRITTEN_SAFE_NS).await;
            written.push(all_off.unwrap_or_else(|| panic!("{told}: not written")));
            relays.push(first_write(&device, 0x20, at_ns).unwrap_or_else(|| panic!("{told}: relays not written")));
            emu.board.dead_man().set(true);
            emu.sleep_ms(25).await;
            emu.host.clear().await.expect("held again");
        }
    });
    let worst = |times: &[u64]| times.iter().copied().max().unwrap_or(0);
    eprintln!(
        "dead-man, {CASES} moments, at most: off {} us, relays written {} us, motors written {} us",
        worst(&off) as f64 / 1e3,
        worst(&relays) as f64 / 1e3,
        worst(&written) as f64 / 1e3
    );
    assert!(worst(&off) <= LINE_NS && worst(&relays) <= RELAYS_NS && worst(&written) <= WRITTEN_SAFE_NS);
}

fn check<I: AsyncFn(&Bench<'_>, &Robot)>(name: &str, trip: Trip<I>) {
    let setup = Setup::osmc_bench();
    trip.check_on(&|simulation, robot| setup.power_up(simulation, robot), name);
}

#[test]
fn host_stop() {
    check(
        "host stop",
        Trip {
            cause: Cause::HostStop,
            inject: async |bench, _| bench.host.stop().await.expect("a stop is always taken"),
            stays: false,
            remedy: nothing,
            off_ns: MS + BRAKED_NS,
            written_ns: Some(BRAKED_NS + WRITTEN_SAFE_NS),
            moments: 4,
        },
    );
}

/// Time limit after a bus fault, ns: the next check of the chip, then the promised 5 ms. They include the firmware's
/// three attempts of 1 ms each, and the freeing of the bus between them.
const BUS_FAULT_OFF_NS: u64 = CHECK_EVERY * PERIOD_NS + 5 * MS;

#[test]
fn sda_held_low() {
    check(
        "SDA held low",
        Trip {
            cause: Cause::I2cFault,
            inject: async |bench, _| bench.device().disturb(Disturbance::StuckLow { persistent: true }),
            stays: true,
            remedy: |device, _| device.free_bus(),
            off_ns: BUS_FAULT_OFF_NS,
            written_ns: None,
            moments: 6,
        },
    );
}

#[test]
fn chip_does_not_answer() {
    check(
        "chip does not answer",
        Trip {
            cause: Cause::I2cFault,
            inject: async |bench, _| bench.device().disturb(Disturbance::AddressNack),
            stays: true,
            remedy: |device, _| device.free_bus(),
            off_ns: BUS_FAULT_OFF_NS,
            written_ns: None,
            moments: 4,
        },
    );
}

#[test]
fn chip_lost_its_supply_for_a_moment() {
    check(
        "PWM chip without supply",
        Trip {
            cause: Cause::ReadBackMismatch,
            inject: async |bench, _| {
                assert!(bench.board.world().brown_out(BoardChip::OsmcPwm), "the bench has it");
            },
            stays: false,
            remedy: nothing,
            off_ns: 10 * US,
            written_ns: Some(CHECKS * CHECK_EVERY * PERIOD_NS + WRITTEN_SAFE_NS),
            moments: 6,
        },
    );
}

#[test]
fn supply_too_low() {
    // The supply falls from 24 V to 15 V and crosses 20 V in the 10 ms low-pass.
    let crossed_ns = (10.0 * (9.0_f64 / 5.0).ln() * 1e6) as u64;
    check(
        "24 V at 15 V",
        Trip {
            cause: Cause::SupplyOutOfRange,
            inject: async |bench, _| bench.board.world().set_emf(SUPPLY_24, 15.0),
            stays: true,
            remedy: |device, _| device.board.world().set_emf(SUPPLY_24, 24.0),
            off_ns: crossed_ns + 2 * PERIOD_NS,
            written_ns: Some(crossed_ns + 2 * PERIOD_NS + WRITTEN_SAFE_NS),
            moments: 3,
        },
    );
}

#[test]
fn host_gone_without_a_word() {
    let setup = Setup::osmc_bench();
    let timeout_ns = u64::from(setup.robot().config.link_timeout_ms) * MS;
    // The limit is that of the simulated board: the time-out and 2 ms, and a heartbeat that may still be on the cable.
    let limit_ns = timeout_ns + 2 * MS + MS / 4 + BRAKED_NS;
    let mut worst_ns = 0;
    for phase_ns in (0..6).map(|moment| moment * 8_437 * US) {
        let work = async |bench: &Bench<'_>| {
            bench.run_rotary(phase_ns).await;
            bench.device().record_wire();
        };
        let off_ns = setup.left_alone(work, async |device, ()| {
            let at_ns = device.clock.now_ns();
            let off_ns = device.wait_off(at_ns, limit_ns).await.expect("stops without a host");
            assert!(off_ns >= timeout_ns * 3 / 4 - MS + BRAKED_NS - SUPERVISOR_NS, "{off_ns} ns are no reason yet");
            assert!(device.wait_all_off_written(at_ns, limit_ns + WRITTEN_SAFE_NS).await.is_some());
            off_ns
        });
        worst_ns = worst_ns.max(off_ns);
    }
    eprintln!("host gone: off after at most {} us of {}", worst_ns / US, limit_ns / US);
}

/// Robot with every kind of output, armed, with its brushless drive and a servo commanded: each output is written safe
/// in time by its own means, and the auxiliary stop, which is polled every millisecond, works as well as the handle.
#[test]
fn the_auxiliary_stop_makes_every_output_safe() {
    let setup = Setup::new("every-interface");
    let motors: Vec<ChannelId> = setup.robot().config.motors.iter().map(|motor| motor.id).collect();
    let (mut worst_lines_ns, mut worst_ns) = (0, 0);
    setup.bench(async |emu| {
        let device = emu.device();
        for case in 0..8 {
            emu.host.arm().await.expect("nothing is wrong");
            emu.clock.sleep(100 * MS + case * 1_137 * US).await;
            for motor in motors.iter().filter(|motor| motor.kind == ChannelKind::Dhb || motor.kind == ChannelKind::Osmc)
            {
                emu.set(*motor, Mode::Duty, 0.3).await.expect("armed");
            }
            emu.sleep_ms(20).await;
            let is_off =
                || motors.iter().all(|motor| emu.board.world().drive(*motor).is_none_or(|drive| drive.coast == 1.0));
            assert!(!is_off(), "case {case}: nothing to stop");
            device.record_wire();
            let at_ns = emu.clock.now_ns();
            emu.board.auxiliary_stop().set(false);
            // The lines are down one pass of the supervisor later.
            let limit_ns = SUPERVISOR_NS + LINE_NS;
            let lines_ns = device.wait_until(at_ns, limit_ns, is_off).await;
            worst_lines_ns = worst_lines_ns.max(lines_ns.unwrap_or_else(|| panic!("case {case}: not off")));
            let all_off = |address| {
                let written = |device: &Device| {
                    device
                        .wire_since(at_ns)
                        .find(|record| {
                            record.address == address && record.fault.is_none() && record.written == [0xFD, 0x10]
                        })
                        .map(|record| record.end_ns - at_ns)
                };
                written(&device)
            };
            let chips = [setup.robot().config.osmc_pwm, setup.robot().config.dhb_pwm];
            for address in chips.into_iter().flatten().map(|chip| chip.address) {
                let done =
                    device.wait_until(at_ns, SUPERVISOR_NS + WRITTEN_SAFE_NS, || all_off(address).is_some()).await;
                assert!(done.is_some(), "case {case}: {address:#x} not written");
                worst_ns = worst_ns.max(all_off(address).unwrap_or(u64::MAX));
            }
            assert_eq!(emu.safety().await.0, SafetyState::Tripped);
            assert!(emu.safety().await.1.contains(Cause::AuxiliaryStop));
            emu.board.auxiliary_stop().set(true);
            emu.sleep_ms(25).await;
            emu.host.clear().await.expect("released");
        }
    });
    eprintln!(
        "auxiliary stop: off after at most {} us, written after at most {} us",
        worst_lines_ns / US,
        worst_ns / US
    );
}
