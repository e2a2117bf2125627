//! Slots of the board's channels in the arrays of their statuses and commands.

use r4_protocol::{
    Mode,
    config::{
        ANALOG_INPUTS, DAC_OUTPUTS, ENCODERS, MAX_BLDCS, MAX_MOTORS, MAX_RELAYS, MAX_SENSORS, MAX_SERVOS, MAX_SUPPLIES,
        Place, RANGE_SENSORS, STEPPERS, SWITCHES,
    },
};

/// Number of command slots; a brake is commanded beside its drive.
pub(super) const OUTPUTS: usize = MAX_MOTORS + 2 * MAX_BLDCS + MAX_SERVOS + STEPPERS + MAX_RELAYS + DAC_OUTPUTS;
/// Maximum number of channels of a board, dead-man's handle and auxiliary stop included.
pub(super) const CHANNELS: usize =
    OUTPUTS - MAX_BLDCS + ENCODERS + SWITCHES + RANGE_SENSORS + ANALOG_INPUTS + MAX_SUPPLIES + MAX_SENSORS + 2;

/// Index of a channel's status. Outputs come first, and their commands have the same index.
pub(super) fn slot(place: Place) -> usize {
    const BLDC: usize = MAX_MOTORS;
    const SERVO: usize = BLDC + MAX_BLDCS;
    const STEPPER: usize = SERVO + MAX_SERVOS;
    const RELAY: usize = STEPPER + STEPPERS;
    const DAC: usize = RELAY + MAX_RELAYS;
    const ENCODER: usize = DAC + DAC_OUTPUTS;
    const SWITCH: usize = ENCODER + ENCODERS;
    const RANGE: usize = SWITCH + SWITCHES;
    const ANALOG: usize = RANGE + RANGE_SENSORS;
    const SUPPLY: usize = ANALOG + ANALOG_INPUTS;
    const SENSOR: usize = SUPPLY + MAX_SUPPLIES;
    const DEAD_MAN: usize = SENSOR + MAX_SENSORS;
    match place {
        Place::Motor(index) => index,
        Place::Bldc(index) => BLDC + index,
        Place::Servo(index) => SERVO + index,
        Place::Stepper(index) => STEPPER + index,
        Place::Relay(index) => RELAY + index,
        Place::Dac(index) => DAC + index,
        Place::Encoder(index) => ENCODER + index,
        Place::Switch(index) => SWITCH + index,
        Place::Range(index) => RANGE + index,
        Place::Analog(index) => ANALOG + index,
        Place::Supply(index) => SUPPLY + index,
        Place::Sensor(index) => SENSOR + index,
        Place::DeadMan(index) => DEAD_MAN + index,
    }
}

/// Index of an output's newest command; brakes come behind all others, so that the next speed does not replace a brake
/// command.
pub(super) fn command_slot(place: Place, mode: Mode) -> usize {
    match (place, mode) {
        (Place::Bldc(index), Mode::Brake) => OUTPUTS - MAX_BLDCS + index,
        _ => slot(place),
    }
}
