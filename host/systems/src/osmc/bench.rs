//! The paper's three motors and their set points.

use r4_protocol::{ChannelId, ChannelKind, Unit};

/// One of the paper's motors on the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bench {
    /// Name of the motor, and first part of its metrics' names.
    pub name: &'static str,
    /// Channel of the motor on the board.
    pub channel: ChannelId,
    /// Set points in the order of the visits, deg or mm.
    pub set_points: &'static [f64],
    /// Final positions printed in the paper, deg or mm; empty where nothing is printed.
    pub printed: &'static [f64],
    /// Step of the tables of gains, deg; `None` for the actuator.
    pub step: Option<f64>,
    /// Largest duty as published, 255ths.
    pub clip: f64,
    /// Size of one count, rad or m: of the encoder, or of the 10-bit converter by which the paper read the
    /// potentiometer.
    pub count: f64,
    /// Time limit of the host's controller for one set point, s: four times what ours takes.
    pub patience_s: f64,
}

/// The small motor with the set points of Table 1, for which the paper prints no results.
pub const SMALL: Bench = Bench {
    name: "small",
    channel: ChannelId::new(ChannelKind::Dhb, 0),
    set_points: &[90.0, 180.0, 270.0, 360.0],
    printed: &[],
    step: Some(STEP_DEG),
    clip: 255.0,
    count: std::f64::consts::TAU / 600.0,
    patience_s: 4.0,
};

/// The geared motor: Table 1 and, by our reading, Tables 3 to 5.
pub const GEARED: Bench = Bench {
    name: "geared",
    channel: ChannelId::new(ChannelKind::Osmc, 0),
    set_points: &[90.0, 180.0, 270.0, 360.0],
    printed: &[91.0, 182.0, 272.0, 363.0],
    step: Some(STEP_DEG),
    clip: 230.0,
    count: std::f64::consts::TAU / 2400.0,
    patience_s: 8.0,
};

/// The actuator: Table 2.
pub const LINEAR: Bench = Bench {
    name: "linear",
    channel: ChannelId::new(ChannelKind::Actuator, 1),
    set_points: &[10.0, 25.0, 40.0, 70.0, 85.0],
    printed: &[7.0, 23.0, 39.0, 68.0, 83.0],
    step: None,
    clip: 200.0,
    count: 0.1 / 960.0,
    patience_s: 15.0,
};

/// All three motors of the paper.
pub const ALL: [Bench; 3] = [SMALL, GEARED, LINEAR];

/// Step of Tables 3 to 5, deg. The paper does not print it; 270 and 360 both explain the tables. 270 also agrees with a
/// rise time that is defined from 10 to 90 %.
pub const STEP_DEG: f64 = 270.0;

impl Bench {
    /// Scale of the set points: deg in a rad, or mm in a m.
    #[must_use]
    pub fn per_si(&self) -> f64 {
        if self.channel.kind == ChannelKind::Actuator { 1e3 } else { 180.0 / std::f64::consts::PI }
    }

    /// Unit of the set points, `deg` or `mm`.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        if self.channel.kind == ChannelKind::Actuator { "mm" } else { "deg" }
    }

    /// Unit of the channel's positions.
    #[must_use]
    pub fn si(&self) -> Unit {
        if self.channel.kind == ChannelKind::Actuator { Unit::M } else { Unit::Rad }
    }

    /// Scale of the host controller's error: degrees in a rad, or counts of the 10-bit converter in a m.
    #[must_use]
    pub fn per_error(&self) -> f64 {
        if self.channel.kind == ChannelKind::Actuator { 1.0 / self.count } else { self.per_si() }
    }
}
