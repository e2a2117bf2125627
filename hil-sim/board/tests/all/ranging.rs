//! The ranging task on virtual time, with range sensors as the HC-SR04's datasheet describes them.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop where it stands")]

use std::{cell::RefCell, rc::Rc};

use r4_firmware::{
    platform::{EchoState, Ranging},
    ranging,
    sensing::range::RangeReading,
};
use r4_protocol::{ChannelId, ChannelKind, Quality, Range, config::RangeConfig};
use r4_sim::{Clock, Simulation};

const US: u64 = 1_000;
const MS: u64 = 1_000_000;
/// Shortest time between pings by the datasheet, ns.
const SPACING_NS: u64 = 60 * MS;
/// Time from the end of the trigger to the rise of the echo, ns.
const DELAY_NS: u64 = 500 * US;
/// Width of an echo without a target, ns.
const TIME_OUT_NS: u64 = 38 * MS;
/// Longest delay of the task, ns: its period, and the rounding of a wait.
const LATE_NS: u64 = MS + 10 * US;

/// Target or fault of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Front {
    /// A target at this distance, m, in air of 20 °C.
    Target(f64),
    Nothing,
    Unplugged,
    /// The echo line is shorted to the supply.
    Shorted,
    /// A clone without a target: the echo is high for 200 ms.
    Slow,
}

struct Sensor {
    front: Front,
    triggered_ns: Option<u64>,
    /// Last pulse of its echo line: rise and fall, ns.
    pulse_ns: Option<(u64, u64)>,
    cleared_ns: u64,
}

/// The sensors, by connector, and their records.
struct Bench {
    clock: Clock,
    sensors: Vec<Sensor>,
    /// Sensor, end, ns, and length, ns, of each trigger.
    triggers: Vec<(usize, u64, u64)>,
    /// Number of triggers while the sensor's echo was high.
    ignored: usize,
    /// Index in the configuration, time, ns, and the published reading.
    published: Vec<(usize, u64, RangeReading)>,
}

struct Hardware(Rc<RefCell<Bench>>);

impl Ranging for Hardware {
    fn trigger(&mut self, index: u8, high: bool) {
        let mut bench = self.0.borrow_mut();
        let now_ns = bench.clock.now_ns();
        let index = usize::from(index);
        let sensor = &mut bench.sensors[index];
        if high {
            sensor.triggered_ns = Some(now_ns);
            return;
        }
        let length_ns = now_ns - sensor.triggered_ns.take().unwrap();
        let busy = sensor.pulse_ns.is_some_and(|(rise_ns, fall_ns)| (rise_ns..fall_ns).contains(&now_ns));
        let width_ns = match sensor.front {
            // there and back at 331.3 + 0.606 · 20 m/s
            Front::Target(distance_m) => Some((distance_m * 2e9 / 343.42) as u64),
            Front::Nothing => Some(TIME_OUT_NS),
            Front::Slow => Some(200 * MS),
            Front::Unplugged | Front::Shorted => None,
        };
        if let (Some(width_ns), false) = (width_ns, busy) {
            sensor.pulse_ns = Some((now_ns + DELAY_NS, now_ns + DELAY_NS + width_ns));
        }
        bench.ignored += usize::from(busy);
        bench.triggers.push((index, now_ns, length_ns));
    }

    fn clear(&mut self, index: u8) {
        let mut bench = self.0.borrow_mut();
        let now_ns = bench.clock.now_ns();
        bench.sensors[usize::from(index)].cleared_ns = now_ns;
    }

    fn echo(&mut self, index: u8) -> EchoState {
        let bench = self.0.borrow();
        let now_ns = bench.clock.now_ns();
        let sensor = &bench.sensors[usize::from(index)];
        let us = |ns: u64| (ns / US) as u32;
        match sensor.pulse_ns {
            _ if sensor.front == Front::Shorted => EchoState::High { since_us: us(now_ns - sensor.cleared_ns) },
            Some((rise_ns, fall_ns)) if (rise_ns..fall_ns).contains(&now_ns) => {
                EchoState::High { since_us: us(now_ns - rise_ns.max(sensor.cleared_ns)) }
            }
            Some((rise_ns, fall_ns)) if rise_ns >= sensor.cleared_ns && fall_ns <= now_ns => {
                EchoState::Done { width_us: us(fall_ns - rise_ns) }
            }
            _ => EchoState::Idle,
        }
    }
}

/// Sensors up to 4 m that stop below 0.5 m, with one of `fronts` each; the configuration lists them last connector
/// first.
struct Rig {
    simulation: Simulation,
    bench: Rc<RefCell<Bench>>,
    config: Vec<RangeConfig>,
}

impl Rig {
    fn new(fronts: &[Front]) -> Self {
        let mut simulation = Simulation::default();
        let sensors =
            fronts.iter().map(|front| Sensor { front: *front, triggered_ns: None, pulse_ns: None, cleared_ns: 0 });
        let bench = Rc::new(RefCell::new(Bench {
            clock: simulation.clock(),
            sensors: sensors.collect(),
            triggers: Vec::new(),
            ignored: 0,
            published: Vec::new(),
        }));
        let config = |index| RangeConfig {
            id: ChannelId::new(ChannelKind::Range, index),
            range_m: Range::new(0.02, 4.0),
            stop_below_m: Some(0.5),
        };
        let config: Vec<_> = (0..fronts.len() as u8).rev().map(config).collect();
        let (hardware, seen, configured) = (Hardware(bench.clone()), bench.clone(), config.clone());
        simulation.spawn(async move {
            let publish = |place, reading| {
                let mut bench = seen.borrow_mut();
                let now_ns = bench.clock.now_ns();
                bench.published.push((place, now_ns, reading));
            };
            ranging::run(&configured, 20.0, hardware, publish).await;
        });
        Self { simulation, bench, config }
    }

    fn run(&mut self, ns: u64) {
        let clock = self.simulation.clock();
        self.simulation.block_on(clock.sleep(ns)).unwrap();
    }

    /// Readings published for the sensor at connector `index`, with their times, ns.
    fn published(&self, index: usize) -> Vec<(u64, RangeReading)> {
        let place = self.config.iter().position(|config| usize::from(config.id.index) == index).unwrap();
        let bench = self.bench.borrow();
        bench.published.iter().filter(|(of, ..)| *of == place).map(|(_, at_ns, reading)| (*at_ns, *reading)).collect()
    }
}

#[test]
fn sensors_take_turns_and_leave_echoes_time_to_die_away() {
    use Front::{Nothing, Slow, Target, Unplugged};
    for fronts in [&[Target(1.0)][..], &[Slow], &[Target(0.1), Nothing], &[Target(3.9), Unplugged, Slow, Target(2.0)]] {
        let mut rig = Rig::new(fronts);
        rig.run(10_000 * MS);
        let bench = rig.bench.borrow();
        assert_eq!(bench.ignored, 0, "a sensor whose echo is high is not triggered");
        assert!(bench.triggers[0].1 >= SPACING_NS, "echoes from before the start");
        for pair in bench.triggers.windows(2) {
            assert!(pair[1].1 - pair[0].1 >= SPACING_NS, "{pair:?}");
        }
        assert!(bench.triggers.iter().all(|(_, _, length_ns)| (10 * US..MS).contains(length_ns)));
        // Each has its turn in the order of the configuration, as often as the spacing allows; a turn is late by the
        // trigger and the rounding of one wait, so ten seconds include the last of 166 turns or not.
        let places: Vec<_> = bench.published.iter().map(|(place, ..)| *place).collect();
        assert!(places.iter().enumerate().all(|(turn, place)| turn % fronts.len() == *place), "{places:?}");
        assert!((164..=166).contains(&places.len()), "{} turns", places.len());
    }
}

#[test]
fn readings_are_published_when_their_echoes_end() {
    let mut rig = Rig::new(&[Front::Target(0.8), Front::Target(3.5), Front::Nothing]);
    rig.run(2_000 * MS);
    for (index, distance_m) in [(0, Some(0.8)), (1, Some(3.5)), (2, None)] {
        let width_ns = distance_m.map_or(TIME_OUT_NS, |distance_m| (distance_m * 2e9 / 343.42) as u64);
        let triggers: Vec<_> = rig.bench.borrow().triggers.iter().filter(|(of, ..)| *of == index).copied().collect();
        let published = rig.published(index);
        assert!(published.len() >= 10 && triggers.len() >= published.len());
        for ((_, triggered_ns, _), (at_ns, reading)) in triggers.into_iter().zip(published) {
            let end_ns = triggered_ns + DELAY_NS + width_ns;
            assert!((end_ns..=end_ns + LATE_NS).contains(&at_ns), "sensor {index}: {} ns late", at_ns - end_ns);
            assert_eq!(reading.updated.as_micros(), at_ns / US);
            match distance_m {
                // 1 us of resolution is 0.17 mm
                Some(distance_m) => assert!((f64::from(reading.distance_m) - distance_m).abs() < 2e-4, "{reading:?}"),
                None => assert_eq!(reading.quality, Quality::OutOfRange),
            }
            assert!(!reading.stop);
        }
    }
}

#[test]
fn something_near_stops_with_its_first_reading() {
    let mut rig = Rig::new(&[Front::Target(2.0), Front::Nothing, Front::Target(1.0), Front::Nothing]);
    rig.run(1_000 * MS);
    let came_ns = rig.bench.borrow().clock.now_ns();
    rig.bench.borrow_mut().sensors[0].front = Front::Target(0.3);
    rig.run(1_000 * MS);
    let stopped_ns = rig.published(0).iter().find(|(_, reading)| reading.stop).unwrap().0;
    // the sensor's next turn starts within one cycle of four; its echo takes 0.5 + 1.75 ms
    let cycle_ns = 4 * (SPACING_NS + 10 * US);
    assert!(stopped_ns - came_ns < cycle_ns + 3 * MS + LATE_NS, "{} ns", stopped_ns - came_ns);
    rig.bench.borrow_mut().sensors[0].front = Front::Nothing;
    rig.run(1_000 * MS);
    assert!(!rig.published(0).last().unwrap().1.stop, "four cycles later it has gone");
}

#[test]
fn a_sensor_that_fails_does_not_stop_the_others() {
    for (front, quality) in [(Front::Shorted, Quality::Stuck), (Front::Unplugged, Quality::NoAnswer)] {
        let mut rig = Rig::new(&[Front::Target(1.5), Front::Target(2.5)]);
        rig.run(1_000 * MS);
        rig.bench.borrow_mut().sensors[0].front = front;
        let failed_ns = 1_000 * MS;
        rig.run(1_000 * MS);
        let lost: Vec<_> = rig.published(0).into_iter().filter(|(at_ns, _)| *at_ns > failed_ns + SPACING_NS).collect();
        assert!(lost.iter().all(|(_, reading)| reading.quality == quality), "{lost:?}");
        assert!(
            lost.iter().all(|(_, reading)| (reading.distance_m - 1.5).abs() < 2e-4),
            "the last good distance stays"
        );
        let stopped = lost.iter().position(|(_, reading)| reading.stop);
        assert!(stopped.is_some_and(|pings| pings <= 2), "lost after three: {stopped:?}");
        let other = rig.published(1);
        let spaced = other.windows(2).all(|pair| pair[1].0 - pair[0].0 <= 2 * (SPACING_NS + 10 * US) + LATE_NS);
        assert!(spaced && other.iter().all(|(_, reading)| reading.quality == Quality::Good && !reading.stop));
        rig.bench.borrow_mut().sensors[0].front = Front::Target(1.5);
        rig.run(1_000 * MS);
        let back = rig.published(0).last().unwrap().1;
        assert_eq!((back.quality, back.stop), (Quality::Good, false));
    }
}

#[test]
fn an_echo_that_ends_between_two_turns_is_nobodys() {
    // High for 200 ms: stuck in its own turn, over before the next of four, never used as a distance.
    let mut rig = Rig::new(&[Front::Slow, Front::Target(1.0), Front::Target(1.0), Front::Target(1.0)]);
    rig.run(3_000 * MS);
    assert!(rig.published(0).iter().all(|(_, reading)| reading.quality == Quality::Stuck && reading.stop));
    rig.bench.borrow_mut().sensors[0].front = Front::Target(1.0);
    rig.run(300 * MS);
    let first = rig.published(0).last().unwrap().1;
    assert!(first.quality == Quality::Good && (first.distance_m - 1.0).abs() < 2e-4, "{first:?}");
}

#[test]
fn a_ranging_task_that_dies_stops_the_board() {
    let mut rig = Rig::new(&[Front::Target(1.0), Front::Nothing]);
    rig.run(1_000 * MS);
    // in the order of the configuration: connector 1, then connector 0
    let newest = [1, 0].map(|index| rig.published(index).last().unwrap().1);
    let cycle = ranging::cycle(2);
    let last = newest[0].updated.min(newest[1].updated);
    assert_eq!(cycle.as_millis(), 120);
    assert!(!ranging::must_stop(&rig.config, &newest, last + cycle * 4));
    let late = last + cycle * 4 + ranging::TURN;
    assert!(ranging::must_stop(&rig.config, &newest, late));
    let unguarded: Vec<_> = rig.config.iter().map(|config| RangeConfig { stop_below_m: None, ..*config }).collect();
    assert!(!ranging::must_stop(&unguarded, &newest, late));
    let near = [newest[0], RangeReading { stop: true, ..newest[1] }];
    assert!(ranging::must_stop(&rig.config, &near, last));
}

#[test]
fn without_sensors_the_task_waits_for_ever() {
    let mut rig = Rig::new(&[]);
    rig.run(1_000 * MS);
    assert!(rig.bench.borrow().published.is_empty());
}
