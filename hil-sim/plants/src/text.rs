//! Plant files: TOML to [`PlantSpec`] and back.

use std::{collections::BTreeMap, fmt::Write, ops::Range};

use serde::{Deserialize, Deserializer, de};
use toml::Spanned;

use crate::{
    effect::{
        Effect, EffectInfo, catalogue,
        table::{On, Over, Table},
    },
    error::{InvalidField, PlantError, Problem},
    kind::PlantKind,
    model::Model,
    parameter::Fitted,
    spec::{PlantSpec, in_effect},
};

/// Keys and values of a table, each with its place in the text.
type Fields = BTreeMap<Spanned<String>, Spanned<Value>>;

/// A plant file as parsed, before its names and values are checked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    model: Spanned<String>,
    #[serde(default)]
    source: String,
    parameters: Spanned<Fields>,
    #[serde(default)]
    effects: Vec<Spanned<Fields>>,
}

/// A value in a table of the file.
enum Value {
    Number(f64),
    Text(String),
    Numbers(Vec<f64>),
    Other,
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match toml::Value::deserialize(deserializer)? {
            toml::Value::Float(number) => Self::Number(number),
            // a parameter with more than 53 bits would be rounded here; none is that large
            toml::Value::Integer(number) => Self::Number(number as f64),
            toml::Value::String(text) => Self::Text(text),
            toml::Value::Array(values) => {
                let numbers = values.iter().map(|value| match value {
                    toml::Value::Float(number) => Some(*number),
                    toml::Value::Integer(number) => Some(*number as f64),
                    _ => None,
                });
                numbers.collect::<Option<_>>().map_or(Self::Other, Self::Numbers)
            }
            _ => Self::Other,
        })
    }
}

/// Problem with a field and its byte range in the text.
struct Fault {
    span: Range<usize>,
    error: InvalidField,
}

impl Fault {
    fn new(span: Range<usize>, field: impl Into<String>, problem: Problem) -> Self {
        Self { span, error: InvalidField { field: field.into(), problem } }
    }
}

impl PlantSpec {
    /// Reads a plant file. `source_name` is the file's name in error messages.
    ///
    /// # Errors
    /// [`PlantError`] with the file, the line and the field.
    pub fn from_toml(source_name: &str, text: &str) -> Result<Self, PlantError> {
        read(source_name, text)
    }

    /// The plant as a file, which [`PlantSpec::from_toml`] reads back to the bit. Comments of a file are not kept.
    #[must_use]
    pub fn to_toml(&self) -> String {
        write(self)
    }
}

fn read(source_name: &str, text: &str) -> Result<PlantSpec, PlantError> {
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

/// Deserialises a plant nested in a larger TOML document. Errors name the field; the line is that of the plant's table.
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

    let (mut effects, mut tables) = (Vec::with_capacity(raw.effects.len()), Vec::new());
    for (index, fields) in raw.effects.iter().enumerate() {
        let within = |fault: Fault| Fault { error: in_effect(index, fault.error), ..fault };
        if is_table(fields.get_ref()) {
            tables.push(table(fields).map_err(within)?);
        } else {
            effects.push(effect(kind, fields).map_err(within)?);
        }
    }
    // PlantSpec::new checks again what was checked above, where the errors have a better place in the text.
    let spec = PlantSpec::new(model, raw.source, effects).map_err(|error| Fault { span: raw.model.span(), error });
    let mut spec = spec?;
    tables.into_iter().for_each(|table| spec.push_table(table));
    Ok(spec)
}

fn in_parameters(error: InvalidField) -> InvalidField {
    InvalidField { field: format!("parameters.{}", error.field), ..error }
}

const TAG: &str = "effect";
const TABLE: &str = "table";

fn is_table(fields: &Fields) -> bool {
    fields
        .iter()
        .any(|(key, value)| key.get_ref() == TAG && matches!(value.get_ref(), Value::Text(name) if name == TABLE))
}

/// Reads an effect without a name.
fn table(fields: &Spanned<Fields>) -> Result<Table, Fault> {
    const KEYS: [&str; 5] = ["over", "on", "period", "at", "values"];
    let entry = |name: &str| fields.get_ref().iter().find(|(key, _)| key.get_ref() == name).map(|(_, value)| value);
    let span = |name: &str| entry(name).map_or(fields.span(), Spanned::span);
    let missing = |name: &'static str, unit| Fault::new(fields.span(), name, Problem::Missing { unit });
    if let Some((key, _)) =
        fields.get_ref().iter().find(|(key, _)| !KEYS.contains(&key.as_ref().as_str()) && key.get_ref() != TAG)
    {
        return Err(Fault::new(key.span(), key.get_ref().as_str(), Problem::Unknown { known: KEYS.to_vec() }));
    }
    let word = |name: &str| match entry(name).map(Spanned::get_ref) {
        Some(Value::Text(text)) => Some(text.as_str()),
        _ => None,
    };
    let unknown = |name: &str, known| Fault::new(span(name), name, Problem::Unknown { known });
    let over = Over::ALL.into_iter().find(|over| Some(over.name()) == word("over"));
    let over = over.ok_or_else(|| unknown("over", Over::ALL.iter().map(|over| over.name()).collect()))?;
    let on = match entry("on") {
        None => On::Force,
        Some(_) => On::ALL
            .into_iter()
            .find(|on| Some(on.name()) == word("on"))
            .ok_or_else(|| unknown("on", On::ALL.iter().map(|on| on.name()).collect()))?,
    };
    let period = match entry("period").map(Spanned::get_ref) {
        None => None,
        Some(Value::Number(period)) => Some(*period),
        Some(_) => return Err(Fault::new(span("period"), "period", Problem::NotANumber)),
    };
    let numbers = |name: &'static str, unit| match entry(name).map(Spanned::get_ref) {
        Some(Value::Numbers(numbers)) => Ok(numbers.clone()),
        Some(_) => Err(Fault::new(span(name), name, Problem::NotNumbers)),
        None => Err(missing(name, unit)),
    };
    let (at, values) =
        (numbers("at", "a list of what it is over")?, numbers("values", "a list of what it gives there")?);
    Table::new(over, on, period, at, values).map_err(|error| Fault { span: span(&error.field), error })
}

fn effect(kind: PlantKind, table: &Spanned<Fields>) -> Result<Effect, Fault> {
    let known = || {
        let named = catalogue().iter().filter(|info| info.kinds.contains(&kind)).map(|info| info.name);
        Problem::Unknown { known: named.chain([TABLE]).collect() }
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

/// Sets every parameter from a table that must hold all of them and nothing else, except keys for which `is_else` is
/// true.
fn fill(
    fitted: &mut dyn Fitted,
    kind: PlantKind,
    table: &Fields,
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

fn write(spec: &PlantSpec) -> String {
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
    for table in spec.tables() {
        let _ = writeln!(text, "\n[[effects]]\n{TAG} = \"{TABLE}\"\nover = \"{}\"", table.over().name());
        let _ = writeln!(text, "on = \"{}\"", table.on().name());
        if let Some(period) = table.period() {
            let _ = writeln!(text, "period = {period:?}");
        }
        // Debug output of a list of floats in Rust is also valid TOML
        let _ = writeln!(text, "at = {:?}\nvalues = {:?}", table.at(), table.values());
    }
    text
}

fn write_values(text: &mut String, kind: PlantKind, fitted: &dyn Fitted) {
    for (index, parameter) in fitted.parameters().iter().enumerate() {
        if let Some(value) = fitted.value(index) {
            // Rust's shortest form that reads back to the same bits is also valid TOML
            let _ = writeln!(text, "{} = {value:?}", parameter.name(kind));
        }
    }
}
