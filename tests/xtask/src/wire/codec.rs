//! Decoder of frames and messages that follows only the rules of the page: it shows that these are sufficient.

use r4_protocol::frame::Check;
use serde_json::{Map, Value as Json, json};

use super::model::{Field, Kind, Model, Shape, Variant};

/// Checksum of frames, as the page describes it.
pub(super) struct Checksum {
    pub(super) name: &'static str,
    /// Length on the wire, bytes, low byte first.
    pub(super) bytes: usize,
    pub(super) polynomial: u32,
    /// Polynomial as it is used, bit-reversed.
    pub(super) reflected: u32,
    pub(super) initial: u32,
    pub(super) final_xor: u32,
    /// Checksum of the ASCII digits 1 to 9.
    pub(super) check: u32,
}

/// Returns the description of one of the two checksums.
pub(super) fn checksum(of: Check) -> Checksum {
    match of {
        Check::Short => {
            let crc::Algorithm { poly, init, xorout, check, .. } = crc::CRC_16_IBM_SDLC;
            Checksum {
                name: "CRC-16/IBM-SDLC",
                bytes: 2,
                polynomial: poly.into(),
                reflected: poly.reverse_bits().into(),
                initial: init.into(),
                final_xor: xorout.into(),
                check: check.into(),
            }
        }
        Check::Long => {
            let crc::Algorithm { poly, init, xorout, check, .. } = crc::CRC_32_ISO_HDLC;
            Checksum {
                name: "CRC-32/ISO-HDLC",
                bytes: 4,
                polynomial: poly,
                reflected: poly.reverse_bits(),
                initial: init,
                final_xor: xorout,
                check,
            }
        }
    }
}

impl Checksum {
    /// Computes the checksum bit by bit.
    pub(super) fn of(&self, bytes: &[u8]) -> u32 {
        let sum = bytes.iter().fold(self.initial, |sum, byte| {
            (0..8)
                .fold(sum ^ u32::from(*byte), |sum, _| if sum & 1 == 1 { sum >> 1 ^ self.reflected } else { sum >> 1 })
        });
        sum ^ self.final_xor
    }

    /// Formats a number of the checksum's width in hexadecimal.
    pub(super) fn hex(&self, number: u32) -> String {
        format!("{number:#0width$x}", width = 2 + 2 * self.bytes)
    }
}

/// Returns the message in a frame, delimiter included, that has this checksum.
///
/// # Errors
/// The problem of COBS or the checksum.
pub(super) fn payload(frame: &[u8], check: Check) -> Result<Vec<u8>, String> {
    let [body @ .., 0] = frame else { return Err("no delimiter".into()) };
    let (mut plain, mut rest) = (Vec::new(), body);
    while let [code, after @ ..] = rest {
        let length = usize::from(*code).checked_sub(1).ok_or("a 0 within")?;
        plain.extend(after.get(..length).ok_or("a code points behind the end")?);
        rest = &after[length..];
        // Code 0xFF stands for 254 bytes without a zero behind them; the last piece has none either.
        if *code != 0xFF && !rest.is_empty() {
            plain.push(0);
        }
    }
    let checksum = checksum(check);
    let end = plain.len().checked_sub(checksum.bytes).ok_or("no checksum")?;
    let (message, received) = plain.split_at(end);
    let calculated = checksum.of(message).to_le_bytes();
    if calculated[..checksum.bytes] == *received { Ok(message.to_vec()) } else { Err("checksum".into()) }
}

/// Reader of a message by the model.
pub(super) struct Reader<'a> {
    model: &'a Model,
    rest: &'a [u8],
}

/// Reads all of `message` as a value of type `name`. A struct is an object, a variant its name or an object of its name
/// and its fields, bytes are numbers, and a float without a number in JSON is `"NaN"`, `"inf"` or `"-inf"`.
///
/// # Errors
/// The bytes do not fit the type.
pub(super) fn read(model: &Model, name: &'static str, message: &[u8]) -> Result<Json, String> {
    let mut reader = Reader { model, rest: message };
    let value = reader.value(&Shape::Named(name))?;
    if reader.rest.is_empty() { Ok(value) } else { Err(format!("{} bytes are left", reader.rest.len())) }
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or("the message ends early")?;
        self.rest = rest;
        Ok(*taken)
    }

    fn varint(&mut self, bits: u8) -> Result<u64, String> {
        let mut number = 0;
        // Limits the length, so that a varint without end is an error.
        for place in 0..bits.div_ceil(7) {
            let [byte] = self.take()?;
            number |= u64::from(byte & 0x7F) << (7 * place);
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        Err(format!("a varint is longer than {bits} bits take"))
    }

    fn length(&mut self, max: usize) -> Result<usize, String> {
        let length = self.varint(32)?;
        usize::try_from(length).ok().filter(|length| *length <= max).ok_or_else(|| format!("{length} of at most {max}"))
    }

    fn value(&mut self, shape: &Shape) -> Result<Json, String> {
        Ok(match shape {
            Shape::Bool => match self.take()? {
                [0] => false.into(),
                [1] => true.into(),
                [other] => return Err(format!("{other} is no bool")),
            },
            Shape::U8 => u8::from_le_bytes(self.take()?).into(),
            Shape::I8 => i8::from_le_bytes(self.take()?).into(),
            Shape::Unsigned(bits) => self.varint(*bits)?.into(),
            Shape::Signed(bits) => {
                let zigzag = self.varint(*bits)?;
                ((zigzag >> 1).cast_signed() ^ -(zigzag & 1).cast_signed()).into()
            }
            Shape::F32 => float(f32::from_le_bytes(self.take()?)),
            Shape::Text { max } => {
                let bytes =
                    (0..self.length(*max)?).map(|_| self.take().map(|[byte]| byte)).collect::<Result<_, _>>()?;
                String::from_utf8(bytes).map_err(|error| error.to_string())?.into()
            }
            Shape::Option(of) => match self.take()? {
                [0] => Json::Null,
                [1] => self.value(of)?,
                [other] => return Err(format!("{other} is no option")),
            },
            Shape::List { of, max } => {
                (0..self.length(*max)?).map(|_| self.value(of)).collect::<Result<Vec<_>, _>>()?.into()
            }
            Shape::Array { of, length } => (0..*length).map(|_| self.value(of)).collect::<Result<Vec<_>, _>>()?.into(),
            Shape::Result { ok, refusal } => match self.varint(32)? {
                0 => json!({ "Ok": self.value(ok)? }),
                1 => json!({ "Err": self.value(refusal)? }),
                other => return Err(format!("{other} is no result")),
            },
            Shape::Named(name) => {
                let model = self.model;
                match &model.get(name)?.kind {
                    Kind::Struct(fields) => self.fields(fields)?,
                    Kind::Enum(variants) => self.variant(name, variants)?,
                }
            }
        })
    }

    fn variant(&mut self, name: &str, variants: &[Variant]) -> Result<Json, String> {
        let number = self.varint(32)?;
        let found = usize::try_from(number).ok().and_then(|number| variants.get(number));
        let variant = found.ok_or_else(|| format!("{name} has no variant {number}"))?;
        if variant.fields.is_empty() {
            return Ok(variant.name.into());
        }
        Ok(json!({ variant.name: self.fields(&variant.fields)? }))
    }

    /// Reads fields as an object; a single field without a name is its value alone.
    fn fields(&mut self, fields: &[Field]) -> Result<Json, String> {
        if let [Field { name: None, shape, .. }] = fields {
            return self.value(shape);
        }
        let mut object = Map::new();
        for field in fields {
            object.insert(field.name.unwrap_or_default().into(), self.value(&field.shape)?);
        }
        Ok(object.into())
    }
}

fn float(number: f32) -> Json {
    match number {
        _ if number.is_nan() => "NaN".into(),
        f32::INFINITY => "inf".into(),
        f32::NEG_INFINITY => "-inf".into(),
        _ => f64::from(number).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_the_catalogue() {
        for of in [Check::Short, Check::Long] {
            let checksum = checksum(of);
            assert_eq!(checksum.of(b"123456789"), checksum.check, "{}", checksum.name);
        }
        assert_eq!(checksum(Check::Short).hex(0x21), "0x0021");
    }

    #[test]
    fn damage_is_seen() {
        // Bye with `seq` 3, a row of all golden tables.
        let frame = [0x01, 0x05, 0x03, 0x01, 0x2D, 0xFD, 0x00];
        assert_eq!(payload(&frame, Check::Short), Ok(vec![0, 3, 1]));
        assert!(payload(&frame, Check::Long).is_err() && payload(&frame[..6], Check::Short).is_err());
        for place in 0..frame.len() - 1 {
            let mut damaged = frame;
            damaged[place] ^= 1;
            assert!(payload(&damaged, Check::Short).is_err(), "byte {place}");
        }
    }
}
