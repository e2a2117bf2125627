//! Driver of any of the supported sensor chips.

use r4_protocol::config::{SensorChip, SensorConfig};

use super::{
    as5600::As5600,
    icm20948::Icm20948,
    ina226::Ina226,
    nau7802::Nau7802,
    sensor::{Driver, Exchange, Outcome},
    vl6180x::Vl6180x,
};

macro_rules! chips {
    ($($chip:ident)*) => {
        /// Driver of any of the supported chips.
        #[derive(Clone, Debug)]
        pub enum AnyDriver {
            $(
                #[doc = concat!("Of a [`", stringify!($chip), "`].")]
                $chip($chip),
            )*
        }

        impl AnyDriver {
            /// Creates the driver of the chip that `config` names, before its first transfer.
            #[must_use]
            pub fn new(config: &SensorConfig) -> Self {
                match &config.chip {
                    $(SensorChip::$chip(chip) => Self::$chip($chip::new(chip, config.rate_hz)),)*
                }
            }
        }

        impl Driver for AnyDriver {
            fn restart(&mut self) {
                match self {
                    $(Self::$chip(driver) => driver.restart(),)*
                }
            }

            fn next(&self) -> Exchange {
                match self {
                    $(Self::$chip(driver) => driver.next(),)*
                }
            }

            fn done(&mut self, read: &[u8]) -> Outcome {
                match self {
                    $(Self::$chip(driver) => driver.done(read),)*
                }
            }
        }
    };
}

chips!(Icm20948 Ina226 As5600 Nau7802 Vl6180x);
