//! Table `[body.suction-pad]`: a strip with suction cups and inflatable membranes.

use r4_protocol::channel::ChannelId;
use r4_world::{AnyBody, Cup, Line, Membrane, Restriction, Strip, SuctionError, SuctionPad};
use serde::Deserialize;

use super::{Shafts, flow::FlowTable};
use crate::{
    error::BoardError,
    number::{channel, not_negative, optional_not_negative, optional_positive, positive},
    robot::SimulatedBody,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct SuctionTable {
    #[serde(default, deserialize_with = "optional_not_negative")]
    supply_pa: Option<f64>,
    strip: StripTable,
    cup: [CupTable; 2],
    membrane: [MembraneTable; 3],
    line: LineTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StripTable {
    #[serde(deserialize_with = "positive")]
    stiffness_n_per_m: f64,
    #[serde(deserialize_with = "not_negative")]
    middle: f64,
    #[serde(deserialize_with = "not_negative")]
    outer: f64,
    #[serde(deserialize_with = "not_negative")]
    near: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CupTable {
    #[serde(deserialize_with = "positive")]
    radius_m: f64,
    #[serde(deserialize_with = "positive")]
    suction_pa: f64,
    #[serde(deserialize_with = "positive")]
    stiffness_n_per_m: f64,
    #[serde(deserialize_with = "positive")]
    leak_strain: f64,
    #[serde(deserialize_with = "positive")]
    leak_per_s: f64,
    #[serde(deserialize_with = "not_negative")]
    peel: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MembraneTable {
    #[serde(deserialize_with = "channel")]
    stepper: ChannelId,
    #[serde(deserialize_with = "channel")]
    valve: ChannelId,
    #[serde(deserialize_with = "positive")]
    radius_m: f64,
    #[serde(deserialize_with = "positive")]
    thickness_m: f64,
    #[serde(deserialize_with = "positive")]
    shear_pa: f64,
    #[serde(deserialize_with = "positive")]
    stiffening: f64,
    #[serde(deserialize_with = "positive")]
    viscosity_pa_s: f64,
    #[serde(deserialize_with = "positive")]
    burst_stretch: f64,
    #[serde(default, deserialize_with = "not_negative")]
    softening: f64,
    #[serde(default, deserialize_with = "not_negative")]
    relaxing: f64,
    #[serde(default, deserialize_with = "optional_positive")]
    relaxing_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LineTable {
    #[serde(deserialize_with = "positive")]
    lead_m: f64,
    #[serde(deserialize_with = "positive")]
    bore_m2: f64,
    #[serde(deserialize_with = "positive")]
    syringe_m3: f64,
    #[serde(deserialize_with = "positive")]
    dead_m3: f64,
    tube: FlowTable,
    orifice: FlowTable,
    #[serde(default, deserialize_with = "not_negative")]
    leak_m3_s_pa: f64,
}

impl SuctionTable {
    pub(super) fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let source = shafts.reader.source;
        let LineTable { lead_m, bore_m2, syringe_m3, dead_m3, tube, orifice, leak_m3_s_pa } = self.line;
        // The leak is given by its conductance alone; the critical ratio of the tube serves for it.
        let leak = Restriction { conductance_m3_s_pa: leak_m3_s_pa, critical_ratio: tube.critical_ratio };
        let (tube, orifice) = (tube.into(), orifice.into());
        let mut line = |index: usize| {
            let MembraneTable { stepper, valve, .. } = self.membrane[index];
            let path = format!("body.suction-pad.membrane[{index}]");
            let stepper = shafts.turning(stepper, format!("{path}.stepper"))?;
            let valve = shafts.relay(valve, format!("{path}.valve"))?;
            // A channel is taken only once, so that a shared one leaves the list shorter.
            if shafts.channels.len() < 2 * (index + 1) {
                return Err(source.rule(path, "each membrane needs a stepper and a valve of its own"));
            }
            Ok(Line { stepper, valve, lead_m, bore_m2, syringe_m3, dead_m3, tube, orifice, leak })
        };
        let lines = [line(0)?, line(1)?, line(2)?];
        let membranes = [0, 1, 2].map(|index: usize| {
            let table = &self.membrane[index];
            Membrane {
                radius_m: table.radius_m,
                thickness_m: table.thickness_m,
                shear_pa: table.shear_pa,
                stiffening: table.stiffening,
                viscosity_pa_s: table.viscosity_pa_s,
                burst_stretch: table.burst_stretch,
                softening: table.softening,
                relaxing: table.relaxing,
                relaxing_s: table.relaxing_s.unwrap_or(1.0),
            }
        });
        let cups = [0, 1].map(|index: usize| {
            let CupTable { radius_m, suction_pa, stiffness_n_per_m, leak_strain, leak_per_s, peel } = self.cup[index];
            Cup { radius_m, suction_pa, stiffness_n_m: stiffness_n_per_m, leak_strain, leak_per_s, peel }
        });
        let StripTable { stiffness_n_per_m, middle, outer, near } = self.strip;
        let strip = Strip { stiffness_n_m: stiffness_n_per_m, middle, outer, near };
        let pad = SuctionPad::new(strip, cups, membranes, lines, self.supply_pa).map_err(|why| {
            let path = match why {
                SuctionError::Membrane { membrane } | SuctionError::Stiff { membrane } => {
                    format!("body.suction-pad.membrane[{membrane}]")
                }
                SuctionError::Line { .. } | SuctionError::Wide { .. } => "body.suction-pad.line".into(),
                SuctionError::Cup { cup } => format!("body.suction-pad.cup[{cup}]"),
                SuctionError::Strip => "body.suction-pad.strip".into(),
                SuctionError::Supply => "body.suction-pad.supply_pa".into(),
            };
            source.rule(path, why)
        })?;
        Ok(SimulatedBody { kind: AnyBody::SuctionPad(Box::new(pad)), channels: shafts.channels })
    }
}
