//! Table `[body.deformable]`: a robot on wheels in a shell of six panels that a servo narrows, with two whiskers.

use r4_protocol::channel::ChannelId;
use r4_world::{AnyBody, Deformable, DeformableError, Point, Shell, Whiskers};
use serde::Deserialize;

use super::{Shafts, WheeledTable};
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, positive},
    robot::SimulatedBody,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct DeformableTable {
    wheeled: WheeledTable,
    shell: ShellTable,
    whiskers: WhiskersTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShellTable {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "positive")]
    panel_m: f64,
    #[serde(deserialize_with = "positive")]
    rest_rad: f64,
    #[serde(deserialize_with = "finite")]
    per_rad: f64,
    ends_rad: [f64; 2],
    #[serde(deserialize_with = "positive")]
    holds_n: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WhiskersTable {
    hinge_m: Point,
    #[serde(deserialize_with = "positive")]
    length_m: f64,
    #[serde(deserialize_with = "not_negative")]
    rest_rad: f64,
    #[serde(deserialize_with = "positive")]
    stiffness_nm_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    hysteresis_rad: f64,
    #[serde(deserialize_with = "positive")]
    every_s: f64,
    #[serde(default, deserialize_with = "not_negative")]
    late_s: f64,
    #[serde(default, deserialize_with = "not_negative")]
    noise_rad: f64,
    #[serde(default)]
    seed: u64,
}

impl DeformableTable {
    pub(super) fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let source = shafts.reader.source;
        let ShellTable { channel, panel_m, rest_rad, per_rad, ends_rad, holds_n } = self.shell;
        let shaft = shafts.turning(channel, "body.deformable.shell.channel".into())?;
        if self.wheeled.outline_m.is_some() {
            let why = "the shell is the outline: leave `outline_m` out";
            return Err(source.rule("body.deformable.wheeled.outline_m", why));
        }
        // A shared shaft would drive and narrow the robot at once.
        if self.wheeled.wheel.iter().any(|wheel| wheel.channel == Some(channel)) {
            return Err(
                source.rule("body.deformable.shell.channel", "a wheel has this channel: the shell needs its own")
            );
        }
        let base = self.wheeled.chassis(&mut shafts, "body.deformable.wheeled")?;
        let shell = Shell { panel_m, rest_rad, per_rad, ends_rad, holds_n, shaft };
        let WhiskersTable { hinge_m, length_m, rest_rad, stiffness_nm_per_rad, hysteresis_rad, every_s, .. } =
            self.whiskers;
        let WhiskersTable { late_s, noise_rad, seed, .. } = self.whiskers;
        let whiskers = Whiskers {
            hinge_m,
            length_m,
            rest_rad,
            stiffness_nm_per_rad,
            hysteresis_rad,
            every_s,
            late_s,
            noise_rad,
            seed,
        };
        let body = Deformable::new(base, shell, whiskers).map_err(|why| {
            let table = match why {
                DeformableError::Shell { .. } | DeformableError::Shaft { .. } => "shell",
                DeformableError::Whiskers => "whiskers",
            };
            source.rule(format!("body.deformable.{table}"), why)
        })?;
        Ok(SimulatedBody { kind: AnyBody::Deformable(Box::new(body)), channels: shafts.channels })
    }
}
