//! Rules of motor bridges: in each direction one line carries the PWM, the others are steady.
//!
//! OSMC (HIP4081A): both high sides on, PWM on one low side. Forwards, current flows from leg A's high side through the
//! motor into leg B's low side, so PWM is on `BLI` and `ALI` stays low; backwards the other way round. While the PWM is
//! low both ends of the motor are at the supply, which brakes it.
//!
//! DHB-12: enable high, PWM on `IN1` forwards, on `IN2` backwards.
//!
//! - A change of direction first takes the PWM line low for two PWM periods, then sets all lines in one transfer.
//! - An unchanged direction writes only the changed line, and of it only the changed count, or both where the pulse
//!   meets the end of the period.
//! - Bridges of one chip switch on one after the other, each at its own phase: this lowers the peak current from their
//!   supply's capacitor.

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

/// Maximum number of lines of a bridge.
pub const MAX_LINES: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Forwards,
    Backwards,
}

#[derive(Clone, Copy, Debug)]
enum State {
    /// All lines are low since `since`: the motor coasts.
    Off { since: Instant },
    /// The PWM line of one direction is at `pwm`, and the steady lines are on.
    On { direction: Direction, pwm: Output, pwm_since: Instant },
}

/// Next step towards a duty.
enum Step {
    /// Nothing has to be written.
    Keep { applied: f32 },
    /// One line is written, the PWM line.
    Change { direction: Direction, before: Output, pwm: Output, applied: f32 },
    /// All lines are written.
    SetAll { direction: Direction, pwm: Output },
}

/// Plan for a duty, returned by [`Bridge::plan`].
#[derive(Clone, Copy, Debug)]
pub enum Plan {
    /// The lines are as they should be and give this duty.
    Keep(f32),
    /// This write is to be sent, and then passed to [`Bridge::sent`].
    Send(Write, Planned),
}

/// State of a bridge once its write has been sent.
#[derive(Clone, Copy, Debug)]
pub struct Planned {
    direction: Direction,
    pwm: Output,
    applied: f32,
}

impl Planned {
    /// Duty (share of the supply) that the motor then gets.
    #[must_use]
    pub const fn applied(&self) -> f32 {
        self.applied
    }
}

/// One bridge and the last state written to its lines.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    wiring: BridgeConfig,
    inverted: bool,
    /// Count of the PWM period at which the bridge's pulses begin.
    phase: u16,
    reversal: Duration,
    state: State,
    /// Duty that the motor gets.
    applied: f32,
}

impl Bridge {
    /// Creates a bridge that is off and rests for `reversal` between directions. Its pulses begin at count `phase` of
    /// the PWM period, below 4096.
    #[must_use]
    pub fn new(wiring: BridgeConfig, inverted: bool, phase: u16, reversal: Duration) -> Self {
        Self { wiring, inverted, phase, reversal, state: State::Off { since: Instant::now() }, applied: 0.0 }
    }

    /// Records that all lines of the chip have just been turned off.
    pub fn now_off(&mut self) {
        if let State::On { .. } = self.state {
            self.state = State::Off { since: Instant::now() };
        }
        self.applied = 0.0;
    }

    /// Duty (share of the supply) that the motor gets, negative backwards.
    #[must_use]
    pub fn applied(&self) -> f32 {
        self.applied
    }

    /// Plans the write that brings the lines to `duty`, or to the next step towards it.
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

    /// Records that the planned write was sent at `pwm_since` or before; until this call the bridge keeps its old
    /// state.
    pub fn sent(&mut self, planned: Planned, pwm_since: Instant) {
        let Planned { direction, pwm, applied } = planned;
        self.state = State::On { direction, pwm, pwm_since };
        self.applied = applied;
    }

    /// Returns true while lines are on: the motor is driven, or shorted at duty 0.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        matches!(self.state, State::On { .. })
    }

    /// Turns off all lines of this bridge, and of no other.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer; the state is then as before, and the call can be repeated.
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
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify<B: I2c>(&self, chip: &Pca9685, bus: &mut B, line: usize) -> Result<(), ChipError<B::Error>> {
        let output = self.first() + line as u8;
        match self.state {
            State::Off { .. } => chip.verify_off(bus, output).await,
            State::On { direction, pwm, .. } => chip.verify(bus, output, self.outputs(direction, pwm)[line]).await,
        }
    }

    /// Number of lines of the bridge.
    #[must_use]
    pub const fn line_count(&self) -> usize {
        match self.wiring {
            BridgeConfig::Osmc(_) => 4,
            BridgeConfig::Dhb(_) => 3,
        }
    }

    /// Returns true for an OSMC, which has a chip of its own.
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

    /// Outputs of all lines of a bridge that is on, in the order of the chip.
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use embassy_futures::block_on;
    use r4_protocol::config::{BridgeLines, DhbLines};

    use super::*;
    use crate::testing::{Registers, Tasks};

    const CHIP: u8 = 0x40;
    /// Lines in another order than the chip's outputs, the first of which is 4.
    const OSMC: BridgeConfig = BridgeConfig::Osmc(BridgeLines { ahi: 6, ali: 4, bhi: 5, bli: 7 });
    const DHB: BridgeConfig = BridgeConfig::Dhb(DhbLines { in1: 6, in2: 5, en: 4 });
    const REVERSAL: Duration = Duration::from_micros(1312);
    const PHASE: u16 = 0x0300;

    const LOW: [u8; 4] = [0, 0, 0, 0x10];
    const HIGH: [u8; 4] = [0, 0x10, 0, 0];
    /// PWM line at duty 0, which keeps the count at which its pulses begin.
    const REST: [u8; 4] = [0x00, 0x03, 0, 0x10];
    /// Pulse of a quarter of the period, from count 0x300 on.
    const QUARTER: [u8; 4] = [0x00, 0x03, 0x00, 0x07];

    struct Rig {
        chip: Pca9685,
        bus: Registers,
        tasks: Tasks,
        bridge: Bridge,
    }

    impl Rig {
        /// Creates a bridge that has just been switched off.
        fn new(wiring: BridgeConfig, inverted: bool) -> Self {
            let bus = Registers::default();
            bus.set(CHIP, 0xFD, 0);
            (0..16).for_each(|output| bus.set(CHIP, 6 + 4 * output + 3, 0x10));
            let bridge = Bridge::new(wiring, inverted, PHASE, REVERSAL);
            Self { chip: Pca9685::new(CHIP, 1526.0), bus, tasks: Tasks::default(), bridge }
        }

        /// Creates a bridge that has rested, so that it may run in either direction.
        fn rested(wiring: BridgeConfig, inverted: bool) -> Self {
            let mut rig = Self::new(wiring, inverted);
            rig.tasks.advance(REVERSAL);
            rig
        }

        /// Plans, sends the write if there is one, and returns the motor's duty and the number of bytes sent.
        fn drive(&mut self, duty: f32) -> (f32, usize) {
            match self.bridge.plan(&self.chip, duty) {
                Plan::Keep(applied) => (applied, 0),
                Plan::Send(write, planned) => {
                    block_on(write.send(&mut self.bus)).expect("the bus works");
                    self.bridge.sent(planned, Instant::now());
                    (planned.applied(), write.bytes().len())
                }
            }
        }

        /// Registers of the outputs from 4 on.
        fn lines<const N: usize>(&self) -> [[u8; 4]; N] {
            core::array::from_fn(|line| {
                core::array::from_fn(|byte| self.bus.get(CHIP, 6 + 4 * (4 + line as u8) + byte as u8))
            })
        }

        /// Numbers of the lines that do not read back as written.
        fn mismatches(&mut self) -> Vec<usize> {
            let line_count = self.bridge.line_count();
            let differs = |line: &usize| block_on(self.bridge.verify(&self.chip, &mut self.bus, *line)).is_err();
            (0..line_count).filter(differs).collect()
        }
    }

    /// In each direction, for both kinds of bridge and either polarity of the motor, one line pulses from its phase on
    /// and its counterpart stays low.
    #[test]
    fn each_direction_pulses_one_line_beside_the_steady_ones() {
        for inverted in [false, true] {
            for forwards in [true, false] {
                let duty = if forwards != inverted { 0.25 } else { -0.25 };
                let mut rig = Rig::rested(OSMC, inverted);
                assert_eq!(rig.drive(duty), (duty, 17));
                let expected = if forwards { [LOW, HIGH, HIGH, QUARTER] } else { [QUARTER, HIGH, HIGH, LOW] };
                assert_eq!(rig.lines(), expected, "{duty} of an OSMC, inverted: {inverted}");
                assert!(rig.bridge.is_osmc());

                let mut rig = Rig::rested(DHB, inverted);
                assert_eq!(rig.drive(duty), (duty, 13));
                let expected = if forwards { [HIGH, LOW, QUARTER] } else { [HIGH, QUARTER, LOW] };
                assert_eq!(rig.lines(), expected, "{duty} of a DHB, inverted: {inverted}");
                assert!(!rig.bridge.is_osmc());
                assert_eq!((rig.bridge.applied(), rig.bridge.is_on()), (duty, true));
            }
        }
    }

    /// A bridge that was switched off rests as long as one that reverses, counted from the first switching off.
    #[test]
    fn a_bridge_that_is_off_rests_before_it_is_switched_on() {
        let mut rig = Rig::new(OSMC, false);
        rig.tasks.advance(REVERSAL - Duration::from_ticks(1));
        rig.bridge.now_off();
        assert_eq!(rig.drive(0.25), (0.0, 0));
        assert!(!rig.bridge.is_on());
        rig.tasks.advance(Duration::from_ticks(1));
        assert_eq!(rig.drive(0.25), (0.25, 17));
        rig.bridge.now_off();
        assert_eq!((rig.bridge.applied(), rig.bridge.is_on()), (0.0, false));
        assert_eq!(rig.drive(0.25), (0.0, 0));
    }

    /// A reversal takes the PWM line low for two PWM periods, counted from that write, then sets all lines in one
    /// transfer.
    #[test]
    fn a_turn_takes_the_pulses_away_waits_and_sets_all_lines_at_once() {
        for duty in [0.25, -0.25] {
            let mut rig = Rig::rested(OSMC, false);
            assert_eq!(rig.drive(duty), (duty, 17));
            let before: [_; 4] = rig.lines();
            let at_rest = before.map(|line| if line == QUARTER { REST } else { line });
            assert_eq!(rig.drive(-duty), (0.0, 3));
            assert_eq!(rig.lines(), at_rest);
            rig.tasks.advance(REVERSAL - Duration::from_ticks(1));
            assert_eq!(rig.drive(-duty), (0.0, 0));
            assert_eq!(rig.lines(), at_rest);
            rig.tasks.advance(Duration::from_ticks(1));
            assert_eq!(rig.drive(-duty), (-duty, 17));
            let [ali, ahi, bhi, bli] = before;
            assert_eq!(rig.lines(), [bli, ahi, bhi, ali]);
        }
    }

    /// Neither a return to the previous direction nor duty 0 needs a rest.
    #[test]
    fn the_same_direction_writes_only_the_count_that_moves() {
        let mut rig = Rig::rested(OSMC, false);
        rig.drive(0.25);
        assert_eq!(rig.drive(0.25), (0.25, 0));
        assert_eq!(rig.drive(0.5), (0.5, 3));
        // Duty 0 shorts the motor by the line that pulsed.
        for zero in [0.0, -0.0, -1e-5] {
            rig.drive(0.25);
            assert_eq!(rig.drive(zero), (zero, 3), "{zero}");
            assert_eq!(rig.lines(), [LOW, HIGH, HIGH, REST], "{zero}");
            assert_eq!(rig.drive(zero), (zero, 0), "{zero}");
            assert!(rig.bridge.is_on());
        }
        assert_eq!(rig.drive(0.25), (0.25, 3));
        assert_eq!(rig.lines(), [LOW, HIGH, HIGH, QUARTER]);
    }

    /// Duty 0 counts as positive: a bridge switched on with it takes a positive duty at once, and a negative one after
    /// a rest.
    #[test]
    fn a_bridge_that_is_switched_on_at_rest_is_on_its_way_forwards() {
        for inverted in [false, true] {
            for (duty, expected) in [(0.25, (0.25, 5)), (-0.25, (0.0, 0))] {
                let mut rig = Rig::rested(OSMC, inverted);
                assert_eq!(rig.drive(0.0), (0.0, 17));
                assert_eq!(rig.lines(), [LOW, HIGH, HIGH, LOW]);
                assert_eq!(rig.drive(duty), expected, "inverted: {inverted}");
            }
        }
    }

    #[test]
    fn only_its_own_lines_are_switched_off() {
        for (wiring, lines) in [(OSMC, 4), (DHB, 3)] {
            let mut rig = Rig::rested(wiring, false);
            rig.drive(0.25);
            for output in (0..16).filter(|output| !(4..4 + lines).contains(output)) {
                rig.bus.set(CHIP, 6 + 4 * output + 3, 0x01);
            }
            block_on(rig.bridge.off(&rig.chip, &mut rig.bus)).expect("the bus works");
            for output in 0..16 {
                let expected = if (4..4 + lines).contains(&output) { 0x10 } else { 0x01 };
                assert_eq!(rig.bus.get(CHIP, 6 + 4 * output + 3), expected, "{output}");
            }
            assert_eq!((rig.bridge.applied(), rig.bridge.is_on()), (0.0, false));
            // Off is written only once: a bridge that is off is left alone.
            rig.bus.fail(1);
            assert!(block_on(rig.bridge.off(&rig.chip, &mut rig.bus)).is_ok());
        }
    }

    /// A line that differs from its written state is found by its number, whether the bridge is on or off.
    #[test]
    fn a_line_that_changes_is_found() {
        for wiring in [OSMC, DHB] {
            for on in [true, false] {
                for line in 0..Rig::new(wiring, false).bridge.line_count() {
                    let mut rig = Rig::rested(wiring, false);
                    if on {
                        rig.drive(-0.25);
                    }
                    assert!(rig.mismatches().is_empty());
                    let register = 6 + 4 * (4 + line as u8) + 3;
                    rig.bus.set(CHIP, register, rig.bus.get(CHIP, register) ^ 0x10);
                    assert_eq!(rig.mismatches(), [line], "{wiring:?}, on: {on}");
                }
            }
        }
    }
}
