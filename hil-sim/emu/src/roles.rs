//! Roles of the chip's pins, from the carrier's file.

use r4_boards::Carrier;
use r4_mcu::Pin;

/// Role of a pin: what the carrier wires it to. Numbers are those of the carrier's connectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Role {
    /// Track A or B of an encoder.
    Track { encoder: u8, b: bool },
    /// Switch input beside an encoder.
    Switch(u8),
    /// Step pulses to a stepper driver.
    Step(u8),
    /// Direction of a stepper driver.
    Direction(u8),
    /// Enable of all stepper drivers.
    StepperEnable,
    /// Trigger of a range sensor.
    Trigger(u8),
    /// Echo of a range sensor.
    Echo(u8),
    /// Analog input with a voltage divider.
    Analog(u8),
    /// Analog output of the DAC.
    Dac(u8),
    /// DISABLE of the OSMC bridges.
    OsmcDisable,
    /// Output enable of the motors' PWM chips; high is off.
    PwmDisable,
    /// LDAC of the brushless drives' DAC.
    LoadDac,
    /// Line of the dead-man's handle.
    DeadMan,
    /// Line of the auxiliary stop.
    AuxiliaryStop,
    /// Heartbeat to an external watchdog.
    Heartbeat,
    /// Light on the processor's board: 0 red, 1 green, 2 blue; on while low.
    Light(u8),
    /// Clock line of an I2C bus, by the number of the chip's controller.
    Scl(u8),
    /// Data line of an I2C bus, by the number of the chip's controller.
    Sda(u8),
    /// Button on the processor's board.
    Button,
}

/// Roles of all pins that have one.
pub(crate) struct Roles {
    /// Role by port and pin number.
    by_pin: [[Option<Role>; 16]; PORTS],
    by_role: Vec<(Role, Pin)>,
}

/// Number of GPIO ports, A to K.
const PORTS: usize = 11;

impl Roles {
    /// Reads the roles from a carrier. Its reader has checked that each name it uses is one of its pins.
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
        // Lights and button belong to the processor's board; every carrier has them under these names.
        ["led_r", "led_g", "led_b"].iter().zip(0..).for_each(|(id, index)| is(id, Role::Light(index)));
        is("btn", Role::Button);
        // I2C pins are found by their signal, such as I2C2_SCL.
        for pin in &carrier.pins {
            let Some((controller, line)) = pin.signal.as_deref().and_then(i2c_signal) else { continue };
            is(&pin.id, if line == "SCL" { Role::Scl(controller) } else { Role::Sda(controller) });
        }
        roles
    }

    /// Returns the role of a pin.
    pub(crate) fn of(&self, pin: Pin) -> Option<Role> {
        *self.by_pin.get(usize::from(pin.port))?.get(usize::from(pin.number))?
    }

    /// Returns the pin with a role; the last one of several.
    pub(crate) fn pin(&self, role: Role) -> Option<Pin> {
        self.by_role.iter().rev().find(|(known, _)| *known == role).map(|(_, pin)| *pin)
    }
}

/// Parses controller number and line of a signal such as `I2C2_SCL`.
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
