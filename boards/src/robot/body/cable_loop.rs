//! Table `[body.cable-loop]`: a gripper with a loop that closes round a vial.

use r4_protocol::channel::ChannelId;
use r4_world::{AnyBody, CableLoop, CableLoopError, Point, cable_loop};
use serde::Deserialize;

use super::Shafts;
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, positive},
    robot::SimulatedBody,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct CableLoopTable {
    #[serde(deserialize_with = "channel")]
    spool: ChannelId,
    #[serde(deserialize_with = "channel")]
    lift: ChannelId,
    #[serde(deserialize_with = "channel")]
    ahead: ChannelId,
    #[serde(deserialize_with = "channel")]
    aside: ChannelId,
    finger: FingerTable,
    bowden: BowdenTable,
    creep: CreepTable,
    sensor: TipSensorTable,
    axes: AxesTable,
    vial: VialTable,
    jerk: Option<JerkTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FingerTable {
    #[serde(deserialize_with = "positive")]
    spool_radius_m: f64,
    #[serde(deserialize_with = "positive")]
    legs_m: f64,
    #[serde(deserialize_with = "positive")]
    bend_radius_m: f64,
    #[serde(deserialize_with = "positive")]
    thickness_m: f64,
    #[serde(deserialize_with = "positive")]
    strand_n: f64,
    #[serde(deserialize_with = "not_negative")]
    half_angle_rad: f64,
    #[serde(deserialize_with = "positive")]
    tip_n_per_m: f64,
    #[serde(deserialize_with = "positive")]
    start_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BowdenTable {
    #[serde(deserialize_with = "positive")]
    stiffness_n_per_m: f64,
    #[serde(default, deserialize_with = "not_negative")]
    friction_angle: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CreepTable {
    #[serde(deserialize_with = "not_negative")]
    share: f64,
    #[serde(deserialize_with = "positive")]
    time_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TipSensorTable {
    #[serde(default, deserialize_with = "finite")]
    zero_n: f64,
    #[serde(default, deserialize_with = "finite")]
    drift_n_per_s: f64,
    #[serde(default, deserialize_with = "not_negative")]
    slip_share: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AxesTable {
    #[serde(deserialize_with = "positive")]
    raised_m: f64,
    #[serde(deserialize_with = "finite")]
    lift_m_per_rad: f64,
    #[serde(deserialize_with = "finite")]
    ahead_m_per_rad: f64,
    #[serde(deserialize_with = "finite")]
    aside_m_per_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VialTable {
    #[serde(deserialize_with = "positive")]
    diameter_m: f64,
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(deserialize_with = "positive")]
    height_m: f64,
    place_m: Point,
    #[serde(deserialize_with = "positive")]
    friction: f64,
    #[serde(deserialize_with = "positive")]
    kinetic_share: f64,
    #[serde(deserialize_with = "positive")]
    crush_n: f64,
    #[serde(deserialize_with = "positive")]
    clearance_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JerkTable {
    #[serde(deserialize_with = "not_negative")]
    after_s: f64,
    #[serde(deserialize_with = "not_negative")]
    lasts_s: f64,
    #[serde(deserialize_with = "finite")]
    acceleration_m_s2: f64,
}

impl CableLoopTable {
    pub(super) fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let channels = [(self.spool, "spool"), (self.lift, "lift"), (self.ahead, "ahead"), (self.aside, "aside")];
        let source = shafts.reader.source;
        for (number, (channel, name)) in channels.into_iter().enumerate() {
            let path = format!("body.cable-loop.{name}");
            // `CableLoop` has its axes in this order; a channel that was taken before has a lower number.
            if shafts.turning(channel, path.clone())? != number {
                return Err(source.rule(path, "each axis needs a channel of its own"));
            }
        }
        let Self { finger, bowden, creep, sensor, axes, vial, jerk, .. } = self;
        let finger = cable_loop::Finger {
            spool_radius_m: finger.spool_radius_m,
            legs_m: finger.legs_m,
            bend_radius_m: finger.bend_radius_m,
            thickness_m: finger.thickness_m,
            strand_n: finger.strand_n,
            half_angle_rad: finger.half_angle_rad,
            tip_n_per_m: finger.tip_n_per_m,
            start_m: finger.start_m,
        };
        let bowden =
            cable_loop::Bowden { stiffness_n_per_m: bowden.stiffness_n_per_m, friction_angle: bowden.friction_angle };
        let creep = cable_loop::Creep { share: creep.share, time_s: creep.time_s };
        let sensor = cable_loop::TipSensor {
            zero_n: sensor.zero_n,
            drift_n_per_s: sensor.drift_n_per_s,
            slip_share: sensor.slip_share,
        };
        let axes = cable_loop::Axes {
            raised_m: axes.raised_m,
            lift_m_per_rad: axes.lift_m_per_rad,
            ahead_m_per_rad: axes.ahead_m_per_rad,
            aside_m_per_rad: axes.aside_m_per_rad,
        };
        let vial = cable_loop::Vial {
            diameter_m: vial.diameter_m,
            mass_kg: vial.mass_kg,
            height_m: vial.height_m,
            place_m: vial.place_m,
            friction: vial.friction,
            kinetic_share: vial.kinetic_share,
            crush_n: vial.crush_n,
            clearance_m: vial.clearance_m,
        };
        let jerk = jerk.as_ref().map(|jerk| cable_loop::Jerk {
            after_s: jerk.after_s,
            lasts_s: jerk.lasts_s,
            acceleration_m_s2: jerk.acceleration_m_s2,
        });
        let body = CableLoop::new((finger, bowden, creep, sensor), axes, vial, jerk).map_err(|why| {
            let path = match why {
                CableLoopError::Finger => "body.cable-loop.finger",
                CableLoopError::Bowden => "body.cable-loop.bowden",
                CableLoopError::Creep => "body.cable-loop.creep",
                CableLoopError::Axes => "body.cable-loop.axes",
                CableLoopError::Vial => "body.cable-loop.vial",
            };
            source.rule(path, why)
        })?;
        Ok(SimulatedBody { kind: AnyBody::CableLoop(Box::new(body)), channels: shafts.channels })
    }
}
