//! Deserializer for the tree of a TOML file.
//!
//! `toml` has one of its own, which compiles every type for tables, values, dates and spans: 600 functions and 2.1 MB of
//! the program. These files have no dates, and no type asks for a span, so that here each type is compiled once.

use std::{borrow::Cow, fmt, ops::Range};

use serde::{
    de::{
        DeserializeSeed, Deserializer, EnumAccess, Error as _, IntoDeserializer, MapAccess, SeqAccess, Unexpected,
        VariantAccess, Visitor,
        value::{CowStrDeserializer, StrDeserializer},
    },
    forward_to_deserialize_any,
};
use toml::{
    Spanned,
    de::{DeArray, DeTable, DeValue},
};

/// Mistake in a file, with its place.
#[derive(Debug)]
pub(crate) struct Fault {
    pub(crate) message: String,
    /// Bytes of the text; `None` for a mistake that has no place of its own.
    pub(crate) span: Option<Range<usize>>,
}

impl Fault {
    /// The same fault, in `span` unless it has a place already: the innermost one counts.
    fn within(mut self, span: &Range<usize>) -> Self {
        self.span.get_or_insert_with(|| span.clone());
        self
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Fault {}

impl serde::de::Error for Fault {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self { message: message.to_string(), span: None }
    }
}

impl From<toml::de::Error> for Fault {
    fn from(error: toml::de::Error) -> Self {
        Self { message: error.message().to_owned(), span: error.span() }
    }
}

/// A value with its place in the text.
pub(crate) struct Node<'de> {
    value: DeValue<'de>,
    span: Range<usize>,
}

impl<'de> From<Spanned<DeValue<'de>>> for Node<'de> {
    fn from(value: Spanned<DeValue<'de>>) -> Self {
        Self { span: value.span(), value: value.into_inner() }
    }
}

impl<'de> From<Spanned<DeTable<'de>>> for Node<'de> {
    fn from(table: Spanned<DeTable<'de>>) -> Self {
        Self { span: table.span(), value: DeValue::Table(table.into_inner()) }
    }
}

/// A value as serde sees it.
enum Seen<'de> {
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(Cow<'de, str>),
    Array(DeArray<'de>),
    Table(DeTable<'de>),
}

impl<'de> Seen<'de> {
    /// Takes a value of the file; converts the digits of a number.
    fn of(value: DeValue<'de>) -> Result<Self, Fault> {
        Ok(match value {
            DeValue::Boolean(value) => Self::Bool(value),
            DeValue::Integer(digits) => match i64::from_str_radix(digits.as_str(), digits.radix()) {
                Ok(value) => Self::Integer(value),
                Err(_) => return Err(Fault::custom("integer number overflowed")),
            },
            DeValue::Float(digits) => match digits.as_str().parse::<f64>() {
                // `inf` may be written; a number too large to be one becomes it as well.
                Ok(value) if value.is_finite() || value.is_nan() || digits.as_str().ends_with("inf") => {
                    Self::Float(value)
                }
                _ => return Err(Fault::custom("floating-point number overflowed")),
            },
            DeValue::String(text) => Self::Text(text),
            DeValue::Datetime(date) => {
                return Err(Fault::custom(format_args!("{date} is a date, which no field takes")));
            }
            DeValue::Array(values) => Self::Array(values),
            DeValue::Table(table) => Self::Table(table),
        })
    }

    /// The value as serde's errors name it.
    fn unexpected(&self) -> Unexpected<'_> {
        match self {
            Self::Bool(value) => Unexpected::Bool(*value),
            Self::Integer(value) => Unexpected::Signed(*value),
            Self::Float(value) => Unexpected::Float(*value),
            Self::Text(text) => Unexpected::Str(text),
            Self::Array(_) => Unexpected::Seq,
            Self::Table(_) => Unexpected::Map,
        }
    }
}

impl<'de> Node<'de> {
    /// Passes the value to `visit`, and puts a fault without a place at this node.
    fn visit<T>(self, visit: impl FnOnce(Seen<'de>) -> Result<T, Fault>) -> Result<T, Fault> {
        Seen::of(self.value).and_then(visit).map_err(|fault| fault.within(&self.span))
    }
}

impl<'de> Deserializer<'de> for Node<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.visit(|seen| match seen {
            Seen::Bool(value) => visitor.visit_bool(value),
            Seen::Integer(value) => visitor.visit_i64(value),
            Seen::Float(value) => visitor.visit_f64(value),
            Seen::Text(Cow::Borrowed(text)) => visitor.visit_borrowed_str(text),
            Seen::Text(Cow::Owned(text)) => visitor.visit_string(text),
            Seen::Array(values) => visitor.visit_seq(Elements(values.into_iter())),
            Seen::Table(table) => visitor.visit_map(Fields::of(table)),
        })
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        // A field that is left out never comes here.
        visitor.visit_some(self)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value, Fault> {
        let span = self.span.clone();
        visitor.visit_newtype_struct(self).map_err(|fault| fault.within(&span))
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.visit(|seen| match seen {
            Seen::Array(values) => visitor.visit_seq(Elements(values.into_iter())),
            other => Err(Fault::invalid_type(other.unexpected(), &visitor)),
        })
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Fault> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        self.visit(|seen| match seen {
            Seen::Table(table) => visitor.visit_map(Fields::of(table)),
            other => Err(Fault::invalid_type(other.unexpected(), &visitor)),
        })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.deserialize_map(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        self.visit(|seen| visitor.visit_enum(Variant::of(seen)?))
    }

    forward_to_deserialize_any! {
        bool u8 u16 u32 u64 i8 i16 i32 i64 f32 f64 char str string bytes byte_buf unit unit_struct ignored_any identifier
    }
}

/// Elements of an array.
struct Elements<'de>(std::vec::IntoIter<Spanned<DeValue<'de>>>);

impl<'de> SeqAccess<'de> for Elements<'de> {
    type Error = Fault;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Fault> {
        self.0.next().map(|value| seed.deserialize(Node::from(value))).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

/// Fields of a table.
struct Fields<'de> {
    rest: std::vec::IntoIter<(Spanned<Cow<'de, str>>, Spanned<DeValue<'de>>)>,
    value: Option<Node<'de>>,
}

impl<'de> Fields<'de> {
    fn of(table: DeTable<'de>) -> Self {
        Self { rest: table.into_iter().collect::<Vec<_>>().into_iter(), value: None }
    }

    // These two are apart from the generic functions below, which are compiled for each type of a value.

    /// Name of the next field, with its place.
    fn next_name(&mut self) -> Option<(CowStrDeserializer<'de, Fault>, Range<usize>)> {
        let (key, value) = self.rest.next()?;
        self.value = Some(Node::from(value));
        let span = key.span();
        Some((CowStrDeserializer::new(key.into_inner()), span))
    }

    /// Value of the field whose name was read last, with its place.
    fn value(&mut self) -> Result<(Node<'de>, Range<usize>), Fault> {
        let node = self.value.take().ok_or_else(|| Fault::custom("a value is read before its key"))?;
        let span = node.span.clone();
        Ok((node, span))
    }
}

impl<'de> MapAccess<'de> for Fields<'de> {
    type Error = Fault;

    fn next_key_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, Fault> {
        match self.next_name() {
            Some((name, span)) => match seed.deserialize(name) {
                Ok(name) => Ok(Some(name)),
                Err(fault) => Err(fault.within(&span)),
            },
            None => Ok(None),
        }
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, Fault> {
        match self.value() {
            Ok((node, span)) => match seed.deserialize(node) {
                Ok(value) => Ok(value),
                Err(fault) => Err(fault.within(&span)),
            },
            Err(fault) => Err(fault),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }
}

/// Variant of an enumeration: its name, or a table with its name and its content.
struct Variant<'de> {
    name: Cow<'de, str>,
    content: Option<Node<'de>>,
}

impl<'de> Variant<'de> {
    fn of(value: Seen<'de>) -> Result<Self, Fault> {
        let table = match value {
            Seen::Text(name) => return Ok(Self { name, content: None }),
            Seen::Table(table) => table,
            _ => return Err(Fault::custom("wanted string or table")),
        };
        let len = table.len();
        match (table.into_iter().next(), len) {
            (Some((name, content)), 1) => Ok(Self { name: name.into_inner(), content: Some(Node::from(content)) }),
            _ => Err(Fault::custom(format_args!("wanted exactly 1 element, found {len} elements"))),
        }
    }
}

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = Fault;
    type Variant = Content<'de>;

    fn variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<(S::Value, Content<'de>), Fault> {
        let name: StrDeserializer<'_, Fault> = self.name.as_ref().into_deserializer();
        Ok((seed.deserialize(name)?, Content(self.content)))
    }
}

/// Content of a variant; `None` where only its name is written.
struct Content<'de>(Option<Node<'de>>);

impl<'de> Content<'de> {
    fn node(self) -> Result<Node<'de>, Fault> {
        self.0.ok_or_else(|| Fault::invalid_type(Unexpected::UnitVariant, &"a table with its fields"))
    }
}

impl<'de> VariantAccess<'de> for Content<'de> {
    type Error = Fault;

    fn unit_variant(self) -> Result<(), Fault> {
        match self.0 {
            None => Ok(()),
            Some(node) => match node.value.as_table() {
                Some(table) if table.is_empty() => Ok(()),
                _ => Err(Fault::custom("expected empty table").within(&node.span)),
            },
        }
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, Fault> {
        seed.deserialize(self.node()?)
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Fault> {
        self.node()?.deserialize_seq(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(self, _: &'static [&'static str], visitor: V) -> Result<V::Value, Fault> {
        self.node()?.deserialize_map(visitor)
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, rename_all = "kebab-case")]
    struct File {
        number: Option<f64>,
        count: Option<u8>,
        pair: Option<[f32; 2]>,
        shape: Option<Shape>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Shape {
        Point,
        Round { radius: f64 },
        Named(String),
    }

    fn read(text: &str) -> Result<File, Fault> {
        File::deserialize(Node::from(DeTable::parse(text)?))
    }

    /// All forms of numbers, arrays and variants, compared with what `toml` reads.
    #[test]
    fn it_reads_what_toml_reads() {
        for text in [
            "",
            "number = 1_000.5",
            "number = -0x0",
            "number = 3",
            "number = -inf",
            "number = 1e300",
            "count = 0b1010_1010",
            "count = 0xfF",
            "pair = [1, 2.5]",
            "shape = 'point'",
            "shape = \"po\\u0069nt\"",
            "shape.point = {}",
            "shape.round = { radius = 2 }",
            "[shape]\nnamed = 'a'",
        ] {
            let by_toml: Result<File, _> = toml::from_str(text);
            match (read(text), by_toml) {
                (Ok(read), Ok(expected)) => assert_eq!(read, expected, "{text}"),
                (Err(_), Err(_)) => assert!(text.contains("-0x"), "{text}"),
                (read, expected) => panic!("{text}: {read:?}, toml {expected:?}"),
            }
        }
        assert!(read("number = nan").expect("a number").number.expect("there").is_nan());
    }

    /// The message, and the text at the place of the mistake.
    #[test]
    fn a_mistake_has_its_innermost_place() {
        for (text, message, place) in [
            ("count = 256", "invalid value: integer `256`, expected u8", "256"),
            ("count = 99999999999999999999", "integer number overflowed", "99999999999999999999"),
            ("number = 1e400", "floating-point number overflowed", "1e400"),
            ("number = 'a'", "invalid type: string \"a\", expected f64", "'a'"),
            ("number = [1]", "invalid type: sequence, expected f64", "[1]"),
            ("number = 1979-05-27", "1979-05-27 is a date, which no field takes", "1979-05-27"),
            ("pair = [1, true]", "invalid type: boolean `true`, expected f32", "true"),
            ("pair = [1]", "invalid length 1, expected an array of length 2", "[1]"),
            ("pair = { a = 1 }", "invalid type: map, expected an array of length 2", "{ a = 1 }"),
            ("other = 1", "unknown field `other`, expected one of `number`, `count`, `pair`, `shape`", "other"),
            ("shape = 1", "wanted string or table", "1"),
            ("shape = {}", "wanted exactly 1 element, found 0 elements", "{}"),
            (
                "shape = { point = {}, named = 'a' }",
                "wanted exactly 1 element, found 2 elements",
                "{ point = {}, named = 'a' }",
            ),
            ("shape = 'square'", "unknown variant `square`, expected one of `point`, `round`, `named`", "'square'"),
            ("shape.round = {}", "missing field `radius`", "{}"),
            ("shape.round = 5", "invalid type: integer `5`, expected struct variant Shape::Round", "5"),
            ("shape = 'round'", "invalid type: unit variant, expected a table with its fields", "'round'"),
            ("shape.point = { a = 1 }", "expected empty table", "{ a = 1 }"),
        ] {
            let fault = read(text).expect_err(text);
            assert_eq!((fault.message.as_str(), fault.span.map(|span| &text[span])), (message, Some(place)), "{text}");
        }
    }
}
