//! Rules of an OSMC bridge (HIP4081A): both high sides on, PWM on one low side.
//!
//! Forwards, current flows from leg A's high side through the motor into leg B's low side, so PWM is on `BLI` and `ALI`
//! stays low; backwards the other way round. While the PWM is low both ends of the motor are at the supply: it brakes.
//!
//! - A change of direction first takes both low sides off for two PWM periods, then sets all four lines in one transfer.
//! - An unchanged direction writes only the "off" count of the one line that moves.

use embassy_time::{Duration, Instant};
use embedded_hal_async::i2c::I2c;
use r4_protocol::config::BridgeLines;

use crate::chips::{
    ChipError,
    pca9685::{Output, Pca9685},
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Forwards,
    Backwards,
}

#[derive(Clone, Copy, Debug)]
enum State {
    /// All four lines low since then: the motor coasts.
    Off { since: Instant },
    /// High sides on, one low side at `low`.
    On { direction: Direction, low: Output, low_since: Instant },
}

/// One bridge and what its lines were last told.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    lines: BridgeLines,
    inverted: bool,
    reversal: Duration,
    state: State,
}

impl Bridge {
    /// A bridge on `lines`, off, that rests for `reversal` between directions.
    #[must_use]
    pub fn new(lines: BridgeLines, inverted: bool, reversal: Duration) -> Self {
        Self { lines, inverted, reversal, state: State::Off { since: Instant::now() } }
    }

    /// All lines of the chip have just been turned off.
    pub fn now_off(&mut self) {
        if let State::On { .. } = self.state {
            self.state = State::Off { since: Instant::now() };
        }
    }

    /// Sets the lines for `duty`, or for the next step towards it, and returns the duty they now give.
    ///
    /// # Errors
    /// A failed transfer; the state is then as before, and the call can be repeated.
    pub async fn drive<B: I2c>(&mut self, chip: &Pca9685, bus: &mut B, duty: f32) -> Result<f32, B::Error> {
        let wanted = if (duty < 0.0) != self.inverted { Direction::Backwards } else { Direction::Forwards };
        let low = Output::high_for(duty.abs());
        let now = Instant::now();
        match self.state {
            State::On { direction, low: last, .. } if last == low && (direction == wanted || low == Output::LOW) => {
                Ok(duty)
            }
            State::On { direction, .. } if direction == wanted || low == Output::LOW => {
                chip.set_off_count(bus, self.low_line(direction), low).await?;
                self.state = State::On { direction, low, low_since: Instant::now() };
                Ok(duty)
            }
            State::On { direction, low: last, .. } if last != Output::LOW => {
                chip.set_off_count(bus, self.low_line(direction), Output::LOW).await?;
                self.state = State::On { direction, low: Output::LOW, low_since: Instant::now() };
                Ok(0.0)
            }
            State::On { low_since: since, .. } | State::Off { since } if now - since < self.reversal => Ok(0.0),
            State::On { .. } | State::Off { .. } => {
                let state = State::On { direction: wanted, low, low_since: now };
                chip.set_four(bus, self.lines.first(), self.outputs(state)).await?;
                self.state = State::On { direction: wanted, low, low_since: Instant::now() };
                Ok(duty)
            }
        }
    }

    /// Reads line number `line` (0 to 3) back and compares.
    ///
    /// # Errors
    /// A failed transfer, or a register that does not hold what was written.
    pub async fn verify<B: I2c>(&self, chip: &Pca9685, bus: &mut B, line: usize) -> Result<(), ChipError<B::Error>> {
        let output = self.lines.first() + line as u8;
        match self.state {
            State::Off { .. } => chip.verify_off(bus, output).await,
            State::On { .. } => chip.verify(bus, output, self.outputs(self.state)[line]).await,
        }
    }

    const fn low_line(&self, direction: Direction) -> u8 {
        match direction {
            Direction::Forwards => self.lines.bli,
            Direction::Backwards => self.lines.ali,
        }
    }

    /// The four outputs, in the order of the chip.
    fn outputs(&self, state: State) -> [Output; 4] {
        let mut outputs = [Output::LOW; 4];
        if let State::On { direction, low, .. } = state {
            let mut set = |line: u8, output| outputs[usize::from(line - self.lines.first())] = output;
            set(self.lines.ahi, Output::HIGH);
            set(self.lines.bhi, Output::HIGH);
            set(self.low_line(direction), low);
        }
        outputs
    }
}
