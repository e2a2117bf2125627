//! Table `[body.berry-picker]`: a pneumatic gripper before a bush.

use r4_protocol::channel::ChannelId;
use r4_world::{AirSupply, AnyBody, Berry, BerryError, BerryPicker, CoilValve, Cylinder, Fingers, Point, ToolAxes};
use serde::Deserialize;

use super::{Shafts, flow::FlowTable};
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, positive},
    robot::SimulatedBody,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct PickerTable {
    supply: SupplyTable,
    valve: ValveTable,
    cylinder: CylinderTable,
    fingers: FingersTable,
    axes: ToolAxesTable,
    #[serde(default, rename = "berry")]
    berries: Vec<BerryTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SupplyTable {
    #[serde(deserialize_with = "positive")]
    receiver_m3: f64,
    #[serde(deserialize_with = "positive")]
    compressor_m3_s: f64,
    runs_between_pa: [f64; 2],
    #[serde(deserialize_with = "positive")]
    regulated_pa: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ValveTable {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "not_negative")]
    on_s: f64,
    #[serde(deserialize_with = "not_negative")]
    off_s: f64,
    inlet: FlowTable,
    exhaust: FlowTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CylinderTable {
    #[serde(deserialize_with = "positive")]
    bore_m: f64,
    #[serde(deserialize_with = "positive")]
    rod_m: f64,
    #[serde(deserialize_with = "positive")]
    stroke_m: f64,
    #[serde(deserialize_with = "positive")]
    dead_m3: f64,
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(deserialize_with = "not_negative")]
    coulomb_n: f64,
    #[serde(deserialize_with = "not_negative")]
    viscous_n_s_per_m: f64,
    #[serde(default, deserialize_with = "not_negative")]
    cushion_n_s_per_m: f64,
    closes_outwards: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FingersTable {
    #[serde(deserialize_with = "positive")]
    open_gap_m: f64,
    #[serde(deserialize_with = "positive")]
    gap_ratio: f64,
    #[serde(deserialize_with = "positive")]
    stiffness_n_per_m: f64,
    #[serde(default, deserialize_with = "not_negative")]
    bending_n_per_m: f64,
    #[serde(deserialize_with = "positive")]
    pad_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolAxesTable {
    #[serde(deserialize_with = "channel")]
    reach: ChannelId,
    #[serde(deserialize_with = "channel")]
    row: ChannelId,
    #[serde(deserialize_with = "positive")]
    m_per_rad: f64,
    #[serde(deserialize_with = "finite")]
    tray_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BerryTable {
    place_m: Point,
    diameter_m: f64,
    mass_kg: f64,
    stiffness_n_per_m: f64,
    friction: f64,
    stalk_n_per_m: f64,
    detach_n: f64,
    crush_n: f64,
}

impl PickerTable {
    pub(super) fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let Self { supply, valve, cylinder, fingers, axes, berries } = self;
        let supply = AirSupply {
            receiver_m3: supply.receiver_m3,
            compressor_m3_s: supply.compressor_m3_s,
            runs_between_pa: supply.runs_between_pa,
            regulated_pa: supply.regulated_pa,
        };
        let valve = CoilValve {
            shaft: shafts.relay(valve.channel, "body.berry-picker.valve.channel".into())?,
            delay_s: [valve.on_s, valve.off_s],
            inlet: valve.inlet.into(),
            exhaust: valve.exhaust.into(),
        };
        let cylinder = Cylinder {
            bore_m: cylinder.bore_m,
            rod_m: cylinder.rod_m,
            stroke_m: cylinder.stroke_m,
            dead_m3: cylinder.dead_m3,
            mass_kg: cylinder.mass_kg,
            coulomb_n: cylinder.coulomb_n,
            viscous_n_s_per_m: cylinder.viscous_n_s_per_m,
            cushion_n_s_per_m: cylinder.cushion_n_s_per_m,
            closes_outwards: cylinder.closes_outwards,
        };
        let fingers = Fingers {
            open_gap_m: fingers.open_gap_m,
            gap_ratio: fingers.gap_ratio,
            stiffness_n_per_m: fingers.stiffness_n_per_m,
            bending_n_per_m: fingers.bending_n_per_m,
            pad_m: fingers.pad_m,
        };
        let reach = shafts.turning(axes.reach, "body.berry-picker.axes.reach".into())?;
        let row = shafts.turning(axes.row, "body.berry-picker.axes.row".into())?;
        // Two axes on one shaft could not reach a berry.
        if reach == row {
            return Err(shafts.reader.source.rule("body.berry-picker.axes.row", "each axis needs a motor of its own"));
        }
        let axes = ToolAxes { shafts: [reach, row], m_per_rad: axes.m_per_rad, tray_m: axes.tray_m };
        let berry = |berry: &BerryTable| Berry {
            place_m: berry.place_m,
            diameter_m: berry.diameter_m,
            mass_kg: berry.mass_kg,
            stiffness_n_per_m: berry.stiffness_n_per_m,
            friction: berry.friction,
            stalk_n_per_m: berry.stalk_n_per_m,
            detach_n: berry.detach_n,
            crush_n: berry.crush_n,
        };
        let berries = berries.iter().map(berry).collect();
        let picker = BerryPicker::new(supply, valve, cylinder, fingers, axes, berries).map_err(|why| {
            let path = match why {
                BerryError::Supply => "body.berry-picker.supply".into(),
                BerryError::Valve => "body.berry-picker.valve".into(),
                BerryError::Cylinder | BerryError::Stiff { .. } => "body.berry-picker.cylinder".into(),
                BerryError::Fingers => "body.berry-picker.fingers".into(),
                BerryError::Berry { berry } => format!("body.berry-picker.berry[{berry}]"),
            };
            shafts.reader.source.rule(path, why)
        })?;
        Ok(SimulatedBody { kind: AnyBody::BerryPicker(Box::new(picker)), channels: shafts.channels })
    }
}
