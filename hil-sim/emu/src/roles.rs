//! Which of the chip's pins is wired to what, from the carrier's file.

use r4_boards::Carrier;
use r4_mcu::Pin;

/// What a pin of the chip is wired to. Numbers are those of the carrier's connectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Role {
    /// A track of an encoder.
    Track { encoder: u8, b: bool },
    /// The switch beside an encoder.
    Switch(u8),
    /// Pulses to a stepper driver.
    Step(u8),
    /// Direction of a stepper driver.
    Direction(u8),
    /// Enable of all stepper drivers.
    StepperEnable,
    /// Trigger of a range sensor.
    Trigger(u8),
    /// Echo of a range sensor.
    Echo(u8),
    /// A divided analog input.
    Analog(u8),
    /// An analog output.
    Dac(u8),
    /// DISABLE of the OSMC bridges.
    OsmcDisable,
    /// Output enable of the motors' PWM chips; high is off.
    PwmDisable,
    /// LDAC of the brushless drives' DAC.
    LoadDac,
    /// The dead-man's handle.
    DeadMan,
    /// The auxiliary stop.
    AuxiliaryStop,
    /// To an external watchdog.
    Heartbeat,
    /// A light of the processor's board: 0 red, 1 green, 2 blue; on while low.
    Light(u8),
    /// Clock of an I2C bus, by the chip's controller.
    Scl(u8),
    /// Data of an I2C bus.
    Sda(u8),
    /// The button of the processor's board.
    Button,
}

/// The roles of all pins that have one.
pub(crate) struct Roles {
    /// By port and number.
    by_pin: [[Option<Role>; 16]; PORTS],
    by_role: Vec<(Role, Pin)>,
}

/// Ports A to K.
const PORTS: usize = 11;

impl Roles {
    /// Reads them from a carrier. The carrier's reader has checked that each name it uses is a pin of it.
    pub(crate) fn new(carrier: &Carrier) -> Self {
        let mut roles = Self { by_pin: [[None; 16]; PORTS], by_role: Vec::new() };
        let mut is = |id: &str, role: Role| {
            if let Some(pin) = carrier.pin(id) {
                let pin = Pin::new(pin.stm32.port, pin.stm32.number);
                roles.by_pin[usize::from(pin.port)][usize::from(pin.number)] = Some(role);
                roles.by_role.push((role, pin));
            }
        };
        for (pins, encoder) in carrier.encoder.connectors.iter().zip(0..) {
            is(&pins.a, Role::Track { encoder, b: false });
            is(&pins.b, Role::Track { encoder, b: true });
            is(&pins.switch, Role::Switch(encoder));
        }
        for (pins, index) in carrier.stepper.connectors.iter().zip(0..) {
            is(&pins.step, Role::Step(index));
            is(&pins.direction, Role::Direction(index));
        }
        is(&carrier.stepper.enable, Role::StepperEnable);
        for (pins, index) in carrier.range.connectors.iter().zip(0..) {
            is(&pins.trigger, Role::Trigger(index));
            is(&pins.echo, Role::Echo(index));
        }
        carrier.analog.inputs.iter().zip(0..).for_each(|(id, index)| is(id, Role::Analog(index)));
        carrier.dac.outputs.iter().zip(0..).for_each(|(id, index)| is(id, Role::Dac(index)));
        is(&carrier.osmc.disable, Role::OsmcDisable);
        is(&carrier.safety.motor_output_enable_n, Role::PwmDisable);
        is(&carrier.bldc.load_dac, Role::LoadDac);
        is(&carrier.safety.dead_man, Role::DeadMan);
        is(&carrier.safety.stop, Role::AuxiliaryStop);
        is(&carrier.safety.heartbeat, Role::Heartbeat);
        // Of the processor's board, which every carrier has by these names.
        ["led_r", "led_g", "led_b"].iter().zip(0..).for_each(|(id, index)| is(id, Role::Light(index)));
        is("btn", Role::Button);
        // Buses are told by the signal, as in I2C2_SCL.
        for pin in &carrier.pins {
            let Some((controller, line)) = pin.signal.as_deref().and_then(i2c_signal) else { continue };
            is(&pin.id, if line == "SCL" { Role::Scl(controller) } else { Role::Sda(controller) });
        }
        roles
    }

    /// What a pin is wired to.
    pub(crate) fn of(&self, pin: Pin) -> Option<Role> {
        *self.by_pin.get(usize::from(pin.port))?.get(usize::from(pin.number))?
    }

    /// The pin that has a role.
    pub(crate) fn pin(&self, role: Role) -> Option<Pin> {
        self.by_role.iter().rev().find(|(known, _)| *known == role).map(|(_, pin)| *pin)
    }
}

/// Controller and line of a signal such as `I2C2_SCL`.
fn i2c_signal(signal: &str) -> Option<(u8, &str)> {
    let (controller, line) = signal.strip_prefix("I2C")?.split_once('_')?;
    Some((controller.parse().ok()?, line))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_carriers_pins_have_their_roles() {
        let roles = Roles::new(&r4_boards::load_carrier("r4-carrier").expect("it is built in"));
        assert_eq!(roles.of(Pin::new('G', 7)), Some(Role::DeadMan));
        assert_eq!(roles.of(Pin::new('J', 6)), Some(Role::Track { encoder: 0, b: true }));
        assert_eq!(roles.of(Pin::new('H', 4)), Some(Role::Scl(2)));
        assert_eq!(roles.pin(Role::Step(1)), Some(Pin::new('A', 7)));
        assert_eq!(roles.of(Pin::new('A', 13)), None);
    }
}
