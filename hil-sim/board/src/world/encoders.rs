//! Encoder tracks: edges on their lines, and the processor's counters in the simulated firmware.

use std::f64::consts::TAU;

use r4_boards::{SimulatedEncoder, SimulatedSensor};
use r4_firmware::{
    platform::{EdgeInputs, Encoders},
    sensing::{
        quadrature::Decoder,
        storm::{ENCODER_EDGES_PER_MS, EdgeBudget},
    },
};

use super::{Processor, World, drives::Bldc, motor::Motor};
use crate::sensors::quadrature::{Channel, HardwareCounter, Levels, QuadratureSignal, Transition};

/// Input filter of the encoder timers, ns: 8 samples at a quarter of 120 MHz, so that 1000 counts in a ms pass.
const ENCODER_FILTER_NS: u64 = 267;
/// Number of inputs that are counted by timers; interrupts count the others.
const ENCODERS_ON_TIMERS: usize = 3;
/// Delay allowed for reporting an edge, as a share of the time between two edges at the present speed, so that no two
/// are reported at once. The larger it is, the less often the shaft is sampled.
const LATE_SHARE: f64 = 0.05;
/// Smallest delay allowed, ns.
const LATE_LEAST_NS: u64 = 2_000;
/// Largest delay allowed, ns, also for a driven shaft at a standstill.
const LATE_MOST_NS: u64 = 20_000;
/// Largest delay of an edge of a shaft that moves or is driven, for any motion, ns.
const CEILING_NS: u64 = 100_000;
/// Largest delay of an edge of a shaft at rest that nothing drives, ns: something other than the board moves it.
const REST_NS: u64 = 1_000_000;
/// Speed below which a shaft counts as standing, counts/s.
const STANDSTILL: f64 = 1.0;

/// Ticks per ms of the clock for budgets of edges.
pub(super) const US_PER_MS: u32 = 1000;

/// Time of the clock for budgets of edges, µs.
pub(super) const fn ticks(at_ns: u64) -> u32 {
    (at_ns / 1000) as u32
}

/// A line of an encoder's connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderLine {
    /// Line of a track, A or B.
    Track(Channel),
    /// Line of the switch, if the index track is on it.
    Index,
}

/// A change of one line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncoderEdge {
    /// Time of the change, ns.
    pub at_ns: u64,
    /// Line that has changed.
    pub line: EncoderLine,
    /// Level from then on.
    pub high: bool,
}

/// The processor's counter for an encoder's tracks.
pub(super) enum Counter {
    Timer(HardwareCounter),
    /// Decoder in interrupts; both tracks share its budget of edges.
    Interrupts(Decoder, EdgeBudget),
}

impl Counter {
    /// Count of the counter.
    fn count(&mut self, now_ns: u64) -> u16 {
        match self {
            Self::Timer(timer) => timer.count(now_ns),
            Self::Interrupts(decoder, _) => decoder.count(),
        }
    }
}

/// Interrupt of an index track, which latches the counter. Its entry takes 0.1 µs of a Cortex-M7, and another interrupt
/// of its priority may come before it.
#[derive(Clone, Copy, Default)]
pub(super) struct IndexLatch {
    on: bool,
    /// Time at which the pending interrupt reads the counter, ns.
    due_ns: Option<u64>,
    at: Option<u16>,
}

/// Time from the edge to the latched counter, ns: our choice of a typical case.
const LATCH_NS: u64 = 2_000;

impl IndexLatch {
    /// Latches the counter if it is due by `now_ns`.
    fn look(&mut self, now_ns: u64, counter: &mut Counter) {
        if let Some(due_ns) = self.due_ns.take_if(|due_ns| *due_ns <= now_ns) {
            self.at = Some(counter.count(due_ns));
        }
    }

    fn take(&mut self, Transition { at_ns, index, .. }: Transition) {
        if index && !self.on {
            self.due_ns = Some(at_ns + LATCH_NS);
        }
        self.on = index;
    }
}

/// The processor's counters after a reset. Without `interrupts` only the timers count.
pub(super) fn counters(encoders: &[QuadratureSignal; 4], interrupts: bool) -> [Option<Counter>; 4] {
    std::array::from_fn(|index| {
        let levels = encoders[index].levels();
        if index < ENCODERS_ON_TIMERS {
            return Some(Counter::Timer(HardwareCounter::new(ENCODER_FILTER_NS, levels)));
        }
        if !interrupts {
            return None;
        }
        let mut decoder = Decoder::new();
        decoder.update(levels.a, levels.b);
        Some(Counter::Interrupts(decoder, EdgeBudget::new(ENCODER_EDGES_PER_MS, US_PER_MS)))
    })
}

/// Motion of an encoder's shaft, in its counts.
struct Turning {
    position: f64,
    /// Rate of the count, 1/s, negative backwards.
    speed: f64,
    /// Largest acceleration of its drive, counts/s².
    acceleration: f64,
    /// True if it is driven, by its own motor or by another one through the body.
    driven: bool,
}

/// Earliest time at which a shaft can have travelled `way` in the direction of `speed`, with `acceleration`, s.
fn earliest_s(way: f64, speed: f64, acceleration: f64) -> f64 {
    2.0 * way / (speed + (speed * speed + 2.0 * acceleration * way).sqrt())
}

impl World {
    /// Levels of an encoder's tracks at the last [`World::take_encoder_edges`]; both low for an input the board does
    /// not have.
    #[must_use]
    pub fn encoder_levels(&self, index: usize) -> Levels {
        self.pins.encoders.get(index).map_or(Levels::default(), QuadratureSignal::levels)
    }

    /// Passes every edge of an encoder's tracks, and of its index on a switch line, up to now that was not passed
    /// before, in order of time.
    ///
    /// Between two calls a shaft is assumed to turn at constant speed. Of more than 4096 counts the first are skipped,
    /// in multiples of four, so levels stay right; returns their number, with sign. A counter that adds it is exact, an
    /// interrupt would have been lost anyway; it is 0 with one call per ms. After a lost edge both tracks change at
    /// once.
    pub fn take_encoder_edges(&mut self, index: usize, mut sink: impl FnMut(EncoderEdge)) -> i64 {
        let mut levels = self.encoder_levels(index);
        let index_low = self.pins.index_low(index);
        let mut is_on = self.pins.encoders.get(index).is_some_and(QuadratureSignal::index);
        self.turn(index, |Transition { at_ns, levels: now, index: on }| {
            for (track, was, high) in [(Channel::A, levels.a, now.a), (Channel::B, levels.b, now.b)] {
                if was != high {
                    sink(EncoderEdge { at_ns, line: EncoderLine::Track(track), high });
                }
            }
            if let (Some(active_low), true) = (index_low, on != is_on) {
                sink(EncoderEdge { at_ns, line: EncoderLine::Index, high: on != active_low });
            }
            (levels, is_on) = (now, on);
        })
    }

    /// Time of the next sample of an encoder's tracks, ns, so that no edge is reported much later than it happens: not
    /// before the earliest time at which the shaft can reach the next count, from its speed, the position in the count
    /// and twice the largest acceleration of its motor at this supply. `u64::MAX` for an input without an encoder.
    ///
    /// Each edge is reported at most 20 µs late, and at most a twentieth of the time to the next one at constant speed;
    /// 100 µs if a load or an end stop jolts the shaft. A shaft at rest that nothing drives is sampled each ms, and
    /// when a PWM chip changes its outputs.
    ///
    /// The time is valid until the caller changes a line or a chip.
    pub fn next_encoder_change_ns(&mut self, index: usize) -> u64 {
        self.catch_up();
        let now_ns = self.now_ns;
        let Some(signal) = self.pins.encoders.get(index) else { return u64::MAX };
        let glitch_ns = signal.next_glitch_ns().unwrap_or(u64::MAX).max(now_ns);
        let count = signal.count();
        let Some(Turning { position, speed, acceleration, driven }) = self.turned_by(index) else { return glitch_ns };
        // an edge that is already due
        if position.floor() as i64 != count {
            return now_ns;
        }
        let chips_ns = self.chips.next_change_ns().unwrap_or(u64::MAX).max(now_ns);
        let stands = speed.abs() < STANDSTILL;
        let after_ns = if stands && !driven {
            REST_NS
        } else {
            let acceleration = 2.0 * acceleration;
            let above = position - position.floor();
            let up_s = earliest_s(1.0 - above, speed, acceleration);
            let down_s = earliest_s(above, -speed, acceleration);
            // a float cast to u64 saturates, so infinities and NaN are clipped too
            let late_ns = ((LATE_SHARE / speed.abs() * 1e9) as u64).clamp(LATE_LEAST_NS, LATE_MOST_NS);
            ((up_s.min(down_s) * 1e9) as u64).saturating_add(late_ns).min(CEILING_NS)
        };
        now_ns.saturating_add(after_ns).min(glitch_ns).min(chips_ns.max(now_ns + LATE_LEAST_NS))
    }

    /// Motion of an encoder's shaft now; `None` for an input without one.
    fn turned_by(&mut self, index: usize) -> Option<Turning> {
        let on = |input: u8| usize::from(input) == index;
        let drives = |motor: &Motor| motor.drive.duty != 0.0;
        let body_driven = |motors: &[Motor], bldcs: &[Bldc]| {
            motors.iter().any(|motor| motor.coupled && drives(motor))
                || bldcs.iter().any(|bldc| bldc.coupled && !bldc.drive.is_coasting())
        };
        for motor in &self.motors {
            let output = match motor.sensor {
                Some(SimulatedSensor::Encoder { input, lines_per_turn }) if on(input) => Some(lines_per_turn),
                _ => None,
            };
            let motor_side = motor.motor_side.filter(|side| on(side.input)).map(|side| side.lines_per_turn);
            if let Some(lines_per_turn) = output.or(motor_side) {
                let counts = |rad: f64| rad / TAU * f64::from(lines_per_turn) * 4.0;
                let (position, speed) = if output.is_some() {
                    (motor.plant.sensed_position(), motor.plant.speed())
                } else {
                    motor.plant.motor_side()
                };
                return Some(Turning {
                    position: counts(position),
                    speed: counts(speed),
                    acceleration: counts(motor.top_acceleration(self.rails[motor.rail].spec.emf_v)),
                    driven: drives(motor) || motor.coupled && body_driven(&self.motors, &self.bldcs),
                });
            }
        }
        let turns = |bldc: &Bldc| bldc.encoder.is_some_and(|SimulatedEncoder { input, .. }| on(input));
        let number = self.bldcs.iter().position(turns)?;
        let now_ns = self.now_ns;
        let bldc = &mut self.bldcs[number];
        let lines_per_turn = f64::from(bldc.encoder?.lines_per_turn);
        let counts = |rad: f64| rad / TAU * lines_per_turn * 4.0;
        let acceleration = counts(bldc.top_acceleration());
        let drive = bldc.at(now_ns);
        let (position, speed) = (counts(drive.position_rad()), counts(drive.speed_rad_s()));
        let driven = !drive.is_coasting() || bldc.coupled && body_driven(&self.motors, &self.bldcs);
        Some(Turning { position, speed, acceleration, driven })
    }

    /// Moves an encoder with its shaft to the present time.
    fn turn(&mut self, index: usize, sink: impl FnMut(Transition)) -> i64 {
        self.catch_up();
        let counts = self.turned_by(index).map_or(0.0, |turning| turning.position);
        let now_ns = self.clock.now_ns();
        self.pins.encoders.get_mut(index).map_or(0, |signal| signal.advance(now_ns, counts, sink))
    }

    /// Feeds an encoder's edges to the processor's counter.
    fn count_encoder(&mut self, index: usize) {
        // taken out of the world, which is borrowed while it passes the edges
        let Some(mut counter) = self.counters.get_mut(index).and_then(Option::take) else { return };
        let mut latch = self.index_latches[index];
        let left_out = self.turn(index, |transition| {
            latch.look(transition.at_ns, &mut counter);
            match &mut counter {
                Counter::Timer(timer) => timer.take(transition),
                Counter::Interrupts(_, budget) if budget.is_masked() => {}
                Counter::Interrupts(decoder, budget) => {
                    decoder.update(transition.levels.a, transition.levels.b);
                    budget.edge(ticks(transition.at_ns));
                }
            }
            latch.take(transition);
        });
        latch.look(self.clock.now_ns(), &mut counter);
        self.index_latches[index] = latch;
        // counts that only the simulation skips: a timer does not lose them
        if let Counter::Timer(timer) = &mut counter {
            timer.add(left_out);
        }
        self.counters[index] = Some(counter);
    }
}

impl Encoders for Processor {
    fn count(&mut self, index: u8) -> u16 {
        let mut world = self.0.borrow_mut();
        let index = usize::from(index);
        world.count_encoder(index);
        let now_ns = world.clock.now_ns();
        world.counters.get_mut(index).and_then(Option::as_mut).map_or(0, |counter| counter.count(now_ns))
    }

    fn at_index(&mut self, index: u8) -> Option<u16> {
        let mut world = self.0.borrow_mut();
        world.count_encoder(index.into());
        world.index_latches.get_mut(usize::from(index))?.at.take()
    }

    fn illegal(&mut self, index: u8) -> u32 {
        match self.0.borrow().counters.get(usize::from(index)) {
            Some(Some(Counter::Interrupts(decoder, _))) => decoder.illegal(),
            _ => 0,
        }
    }
}

impl EdgeInputs for Processor {
    fn storm(&mut self) -> bool {
        let mut world = self.0.borrow_mut();
        let mut storm = false;
        for index in ENCODERS_ON_TIMERS..world.counters.len() {
            world.count_encoder(index);
            let now = ticks(world.clock.now_ns());
            let levels = world.encoder_levels(index);
            let Some(Some(Counter::Interrupts(decoder, budget))) = world.counters.get_mut(index) else { continue };
            let verdict = budget.look(now);
            storm |= verdict.storm;
            if verdict.unmask {
                decoder.update(levels.a, levels.b);
            }
        }
        storm | world.echo_storm()
    }
}
