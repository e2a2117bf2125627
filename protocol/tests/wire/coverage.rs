//! Reader of a message by the schema that its type publishes; it notes every enum variant on the way.
//!
//! It makes the golden table and the strategies complete: a variant added anywhere below `ToDevice` or `ToHost` is in
//! the schema at once, and is missing from the variants seen until a row or a strategy has it.

use std::collections::BTreeSet;

use postcard_schema::{
    Schema,
    schema::{DataModelType, DataModelVariant, NamedType},
};
use r4_protocol::{ToDevice, ToHost};
use serde::Serialize;

use crate::payload;

/// Set of variants, written `Type::Variant`.
pub(crate) type Variants = BTreeSet<String>;

/// Returns every variant that can travel.
pub(crate) fn all() -> Variants {
    let mut variants = Variants::new();
    collect(ToDevice::SCHEMA, &mut variants);
    collect(ToHost::SCHEMA, &mut variants);
    variants
}

/// Adds the variants in `message` to `seen`.
///
/// # Panics
/// When the bytes do not fit the schema.
pub(crate) fn note<T: Schema + Serialize>(message: &T, seen: &mut Variants) {
    let bytes = payload(message);
    let mut reader = Reader { rest: &bytes, seen };
    reader.value(T::SCHEMA);
    // Otherwise the schema and the encoder disagree, and the variants seen are wrong.
    assert!(reader.rest.is_empty(), "the schema of {} is shorter than the message", T::SCHEMA.name);
}

fn collect(named: &NamedType, variants: &mut Variants) {
    match named.ty {
        DataModelType::Enum(list) => {
            for variant in *list {
                variants.insert(format!("{}::{}", named.name, variant.name));
                match variant.ty {
                    DataModelVariant::UnitVariant => {}
                    DataModelVariant::NewtypeVariant(inner) => collect(inner, variants),
                    DataModelVariant::TupleVariant(fields) => fields.iter().for_each(|f| collect(f, variants)),
                    DataModelVariant::StructVariant(fields) => fields.iter().for_each(|f| collect(f.ty, variants)),
                }
            }
        }
        DataModelType::Struct(fields) => fields.iter().for_each(|field| collect(field.ty, variants)),
        DataModelType::Tuple(fields) | DataModelType::TupleStruct(fields) => {
            fields.iter().for_each(|field| collect(field, variants));
        }
        DataModelType::NewtypeStruct(inner) | DataModelType::Seq(inner) | DataModelType::Option(inner) => {
            collect(inner, variants);
        }
        DataModelType::Map { key, val } => {
            collect(key, variants);
            collect(val, variants);
        }
        _ => {}
    }
}

struct Reader<'a> {
    rest: &'a [u8],
    seen: &'a mut Variants,
}

impl Reader<'_> {
    fn value(&mut self, named: &NamedType) {
        match named.ty {
            DataModelType::Bool => assert!(self.byte() <= 1),
            DataModelType::U8 | DataModelType::I8 => drop(self.byte()),
            DataModelType::U16
            | DataModelType::U32
            | DataModelType::U64
            | DataModelType::I16
            | DataModelType::I32
            | DataModelType::I64 => drop(self.varint()),
            DataModelType::F32 => self.skip(4),
            DataModelType::F64 => self.skip(8),
            DataModelType::String | DataModelType::ByteArray => {
                let len = self.varint();
                self.skip(len as usize);
            }
            DataModelType::Option(inner) => {
                if self.byte() == 1 {
                    self.value(inner);
                }
            }
            DataModelType::NewtypeStruct(inner) => self.value(inner),
            DataModelType::Seq(inner) => (0..self.varint()).for_each(|_| self.value(inner)),
            DataModelType::Tuple(fields) | DataModelType::TupleStruct(fields) => {
                fields.iter().for_each(|field| self.value(field));
            }
            DataModelType::Struct(fields) => fields.iter().for_each(|field| self.value(field.ty)),
            DataModelType::Enum(list) => {
                let variant = list[self.varint() as usize];
                self.seen.insert(format!("{}::{}", named.name, variant.name));
                match variant.ty {
                    DataModelVariant::UnitVariant => {}
                    DataModelVariant::NewtypeVariant(inner) => self.value(inner),
                    DataModelVariant::TupleVariant(fields) => fields.iter().for_each(|field| self.value(field)),
                    DataModelVariant::StructVariant(fields) => fields.iter().for_each(|field| self.value(field.ty)),
                }
            }
            DataModelType::Unit | DataModelType::UnitStruct => {}
            other => panic!("no message had a {other:?} before: read it here"),
        }
    }

    fn byte(&mut self) -> u8 {
        let (first, rest) = self.rest.split_first().expect("the message is shorter than its schema");
        self.rest = rest;
        *first
    }

    fn skip(&mut self, count: usize) {
        self.rest = &self.rest[count..];
    }

    /// Reads a varint: seven bits a byte, the lowest first; the top bit says that more follow.
    fn varint(&mut self) -> u64 {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte();
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        value
    }
}
