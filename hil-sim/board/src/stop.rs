//! Measurement of the time until each kind of a board's outputs is safe, as seen from outside: pins, chips and
//! voltages.

use std::fmt;

use r4_protocol::{
    ChannelId,
    config::{BoardConfig, RelayRole},
};

use crate::{chips::pca9685::Pca9685, environment::Environment, world::World};

/// Number of outputs of a PCA9685.
const PWM_OUTPUTS: u8 = 16;
/// Register LED0_ON_L, the first of four registers of each output (PCA9685 datasheet, table 4).
const LED0: u8 = 0x06;
/// Full OFF bit in the last of those four (7.3.3).
const FULL_OFF: u8 = 0x10;
/// Number of codes of both DACs.
const DAC_CODES: f64 = 4096.0;
/// Full scale of the processor's own DAC, V: its reference.
const OWN_DAC_V: f64 = 3.3;
/// Tolerance of a voltage, codes: half a code of rounding, and the error of a sum of floats.
const WITHIN_CODES: f64 = 0.6;

/// A kind of output, with its condition for being safe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Outputs {
    /// Relay in the motors' supply: commanded open, over the bus.
    MotorPower,
    /// Bridges: no transistor conducts, by the hardware lines or by the chip's outputs.
    Bridges,
    /// The same bridges in their chips: every PWM output is full OFF in its registers.
    BridgeChips,
    /// Brushless drives: neutral at the speed input.
    Bldcs,
    /// Steppers: no further pulse.
    Steppers,
    /// Servos: no new pulse width if they hold when safe, no pulse if they do not.
    Servos,
    /// The processor's analog outputs: at their safe voltage.
    Dacs,
}

impl Outputs {
    /// All kinds, in the order of declaration.
    pub const ALL: [Self; 7] =
        [Self::MotorPower, Self::Bridges, Self::BridgeChips, Self::Bldcs, Self::Steppers, Self::Servos, Self::Dacs];

    /// True if a board has outputs of this kind.
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

/// Records the time since which each kind of output is safe without interruption, with the resolution of its samples.
///
/// A time is never too early: it is that of the first sample in which all outputs of a kind were safe. Steppers and
/// held servos are safe if nothing has changed since the sample before.
pub struct StopWatch {
    safe_since_ns: [Option<u64>; Outputs::ALL.len()],
    steps: Vec<i64>,
    pulses: Vec<Option<u8>>,
}

impl StopWatch {
    /// Starts with a first sample.
    #[must_use]
    pub fn new(board: &Environment) -> Self {
        let mut watch = Self { safe_since_ns: [None; Outputs::ALL.len()], steps: Vec::new(), pulses: Vec::new() };
        watch.look(board);
        watch
    }

    /// Samples all outputs at the present time.
    pub fn look(&mut self, board: &Environment) {
        let config = &board.robot().config;
        let mut world = board.world();
        let now_ns = world.clock().now_ns();
        for (kind, outputs) in Outputs::ALL.into_iter().enumerate() {
            let safe = self.is_safe(outputs, config, &mut world);
            let since = &mut self.safe_since_ns[kind];
            *since = if safe { since.or(Some(now_ns)) } else { None };
        }
    }

    /// Time since which `outputs` are safe, ns; `None` if they were not at the last sample.
    #[must_use]
    pub fn safe_since_ns(&self, outputs: Outputs) -> Option<u64> {
        self.safe_since_ns[outputs as usize]
    }

    fn is_safe(&mut self, outputs: Outputs, config: &BoardConfig, world: &mut World) -> bool {
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
                    world.throttle_v(bldc.id).is_some_and(|volts| is_near(volts, bldc.neutral_v, full_scale_v))
                })
            }
            Outputs::Steppers => {
                let commanded = |id| world.stepper(id).map_or(0, |driver| driver.commanded());
                let steps = config.steppers.iter().map(|stepper| stepper.id).map(commanded).collect();
                let before = std::mem::replace(&mut self.steps, steps);
                // no step since the last sample
                before == self.steps
            }
            Outputs::Servos => {
                let Some(chip) = world.servo_pwm() else { return true };
                let pulses = (LED0..LED0 + 4 * PWM_OUTPUTS).map(|register| chip.borrow().register(register)).collect();
                let before = std::mem::replace(&mut self.pulses, pulses);
                // servos hold their positions while their pulses stay the same
                let holds = config.servo_pwm.is_some_and(|chip| chip.hold_when_safe);
                (holds && before == self.pulses) || all_off(&chip.borrow())
            }
            Outputs::Dacs => config.dacs.iter().all(|dac| {
                let volts = world.pins().dac_v(dac.id.index.into());
                volts.is_some_and(|volts| is_near(volts, dac.safe_v, OWN_DAC_V))
            }),
        }
    }
}

/// Travel within [`REST_NS`] below which a plant is at rest: slower than 0.05 rad/s, 3 degrees a second, or 0.5 mm/s.
const REST_TRAVEL_RAD: f64 = 0.01;
const REST_TRAVEL_M: f64 = 1e-4;
const REST_NS: u64 = 200_000_000;

/// Follows the plants that can run on: the time from which nothing drives them, and how long and how far they still
/// move. Servos hold, and are not among them.
///
/// Times are those of the first sample that shows it, so never too early.
pub struct RunOut {
    plants: Vec<Plant>,
}

struct Plant {
    channel: ChannelId,
    start: f64,
    /// Position after the last travel of `rest_travel`, and its time, ns.
    last: f64,
    moved_ns: u64,
    rest_travel: f64,
    /// Time since which it is off, ns.
    off_ns: Option<u64>,
    /// Commanded step count of a stepper.
    commanded: i64,
}

/// Result for a plant that ran out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ran {
    /// Channel of the plant.
    pub channel: ChannelId,
    /// Virtual time at which its output went off permanently, ns: no transistor conducts, the speed input is neutral,
    /// no pulse follows. `None` while it is on.
    pub off_ns: Option<u64>,
    /// Virtual time at which it came to rest, ns; `None` while it moves.
    pub rest_ns: Option<u64>,
    /// Distance from its position at the creation of [`RunOut`], rad or m.
    pub distance: f64,
}

impl RunOut {
    /// Starts at the present time and positions.
    #[must_use]
    pub fn new(board: &Environment) -> Self {
        let config = &board.robot().config;
        let mut world = board.world();
        let now_ns = world.clock().now_ns();
        let motors = config.motors.iter().map(|motor| motor.id);
        let others = config.bldcs.iter().map(|bldc| bldc.id).chain(config.steppers.iter().map(|stepper| stepper.id));
        let plants = motors.chain(others).filter_map(|channel| {
            let start = world.position(channel)?;
            let rest_travel = if world.is_linear(channel) { REST_TRAVEL_M } else { REST_TRAVEL_RAD };
            let (last, moved_ns) = (start, now_ns);
            Some(Plant { channel, start, last, moved_ns, rest_travel, off_ns: None, commanded: i64::MIN })
        });
        Self { plants: plants.collect() }
    }

    /// Samples all plants at the present time.
    pub fn look(&mut self, board: &Environment) {
        let config = &board.robot().config;
        let full_scale_v = config.bldc_dac.map_or(0.0, |chip| f64::from(chip.full_scale_v));
        let mut world = board.world();
        let now_ns = world.clock().now_ns();
        for plant in &mut self.plants {
            let position = world.position(plant.channel).unwrap_or(plant.last);
            if (position - plant.last).abs() > plant.rest_travel {
                (plant.last, plant.moved_ns) = (position, now_ns);
            }
            let commanded = world.stepper(plant.channel).map(|driver| driver.commanded());
            let is_off = match (commanded, config.bldcs.iter().find(|bldc| bldc.id == plant.channel)) {
                (Some(commanded), _) => std::mem::replace(&mut plant.commanded, commanded) == commanded,
                (None, Some(bldc)) => {
                    world.throttle_v(bldc.id).is_some_and(|volts| is_near(volts, bldc.neutral_v, full_scale_v))
                }
                (None, None) => world.drive(plant.channel).is_some_and(|drive| drive.coast == 1.0),
            };
            plant.off_ns = if is_off { plant.off_ns.or(Some(now_ns)) } else { None };
        }
    }

    /// True if every plant is off and at rest, at the last sample, taken at `now_ns`.
    #[must_use]
    pub fn is_over(&self, now_ns: u64) -> bool {
        self.plants.iter().all(|plant| plant.off_ns.is_some() && now_ns >= plant.moved_ns + REST_NS)
    }

    /// Result for each plant, at the last sample, taken at `now_ns`.
    #[must_use]
    pub fn ran(&self, board: &Environment, now_ns: u64) -> Vec<Ran> {
        let mut world = board.world();
        let ran = self.plants.iter().map(|plant| Ran {
            channel: plant.channel,
            off_ns: plant.off_ns,
            rest_ns: (now_ns >= plant.moved_ns + REST_NS).then_some(plant.moved_ns),
            distance: world.position(plant.channel).map_or(0.0, |position| (position - plant.start).abs()),
        });
        ran.collect()
    }
}

/// True if a voltage equals the wanted one within the resolution of a converter.
fn is_near(volts: f64, wanted_v: f32, full_scale_v: f64) -> bool {
    (volts - f64::from(wanted_v)).abs() <= WITHIN_CODES * full_scale_v / DAC_CODES
}

/// True if every output is full OFF.
fn all_off(chip: &Pca9685) -> bool {
    (0..PWM_OUTPUTS).all(|output| chip.register(LED0 + 4 * output + 3).is_some_and(|high| high & FULL_OFF != 0))
}
