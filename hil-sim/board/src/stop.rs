//! How long each kind of a board's outputs takes until it is safe, seen from outside: pins, chips and voltages.

use std::fmt;

use r4_protocol::config::{BoardConfig, RelayRole};

use crate::{chips::pca9685::Pca9685, surroundings::Surroundings, world::World};

/// Outputs of a PCA9685.
const PWM_OUTPUTS: u8 = 16;
/// LED0_ON_L, the first of four registers of each output (PCA9685 datasheet, table 4).
const LED0: u8 = 0x06;
/// Full OFF, in the last of those four (7.3.3).
const FULL_OFF: u8 = 0x10;
/// Codes of both DACs.
const DAC_CODES: f64 = 4096.0;
/// Full scale of the processor's own DAC, V: its reference.
const OWN_DAC_V: f64 = 3.3;
/// A voltage is the wanted one within so many codes: half a code of rounding, and what a sum of floats leaves.
const WITHIN_CODES: f64 = 0.6;

/// A kind of output, and what counts as safe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Outputs {
    /// The relay in the motors' supply: told to open, over the bus.
    MotorPower,
    /// Bridges: no transistor conducts, by the hardware lines or by the chip's outputs.
    Bridges,
    /// The same bridges in their chips: every PWM output is full OFF in its registers.
    BridgeChips,
    /// Brushless drives: neutral at the speed input.
    Bldcs,
    /// Steppers: no further pulse.
    Steppers,
    /// Servos: no new pulse width where they hold when safe, no pulse where they do not.
    Servos,
    /// The processor's analog outputs: at their safe voltage.
    Dacs,
}

impl Outputs {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::MotorPower, Self::Bridges, Self::BridgeChips, Self::Bldcs, Self::Steppers, Self::Servos, Self::Dacs];

    /// Whether a board has them.
    #[must_use]
    pub fn are_on(self, config: &BoardConfig) -> bool {
        match self {
            Self::MotorPower => config.relays.iter().any(|relay| relay.role == RelayRole::MotorPower),
            Self::Bridges | Self::BridgeChips => !config.motors.is_empty(),
            Self::Bldcs => !config.bldcs.is_empty(),
            Self::Steppers => !config.steppers.is_empty(),
            Self::Servos => !config.servos.is_empty(),
            Self::Dacs => !config.dacs.is_empty(),
        }
    }
}

impl fmt::Display for Outputs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MotorPower => "motor power relay",
            Self::Bridges => "bridges off",
            Self::BridgeChips => "bridge chips off",
            Self::Bldcs => "brushless neutral",
            Self::Steppers => "steppers still",
            Self::Servos => "servos held",
            Self::Dacs => "analog outputs safe",
        })
    }
}

/// Tells since when each kind of output is safe without interruption, to the resolution at which it looks.
///
/// A time is never too early: it is that of the first look at which all of a kind were seen safe. Steppers and held
/// servos are so when nothing has changed since the look before.
pub struct StopWatch {
    safe_since_ns: [Option<u64>; Outputs::ALL.len()],
    steps: Vec<i64>,
    pulses: Vec<Option<u8>>,
}

impl StopWatch {
    /// Takes the first look.
    #[must_use]
    pub fn new(board: &Surroundings) -> Self {
        let mut watch = Self { safe_since_ns: [None; Outputs::ALL.len()], steps: Vec::new(), pulses: Vec::new() };
        watch.look(board);
        watch
    }

    /// Looks at all outputs now.
    pub fn look(&mut self, board: &Surroundings) {
        let config = &board.robot().config;
        let mut world = board.world();
        let now_ns = world.clock().now_ns();
        for (kind, outputs) in Outputs::ALL.into_iter().enumerate() {
            let safe = self.is_safe(outputs, config, &mut world);
            let since = &mut self.safe_since_ns[kind];
            *since = if safe { since.or(Some(now_ns)) } else { None };
        }
    }

    /// Since when `outputs` are safe; `None` when they were not at the last look.
    #[must_use]
    pub fn safe_since_ns(&self, outputs: Outputs) -> Option<u64> {
        self.safe_since_ns[outputs as usize]
    }

    fn is_safe(&mut self, outputs: Outputs, config: &BoardConfig, world: &mut World) -> bool {
        let near = |volts: f64, wanted_v: f32, full_scale_v: f64| {
            (volts - f64::from(wanted_v)).abs() <= WITHIN_CODES * full_scale_v / DAC_CODES
        };
        match outputs {
            Outputs::MotorPower => {
                let mut relays = config.relays.iter().filter(|relay| relay.role == RelayRole::MotorPower);
                relays.all(|relay| world.relay_closed(relay.id) == Some(false))
            }
            Outputs::Bridges => {
                config.motors.iter().all(|motor| world.drive(motor.id).is_some_and(|drive| drive.coast == 1.0))
            }
            Outputs::BridgeChips => {
                world.osmc_pwm().into_iter().chain(world.dhb_pwm()).all(|chip| all_off(&chip.borrow()))
            }
            Outputs::Bldcs => {
                let full_scale_v = config.bldc_dac.map_or(0.0, |chip| f64::from(chip.full_scale_v));
                config.bldcs.iter().all(|bldc| {
                    world.throttle_v(bldc.id).is_some_and(|volts| near(volts, bldc.neutral_v, full_scale_v))
                })
            }
            Outputs::Steppers => {
                let commanded = |id| world.stepper(id).map_or(0, |driver| driver.commanded());
                let steps = config.steppers.iter().map(|stepper| stepper.id).map(commanded).collect();
                let before = std::mem::replace(&mut self.steps, steps);
                before == self.steps
            }
            Outputs::Servos => {
                let Some(chip) = world.servo_pwm() else { return true };
                let pulses = (LED0..LED0 + 4 * PWM_OUTPUTS).map(|register| chip.borrow().register(register)).collect();
                let before = std::mem::replace(&mut self.pulses, pulses);
                let holds = config.servo_pwm.is_some_and(|chip| chip.hold_when_safe);
                (holds && before == self.pulses) || all_off(&chip.borrow())
            }
            Outputs::Dacs => config.dacs.iter().all(|dac| {
                let volts = world.pins().dac_v(dac.id.index.into());
                volts.is_some_and(|volts| near(volts, dac.safe_v, OWN_DAC_V))
            }),
        }
    }
}

/// Whether every output is full OFF.
fn all_off(chip: &Pca9685) -> bool {
    (0..PWM_OUTPUTS).all(|output| chip.register(LED0 + 4 * output + 3).is_some_and(|high| high & FULL_OFF != 0))
}
