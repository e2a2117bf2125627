//! Plant files: TOML to [`PlantSpec`] and back.

use std::{collections::BTreeMap, fmt::Write, ops::Range};

use serde::{Deserialize, Deserializer, de};
use toml::Spanned;

use crate::{
    effect::{Effect, EffectInfo, catalogue},
    error::{InvalidField, PlantError, Problem},
    model::{Model, PlantKind},
    parameter::Fitted,
    spec::{PlantSpec, in_effect},
};

/// A table of numbers, every key and value with where it stands.
type Table = BTreeMap<Spanned<String>, Spanned<Value>>;

/// A plant file before anything in it is believed.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    model: Spanned<String>,
    #[serde(default)]
    source: String,
    parameters: Spanned<Table>,
    #[serde(default)]
    effects: Vec<Spanned<Table>>,
}

/// A value in a table.
enum Value {
    Number(f64),
    Text(String),
    Other,
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match toml::Value::deserialize(deserializer)? {
            toml::Value::Float(number) => Self::Number(number),
            // a parameter with more than 53 bits would be rounded here; none is that large
            toml::Value::Integer(number) => Self::Number(number as f64),
            toml::Value::String(text) => Self::Text(text),
            _ => Self::Other,
        })
    }
}

/// What is wrong, and where in the text.
struct Fault {
    span: Range<usize>,
    error: InvalidField,
}

impl Fault {
    fn new(span: Range<usize>, field: impl Into<String>, problem: Problem) -> Self {
        Self { span, error: InvalidField { field: field.into(), problem } }
    }
}

pub(crate) fn read(source_name: &str, text: &str) -> Result<PlantSpec, PlantError> {
    let line = |offset: usize| 1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count();
    let raw: Raw = toml::from_str(text).map_err(|error| PlantError::Toml {
        source_name: source_name.into(),
        line: line(error.span().map_or(0, |span| span.start)),
        error,
    })?;
    spec(raw).map_err(|fault| PlantError::Field {
        source_name: source_name.into(),
        line: line(fault.span.start),
        error: fault.error,
    })
}

/// Within a larger TOML document. Errors name the field; the line is that of the plant's table.
impl<'de> Deserialize<'de> for PlantSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        spec(Raw::deserialize(deserializer)?).map_err(|fault| de::Error::custom(fault.error))
    }
}

fn spec(raw: Raw) -> Result<PlantSpec, Fault> {
    let name = raw.model.get_ref();
    let known = || Problem::Unknown { known: Model::ALL.iter().map(Model::name).collect() };
    let model = Model::ALL.into_iter().find(|model| model.name() == name);
    let mut model = model.ok_or_else(|| Fault::new(raw.model.span(), "model", known()))?;
    let kind = model.kind();
    fill(&mut model, kind, raw.parameters.get_ref(), raw.parameters.span(), |_| false)
        .map_err(|fault| Fault { error: in_parameters(fault.error), ..fault })?;

    let mut effects = Vec::with_capacity(raw.effects.len());
    for (index, table) in raw.effects.iter().enumerate() {
        let effect = effect(kind, table).map_err(|fault| Fault { error: in_effect(index, fault.error), ..fault })?;
        effects.push(effect);
    }
    // All of it was checked above, with better places for its errors.
    PlantSpec::new(model, raw.source, effects).map_err(|error| Fault { span: raw.model.span(), error })
}

fn in_parameters(error: InvalidField) -> InvalidField {
    InvalidField { field: format!("parameters.{}", error.field), ..error }
}

const TAG: &str = "effect";

fn effect(kind: PlantKind, table: &Spanned<Table>) -> Result<Effect, Fault> {
    let known = || Problem::Unknown {
        known: catalogue().iter().filter(|info| info.kinds.contains(&kind)).map(|info| info.name).collect(),
    };
    let named = table.get_ref().iter().find(|(key, _)| key.get_ref() == TAG).map(|(_, value)| value);
    let named = named.ok_or_else(|| Fault::new(table.span(), TAG, Problem::NotAName))?;
    let Value::Text(name) = named.get_ref() else {
        return Err(Fault::new(named.span(), TAG, Problem::NotAName));
    };
    let info = EffectInfo::named(name).ok_or_else(|| Fault::new(named.span(), TAG, known()))?;
    if !info.kinds.contains(&kind) {
        return Err(Fault::new(named.span(), TAG, Problem::WrongKind { kind }));
    }
    let mut effect = info.typical;
    fill(&mut effect, kind, table.get_ref(), table.span(), |key| key == TAG)?;
    Ok(effect)
}

/// Sets every parameter from a table that has all of them and, but for what `is_else` says, nothing else.
fn fill(
    fitted: &mut dyn Fitted,
    kind: PlantKind,
    table: &Table,
    span: Range<usize>,
    is_else: impl Fn(&str) -> bool,
) -> Result<(), Fault> {
    for (key, value) in table.iter().filter(|(key, _)| !is_else(key.get_ref())) {
        let name = key.get_ref().as_str();
        let known = || fitted.parameters().iter().map(|parameter| parameter.name(kind)).collect();
        if fitted.get(kind, name).is_none() {
            return Err(Fault::new(key.span(), name, Problem::Unknown { known: known() }));
        }
        let Value::Number(number) = value.get_ref() else {
            return Err(Fault::new(value.span(), name, Problem::NotANumber));
        };
        fitted.set(kind, name, *number).map_err(|problem| Fault::new(value.span(), name, problem))?;
    }
    for parameter in fitted.parameters() {
        let name = parameter.name(kind);
        if !table.keys().any(|key| key.get_ref() == name) {
            return Err(Fault::new(span, name, Problem::Missing { unit: parameter.unit(kind) }));
        }
    }
    Ok(())
}

pub(crate) fn write(spec: &PlantSpec) -> String {
    let kind = spec.kind();
    let mut text = format!("model = \"{}\"\n", spec.model().name());
    // Writing to a String cannot fail, here and below.
    let _ = writeln!(text, "source = {}", toml::Value::from(spec.source()));
    text.push_str("\n[parameters]\n");
    write_values(&mut text, kind, spec.model());
    for effect in spec.effects() {
        let _ = writeln!(text, "\n[[effects]]\n{TAG} = \"{}\"", effect.name());
        write_values(&mut text, kind, effect);
    }
    text
}

fn write_values(text: &mut String, kind: PlantKind, fitted: &dyn Fitted) {
    for (index, parameter) in fitted.parameters().iter().enumerate() {
        if let Some(value) = fitted.value(index) {
            // Rust's shortest form that reads back to the same bits is also TOML's
            let _ = writeln!(text, "{} = {value:?}", parameter.name(kind));
        }
    }
}
