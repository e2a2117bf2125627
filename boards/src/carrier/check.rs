//! Rules between the fields of a carrier file.

use std::fmt::Display;

use crate::{
    carrier::{Carrier, Chip, PinKind},
    error::BoardError,
    source::{Claims, Source},
};

/// Reads and checks a carrier file.
pub(crate) fn read(source: &Source) -> Result<Carrier, BoardError> {
    let carrier: Carrier = source.parse()?;
    Check { source, carrier: &carrier, claims: Claims::new(source) }.all()?;
    Ok(carrier)
}

struct Check<'c> {
    source: &'c Source,
    carrier: &'c Carrier,
    claims: Claims<'c>,
}

impl Check<'_> {
    fn all(&mut self) -> Result<(), BoardError> {
        self.pins()?;
        self.i2c()?;
        self.pwm_outputs()?;
        self.expander_bits()?;
        self.connectors()?;
        self.limits()
    }

    fn pins(&mut self) -> Result<(), BoardError> {
        for (index, pin) in self.carrier.pins.iter().enumerate() {
            let path = |field: &str| format!("pins[{index}].{field}");
            self.claims.take("function", &pin.id, path("id"))?;
            self.claims.take("header pin", &pin.header, path("header"))?;
            self.claims.take("pin", pin.stm32, path("stm32"))?;
            if pin.kind == PinKind::Exti {
                // An STM32 has one EXTI line for each pin number, whatever the port (RM0399, EXTI).
                self.claims.take("EXTI line", pin.stm32.number, path("stm32"))?;
                let line = format!("EXTI{}", pin.stm32.number);
                let holds = pin.signal.as_deref() == Some(line.as_str());
                self.rule(holds, path("signal"), "an exti pin has the signal EXTI and its own number")?;
            }
            if let Some(signal) = &pin.signal {
                self.claims.take("signal", signal, path("signal"))?;
                // A pin's signal would change the settings of the timer that keeps the firmware's time.
                let keeps_time = signal.split('_').next() == Some(self.carrier.time.timer.as_str());
                self.rule(!keeps_time, path("signal"), "the timer that keeps the time has no pins")?;
            }
            let alternate = matches!(pin.kind, PinKind::Cap | PinKind::Bus);
            self.rule(pin.af.is_some() == alternate, path("af"), "cap and bus pins have an af, others have none")?;
            self.rule(pin.af.is_none_or(|af| af < 16), path("af"), "af is 0 to 15")?;
            let plain = pin.kind == PinKind::Gpio;
            self.rule(pin.signal.is_none() == plain, path("signal"), "a gpio pin has no signal, others have one")?;
        }
        Ok(())
    }

    fn i2c(&mut self) -> Result<(), BoardError> {
        let i2c = &self.carrier.i2c;
        self.pin(&i2c.sda, "i2c.sda", &[PinKind::Bus])?;
        self.pin(&i2c.scl, "i2c.scl", &[PinKind::Bus])?;
        self.rule(
            (1..=400_000).contains(&i2c.rate_hz),
            "i2c.rate_hz",
            "at most 400000: MCP4728 and MCP23017 share no faster mode",
        )?;
        let own = i2c.devices.iter().map(|device| device.address).enumerate();
        let own = own.map(|(index, address)| (address, format!("i2c.devices[{index}].address")));
        let reserved = i2c.reserved.iter().map(|reserved| reserved.address).enumerate();
        let reserved = reserved.map(|(index, address)| (address, format!("i2c.reserved[{index}].address")));
        for (address, path) in own.chain(reserved) {
            // The I2C specification keeps 0x00 to 0x07 and 0x78 to 0x7f for itself.
            self.rule((0x08..0x78).contains(&address), &path, "a 7-bit address is 0x08 to 0x77")?;
            self.claims.take("I2C address", format!("{address:#04x}"), path)?;
        }
        for (index, device) in i2c.devices.iter().enumerate() {
            // The address pins of a PCA9685 set the lower six bits of 1xxxxxx (NXP datasheet, "Device address").
            let holds = device.chip != Chip::Pca9685 || device.address >= 0x40;
            let path = format!("i2c.devices[{index}].address");
            self.rule(holds, path, "a PCA9685 has an address from 0x40 to 0x77")?;
            self.claims.take("I2C chip name", &device.id, format!("i2c.devices[{index}].id"))?;
        }
        Ok(())
    }

    fn pwm_outputs(&mut self) -> Result<(), BoardError> {
        let Carrier { osmc, dhb, servo, .. } = self.carrier;
        self.device(&osmc.pwm, "osmc.pwm", Chip::Pca9685)?;
        self.device(&dhb.pwm, "dhb.pwm", Chip::Pca9685)?;
        self.device(&servo.pwm, "servo.pwm", Chip::Pca9685)?;
        for (index, lines) in osmc.connectors.iter().enumerate() {
            let fields = [("ahi", lines.ahi), ("ali", lines.ali), ("bhi", lines.bhi), ("bli", lines.bli)];
            self.outputs("PWM output", &osmc.pwm, 16, &format!("osmc.connectors[{index}]"), &fields)?;
        }
        for (index, lines) in dhb.connectors.iter().enumerate() {
            let fields = [("in1", lines.in1), ("in2", lines.in2), ("en", lines.en)];
            self.outputs("PWM output", &dhb.pwm, 16, &format!("dhb.connectors[{index}]"), &fields)?;
        }
        for (index, output) in servo.outputs.iter().enumerate() {
            self.output("PWM output", &servo.pwm, 16, *output, &format!("servo.outputs[{index}]"))?;
        }
        Ok(())
    }

    fn expander_bits(&mut self) -> Result<(), BoardError> {
        let Carrier { bldc, relay, .. } = self.carrier;
        self.device(&bldc.dac, "bldc.dac", Chip::Mcp4728)?;
        self.device(&bldc.expander, "bldc.expander", Chip::Mcp23017)?;
        self.device(&relay.expander, "relay.expander", Chip::Mcp23017)?;
        self.rule(relay.expander == bldc.expander, "relay.expander", "must be bldc.expander: the firmware has one")?;
        for (index, lines) in bldc.connectors.iter().enumerate() {
            let path = format!("bldc.connectors[{index}]");
            self.outputs("DAC output", &bldc.dac, 4, &path, &[("speed", lines.speed)])?;
            let bits = [("direction", lines.direction), ("brake", lines.brake)];
            self.outputs("expander bit", &bldc.expander, 16, &path, &bits)?;
        }
        for (index, bit) in relay.outputs.iter().enumerate() {
            self.output("expander bit", &relay.expander, 16, *bit, &format!("relay.outputs[{index}]"))?;
        }
        // Claimed, so that the motors' supply and the ignition are not one relay.
        for (relay_number, path) in [(relay.motor_power, "relay.motor_power"), (relay.ignition, "relay.ignition")] {
            let holds = usize::from(relay_number) < relay.outputs.len();
            self.rule(holds, path, "must be the number of a relay in relay.outputs, from 0")?;
            self.claims.take("relay", relay_number, path)?;
        }
        Ok(())
    }

    fn connectors(&mut self) -> Result<(), BoardError> {
        use PinKind::{Adc, Cap, Dac, Exti, Gpio};
        let Carrier { osmc, bldc, stepper, encoder, range, analog, dac, safety, .. } = self.carrier;
        self.pin(&osmc.disable, "osmc.disable", &[Gpio])?;
        self.pin(&bldc.load_dac, "bldc.load_dac", &[Gpio])?;
        self.pin(&stepper.enable, "stepper.enable", &[Gpio])?;
        for (index, pins) in stepper.connectors.iter().enumerate() {
            self.pin(&pins.step, format!("stepper.connectors[{index}].step"), &[Cap])?;
            self.pin(&pins.direction, format!("stepper.connectors[{index}].direction"), &[Gpio])?;
        }
        for (index, pins) in encoder.connectors.iter().enumerate() {
            self.pin(&pins.a, format!("encoder.connectors[{index}].a"), &[Cap, Exti])?;
            self.pin(&pins.b, format!("encoder.connectors[{index}].b"), &[Cap, Exti])?;
            self.pin(&pins.switch, format!("encoder.connectors[{index}].switch"), &[Gpio])?;
        }
        for (index, pins) in range.connectors.iter().enumerate() {
            self.pin(&pins.trigger, format!("range.connectors[{index}].trigger"), &[Gpio])?;
            self.pin(&pins.echo, format!("range.connectors[{index}].echo"), &[Cap, Exti])?;
        }
        for (index, pin) in analog.inputs.iter().enumerate() {
            self.pin(pin, format!("analog.inputs[{index}]"), &[Adc])?;
        }
        for (index, pin) in dac.outputs.iter().enumerate() {
            self.pin(pin, format!("dac.outputs[{index}]"), &[Dac])?;
        }
        self.pin(&safety.dead_man, "safety.dead_man", &[Exti])?;
        self.pin(&safety.stop, "safety.stop", &[Gpio])?;
        self.pin(&safety.heartbeat, "safety.heartbeat", &[Gpio])?;
        self.pin(&safety.motor_output_enable_n, "safety.motor_output_enable_n", &[Gpio])
    }

    fn limits(&self) -> Result<(), BoardError> {
        let Carrier { osmc, dhb, servo, analog, .. } = self.carrier;
        let holds = osmc.duty_max_default <= osmc.duty_max_hard;
        self.rule(holds, "osmc.duty_max_default", "must be at most osmc.duty_max_hard")?;
        let holds = dhb.duty_max_default <= dhb.duty_max_hard;
        self.rule(holds, "dhb.duty_max_default", "must be at most dhb.duty_max_hard")?;
        let (pulse, hard) = (servo.pulse_default_s, servo.pulse_hard_s);
        let holds = hard.min <= pulse.min && pulse.max <= hard.max && hard.min > 0.0;
        self.rule(holds, "servo.pulse_default_s", "must lie inside servo.pulse_hard_s, above 0")?;
        let holds = analog.full_scale_v >= analog.reference_v;
        self.rule(holds, "analog.full_scale_v", "must be at least reference_v: a divider cannot amplify")
    }

    fn rule(&self, holds: bool, path: impl Display, rule: &'static str) -> Result<(), BoardError> {
        if holds { Ok(()) } else { Err(BoardError::Rule { at: self.source.at(path), channel: None, rule }) }
    }

    fn pin(&mut self, id: &str, path: impl Display, kinds: &[PinKind]) -> Result<(), BoardError> {
        match self.carrier.pin(id) {
            Some(pin) => {
                self.rule(kinds.contains(&pin.kind), &path, "the pin has a kind that cannot do this")?;
                // A pin may be listed once and connected once.
                self.claims.take("connection of the pin", id, path)
            }
            None => Err(BoardError::NoSuch {
                at: self.source.at(path),
                what: "pin",
                asked: id.to_owned(),
                known: "an id out of pins".to_owned(),
            }),
        }
    }

    fn device(&self, id: &str, path: &str, chip: Chip) -> Result<(), BoardError> {
        match self.carrier.device(id) {
            Some(device) => self.rule(device.chip == chip, path, "the chip is of a kind that cannot do this"),
            None => Err(BoardError::NoSuch {
                at: self.source.at(path),
                what: "I2C chip",
                asked: id.to_owned(),
                known: "an id out of i2c.devices".to_owned(),
            }),
        }
    }

    /// Takes several outputs of a chip that has `count` of them.
    fn outputs(
        &mut self,
        what: &'static str,
        chip: &str,
        count: u8,
        path: &str,
        fields: &[(&str, u8)],
    ) -> Result<(), BoardError> {
        fields
            .iter()
            .try_for_each(|(field, output)| self.output(what, chip, count, *output, &format!("{path}.{field}")))
    }

    fn output(&mut self, what: &'static str, chip: &str, count: u8, output: u8, path: &str) -> Result<(), BoardError> {
        if output >= count {
            return Err(BoardError::NoSuch {
                at: self.source.at(path),
                what,
                asked: output.to_string(),
                known: format!("0 to {}", count.saturating_sub(1)),
            });
        }
        self.claims.take(what, format!("{output} of {chip}"), path)
    }
}
