//! Description of a plant: base model, effects, source.

use crate::{
    effect::{Effect, check_values, table::Table},
    error::{InvalidField, Problem},
    kind::PlantKind,
    model::Model,
    parameter::Fitted,
};

/// A base model, its effects, and the source of the numbers. Every constructor and setter checks the bounds, so a
/// [`crate::Plant`] can be built from any `PlantSpec`.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantSpec {
    model: Model,
    source: String,
    effects: Vec<Effect>,
    tables: Vec<Table>,
}

impl PlantSpec {
    /// A plant of these parts. `source` says where the numbers come from.
    ///
    /// # Errors
    /// [`InvalidField`] names the first parameter out of range, or an effect that this kind of plant cannot have.
    pub fn new(model: Model, source: impl Into<String>, effects: Vec<Effect>) -> Result<Self, InvalidField> {
        let kind = model.kind();
        check_values(&model, kind)
            .map_err(|error| InvalidField { field: format!("parameters.{}", error.field), ..error })?;
        for (index, effect) in effects.iter().enumerate() {
            effect.check(kind).map_err(|error| in_effect(index, error))?;
        }
        Ok(Self { model, source: source.into(), effects, tables: Vec::new() })
    }

    /// Base model of the plant.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Kind of motion of the output.
    #[must_use]
    pub fn kind(&self) -> PlantKind {
        self.model.kind()
    }

    /// Source of the numbers, as free text.
    #[must_use]
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Named effects; those at one insertion point act in this order.
    #[must_use]
    pub fn effects(&self) -> &[Effect] {
        &self.effects
    }

    /// Effects without a name. Those on the input act after the named ones.
    #[must_use]
    pub fn tables(&self) -> &[Table] {
        &self.tables
    }

    /// Appends an effect without a name.
    pub fn push_table(&mut self, table: Table) {
        self.tables.push(table);
    }

    /// Removes an effect without a name; `None` if there is none at this index.
    pub fn remove_table(&mut self, index: usize) -> Option<Table> {
        (index < self.tables.len()).then(|| self.tables.remove(index))
    }

    /// Replaces the source of the numbers.
    pub fn set_source(&mut self, source: impl Into<String>) {
        self.source = source.into();
    }

    /// Appends a named effect.
    ///
    /// # Errors
    /// As [`PlantSpec::new`]; the description is unchanged then.
    pub fn push_effect(&mut self, effect: Effect) -> Result<(), InvalidField> {
        effect.check(self.kind()).map_err(|error| in_effect(self.effects.len(), error))?;
        self.effects.push(effect);
        Ok(())
    }

    /// Removes a named effect; `None` if there is none at this index.
    pub fn remove_effect(&mut self, index: usize) -> Option<Effect> {
        (index < self.effects.len()).then(|| self.effects.remove(index))
    }

    /// Sets a parameter of the base model by name.
    ///
    /// # Errors
    /// As [`Fitted::set`]; the description is unchanged then.
    pub fn set_parameter(&mut self, name: &str, value: f64) -> Result<(), InvalidField> {
        let kind = self.kind();
        self.model
            .set(kind, name, value)
            .map_err(|problem| InvalidField { field: format!("parameters.{name}"), problem })
    }

    /// Sets a parameter of an effect by name.
    ///
    /// # Errors
    /// As [`Fitted::set`], and [`Problem::NoSuchEffect`] past the last effect; the description is unchanged then.
    pub fn set_effect_parameter(&mut self, index: usize, name: &str, value: f64) -> Result<(), InvalidField> {
        let kind = self.kind();
        let effects = self.effects.len();
        let effect = self.effects.get_mut(index).ok_or_else(|| InvalidField {
            field: format!("effects[{index}]"),
            problem: Problem::NoSuchEffect { effects },
        })?;
        effect.set(kind, name, value).map_err(|problem| in_effect(index, InvalidField { field: name.into(), problem }))
    }
}

pub(crate) fn in_effect(index: usize, error: InvalidField) -> InvalidField {
    InvalidField { field: format!("effects[{index}].{}", error.field), ..error }
}
