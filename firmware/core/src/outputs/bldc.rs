//! Rules of brushless drives: speed by a voltage of the DAC, direction and brake by lines of the port expander.
//!
//! - The voltage is `neutral + share · (full - neutral)`, and changes no faster than `slew_per_s`. Its code never
//!   leaves the window from the lowest to the highest of the configured voltages: a code outside can damage a drive.
//! - The direction line changes only after `rest_ms` at neutral. The drive's speed is not measured: `rest_ms` must be
//!   long enough for the motor to come to rest.
//! - The brake is never applied against a voltage. Only braking, also as the safe state, bypasses the slew limit.
//! - A step that releases the brake or changes the direction leaves the voltage at neutral, so the order of writes to
//!   DAC and expander does not matter.
//!
//! After power-up the expander's pins are inputs until it is set up: pull-ups or pull-downs at the drive must then give
//! "brake applied", as the EEPROM of the DAC gives neutral. A reset of the processor alone leaves voltages and lines as
//! they were: [`Bldcs::resume`] keeps the direction lines, so that they too change only after a rest at neutral.

use heapless::Vec;
use r4_protocol::config::{BldcConfig, DacChipConfig, MAX_BLDCS, Reverse};

use super::slew::towards;
use crate::chips::mcp4728::{CODE_MAX, OUTPUTS};
use crate::within::Within;

/// Command for one brushless drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Run at this share of full speed, -1..=1, negative backwards, with the brake released. A drive that cannot run
    /// backwards stays at neutral instead.
    Run(f32),
    /// Neutral at once, with the brake applied if there is one.
    Brake,
}

/// Requested contents of the DAC and the expander.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Codes of the DAC's outputs; 0 where there is no drive.
    pub codes: [u16; OUTPUTS],
    /// Bits of the expander that are lines of drives.
    pub mask: u16,
    /// Levels of those bits; the others are 0.
    pub levels: u16,
}

/// All brushless drives of a board.
#[derive(Clone, Debug)]
pub struct Bldcs {
    drives: Vec<Drive, MAX_BLDCS>,
    /// Combined request of all drives.
    wanted: Wanted,
}

impl Bldcs {
    /// Creates the drives in their safe state. The configuration must be valid.
    #[must_use]
    pub fn new(configs: &[BldcConfig], chip: DacChipConfig) -> Self {
        let drives: Vec<_, _> =
            configs.iter().take(MAX_BLDCS).map(|config| Drive::new(*config, chip.full_scale_v)).collect();
        Self { wanted: wanted(&drives), drives }
    }

    /// Sets the command of drive number `index` of the configuration, effective from the next [`Bldcs::step`] on.
    pub fn command(&mut self, index: usize, command: Command) {
        self.drives[index].command = command;
    }

    /// Takes all drives to neutral and brakes them, until the next command.
    pub fn make_safe(&mut self) -> Wanted {
        let changed = self.drives.iter_mut().fold(false, |changed, drive| {
            drive.command = Command::Brake;
            changed | drive.changes(Drive::brake)
        });
        if changed { self.renew() } else { self.wanted }
    }

    /// Steps all drives by `period_s`, s, towards their commands.
    pub fn step(&mut self, period_s: f32) -> Wanted {
        let period_us = libm::roundf(period_s * 1e6) as u32;
        let changed = self
            .drives
            .iter_mut()
            .fold(false, |changed, drive| changed | drive.changes(|drive| drive.step(period_s, period_us)));
        if changed { self.renew() } else { self.wanted }
    }

    /// Request of the last step or safe state.
    #[must_use]
    pub const fn wanted(&self) -> Wanted {
        self.wanted
    }

    /// Computes the codes and line levels that [`Bldcs::wanted`] returns, from the drives' present state.
    fn renew(&mut self) -> Wanted {
        self.wanted = wanted(&self.drives);
        self.wanted
    }

    /// Takes over the directions from the expander's pins, which drive `levels`.
    pub fn resume(&mut self, levels: u16) {
        for drive in &mut self.drives {
            drive.backwards = (levels ^ drive.inactive) & drive.direction_line != 0;
            drive.at_neutral_us = 0;
        }
        self.renew();
    }

    /// Commanded share of full speed of each drive at present, -1..=1.
    pub fn shares(&self) -> impl Iterator<Item = f32> + '_ {
        self.drives.iter().map(|drive| drive.share)
    }
}

fn wanted(drives: &[Drive]) -> Wanted {
    let mut wanted = Wanted { codes: [0; OUTPUTS], mask: 0, levels: 0 };
    for drive in drives {
        wanted.codes[usize::from(drive.config.output)] = drive.code();
        wanted.mask |= drive.direction_line | drive.brake_line;
        wanted.levels |= drive.levels();
    }
    wanted
}

#[derive(Clone, Debug)]
struct Drive {
    config: BldcConfig,
    full_scale_v: f32,
    /// Lowest and highest permitted code.
    window: [u16; 2],
    /// Expander bits of the lines, 0 without a line, and the bits' levels while neither is active.
    direction_line: u16,
    brake_line: u16,
    inactive: u16,
    command: Command,
    /// Commanded share of full speed; with a direction line negative only while that is active.
    share: f32,
    /// Time since `share` became 0, µs.
    at_neutral_us: u32,
    braked: bool,
    /// True while the direction line, if there is one, is active.
    backwards: bool,
}

impl Drive {
    fn new(config: BldcConfig, full_scale_v: f32) -> Self {
        let backwards_v = if let Reverse::Voltage { full_v } = config.reverse { full_v } else { config.neutral_v };
        let direction = if let Reverse::Line { line, .. } = config.reverse { Some(line) } else { None };
        let [direction_line, brake_line] = [direction, config.brake].map(|line| line.map_or(0, |line| 1 << line.bit));
        let active_low = [direction, config.brake].into_iter().flatten().filter(|line| line.active_low);
        let ends = [config.neutral_v, config.forward_v, backwards_v].map(|volts| code_for(volts, full_scale_v));
        Self {
            config,
            full_scale_v,
            window: ends.iter().fold([CODE_MAX, 0], |[low, high], code| [low.min(*code), high.max(*code)]),
            direction_line,
            brake_line,
            inactive: active_low.fold(0, |levels, line| levels | 1 << line.bit),
            command: Command::Brake,
            share: 0.0,
            at_neutral_us: 0,
            braked: true,
            backwards: false,
        }
    }

    fn brake(&mut self) {
        self.share = 0.0;
        self.braked = true;
    }

    /// Applies `what` and returns true if it changes the request to the chips.
    fn changes(&mut self, what: impl FnOnce(&mut Self)) -> bool {
        let before = (self.share, self.braked, self.backwards);
        what(self);
        before != (self.share, self.braked, self.backwards)
    }

    fn step(&mut self, period_s: f32, period_us: u32) {
        if self.share == 0.0 {
            self.at_neutral_us = self.at_neutral_us.saturating_add(period_us);
        }
        let Command::Run(share) = self.command else { return self.brake() };
        if self.braked {
            self.braked = false;
            return;
        }
        let mut target = if share.is_nan() { 0.0 } else { share.within(-1.0, 1.0) };
        match self.config.reverse {
            Reverse::Line { rest_ms, .. } if target != 0.0 && (target < 0.0) != self.backwards => {
                if self.share == 0.0 && self.at_neutral_us >= 1000 * u32::from(rest_ms) {
                    self.backwards = !self.backwards;
                }
                target = 0.0;
            }
            Reverse::None => target = target.max(0.0),
            Reverse::Line { .. } | Reverse::Voltage { .. } => {}
        }
        self.share = towards(self.share, target, self.config.slew_per_s * period_s);
        if self.share != 0.0 {
            self.at_neutral_us = 0;
        }
    }

    fn code(&self) -> u16 {
        let BldcConfig { neutral_v, forward_v, reverse, .. } = self.config;
        let full_v = match reverse {
            Reverse::Voltage { full_v } if self.share < 0.0 => full_v,
            _ => forward_v,
        };
        let [low, high] = self.window;
        code_for(neutral_v + self.share.abs() * (full_v - neutral_v), self.full_scale_v).clamp(low, high)
    }

    /// Levels of the drive's expander lines.
    fn levels(&self) -> u16 {
        let direction = if self.backwards { self.direction_line } else { 0 };
        let brake = if self.braked { self.brake_line } else { 0 };
        self.inactive ^ direction ^ brake
    }
}

/// Returns the nearest code for a voltage. Half a code is 0.6 mV of 5 V, a fraction of the chip's own error.
fn code_for(volts: f32, full_scale_v: f32) -> u16 {
    let codes = f32::from(CODE_MAX) + 1.0;
    ((volts / full_scale_v * codes + 0.5) as u16).min(CODE_MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind, config::DriveLine};

    use super::*;

    const PERIOD_S: f32 = 0.001;
    const PERIOD_US: u32 = 1000;
    const CHIP: DacChipConfig = DacChipConfig { address: 0x60, full_scale_v: 5.0 };
    const DIRECTION: DriveLine = DriveLine { bit: 2, active_low: false };
    const BRAKE: DriveLine = DriveLine { bit: 11, active_low: true };
    const NEUTRAL: u16 = 1638; // 2.0 V is code 1638.4

    /// Drive that reaches full speed in 100 ms.
    fn config(reverse: Reverse) -> BldcConfig {
        BldcConfig {
            id: ChannelId::new(ChannelKind::Bldc, 0),
            output: 1,
            neutral_v: 2.0,
            forward_v: 3.0,
            reverse,
            brake: Some(BRAKE),
            slew_per_s: 10.0,
            stop_brake_ms: 0,
        }
    }

    const fn by_line(rest_ms: u16) -> Reverse {
        Reverse::Line { line: DIRECTION, rest_ms }
    }

    fn after(drives: &mut Bldcs, steps: usize) -> Wanted {
        (0..steps).for_each(|_| _ = drives.step(PERIOD_S));
        drives.wanted()
    }

    #[test]
    fn runs_forwards_with_the_brake_released_first() {
        let mut drives = Bldcs::new(&[config(by_line(50))], CHIP);
        let mask = 1 << 2 | 1 << 11;
        assert_eq!(drives.wanted(), Wanted { codes: [0, NEUTRAL, 0, 0], mask, levels: 0 }, "braked, at neutral");
        drives.command(0, Command::Run(1.0));
        assert_eq!(drives.step(PERIOD_S), Wanted { codes: [0, NEUTRAL, 0, 0], mask, levels: 1 << 11 });
        assert_eq!(drives.step(PERIOD_S).codes[1], 1647); // 2.01 V is code 1646.6
        assert_eq!(after(&mut drives, 99).codes[1], 2458); // 3.0 V is code 2457.6
        assert_eq!(drives.make_safe(), Wanted { codes: [0, NEUTRAL, 0, 0], mask, levels: 0 });
        assert_eq!(after(&mut drives, 10).levels, 0, "and stays so");
    }

    #[test]
    fn the_direction_line_waits_for_the_ramp_and_the_rest() {
        let mut drives = Bldcs::new(&[config(by_line(50))], CHIP);
        drives.command(0, Command::Run(0.5));
        assert_eq!(after(&mut drives, 100).codes[1], 2048);
        drives.command(0, Command::Run(-0.5));
        let ramp = (1..).find(|_| drives.step(PERIOD_S).codes[1] == NEUTRAL && drives.drives[0].share == 0.0);
        assert!(matches!(ramp, Some(50 | 51)), "{ramp:?} steps, the last for what rounding left");
        // The rest takes 50 periods; the line changes in the last of them.
        let before = after(&mut drives, 49);
        assert_eq!((before.codes[1], before.levels & 1 << 2), (NEUTRAL, 0));
        let changed = drives.step(PERIOD_S);
        assert_eq!((changed.codes[1], changed.levels & 1 << 2), (NEUTRAL, 1 << 2));
        assert_eq!(after(&mut drives, 51).codes[1], 2048, "the same voltages backwards");
        assert_eq!(drives.drives[0].share, -0.5);
    }

    #[test]
    fn a_stop_right_after_the_start_does_not_count_the_rest_before_it() {
        let mut drives = Bldcs::new(&[config(by_line(50))], CHIP);
        drives.command(0, Command::Run(0.0));
        after(&mut drives, 100);
        drives.command(0, Command::Run(1.0));
        drives.step(PERIOD_S);
        drives.make_safe();
        drives.command(0, Command::Run(-1.0));
        assert_eq!(after(&mut drives, 49).levels & 1 << 2, 0);
        assert_eq!(drives.step(PERIOD_S).levels & 1 << 2, 1 << 2);
    }

    /// For any polarity of the lines and any levels found at a restart, the direction is kept, brakes are applied, and
    /// the direction changes only after a full rest.
    #[test]
    fn a_restart_keeps_the_direction_until_the_drive_has_rested() {
        for (direction_low, brake_low) in [(false, false), (false, true), (true, false), (true, true)] {
            let direction = DriveLine { active_low: direction_low, ..DIRECTION };
            let brake = DriveLine { active_low: brake_low, ..BRAKE };
            let reverse = Reverse::Line { line: direction, rest_ms: 50 };
            for levels in [0, 1 << 2, 1 << 11, 1 << 2 | 1 << 11, 1, 1 | 1 << 2, u16::MAX, !(1 << 2)] {
                let mut drives = Bldcs::new(&[BldcConfig { brake: Some(brake), ..config(reverse) }], CHIP);
                let turns = |wanted: Wanted| (wanted.levels & 1 << 2 != 0) != direction_low;
                let brakes = |wanted: Wanted| (wanted.levels & 1 << 11 != 0) != brake_low;
                after(&mut drives, 100);
                drives.resume(levels);
                let resumed = drives.wanted();
                assert_eq!((resumed.levels & 1 << 2, brakes(resumed)), (levels & 1 << 2, true), "{levels:#x}");
                assert_eq!((resumed.codes[1], resumed.levels & !resumed.mask), (NEUTRAL, 0));
                // The same direction continues at once, the other one after 50 ms of rest counted from the restart.
                let backwards = turns(resumed);
                let mut same = drives.clone();
                same.command(0, Command::Run(if backwards { -0.5 } else { 0.5 }));
                let running = after(&mut same, 60);
                assert_eq!((running.codes[1], turns(running), brakes(running)), (2048, backwards, false));
                drives.command(0, Command::Run(if backwards { 0.5 } else { -0.5 }));
                assert_eq!(turns(after(&mut drives, 49)), backwards, "{levels:#x}");
                assert_eq!(turns(after(&mut drives, 1)), !backwards, "{levels:#x}");
                assert_eq!(after(&mut drives, 60).codes[1], 2048);
            }
        }
        // A drive without a direction line has no direction to keep.
        let mut drives = Bldcs::new(&[config(Reverse::Voltage { full_v: 1.22 })], CHIP);
        drives.resume(u16::MAX);
        assert_eq!(drives.wanted().levels, 0);
    }

    #[test]
    fn backwards_by_voltage_or_not_at_all() {
        let mut drives = Bldcs::new(&[config(Reverse::Voltage { full_v: 1.22 })], CHIP);
        drives.command(0, Command::Run(-1.0));
        assert_eq!(after(&mut drives, 101).codes[1], 999); // 1.22 V is code 999.4
        let mut drives = Bldcs::new(&[config(Reverse::None)], CHIP);
        drives.command(0, Command::Run(-1.0));
        assert_eq!(after(&mut drives, 101).codes[1], NEUTRAL);
        drives.command(0, Command::Run(f32::NAN));
        assert_eq!(after(&mut drives, 101).codes[1], NEUTRAL);
    }

    #[test]
    fn not_even_a_share_beyond_full_leaves_the_window() {
        let mut drives = Bldcs::new(&[config(Reverse::Voltage { full_v: 1.22 })], CHIP);
        let codes = [2.0, f32::INFINITY, -2.0, f32::NEG_INFINITY].map(|share| {
            drives.drives[0].share = share;
            wanted(&drives.drives).codes[1]
        });
        assert_eq!(codes, [2458, 2458, 999, 999]);
    }

    fn any_config(output: u8) -> impl Strategy<Value = BldcConfig> {
        let line = move |bit| any::<bool>().prop_map(move |active_low| DriveLine { bit, active_low });
        let reverse = prop_oneof![
            Just(None),
            (line(2 * output), 0..30u16).prop_map(|(line, rest_ms)| Some(Reverse::Line { line, rest_ms })),
        ];
        (
            0.5f32..4.5,
            0.01f32..0.5,
            0.01f32..0.5,
            any::<bool>(),
            reverse,
            prop::option::of(line(2 * output + 1)),
            0.1f32..500.0,
        )
            .prop_map(move |(neutral_v, up_v, down_v, forward_is_up, reverse, brake, slew_per_s)| {
                let (forward_v, full_v) = if forward_is_up {
                    (neutral_v + up_v, neutral_v - down_v)
                } else {
                    (neutral_v - down_v, neutral_v + up_v)
                };
                let reverse = reverse.unwrap_or(Reverse::Voltage { full_v });
                let id = ChannelId::new(ChannelKind::Bldc, output);
                BldcConfig { id, output, neutral_v, forward_v, reverse, brake, slew_per_s, stop_brake_ms: 0 }
            })
    }

    #[derive(Clone, Copy, Debug)]
    enum Event {
        Command(usize, Command),
        MakeSafe,
        Steps(usize),
    }

    fn any_event() -> impl Strategy<Value = Event> {
        let share = prop_oneof![-1.5f32..1.5, Just(0.0), Just(1.0), Just(-1.0), any::<f32>()];
        let command = prop_oneof![4 => share.prop_map(Command::Run), 1 => Just(Command::Brake)];
        prop_oneof![
            4 => (0..4usize, command).prop_map(|(index, command)| Event::Command(index, command)),
            1 => Just(Event::MakeSafe),
            4 => (1..60usize).prop_map(Event::Steps),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn any_commands_keep_the_rules(
            configs in (any_config(0), any_config(1), any_config(2), any_config(3)),
            events in prop::collection::vec(any_event(), 1..60),
        ) {
            let configs = <[BldcConfig; 4]>::from(configs);
            let mut drives = Bldcs::new(&configs, CHIP);
            let exact = |volts: f32| f64::from(volts) / 5.0 * 4096.0;
            // Rounding: f32 leaves 1e-3 of 4096 codes, then half a code.
            let half = 0.501;
            let mut last = drives.wanted();
            let mut last_share = [0.0; 4];
            let mut at_neutral_us = [0u32; 4];
            for event in events {
                let steps = match event {
                    Event::Command(index, command) => {
                        drives.command(index, command);
                        0
                    }
                    Event::MakeSafe => {
                        drives.make_safe();
                        last_share = [0.0; 4];
                        // The chips are written between two steps.
                        last = drives.wanted();
                        for (us, config) in at_neutral_us.iter_mut().zip(&configs) {
                            if (f64::from(last.codes[usize::from(config.output)]) - exact(config.neutral_v)).abs() > half {
                                *us = 0;
                            }
                        }
                        0
                    }
                    Event::Steps(steps) => steps,
                };
                for _ in 0..steps {
                    let now = drives.step(PERIOD_S);
                    for (index, config) in configs.iter().enumerate() {
                        let output = usize::from(config.output);
                        let code = f64::from(now.codes[output]);
                        let neutral = exact(config.neutral_v);
                        let full = if let Reverse::Voltage { full_v } = config.reverse { full_v } else { config.neutral_v };
                        let ends = [config.neutral_v, config.forward_v, full].map(exact);
                        prop_assert!(code >= ends.iter().copied().fold(f64::MAX, f64::min) - half, "below the window");
                        prop_assert!(code <= ends.iter().copied().fold(0.0, f64::max) + half, "above the window");

                        let active = |wanted: &Wanted, line: DriveLine| (wanted.levels >> line.bit & 1 != 0) != line.active_low;
                        let is_neutral = |code: u16| (f64::from(code) - neutral).abs() <= half;
                        let braked = config.brake.is_some_and(|line| active(&now, line));
                        let was_braked = config.brake.is_some_and(|line| active(&last, line));
                        prop_assert!(!(braked || was_braked) || is_neutral(now.codes[output]), "braked, or just released");
                        if let Reverse::Line { line, rest_ms } = config.reverse {
                            // Neutral after the step before counts for the period up to this one.
                            at_neutral_us[index] =
                                if is_neutral(last.codes[output]) { at_neutral_us[index] + PERIOD_US } else { 0 };
                            if active(&last, line) != active(&now, line) {
                                prop_assert!(is_neutral(last.codes[output]) && is_neutral(now.codes[output]));
                                prop_assert!(at_neutral_us[index] >= 1000 * u32::from(rest_ms), "{} us", at_neutral_us[index]);
                            }
                        }
                        let share = drives.drives[index].share;
                        let full = match config.reverse {
                            Reverse::Voltage { full_v } if share < 0.0 => full_v,
                            _ => config.forward_v,
                        };
                        let volts = neutral + f64::from(share.abs()) * (exact(full) - neutral);
                        prop_assert!((code - volts).abs() <= half, "{code}, not {volts}, for {share}");
                        let change = (share - last_share[index]).abs();
                        // One rounding error of the sum, whose magnitude is at most 1.
                        let most = config.slew_per_s * PERIOD_S + f32::EPSILON;
                        prop_assert!(change <= most || drives.drives[index].braked, "{change}, {most}");
                        last_share[index] = share;
                    }
                    last = now;
                }
            }
        }
    }
}
