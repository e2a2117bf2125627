//! Pins of the microcontroller.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, de::Error};

/// A pin and its function.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pin {
    /// Function, by which the rest of the file refers to it.
    pub id: String,
    /// Name on the Arduino header.
    pub header: String,
    /// Pin of the microcontroller.
    pub stm32: Stm32Pin,
    /// Peripheral and its signal, as in `TIM8_CH1`; none for a plain pin.
    pub signal: Option<String>,
    /// Alternate function that connects the signal.
    pub af: Option<u8>,
    /// How it is used.
    pub kind: PinKind,
    /// What a user should know.
    pub note: Option<String>,
}

/// How a pin is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PinKind {
    /// Timer channel: capture, encoder or pulses.
    Cap,
    /// Interrupt on an edge.
    Exti,
    /// Plain input or output.
    Gpio,
    /// Analog input.
    Adc,
    /// Analog output.
    Dac,
    /// Line of a bus.
    Bus,
}

/// A pin by port and number, written `PJ8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Stm32Pin {
    /// `A` to `K`.
    pub port: char,
    /// 0 to 15; also the pin's EXTI line.
    pub number: u8,
}

impl fmt::Display for Stm32Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", self.port, self.number)
    }
}

/// The text is no pin name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a pin: write P, a port from A to K and a number from 0 to 15, as in PJ8")]
pub struct NotAPin;

impl FromStr for Stm32Pin {
    type Err = NotAPin;

    fn from_str(text: &str) -> Result<Self, NotAPin> {
        let mut rest = text.strip_prefix('P').ok_or(NotAPin)?.chars();
        let port = rest.next().filter(|port| ('A'..='K').contains(port)).ok_or(NotAPin)?;
        let number = rest.as_str().parse().ok().filter(|number| *number < 16).ok_or(NotAPin)?;
        let pin = Self { port, number };
        if pin.to_string() == text { Ok(pin) } else { Err(NotAPin) }
    }
}

impl<'de> Deserialize<'de> for Stm32Pin {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(|why: NotAPin| D::Error::custom(format!("`{text}` is {why}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pin_names() {
        assert_eq!("PK15".parse(), Ok(Stm32Pin { port: 'K', number: 15 }));
        for bad in ["", "P", "PA", "A1", "PL0", "PA16", "PA01", "PA+1", "pa1", "PC2_C", "Pé1"] {
            assert_eq!(bad.parse::<Stm32Pin>(), Err(NotAPin), "{bad}");
        }
    }
}
