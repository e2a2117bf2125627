//! Model of the types that travel: shapes and numbers from their schemas, texts and limits from the source.

use postcard_schema::{
    Schema,
    schema::{DataModelType, DataModelVariant, NamedType, NamedValue},
};
use r4_protocol::{ToDevice, ToHost};
use serde_json::{Value as Json, json};
use syn::{Expr, GenericArgument, PathArguments, Type};

use super::{
    constants::Value,
    source::{FieldSource, Source, TypeSource},
};

/// Encoding of a value.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    Bool,
    U8,
    I8,
    /// Unsigned number with this many bits, as a varint.
    Unsigned(u8),
    /// Signed number with this many bits, as a zigzag varint.
    Signed(u8),
    F32,
    Text {
        max: usize,
    },
    Option(Box<Shape>),
    List {
        of: Box<Shape>,
        max: usize,
    },
    Array {
        of: Box<Shape>,
        length: usize,
    },
    Result {
        ok: Box<Shape>,
        refusal: Box<Shape>,
    },
    Named(&'static str),
}

pub(super) struct Field {
    /// Name of the field; `None` for the only field of a variant or struct that has no name.
    pub(super) name: Option<&'static str>,
    pub(super) shape: Shape,
    pub(super) doc: String,
}

pub(super) struct Variant {
    pub(super) name: &'static str,
    pub(super) doc: String,
    pub(super) fields: Vec<Field>,
}

pub(super) enum Kind {
    Struct(Vec<Field>),
    Enum(Vec<Variant>),
}

pub(super) struct Named {
    pub(super) name: &'static str,
    pub(super) doc: String,
    pub(super) kind: Kind,
}

/// Types that travel, in the order in which they are met from [`ToDevice`] and then [`ToHost`] on.
pub(super) struct Model(pub(super) Vec<Named>);

impl Model {
    /// Makes the model of all messages.
    ///
    /// # Errors
    /// A type that travels is not in the source, or is written in a way that this does not know.
    pub(super) fn new(source: &Source) -> Result<Self, String> {
        let mut model = Self(Vec::new());
        for schema in [ToDevice::SCHEMA, ToHost::SCHEMA] {
            model.named(schema, source)?;
        }
        Ok(model)
    }

    pub(super) fn get(&self, name: &str) -> Result<&Named, String> {
        self.0.iter().find(|named| named.name == name).ok_or_else(|| format!("no message has a {name}"))
    }

    /// Adds a struct or an enum, and then the types that it consists of.
    fn named(&mut self, schema: &NamedType, source: &Source) -> Result<Shape, String> {
        let name = schema.name;
        if self.0.iter().any(|named| named.name == name) {
            return Ok(Shape::Named(name));
        }
        let of = source.of_type(name)?;
        let place = self.0.len();
        // A placeholder keeps the order of first use, and ends the recursion of a type in itself.
        self.0.push(Named { name, doc: of.doc.clone(), kind: Kind::Struct(Vec::new()) });
        self.0[place].kind = self.kind(schema, of, source).map_err(|problem| format!("{name}: {problem}"))?;
        Ok(Shape::Named(name))
    }

    fn kind(&mut self, schema: &NamedType, of: &TypeSource, source: &Source) -> Result<Kind, String> {
        match schema.ty {
            DataModelType::Struct(values) => self.fields(values, &of.fields, source).map(Kind::Struct),
            DataModelType::NewtypeStruct(inner) => Ok(Kind::Struct(vec![self.unnamed(inner, &of.fields, source)?])),
            DataModelType::Enum(variants) => {
                let mut all = Vec::new();
                for (variant, written) in variants.iter().zip(&of.variants) {
                    // The order of variants is their encoding, so both sources must agree on it.
                    if variant.name != written.name {
                        return Err(format!(
                            "variant {} of the schema is {} in the source",
                            variant.name, written.name
                        ));
                    }
                    let fields = match variant.ty {
                        DataModelVariant::UnitVariant => Vec::new(),
                        DataModelVariant::NewtypeVariant(inner) => {
                            vec![self.unnamed(inner, &written.fields, source)?]
                        }
                        DataModelVariant::StructVariant(values) => self.fields(values, &written.fields, source)?,
                        DataModelVariant::TupleVariant(_) => return Err("a tuple's fields have no names".into()),
                    };
                    all.push(Variant { name: variant.name, doc: written.doc.clone(), fields });
                }
                let count = (variants.len(), of.variants.len());
                if count.0 == count.1 { Ok(Kind::Enum(all)) } else { Err(format!("variants: {count:?}")) }
            }
            other => Err(format!("{other:?} is neither a struct nor an enum")),
        }
    }

    fn fields(
        &mut self,
        values: &[&NamedValue],
        written: &[FieldSource],
        source: &Source,
    ) -> Result<Vec<Field>, String> {
        if values.len() != written.len() {
            return Err(format!("{} fields in the schema, {} in the source", values.len(), written.len()));
        }
        let field = |(value, written): (&&NamedValue, &FieldSource)| {
            let shape = self.shape(value.ty, &written.written, source)?;
            Ok(Field { name: Some(value.name), shape, doc: written.doc.clone() })
        };
        values.iter().zip(written).map(field).collect()
    }

    fn unnamed(&mut self, inner: &NamedType, written: &[FieldSource], source: &Source) -> Result<Field, String> {
        let [written] = written else { return Err("not one field in the source".into()) };
        Ok(Field { name: None, shape: self.shape(inner, &written.written, source)?, doc: written.doc.clone() })
    }

    fn shape(&mut self, schema: &NamedType, written: &Type, source: &Source) -> Result<Shape, String> {
        let mut inner = |schema, place| self.shape(schema, argument(written, place)?, source).map(Box::new);
        Ok(match schema.ty {
            DataModelType::Bool => Shape::Bool,
            DataModelType::U8 => Shape::U8,
            DataModelType::I8 => Shape::I8,
            DataModelType::U16 => Shape::Unsigned(16),
            DataModelType::U32 => Shape::Unsigned(32),
            DataModelType::U64 => Shape::Unsigned(64),
            DataModelType::I16 => Shape::Signed(16),
            DataModelType::I32 => Shape::Signed(32),
            DataModelType::I64 => Shape::Signed(64),
            DataModelType::F32 => Shape::F32,
            DataModelType::String => Shape::Text { max: limit(written, 0, source)? },
            DataModelType::Option(of) => Shape::Option(inner(of, 0)?),
            DataModelType::Seq(of) => Shape::List { of: inner(of, 0)?, max: limit(written, 1, source)? },
            DataModelType::Tuple(all) => {
                let (Type::Array(array), Some(first)) = (written, all.first()) else {
                    return Err("a tuple that is no array".into());
                };
                Shape::Array { of: self.shape(first, &array.elem, source)?.into(), length: all.len() }
            }
            // serde's `Result` is an enum without a type of ours.
            DataModelType::Enum([ok, refusal]) if ok.name == "Ok" && refusal.name == "Err" => {
                let (DataModelVariant::TupleVariant([ok_type]), DataModelVariant::TupleVariant([refusal_type])) =
                    (ok.ty, refusal.ty)
                else {
                    return Err("a result of other than two values".into());
                };
                Shape::Result { ok: inner(ok_type, 0)?, refusal: inner(refusal_type, 1)? }
            }
            DataModelType::Struct(_) | DataModelType::NewtypeStruct(_) | DataModelType::Enum(_) => {
                return self.named(schema, source);
            }
            other => return Err(format!("the page does not know how {other:?} is encoded: add it to wire/model.rs")),
        })
    }
}

fn generic(written: &Type, place: usize) -> Result<&GenericArgument, String> {
    let arguments = match written {
        Type::Path(path) => path.path.segments.last().map(|segment| &segment.arguments),
        _ => None,
    };
    match arguments {
        Some(PathArguments::AngleBracketed(all)) => all.args.iter().nth(place),
        _ => None,
    }
    .ok_or_else(|| format!("argument {place} of a type is missing"))
}

fn argument(written: &Type, place: usize) -> Result<&Type, String> {
    match generic(written, place)? {
        GenericArgument::Type(inner) => Ok(inner),
        _ => Err(format!("argument {place} of a type is no type")),
    }
}

/// Returns the capacity of a list or text: the constant in its type.
fn limit(written: &Type, place: usize, source: &Source) -> Result<usize, String> {
    let path = match generic(written, place)? {
        GenericArgument::Type(Type::Path(path)) => &path.path,
        GenericArgument::Const(Expr::Path(path)) => &path.path,
        _ => return Err("how much a list holds is no constant".into()),
    };
    let name = path.segments.last().map(|segment| segment.ident.to_string()).unwrap_or_default();
    Value::of(&name, source)?.count().ok_or_else(|| format!("{name} is no length"))
}

impl Shape {
    /// Returns the type in one word or two, as in tables.
    pub(super) fn text(&self) -> String {
        match self {
            Self::Bool => "bool".into(),
            Self::U8 => "u8".into(),
            Self::I8 => "i8".into(),
            Self::Unsigned(bits) => format!("u{bits}"),
            Self::Signed(bits) => format!("i{bits}"),
            Self::F32 => "f32".into(),
            Self::Text { max } => format!("string, at most {max}"),
            Self::Option(of) => format!("option of {}", of.text()),
            Self::List { of, max } => format!("list of {}, at most {max}", of.text()),
            Self::Array { of, length } => format!("{length} × {}", of.text()),
            Self::Result { ok, refusal } => format!("result of {} or {}", ok.text(), refusal.text()),
            Self::Named(name) => (*name).into(),
        }
    }

    pub(super) fn json(&self) -> Json {
        match self {
            Self::Text { max } => json!({ "string": { "max": max } }),
            Self::Option(of) => json!({ "option": of.json() }),
            Self::List { of, max } => json!({ "list": { "of": of.json(), "max": max } }),
            Self::Array { of, length } => json!({ "array": { "of": of.json(), "length": length } }),
            Self::Result { ok, refusal } => json!({ "result": { "ok": ok.json(), "err": refusal.json() } }),
            simple => simple.text().into(),
        }
    }
}

impl Field {
    /// Returns the unit at the end of the field's name.
    pub(super) fn unit(&self) -> Option<&'static str> {
        const UNITS: [(&str, &str); 8] = [
            ("_us", "µs"),
            ("_ms", "ms"),
            ("_hz", "Hz"),
            ("_percent", "%"),
            ("_v", "V"),
            ("_per_s", "1/s"),
            ("_ticks", "control periods"),
            ("_cycles", "cycles of the processor"),
        ];
        let name = self.name?;
        UNITS.iter().find(|(end, _)| name.ends_with(end)).map(|(_, unit)| *unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        let source = Source::read(&crate::root().join("protocol/src")).expect("the source is read");
        Model::new(&source).expect("the source and the schemas agree")
    }

    #[test]
    fn limits_and_texts_come_from_the_source() {
        let model = model();
        let Kind::Enum(requests) = &model.get("Request").expect("it travels").kind else { panic!("an enum") };
        let write = requests.iter().find(|variant| variant.name == "UartWrite").expect("a request");
        let bytes = Shape::List { of: Shape::U8.into(), max: r4_protocol::message::MAX_RAW };
        assert_eq!((write.fields[1].name, &write.fields[1].shape), (Some("bytes"), &bytes));
        assert_eq!(write.fields[1].doc, "What to send.");
        let Kind::Struct(fields) = &model.get("DeviceInfo").expect("it travels").kind else { panic!("a struct") };
        assert_eq!(fields[0].shape, Shape::Text { max: r4_protocol::config::MAX_NAME });
        let timeout = fields.iter().find(|field| field.name == Some("link_timeout_ms")).expect("a field");
        assert_eq!(timeout.unit(), Some("ms"));
    }

    #[test]
    fn everything_that_travels_has_a_text() {
        for Named { name, doc, kind } in &model().0 {
            assert!(!doc.is_empty(), "{name} has no comment");
            match kind {
                Kind::Struct(fields) => fields.iter().for_each(|field| {
                    assert!(field.name.is_none() || !field.doc.is_empty(), "{name}::{:?} has no comment", field.name);
                }),
                Kind::Enum(variants) => variants.iter().for_each(|variant| {
                    assert!(!variant.doc.is_empty(), "{name}::{} has no comment", variant.name);
                }),
            }
        }
    }
}
