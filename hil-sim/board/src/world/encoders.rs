//! Encoder tracks: what is on their lines, and the processor's counters of the simulated firmware.

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

/// Input filter of the encoder timers: 8 samples at a quarter of 120 MHz, so that 1000 counts in a ms pass.
const ENCODER_FILTER_NS: u64 = 267;
/// The first inputs are counted by timers, the others by interrupts.
const ENCODERS_ON_TIMERS: usize = 3;
/// An edge may be told later than it happens, for which nobody has to look at the shaft as often: by this share of the time
/// between two edges at its speed, so that no two are told at once,
const LATE_SHARE: f64 = 0.05;
/// at least this much,
const LATE_LEAST_NS: u64 = 2_000;
/// and at most this much, also for a shaft at a standstill that is driven.
const LATE_MOST_NS: u64 = 20_000;
/// Whatever the shaft does, an edge of one that moves or is driven is told at most so late.
const CEILING_NS: u64 = 100_000;
/// An edge of a shaft at rest that nothing drives is told at most so late: what moves it is not the board.
const REST_NS: u64 = 1_000_000;
/// A shaft slower than this counts as one at a standstill, counts/s.
const STANDSTILL: f64 = 1.0;

/// Of the clock by which budgets of edges go.
pub(super) const US_PER_MS: u32 = 1000;

/// That clock.
pub(super) const fn ticks(at_ns: u64) -> u32 {
    (at_ns / 1000) as u32
}

/// A line of an encoder's connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderLine {
    /// A track.
    Track(Channel),
    /// The switch's, where the index track is on it.
    Index,
}

/// A change of one line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncoderEdge {
    /// When.
    pub at_ns: u64,
    /// Which line.
    pub line: EncoderLine,
    /// The level from then on.
    pub high: bool,
}

/// What the processor makes of an encoder's tracks.
pub(super) enum Counter {
    Timer(HardwareCounter),
    /// Both tracks share an interrupt's budget of edges.
    Interrupts(Decoder, EdgeBudget),
}

impl Counter {
    /// What it has counted.
    fn count(&mut self, now_ns: u64) -> u16 {
        match self {
            Self::Timer(timer) => timer.count(now_ns),
            Self::Interrupts(decoder, _) => decoder.count(),
        }
    }
}

/// The interrupt of an index track, which latches the counter. An interrupt's entry takes 0.1 µs of a Cortex-M7, and another of its
/// priority comes before it.
#[derive(Clone, Copy, Default)]
pub(super) struct IndexLatch {
    on: bool,
    /// When the interrupt that has been called looks.
    due_ns: Option<u64>,
    at: Option<u16>,
}

/// From the edge to the latched counter: our choice of an ordinary case.
const LATCH_NS: u64 = 2_000;

impl IndexLatch {
    /// Looks at the counter, if it is time by `now_ns`.
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

/// The processor's counters after a reset. Without `interrupts` it listens to timers only.
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

/// What turns an encoder, in its counts.
struct Turning {
    position: f64,
    /// Rate at which the count changes, 1/s, negative backwards.
    speed: f64,
    /// Highest of what turns it, counts/s^2.
    acceleration: f64,
    /// Whether anything drives it: itself, or by the body another.
    driven: bool,
}

/// The earliest that a shaft can have gone `way` in the direction of `speed`, from there with `acceleration`, s.
fn earliest_s(way: f64, speed: f64, acceleration: f64) -> f64 {
    2.0 * way / (speed + (speed * speed + 2.0 * acceleration * way).sqrt())
}

impl World {
    /// Levels of an encoder's tracks, as of the last [`World::take_encoder_edges`]; both low for an input the board does
    /// not have.
    #[must_use]
    pub fn encoder_levels(&self, index: usize) -> Levels {
        self.pins.encoders.get(index).map_or(Levels::default(), QuadratureSignal::levels)
    }

    /// Every edge of an encoder's tracks, and of its index on a switch line, up to now that was not told before, in order of time.
    ///
    /// Between two calls a shaft is taken to turn evenly. Of more than 4096 counts the first are left out, in whole turns
    /// of four, so that levels stay right: returned is how many, with their sign. A counter is exact that adds them, an
    /// interrupt would have been lost anyway; 0 for whoever looks once a ms. After a lost edge both tracks change at once.
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

    /// When to look at an encoder's tracks next so that no edge is told much later than it happens: not before the
    /// earliest moment at which the shaft can reach the next count, from its speed, the count's place and the highest
    /// acceleration of its motor at this supply, taken twice. `u64::MAX` for an input without an encoder.
    ///
    /// So each edge is told at most 20 µs late, and at most a twentieth of the time to the next while the shaft turns evenly,
    /// 100 µs where a load or an end stop jolts it. One at rest that nothing drives is looked at each ms, or when a PWM chip changes its outputs.
    ///
    /// Holds as long as nobody changes a line or a chip: ask again after that.
    pub fn next_encoder_change_ns(&mut self, index: usize) -> u64 {
        self.catch_up();
        let now_ns = self.now_ns;
        let Some(signal) = self.pins.encoders.get(index) else { return u64::MAX };
        let glitch_ns = signal.next_glitch_ns().unwrap_or(u64::MAX).max(now_ns);
        let count = signal.count();
        let Some(Turning { position, speed, acceleration, driven }) = self.turned_by(index) else { return glitch_ns };
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
            // Floats that are no time at all, or none, are clipped too.
            let late_ns = ((LATE_SHARE / speed.abs() * 1e9) as u64).clamp(LATE_LEAST_NS, LATE_MOST_NS);
            ((up_s.min(down_s) * 1e9) as u64).saturating_add(late_ns).min(CEILING_NS)
        };
        now_ns.saturating_add(after_ns).min(glitch_ns).min(chips_ns.max(now_ns + LATE_LEAST_NS))
    }

    /// What turns an encoder now; `None` for an input without one.
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

    /// Lets an encoder follow its shaft to now.
    fn turn(&mut self, index: usize, sink: impl FnMut(Transition)) -> i64 {
        self.catch_up();
        let counts = self.turned_by(index).map_or(0.0, |turning| turning.position);
        let now_ns = self.clock.now_ns();
        self.pins.encoders.get_mut(index).map_or(0, |signal| signal.advance(now_ns, counts, sink))
    }

    /// Lets the processor's counter take what an encoder's tracks have done.
    fn count_encoder(&mut self, index: usize) {
        // Out of the way of the world while it brings the edges.
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
