//! Pins of the microcontroller.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, de::Error};

/// Pin of the microcontroller with its function.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pin {
    /// Function of the pin, by which the rest of the file refers to it.
    pub id: String,
    /// Name on the Arduino header.
    pub header: String,
    /// Port and number at the microcontroller.
    pub stm32: Stm32Pin,
    /// Peripheral and its signal, as in `TIM8_CH1`; `None` for a plain pin.
    pub signal: Option<String>,
    /// Number of the alternate function that connects the signal.
    pub af: Option<u8>,
    /// Use of the pin.
    pub kind: PinKind,
    /// Note for the user.
    pub note: Option<String>,
}

/// Use of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PinKind {
    /// Timer channel: capture, encoder or pulses.
    Cap,
    /// Input with an interrupt on an edge.
    Exti,
    /// Plain input or output.
    Gpio,
    /// Input of the analog-to-digital converter.
    Adc,
    /// Output of the digital-to-analog converter.
    Dac,
    /// Line of a bus.
    Bus,
}

/// Pin by port and number, written `PJ8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Stm32Pin {
    /// Letter of the port, `A` to `K`.
    pub port: char,
    /// Number in the port, 0 to 15; also the pin's EXTI line.
    pub number: u8,
}

impl fmt::Display for Stm32Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", self.port, self.number)
    }
}

/// Error of text that is no pin name.
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
