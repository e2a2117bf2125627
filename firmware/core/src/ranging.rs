//! Ranging task: pings the range sensors, one after the other.

use core::future::pending;

use embassy_time::{Duration, Instant, Timer};
use heapless::Vec;
use r4_protocol::config::{RANGE_SENSORS, RangeConfig};

use crate::{
    platform::{EchoState, Ranging},
    sensing::range::{Echo, LOST_AFTER, RangeReading, RangeSensor},
};

/// Interval between two pings, of the same sensor or of different ones.
///
/// The datasheet requires 60 ms between the pings of one sensor, for late echoes to die away: in 60 ms sound travels 10
/// m and back. Another sensor hears the same echoes, so it waits as long: two sensors are read every 120 ms, four every
/// 240 ms.
pub const TURN: Duration = Duration::from_millis(60);
/// Length of the trigger pulse: the datasheet requires 10 µs; the clock's tick of 1 µs may cut one off at either end.
const TRIGGER: Duration = Duration::from_micros(12);
/// Longest wait for the echo's end, from the trigger on: an echo starts after about 0.5 ms and ends at the latest,
/// without a target, 38 ms later.
const WAIT: Duration = Duration::from_millis(40);
/// Interval of polling the capture, which is also the delay of a reading.
const POLL: Duration = Duration::from_millis(1);

/// Time between two readings of one of `sensors` sensors.
#[must_use]
pub fn cycle(sensors: usize) -> Duration {
    TURN * sensors as u32
}

/// Returns true if a sensor with a limit asks for a stop, or has not reported for so long that the ranging task itself
/// must be dead. `readings` are the newest published, in the order of `config`.
#[must_use]
pub fn must_stop(config: &[RangeConfig], readings: &[RangeReading], now: Instant) -> bool {
    // One cycle more than a sensor may miss answers: pings that end late are not yet a dead task.
    let silence = cycle(config.len()) * (u32::from(LOST_AFTER) + 1);
    config.iter().zip(readings).any(|(config, reading)| {
        config.stop_below_m.is_some() && (reading.stop || now.saturating_duration_since(reading.updated) > silence)
    })
}

/// Pings the sensors of `config` in turn indefinitely and passes each result to `publish`, with the sensor's place in
/// `config`, within 1 ms of the end of its echo.
///
/// A sensor whose echo does not end keeps its turn but is not triggered, which it would ignore; the others go on.
pub async fn run<H: Ranging>(
    config: &[RangeConfig],
    air_temperature_c: f32,
    mut hardware: H,
    mut publish: impl FnMut(usize, RangeReading),
) -> ! {
    let sensor = |config: &RangeConfig| (config.id.index, RangeSensor::new(config, air_temperature_c));
    let mut sensors: Vec<_, RANGE_SENSORS> = config.iter().take(RANGE_SENSORS).map(sensor).collect();
    // The first ping waits too: a sensor may still listen to one from before a restart, or be starting up itself.
    let mut next = Instant::now() + TURN;
    loop {
        if sensors.is_empty() {
            pending::<()>().await;
        }
        for (place, (index, sensor)) in sensors.iter_mut().enumerate() {
            Timer::at(next).await;
            next = Instant::now() + TURN;
            let echo = ping(&mut hardware, *index).await;
            publish(place, sensor.update(echo, Instant::now()));
        }
    }
}

async fn ping<H: Ranging>(hardware: &mut H, index: u8) -> Echo {
    hardware.clear(index);
    if let EchoState::High { .. } = hardware.echo(index) {
        return Echo::Stuck;
    }
    hardware.trigger(index, true);
    Timer::after(TRIGGER).await;
    hardware.trigger(index, false);
    let end = Instant::now() + WAIT;
    loop {
        match hardware.echo(index) {
            EchoState::Done { width_us } => return Echo::Width(width_us),
            EchoState::Idle if Instant::now() >= end => return Echo::None,
            EchoState::High { .. } if Instant::now() >= end => return Echo::Stuck,
            EchoState::Idle | EchoState::High { .. } => Timer::after(POLL).await,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::cell::RefCell;
    use std::{rc::Rc, vec, vec::Vec};

    use r4_protocol::{ChannelId, ChannelKind, Quality, Range};

    use super::*;
    use crate::testing::Tasks;

    const MS: Duration = Duration::from_millis(1);
    const US: Duration = Duration::from_micros(1);

    fn config(index: u8, stop_below_m: Option<f32>) -> RangeConfig {
        RangeConfig { id: ChannelId::new(ChannelKind::Range, index), range_m: Range::new(0.02, 4.0), stop_below_m }
    }

    /// A silence of more than four cycles, to the microsecond, stops for any sensor with a limit; one without a limit
    /// stops nothing.
    #[test]
    fn silence_beyond_four_cycles_stops_for_each_sensor_with_a_limit() {
        let begin = Instant::now();
        for sensors in 1..=RANGE_SENSORS {
            let silence = Duration::from_millis(60 * sensors as u64 * 4);
            for silent in 0..sensors {
                for limited in 0..sensors {
                    let of = |place: usize| config(place as u8, (place == limited).then_some(0.5));
                    let configs: Vec<_> = (0..sensors).map(of).collect();
                    let must_stop_after = |age: Duration, stop: bool| {
                        let now = begin + age;
                        let mut readings = vec![RangeReading { updated: now, ..RangeReading::NONE }; sensors];
                        readings[silent] = RangeReading { updated: begin, stop, ..RangeReading::NONE };
                        must_stop(&configs, &readings, now)
                    };
                    assert!(!must_stop_after(silence, false), "{sensors} {silent} {limited}");
                    assert_eq!(must_stop_after(silence + US, false), silent == limited);
                    assert_eq!(must_stop_after(Duration::MIN, true), silent == limited);
                }
            }
        }
        assert!(!must_stop(&[], &[], begin));
    }

    /// Situation of a sensor: target or fault.
    #[derive(Clone, Copy, Debug)]
    enum Front {
        /// Echo that rises 500 µs after the trigger, for this long.
        Echo(Duration),
        Unplugged,
        /// Echo line that is high from this age of the last trigger on.
        HighFrom(Duration),
        Shorted,
    }

    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Event {
        Cleared,
        /// Length of a trigger pulse.
        Triggered(Duration),
        Published(usize, RangeReading),
    }

    /// Sensors by their connectors, and events with their times; for published readings the place is the connector.
    struct Bench {
        fronts: [Front; 2],
        triggered: [Option<Instant>; 2],
        events: Vec<(Instant, usize, Event)>,
    }

    struct Hardware(Rc<RefCell<Bench>>);

    impl Ranging for Hardware {
        fn trigger(&mut self, index: u8, high: bool) {
            let (bench, now) = (&mut *self.0.borrow_mut(), Instant::now());
            let begun = bench.triggered[usize::from(index)].replace(now);
            if let (Some(begun), false) = (begun, high) {
                bench.events.push((now, index.into(), Event::Triggered(now - begun)));
            }
        }

        fn clear(&mut self, index: u8) {
            self.0.borrow_mut().triggered[usize::from(index)] = None;
            self.0.borrow_mut().events.push((Instant::now(), index.into(), Event::Cleared));
        }

        fn echo(&mut self, index: u8) -> EchoState {
            let bench = self.0.borrow();
            let since = |from: Duration, age: Duration| EchoState::High { since_us: (age - from).as_micros() as u32 };
            let rise = US * 500;
            let age = bench.triggered[usize::from(index)].map(|at| at.elapsed());
            match (bench.fronts[usize::from(index)], age) {
                (Front::Shorted, _) => EchoState::High { since_us: 0 },
                (Front::HighFrom(from), Some(age)) if age >= from => since(from, age),
                (Front::Echo(width), Some(age)) if age >= rise + width => {
                    EchoState::Done { width_us: width.as_micros() as u32 }
                }
                (Front::Echo(_), Some(age)) if age >= rise => since(rise, age),
                _ => EchoState::Idle,
            }
        }
    }

    /// Sixteen turns of two sensors; the one at connector 1 is the first.
    fn sixteen_turns(fronts: [Front; 2]) -> (Instant, Vec<(Instant, usize, Event)>) {
        let bench = Rc::new(RefCell::new(Bench { fronts, triggered: [None; 2], events: Vec::new() }));
        let (begin, seen, hardware) = (Instant::now(), bench.clone(), Hardware(bench.clone()));
        let mut tasks = Tasks::default();
        tasks.spawn(async move {
            let publish = |place: usize, reading| {
                seen.borrow_mut().events.push((Instant::now(), 1 - place, Event::Published(place, reading)));
            };
            run(&[config(1, None), config(0, Some(0.5))], 20.0, hardware, publish).await;
        });
        tasks.advance(MS * 1010);
        let events = core::mem::take(&mut bench.borrow_mut().events);
        (begin, events)
    }

    /// Turns take 60 ms, the first of which is waited for; each clears the capture, triggers for at least 10 µs, and
    /// publishes within a millisecond of the echo's end, or 40 ms after the trigger without one.
    #[test]
    fn each_turn_tells_what_came_of_its_ping() {
        const NONE: Duration = Duration::from_millis(40);
        for (front, quality, ends) in [
            (Front::Echo(MS * 10), Quality::Good, US * 10_500),
            (Front::Echo(US * 38_000), Quality::OutOfRange, US * 38_500),
            (Front::Unplugged, Quality::NoAnswer, NONE),
            (Front::HighFrom(MS * 20), Quality::Stuck, NONE),
        ] {
            let (begin, events) = sixteen_turns([front, Front::Echo(MS * 2)]);
            let turns: Vec<_> = events.chunks(3).collect();
            assert_eq!(turns.len(), 16, "{front:?}");
            let mut due = begin + MS * 60;
            for (turn, events) in turns.iter().enumerate() {
                let connector = 1 - turn % 2;
                assert!(events.iter().all(|(_, of, _)| *of == connector), "{events:?}");
                let [(cleared, _, Event::Cleared), (pinged, _, Event::Triggered(length)), (published, _, outcome)] =
                    events
                else {
                    panic!("{events:?}");
                };
                assert!(*cleared >= due && *cleared <= due + US && *length >= US * 10 && *length < US * 20);
                due = *cleared + MS * 60;
                let Event::Published(place, reading) = outcome else { panic!("{events:?}") };
                let (quality, ends) = if connector == 0 { (quality, ends) } else { (Quality::Good, US * 2500) };
                assert_eq!((*place, reading.quality, reading.updated), (turn % 2, quality, *published), "{front:?}");
                let late = *published - *pinged;
                assert!(late >= ends && late <= ends + MS, "{front:?}: {late} after the ping, not {ends}");
            }
        }
    }

    #[test]
    fn an_echo_that_is_high_already_is_not_triggered() {
        let (_, events) = sixteen_turns([Front::Shorted, Front::Shorted]);
        assert!(events.iter().all(|(.., event)| !matches!(event, Event::Triggered(_))), "{events:?}");
        let qualities = events.iter().filter_map(|(.., event)| match event {
            Event::Published(_, reading) => Some(reading.quality),
            _ => None,
        });
        assert_eq!(qualities.collect::<Vec<_>>(), [Quality::Stuck; 16]);
    }
}
