//! Table `[[world.field]]`: fields, which have a value at every place of a world, and the sensors on a body that read
//! them.

use r4_world::{
    Charge, Cloud, Electric, ElectricSpec, Field, FieldError, FieldKind, FlowSpec, Plume, PlumeSpec, Point, Scene,
    Wander,
};
use serde::Deserialize;

use crate::{
    error::BoardError,
    number::{finite, not_negative, positive},
    source::Source,
};

/// Sensor on the body that gives a voltage for a field at its place: `zero_v + volts_per_unit * enhancement * (field +
/// charge)`.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldReading {
    /// Name of a field of the world. In a world without any field the sensor reads 0.
    pub name: String,
    /// Place of the sensor on the body, m.
    pub at_m: Point,
    /// Output without a field, V: that of the offset stage, for a field of both signs.
    pub zero_v: f64,
    /// Output for one unit of the field, V.
    pub volts_per_unit: f64,
    /// Field at the sensor divided by the undisturbed field: the form enhancement of the body that carries a field
    /// mill.
    pub enhancement: f64,
    /// Time constant of the sensor, s; 0 follows at once.
    pub lag_s: f64,
    /// Field of the body's own charge.
    pub charge: SelfCharge,
}

/// Field of the body's own charge at the sensor, in the field's unit: `d/dt = per_rad * |turn rate of wheels| - (charge
/// - rest) / leak`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfCharge {
    /// Field at rest: at time 0, and the final value.
    #[serde(default, deserialize_with = "finite")]
    pub rest: f64,
    /// Field that one radian of the wheels, in their mean, adds.
    #[serde(default, deserialize_with = "finite")]
    pub per_rad: f64,
    /// Time constant of the leakage, s.
    #[serde(default = "leak_s", deserialize_with = "positive")]
    pub leak_s: f64,
}

impl SelfCharge {
    /// Charge of a body without any.
    pub const NONE: Self = Self { rest: 0.0, per_rad: 0.0, leak_s: LEAK_S };
}

impl Default for SelfCharge {
    fn default() -> Self {
        Self::NONE
    }
}

/// Time constant of the leakage through a body's tyres, s: our choice.
const LEAK_S: f64 = 30.0;

fn leak_s() -> f64 {
    LEAK_S
}

fn one() -> f64 {
    1.0
}

/// Table `field` of a `[[simulation.analog]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ReadingTable {
    name: String,
    at_m: Point,
    #[serde(default, deserialize_with = "finite")]
    zero_v: f64,
    #[serde(deserialize_with = "finite")]
    volts_per_unit: f64,
    #[serde(default = "one", deserialize_with = "positive")]
    enhancement: f64,
    #[serde(default, deserialize_with = "not_negative")]
    lag_s: f64,
    #[serde(default)]
    charge: SelfCharge,
}

impl ReadingTable {
    /// Returns whether the sensor's place is finite.
    pub(super) fn is_finite(&self) -> bool {
        self.at_m.into_iter().all(f64::is_finite)
    }
}

impl From<&ReadingTable> for FieldReading {
    fn from(table: &ReadingTable) -> Self {
        let ReadingTable { name, at_m, zero_v, volts_per_unit, enhancement, lag_s, charge } = table;
        Self {
            name: name.clone(),
            at_m: *at_m,
            zero_v: *zero_v,
            volts_per_unit: *volts_per_unit,
            enhancement: *enhancement,
            lag_s: *lag_s,
            charge: *charge,
        }
    }
}

/// Table `[[world.field]]`: a name and one kind of field.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FieldTable {
    name: String,
    gas: Option<GasTable>,
    electric: Option<ElectricTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GasTable {
    source_m: Point,
    #[serde(deserialize_with = "finite")]
    release_m3_s: f64,
    #[serde(default = "filaments_per_s", deserialize_with = "finite")]
    filaments_per_s: f64,
    #[serde(deserialize_with = "finite")]
    layer_m: f64,
    #[serde(deserialize_with = "finite")]
    radius_m: f64,
    #[serde(deserialize_with = "finite")]
    growth_m2_s: f64,
    #[serde(deserialize_with = "finite")]
    spread_m2_s: f64,
    #[serde(default)]
    meander: WanderTable,
    #[serde(deserialize_with = "finite")]
    lifetime_s: f64,
    #[serde(default, deserialize_with = "finite")]
    running_s: f64,
    #[serde(default)]
    seed: u32,
    flow: FlowTable,
}

/// Default rate of filaments, 1/s. Our choice: at 0.5 m/s one every 0.1 m.
fn filaments_per_s() -> f64 {
    5.0
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct WanderTable {
    #[serde(deserialize_with = "finite")]
    deviation: f64,
    #[serde(deserialize_with = "finite")]
    tau_s: f64,
}

impl From<WanderTable> for Wander {
    fn from(WanderTable { deviation, tau_s }: WanderTable) -> Self {
        Self { deviation, tau_s }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FlowTable {
    corners_m: [Point; 2],
    cell_m: f64,
    inlets_m: Vec<[Point; 2]>,
    outlets_m: Vec<[Point; 2]>,
    speed_m_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ElectricTable {
    #[serde(default, deserialize_with = "finite")]
    uniform_v_per_m: f64,
    #[serde(default)]
    charge: Vec<ChargeTable>,
    #[serde(default)]
    cloud: Vec<CloudTable>,
    #[serde(default)]
    drift: WanderTable,
    #[serde(default)]
    seed: u32,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct ChargeTable {
    place_m: Point,
    size_m: f64,
    peak_v_per_m: f64,
}

impl From<ChargeTable> for Charge {
    fn from(ChargeTable { place_m, size_m, peak_v_per_m }: ChargeTable) -> Self {
        Self { place_m, size_m, peak_v_per_m }
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct CloudTable {
    place_m: Point,
    size_m: f64,
    #[serde(default, deserialize_with = "finite")]
    peak_v_per_m: f64,
    #[serde(default)]
    velocity_m_s: Point,
    wander: WanderTable,
}

impl From<CloudTable> for Cloud {
    fn from(CloudTable { place_m, size_m, peak_v_per_m, velocity_m_s, wander }: CloudTable) -> Self {
        Self { charge: Charge { place_m, size_m, peak_v_per_m }, velocity_m_s, wander: wander.into() }
    }
}

/// Checks the tables and returns the fields of a world, in its scene.
pub(super) fn check(tables: &[FieldTable], scene: &Scene, source: &Source) -> Result<Vec<Field>, BoardError> {
    let mut fields: Vec<Field> = Vec::new();
    for (index, table) in tables.iter().enumerate() {
        let path = format!("world.field[{index}]");
        if fields.iter().any(|field| field.name == table.name) {
            return Err(source.rule(format!("{path}.name"), "is the name of a field before it: give it another"));
        }
        let (kind, part) = match (&table.gas, &table.electric) {
            (Some(gas), None) => (gas.kind(scene), "gas"),
            (None, Some(electric)) => (electric.kind(), "electric"),
            _ => return Err(source.rule(path, "needs a table gas or electric, and only one")),
        };
        // Names the field of the table that the error is about, to find its line.
        let kind = kind.map_err(|why| {
            let field = match &why {
                FieldError::Number { what, .. } => format!(".{what}"),
                FieldError::Source(_) => ".source_m".to_owned(),
                FieldError::TooMany { .. } => ".filaments_per_s".to_owned(),
                FieldError::Flow(_) => ".flow".to_owned(),
            };
            source.rule(format!("{path}.{part}{field}"), why)
        })?;
        fields.push(Field { name: table.name.clone(), kind });
    }
    Ok(fields)
}

impl GasTable {
    fn kind(&self, scene: &Scene) -> Result<FieldKind, FieldError> {
        let flow = FlowSpec {
            corners_m: self.flow.corners_m,
            cell_m: self.flow.cell_m,
            inlets_m: self.flow.inlets_m.clone(),
            outlets_m: self.flow.outlets_m.clone(),
            speed_m_s: self.flow.speed_m_s,
        };
        let spec = PlumeSpec {
            source_m: self.source_m,
            release_m3_s: self.release_m3_s,
            filaments_per_s: self.filaments_per_s,
            layer_m: self.layer_m,
            radius_m: self.radius_m,
            growth_m2_s: self.growth_m2_s,
            spread_m2_s: self.spread_m2_s,
            meander: self.meander.into(),
            lifetime_s: self.lifetime_s,
            running_s: self.running_s,
            seed: self.seed.into(),
        };
        Ok(FieldKind::Gas(Box::new(Plume::new(spec, &flow, scene)?)))
    }
}

impl ElectricTable {
    fn kind(&self) -> Result<FieldKind, FieldError> {
        let spec = ElectricSpec {
            uniform_v_per_m: self.uniform_v_per_m,
            charges: self.charge.iter().map(|charge| (*charge).into()).collect(),
            clouds: self.cloud.iter().map(|cloud| (*cloud).into()).collect(),
            drift: self.drift.into(),
            seed: self.seed.into(),
        };
        Ok(FieldKind::Electric(Box::new(Electric::new(spec)?)))
    }
}
