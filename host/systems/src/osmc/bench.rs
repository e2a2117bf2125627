//! The three motors of the paper, and what each is asked for.

use r4_protocol::{ChannelId, ChannelKind, Unit};

/// One of the paper's motors on the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bench {
    /// First part of its metrics' names.
    pub name: &'static str,
    /// Its channel.
    pub channel: ChannelId,
    /// Set points in the order in which they are visited, deg or mm.
    pub set_points: &'static [f64],
    /// Where the motor was in the paper, deg or mm; empty where nothing is printed.
    pub printed: &'static [f64],
    /// Step of the tables of gains, deg; none for the actuator.
    pub step: Option<f64>,
    /// Published largest duty, 255ths.
    pub clip: f64,
    /// rad or m in a count: of the encoder, or of the 10-bit converter that the paper read the potentiometer with.
    pub count: f64,
    /// How long the host's controller has for one set point, s: four times what ours takes.
    pub patience_s: f64,
}

/// The small motor: the set points of Table 1, for which nothing is printed of it.
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

/// All three.
pub const ALL: [Bench; 3] = [SMALL, GEARED, LINEAR];

/// Step of Tables 3 to 5, deg. It is not printed; 270 and 360 both explain the tables. Ours is the one that a definition of the rise
/// from 10 to 90 % allows, too.
pub const STEP_DEG: f64 = 270.0;

impl Bench {
    /// deg in a rad, or mm in a m.
    #[must_use]
    pub fn per_si(&self) -> f64 {
        if self.channel.kind == ChannelKind::Actuator { 1e3 } else { 180.0 / std::f64::consts::PI }
    }

    /// Unit of its set points.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        if self.channel.kind == ChannelKind::Actuator { "mm" } else { "deg" }
    }

    /// Unit of its channel.
    #[must_use]
    pub fn si(&self) -> Unit {
        if self.channel.kind == ChannelKind::Actuator { Unit::M } else { Unit::Rad }
    }

    /// What the host's controller computes with: degrees, or counts of the 10-bit converter.
    #[must_use]
    pub fn per_error(&self) -> f64 {
        if self.channel.kind == ChannelKind::Actuator { 1.0 / self.count } else { self.per_si() }
    }
}
