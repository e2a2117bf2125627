//! Table `[body.two-fingers]`: two fingers with an object between them.

use r4_protocol::channel::ChannelId;
use r4_world::{AnyBody, Encoders, Finger, GripError, Held, Pads, Palm, Point, TwoFingers};
use serde::Deserialize;

use super::Shafts;
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, positive},
    robot::SimulatedBody,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct GripTable {
    #[serde(deserialize_with = "channel")]
    left: ChannelId,
    #[serde(deserialize_with = "channel")]
    right: ChannelId,
    palm: PalmTable,
    finger: FingerTable,
    pads: PadsTable,
    object: HeldTable,
    encoder: EncoderTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PalmTable {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "positive")]
    zero_m: f64,
    #[serde(deserialize_with = "finite")]
    m_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    play_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FingerTable {
    #[serde(deserialize_with = "positive")]
    length_m: f64,
    #[serde(deserialize_with = "not_negative")]
    half_width_m: f64,
    #[serde(deserialize_with = "positive")]
    inertia_kg_m2: f64,
    #[serde(deserialize_with = "positive")]
    link_nm_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    link_nm_s_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    play_rad: f64,
    #[serde(deserialize_with = "positive")]
    servo_nm_per_rad: f64,
    #[serde(deserialize_with = "positive")]
    servo_nm_s_per_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PadsTable {
    #[serde(deserialize_with = "positive")]
    stiffness_n_per_m: f64,
    #[serde(default, deserialize_with = "not_negative")]
    damping_n_s_per_m: f64,
    #[serde(deserialize_with = "not_negative")]
    friction: f64,
    #[serde(default, deserialize_with = "not_negative")]
    creep_per_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HeldTable {
    #[serde(deserialize_with = "positive")]
    side_m: f64,
    #[serde(deserialize_with = "not_negative")]
    edge_m: f64,
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(default, deserialize_with = "not_negative")]
    table_friction: f64,
    place_m: Point,
    #[serde(default, deserialize_with = "finite")]
    angle_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EncoderTable {
    #[serde(deserialize_with = "positive")]
    step_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    noise_rad: f64,
    #[serde(default)]
    offset_rad: [f64; 3],
    #[serde(default)]
    seed: u64,
}

impl GripTable {
    pub(super) fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        for (id, path) in [(self.left, "left"), (self.right, "right"), (self.palm.channel, "palm.channel")] {
            shafts.turning(id, format!("body.two-fingers.{path}"))?;
        }
        let source = shafts.reader.source;
        // A channel is taken only once, so that a shared one leaves the list shorter.
        if shafts.channels.len() < 3 {
            return Err(source.rule("body.two-fingers", "left, right and palm need a channel of their own each"));
        }
        let PalmTable { zero_m, m_per_rad, play_m, .. } = self.palm;
        let FingerTable { length_m, half_width_m, inertia_kg_m2, link_nm_per_rad, link_nm_s_per_rad, .. } = self.finger;
        let FingerTable { play_rad, servo_nm_per_rad, servo_nm_s_per_rad, .. } = self.finger;
        let finger = Finger {
            length_m,
            half_width_m,
            inertia_kg_m2,
            link_nm_per_rad,
            link_nm_s_per_rad,
            play_rad,
            servo_nm_per_rad,
            servo_nm_s_per_rad,
        };
        let PadsTable { stiffness_n_per_m, damping_n_s_per_m, friction, creep_per_s } = self.pads;
        let pads = Pads { stiffness_n_per_m, damping_n_s_per_m, friction, creep_per_s };
        let HeldTable { side_m, edge_m, mass_kg, table_friction, place_m, angle_rad } = self.object;
        let held = Held { side_m, edge_m, mass_kg, table_friction, place_m, angle_rad };
        let EncoderTable { step_rad, noise_rad, offset_rad, seed } = self.encoder;
        let encoders = Encoders { step_rad, noise_rad, offset_rad, seed };
        let body =
            TwoFingers::new(Palm { zero_m, m_per_rad, play_m }, finger, pads, held, encoders).map_err(|why| {
                let table = match why {
                    GripError::Palm => "palm",
                    GripError::Finger => "finger",
                    GripError::Pads { .. } => "pads",
                    GripError::Object => "object",
                    GripError::Encoders => "encoder",
                };
                source.rule(format!("body.two-fingers.{table}"), why)
            })?;
        Ok(SimulatedBody { kind: AnyBody::TwoFingers(Box::new(body)), channels: shafts.channels })
    }
}
