//! Random configurations: nothing panics, and a configuration that is taken can be computed with.

use postcard_schema::{
    Schema,
    schema::{DataModelType, DataModelVariant, NamedType},
};
use proptest::{
    arbitrary::any,
    collection::vec,
    prelude::{ProptestConfig, Strategy},
    prop_assert, prop_assert_eq, proptest,
    sample::Index,
};
use r4_protocol::config::{BoardConfig, ConfigError};

use crate::good::good;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2048))]

    #[test]
    fn no_configuration_panics(config in configs(), which in any::<Index>(), bits in any::<u32>()) {
        survives(config, which, f32::from_bits(bits))?;
    }

    /// Replaces one list or chip of the good configuration: `configs` is too random to get past the first rules.
    #[test]
    fn no_part_of_a_configuration_panics(
        config in configs(),
        part in 0..18u8,
        which in any::<Index>(),
        bits in any::<u32>(),
    ) {
        let mut mixed = good();
        match part {
            0 => mixed.osmc_pwm = config.osmc_pwm,
            1 => mixed.dhb_pwm = config.dhb_pwm,
            2 => mixed.servo_pwm = config.servo_pwm,
            3 => mixed.bldc_dac = config.bldc_dac,
            4 => mixed.expander = config.expander,
            5 => mixed.stepper_bank = config.stepper_bank,
            6 => mixed.motors = config.motors,
            7 => mixed.bldcs = config.bldcs,
            8 => mixed.servos = config.servos,
            9 => mixed.steppers = config.steppers,
            10 => mixed.relays = config.relays,
            11 => mixed.dacs = config.dacs,
            12 => mixed.encoders = config.encoders,
            13 => mixed.switches = config.switches,
            14 => mixed.ranges = config.ranges,
            15 => mixed.analogs = config.analogs,
            16 => mixed.supplies = config.supplies,
            _ => mixed.air_temperature_c = config.air_temperature_c,
        }
        survives(mixed, which, f32::from_bits(bits))?;
    }
}

fn survives(config: BoardConfig, which: Index, value: f32) -> Result<(), proptest::test_runner::TestCaseError> {
    let checked = config.validate();
    match checked {
        Ok(()) => {
            for key in config.parameters() {
                let number = config.parameter(key);
                prop_assert!(number.is_some_and(|number| number.abs() <= 1e9), "{} is {:?}", key, number);
            }
        }
        Err(ConfigError { channel: Some(id), .. }) => prop_assert!(config.place(id).is_some(), "{} is not there", id),
        Err(ConfigError { channel: None, .. }) => {}
    }
    let keys: Vec<_> = config.parameters().collect();
    let mut changed = config.clone();
    if changed.set_parameter(*which.get(&keys), value).is_ok() {
        prop_assert_eq!(changed.validate(), Ok(()));
    } else {
        // Compared as text, because a NaN is not equal to itself.
        prop_assert_eq!(format!("{:?}", changed), format!("{:?}", config));
    }
    Ok(())
}

/// Samples configurations from the schema of `BoardConfig`, so that a field added there is random here.
fn configs() -> impl Strategy<Value = BoardConfig> {
    vec(any::<u32>(), 1024).prop_map(|entropy| {
        let mut writer = Writer { entropy, used: 0, bytes: Vec::new() };
        writer.value(BoardConfig::SCHEMA);
        postcard::from_bytes(&writer.bytes).expect("it is written by the schema")
    })
}

/// Writer of random values in postcard's encoding. Numbers are often such as a configuration could have.
struct Writer {
    entropy: Vec<u32>,
    used: usize,
    bytes: Vec<u8>,
}

impl Writer {
    fn value(&mut self, named: &NamedType) {
        match named.ty {
            DataModelType::Bool => {
                let value = self.below(2);
                self.bytes.push(value as u8);
            }
            DataModelType::U8 => {
                // Mostly small, as numbers of channels and lines are.
                let value = if self.below(4) > 0 { self.below(8) } else { self.below(256) };
                self.bytes.push(value as u8);
            }
            DataModelType::U16 => {
                let value = self.below(1 << 16);
                self.varint(value);
            }
            DataModelType::U32 => {
                // Shifted, so that every order of magnitude occurs.
                let (value, shift) = (self.next(), self.below(32));
                self.varint(value >> shift);
            }
            DataModelType::F32 => {
                // Half of them 0 to 2, as most fields have; half any bits, NaN included.
                let bits = if self.below(2) > 0 { (self.below(1000) as f32 / 500.0).to_bits() } else { self.next() };
                self.bytes.extend(bits.to_le_bytes());
            }
            DataModelType::String => self.bytes.push(0),
            DataModelType::Option(inner) => {
                let some = self.below(2);
                self.bytes.push(some as u8);
                if some == 1 {
                    self.value(inner);
                }
            }
            // Every list has room for two.
            DataModelType::Seq(inner) => {
                let len = self.below(3);
                self.varint(len);
                (0..len).for_each(|_| self.value(inner));
            }
            DataModelType::Struct(fields) => fields.iter().for_each(|field| self.value(field.ty)),
            DataModelType::Enum(variants) => {
                let variant = self.below(variants.len() as u32);
                self.varint(variant);
                match variants[variant as usize].ty {
                    DataModelVariant::UnitVariant => {}
                    DataModelVariant::NewtypeVariant(inner) => self.value(inner),
                    DataModelVariant::TupleVariant(fields) => fields.iter().for_each(|field| self.value(field)),
                    DataModelVariant::StructVariant(fields) => fields.iter().for_each(|field| self.value(field.ty)),
                }
            }
            other => panic!("no configuration had a {other:?} before: write it here"),
        }
    }

    fn next(&mut self) -> u32 {
        self.used += 1;
        // From a list of proptest's, so that it can shrink a failing configuration.
        self.entropy[self.used % self.entropy.len()]
    }

    fn below(&mut self, end: u32) -> u32 {
        self.next() % end
    }

    /// Writes a varint: seven bits a byte, the lowest first; the top bit says that more follow.
    fn varint(&mut self, mut value: u32) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }
}
