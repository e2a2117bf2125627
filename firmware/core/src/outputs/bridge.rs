//! Rules of motor bridges: one line with PWM for each direction, the others steady.
//!
//! OSMC (HIP4081A): both high sides on, PWM on one low side. Forwards, current flows from leg A's high side through the
//! motor into leg B's low side, so PWM is on `BLI` and `ALI` stays low; backwards the other way round. While the PWM is low
//! both ends of the motor are at the supply: it brakes.
//!
//! DHB-12: enable high, PWM on `IN1` forwards, on `IN2` backwards.
//!
//! - A change of direction first takes the PWM line low for two PWM periods, then sets all lines in one transfer.
//! - An unchanged direction writes only the count that moves of the one line that moves, or both where the pulse meets the end
//!   of the period.
//! - Bridges of one chip switch on one after the other, each at its own phase: what their supply's capacitor has to give at
//!   once is less.

use embassy_time::{Duration, Instant};
use embedded_hal_async::i2c::I2c;
use r4_protocol::config::BridgeConfig;

use crate::{
    chips::{
        ChipError,
        pca9685::{Output, Pca9685},
    },
    platform::Write,
};

/// Most lines of a bridge.
pub const MAX_LINES: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Forwards,
    Backwards,
}

#[derive(Clone, Copy, Debug)]
enum State {
    /// All lines low since then: the motor coasts.
    Off { since: Instant },
    /// One direction's PWM line at `pwm`, the steady lines on.
    On { direction: Direction, pwm: Output, pwm_since: Instant },
}

/// What it takes to have a duty.
enum Step {
    /// Nothing has to be written.
    Keep { applied: f32 },
    /// The one line that moves.
    Change { direction: Direction, before: Output, pwm: Output, applied: f32 },
    /// All lines.
    SetAll { direction: Direction, pwm: Output },
}

/// How a bridge comes to a duty: the answer of [`Bridge::plan`].
#[derive(Clone, Copy, Debug)]
pub enum Plan {
    /// The lines are as they should be, and give this duty.
    Keep(f32),
    /// This is to be sent. [`Bridge::sent`] is called then.
    Send(Write, Planned),
}

/// What a bridge does once a write has been sent.
#[derive(Clone, Copy, Debug)]
pub struct Planned {
    direction: Direction,
    pwm: Output,
    applied: f32,
}

impl Planned {
    /// Share of the supply that the motor then gets.
    #[must_use]
    pub const fn applied(&self) -> f32 {
        self.applied
    }
}

/// One bridge and what its lines were last told.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    wiring: BridgeConfig,
    inverted: bool,
    /// Count of the PWM period at which its pulses begin.
    phase: u16,
    reversal: Duration,
    state: State,
    /// What the motor gets.
    applied: f32,
}

impl Bridge {
    /// A bridge that is off and rests for `reversal` between directions. Its pulses begin at count `phase` of the PWM period,
    /// below 4096.
    #[must_use]
    pub fn new(wiring: BridgeConfig, inverted: bool, phase: u16, reversal: Duration) -> Self {
        Self { wiring, inverted, phase, reversal, state: State::Off { since: Instant::now() }, applied: 0.0 }
    }

    /// All lines of the chip have just been turned off.
    pub fn now_off(&mut self) {
        if let State::On { .. } = self.state {
            self.state = State::Off { since: Instant::now() };
        }
        self.applied = 0.0;
    }

    /// Share of the supply the motor gets.
    #[must_use]
    pub fn applied(&self) -> f32 {
        self.applied
    }

    /// How the lines come to `duty`, or to the next step towards it.
    pub fn plan(&mut self, chip: &Pca9685, duty: f32) -> Plan {
        match self.next(duty) {
            Step::Keep { applied } => {
                self.applied = applied;
                Plan::Keep(applied)
            }
            Step::Change { direction, before, pwm, applied } => {
                let write = chip.change(self.pwm_line(direction), before, pwm);
                Plan::Send(write, Planned { direction, pwm, applied })
            }
            Step::SetAll { direction, pwm } => {
                let outputs = self.outputs(direction, pwm);
                let write = chip.set(self.first(), &outputs[..self.line_count()]);
                Plan::Send(write, Planned { direction, pwm, applied: duty })
            }
        }
    }

    /// The write of this plan was sent at `pwm_since`, or before; until then the bridge does what it did before.
    pub fn sent(&mut self, planned: Planned, pwm_since: Instant) {
        let Planned { direction, pwm, applied } = planned;
        self.state = State::On { direction, pwm, pwm_since };
        self.applied = applied;
    }

    /// Whether lines are on: the motor is driven, or shorted at duty 0.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        matches!(self.state, State::On { .. })
    }

    /// Turns all lines of this bridge off, and of no other.
    ///
    /// # Errors
    /// A failed transfer; the state is then as before, and the call can be repeated.
    pub async fn off<B: I2c>(&mut self, chip: &Pca9685, bus: &mut B) -> Result<(), B::Error> {
        if let State::On { .. } = self.state {
            chip.set(self.first(), &[Output::LOW; MAX_LINES][..self.line_count()]).send(bus).await?;
            self.now_off();
        }
        Ok(())
    }

    fn next(&self, duty: f32) -> Step {
        let wanted = if (duty < 0.0) != self.inverted { Direction::Backwards } else { Direction::Forwards };
        let pwm = Output::high_from(self.phase, duty.abs());
        match self.state {
            State::On { direction, pwm: before, .. } if direction == wanted || pwm.is_low() => {
                let pwm = if pwm.is_low() { before.low() } else { pwm };
                if before == pwm {
                    Step::Keep { applied: duty }
                } else {
                    Step::Change { direction, before, pwm, applied: duty }
                }
            }
            State::On { direction, pwm: before, .. } if !before.is_low() => {
                Step::Change { direction, before, pwm: before.low(), applied: 0.0 }
            }
            State::On { pwm_since: since, .. } | State::Off { since } if Instant::now() - since < self.reversal => {
                Step::Keep { applied: 0.0 }
            }
            State::On { .. } | State::Off { .. } => Step::SetAll { direction: wanted, pwm },
        }
    }

    /// Reads line number `line`, below [`Bridge::line_count`], back and compares.
    ///
    /// # Errors
    /// A failed transfer, or a register that does not hold what was written.
    pub async fn verify<B: I2c>(&self, chip: &Pca9685, bus: &mut B, line: usize) -> Result<(), ChipError<B::Error>> {
        let output = self.first() + line as u8;
        match self.state {
            State::Off { .. } => chip.verify_off(bus, output).await,
            State::On { direction, pwm, .. } => chip.verify(bus, output, self.outputs(direction, pwm)[line]).await,
        }
    }

    /// How many lines the bridge has.
    #[must_use]
    pub const fn line_count(&self) -> usize {
        match self.wiring {
            BridgeConfig::Osmc(_) => 4,
            BridgeConfig::Dhb(_) => 3,
        }
    }

    /// Whether it is an OSMC, which has a chip of its own.
    #[must_use]
    pub const fn is_osmc(&self) -> bool {
        matches!(self.wiring, BridgeConfig::Osmc(_))
    }

    fn first(&self) -> u8 {
        match self.wiring {
            BridgeConfig::Osmc(lines) => lines.first(),
            BridgeConfig::Dhb(lines) => lines.first(),
        }
    }

    const fn pwm_line(&self, direction: Direction) -> u8 {
        match (self.wiring, direction) {
            (BridgeConfig::Osmc(lines), Direction::Forwards) => lines.bli,
            (BridgeConfig::Osmc(lines), Direction::Backwards) => lines.ali,
            (BridgeConfig::Dhb(lines), Direction::Forwards) => lines.in1,
            (BridgeConfig::Dhb(lines), Direction::Backwards) => lines.in2,
        }
    }

    /// All lines of a bridge that is on, in the order of the chip.
    fn outputs(&self, direction: Direction, pwm: Output) -> [Output; MAX_LINES] {
        let mut outputs = [Output::LOW; MAX_LINES];
        let first = self.first();
        let mut set = |line: u8, output| outputs[usize::from(line - first)] = output;
        match self.wiring {
            BridgeConfig::Osmc(lines) => {
                set(lines.ahi, Output::HIGH);
                set(lines.bhi, Output::HIGH);
            }
            BridgeConfig::Dhb(lines) => set(lines.en, Output::HIGH),
        }
        set(self.pwm_line(direction), pwm);
        outputs
    }
}
