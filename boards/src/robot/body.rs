//! `[body]` and `[world]`: what couples a robot's shafts, and what it moves among. Simulated only.

use std::fmt::Write;

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::BoardConfig,
};
use r4_world::{
    Ankle, AnyBody, Axle, BalanceTail, Body as _, Cable, CableLoop, CableLoopError, Chassis, ChassisError, Encoders,
    Finger, GripError, Held, Lift, Link, Outline, Pads, Palm, Person, Point, Pose, Scene, SceneError, SlipLaw, Surface,
    TailError, TwoFingers, Tyre, Wearer, Wheel, Wheeled, cable_loop,
    AirSupply, Ankle, AnyBody, Axle, BalanceTail, Berry, BerryError, BerryPicker, Body as _, Cable, Chassis,
    ChassisError, CoilValve, Cylinder, Fingers, Lift, Link, Outline, Person, Point, Pose, Restriction, Scene,
    SceneError, SlipLaw, Surface, TailError, ToolAxes, Tyre, Wearer, Wheel, Wheeled,
    Ankle, AnyBody, Axle, BalanceTail, Body as _, Cable, Chassis, ChassisError, Cup, Lift, Line, Link, Membrane,
    Outline, Person, Point, Pose, Restriction, Scene, SceneError, SlipLaw, Strip, SuctionError, SuctionPad, Surface,
    TailError, Tyre, Wearer, Wheel, Wheeled,
};
use serde::Deserialize;

use super::{
    Mount, Robot, SimulatedBody, World,
    read::Reader,
    simulation::{may_slide, may_turn, others_that_turn},
};
use crate::{
    error::BoardError,
    number::{
        channel, finite, not_negative, optional_channel, optional_finite, optional_not_negative, optional_positive,
        positive,
    },
    source::Source,
};

/// `[body]`: one kind of it.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Body {
    /// A chassis on wheels.
    Wheeled(Box<WheeledTable>),
    /// A person with a tail of two links.
    BalanceTail(Box<TailTable>),
    /// Two fingers with an object between them.
    TwoFingers(Box<GripTable>),
    /// A gripper with a loop that closes round a vial.
    CableLoop(Box<CableLoopTable>),
    /// A pneumatic gripper before a bush.
    BerryPicker(Box<PickerTable>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CableLoopTable {
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
pub(super) struct PickerTable {
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

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct FlowTable {
    #[serde(deserialize_with = "positive")]
    conductance_m3_s_pa: f64,
    #[serde(deserialize_with = "not_negative")]
    critical_ratio: f64,
}

impl From<FlowTable> for Restriction {
    fn from(FlowTable { conductance_m3_s_pa, critical_ratio }: FlowTable) -> Self {
        Self { conductance_m3_s_pa, critical_ratio }
    }
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
struct BerryTable {
    place_m: Point,
    diameter_m: f64,
    mass_kg: f64,
    stiffness_n_per_m: f64,
    friction: f64,
    stalk_n_per_m: f64,
    detach_n: f64,
    crush_n: f64,
    /// A strip with suction cups and inflatable membranes.
    SuctionPad(Box<SuctionTable>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TailTable {
    wearer: WearerTable,
    ankle: AnkleTable,
    link: [LinkTable; 2],
    lift: Option<LiftTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WearerTable {
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(deserialize_with = "positive")]
    centre_m: f64,
    #[serde(deserialize_with = "positive")]
    inertia_kg_m2: f64,
    tail_m: Point,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnkleTable {
    #[serde(deserialize_with = "not_negative")]
    stiffness_nm_per_rad: f64,
    #[serde(deserialize_with = "not_negative")]
    damping_nm_s_per_rad: f64,
    #[serde(deserialize_with = "positive")]
    torque_max_nm: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkTable {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "positive")]
    length_m: f64,
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(deserialize_with = "not_negative")]
    centre_m: f64,
    #[serde(deserialize_with = "positive")]
    inertia_kg_m2: f64,
    #[serde(default, deserialize_with = "finite")]
    rest_rad: f64,
    cable: CableTable,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CableTable {
    #[serde(deserialize_with = "finite")]
    ratio: f64,
    #[serde(deserialize_with = "positive")]
    stiffness_nm_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    damping_nm_s_per_rad: f64,
    #[serde(default, deserialize_with = "not_negative")]
    wraps: f64,
    #[serde(default, deserialize_with = "not_negative")]
    loss_per_wrap: f64,
    #[serde(default, deserialize_with = "not_negative")]
    friction_nm: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LiftTable {
    #[serde(deserialize_with = "not_negative")]
    at_s: f64,
    #[serde(deserialize_with = "not_negative")]
    over_s: f64,
    #[serde(deserialize_with = "not_negative")]
    mass_kg: f64,
    place_m: Point,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WheeledTable {
    #[serde(deserialize_with = "positive")]
    mass_kg: f64,
    #[serde(deserialize_with = "positive")]
    inertia_kg_m2: f64,
    #[serde(default)]
    centre_m: Point,
    #[serde(default, deserialize_with = "not_negative")]
    height_m: f64,
    outline_m: Option<Vec<Point>>,
    tyre: TyreTable,
    wheel: Vec<WheelTable>,
    steering: Option<SteeringTable>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct TyreTable {
    #[serde(deserialize_with = "positive")]
    compliance_long_per_n: f64,
    #[serde(deserialize_with = "positive")]
    compliance_lat_per_n: f64,
    #[serde(deserialize_with = "not_negative")]
    friction: f64,
    #[serde(deserialize_with = "positive")]
    relaxation_m: f64,
    #[serde(default)]
    law: Law,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Law {
    #[default]
    Brush,
    Linear,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WheelTable {
    /// What drives it; left out for one that rolls freely.
    #[serde(default, deserialize_with = "optional_channel")]
    channel: Option<ChannelId>,
    place_m: Point,
    #[serde(deserialize_with = "positive")]
    radius_m: f64,
    #[serde(default)]
    inverted: bool,
    #[serde(default)]
    steered: bool,
    /// A caster or ball: carries, and gives way in every direction.
    #[serde(default)]
    caster: bool,
    tyre: Option<TyreTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SteeringTable {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_finite")]
    rad_per_m: Option<f64>,
    #[serde(default, deserialize_with = "optional_finite")]
    rad_per_rad: Option<f64>,
    /// Position at which the wheels point straight ahead, m or rad.
    #[serde(deserialize_with = "finite")]
    straight: f64,
    #[serde(deserialize_with = "finite")]
    fixed_x_m: f64,
    #[serde(default, deserialize_with = "finite")]
    trail_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SuctionTable {
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

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct FlowTable {
    #[serde(deserialize_with = "positive")]
    conductance_m3_s_pa: f64,
    #[serde(deserialize_with = "not_negative")]
    critical_ratio: f64,
}

impl From<FlowTable> for Restriction {
    fn from(FlowTable { conductance_m3_s_pa, critical_ratio }: FlowTable) -> Self {
        Self { conductance_m3_s_pa, critical_ratio }
    }
}

impl From<TyreTable> for Tyre {
    fn from(table: TyreTable) -> Self {
        Self {
            compliance_per_n: [table.compliance_long_per_n, table.compliance_lat_per_n],
            friction: table.friction,
            relaxation_m: table.relaxation_m,
            law: match table.law {
                Law::Brush => SlipLaw::Brush,
                Law::Linear => SlipLaw::Linear,
            },
        }
    }
}

impl Body {
    /// The body at the origin, and the channels whose shafts it couples.
    pub(super) fn check(&self, reader: &Reader<'_>, config: &BoardConfig) -> Result<SimulatedBody, BoardError> {
        let shafts = Shafts { reader, config, channels: Vec::new() };
        match self {
            Self::Wheeled(table) => table.check(shafts),
            Self::BalanceTail(table) => table.check(shafts),
            Self::TwoFingers(table) => table.check(shafts),
            Self::CableLoop(table) => table.check(shafts),
            Self::BerryPicker(table) => table.check(shafts),
            Self::SuctionPad(table) => table.check(shafts),
        }
    }
}

impl PickerTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
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

impl TailTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let mut link = |index: usize| {
            let table = &self.link[index];
            let cable = &table.cable;
            Ok(Link {
                length_m: table.length_m,
                mass_kg: table.mass_kg,
                centre_m: table.centre_m,
                inertia_kg_m2: table.inertia_kg_m2,
                cable: Cable {
                    shaft: shafts.turning(table.channel, format!("body.balance-tail.link[{index}].channel"))?,
                    ratio: cable.ratio,
                    stiffness_nm_per_rad: cable.stiffness_nm_per_rad,
                    damping_nm_s_per_rad: cable.damping_nm_s_per_rad,
                    wraps: cable.wraps,
                    loss_per_wrap: cable.loss_per_wrap,
                    friction_nm: cable.friction_nm,
                },
            })
        };
        let links = [link(0)?, link(1)?];
        let source = shafts.reader.source;
        if shafts.channels.len() < 2 {
            return Err(source.rule("body.balance-tail.link[1].channel", "each link needs a motor of its own"));
        }
        let WearerTable { mass_kg, centre_m, inertia_kg_m2, tail_m } = self.wearer;
        let AnkleTable { stiffness_nm_per_rad, damping_nm_s_per_rad, torque_max_nm } = self.ankle;
        let ankle = Ankle { stiffness_nm_per_rad, damping_nm_s_per_rad, torque_max_nm };
        let wearer = Wearer { mass_kg, centre_m, inertia_kg_m2, tail_m, ankle };
        let lift = self.lift.as_ref().map(|lift| Lift {
            at_s: lift.at_s,
            over_s: lift.over_s,
            mass_kg: lift.mass_kg,
            place_m: lift.place_m,
        });
        let rest_rad = [self.link[0].rest_rad, self.link[1].rest_rad];
        let tail = BalanceTail::new(wearer, links, rest_rad, lift).map_err(|why| {
            let path = match why {
                TailError::Link { link } => format!("body.balance-tail.link[{link}]"),
                TailError::Cable { link } | TailError::Stiff { link, .. } => {
                    format!("body.balance-tail.link[{link}].cable")
                }
                TailError::Wearer => "body.balance-tail.wearer".into(),
                TailError::Ankle { .. } => "body.balance-tail.ankle".into(),
                TailError::Lift => "body.balance-tail.lift".into(),
            };
            source.rule(path, why)
        })?;
        Ok(SimulatedBody { kind: AnyBody::BalanceTail(Box::new(tail)), channels: shafts.channels })
    }
}

impl CableLoopTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let channels = [(self.spool, "spool"), (self.lift, "lift"), (self.ahead, "ahead"), (self.aside, "aside")];
        let source = shafts.reader.source;
        for (number, (channel, name)) in channels.into_iter().enumerate() {
            let path = format!("body.cable-loop.{name}");
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
impl SuctionTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let source = shafts.reader.source;
        let LineTable { lead_m, bore_m2, syringe_m3, dead_m3, tube, orifice, leak_m3_s_pa } = self.line;
        let leak = Restriction { conductance_m3_s_pa: leak_m3_s_pa, critical_ratio: tube.critical_ratio };
        let (tube, orifice) = (tube.into(), orifice.into());
        let mut line = |index: usize| {
            let MembraneTable { stepper, valve, .. } = self.membrane[index];
            let path = format!("body.suction-pad.membrane[{index}]");
            let stepper = shafts.turning(stepper, format!("{path}.stepper"))?;
            let valve = shafts.relay(valve, format!("{path}.valve"))?;
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

impl WheeledTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let (table, reader) = (self, shafts.reader);
        let mut wheels = Vec::new();
        for (index, wheel) in table.wheel.iter().enumerate() {
            let path = format!("body.wheeled.wheel[{index}]");
            if wheel.caster && (wheel.channel.is_some() || wheel.steered || wheel.tyre.is_some()) {
                return Err(reader.rule(path, "a caster has no channel, no tyre and is not steered"));
            }
            let driven = wheel.channel.map(|id| shafts.turning(id, format!("{path}.channel")));
            wheels.push(Wheel {
                place_m: wheel.place_m,
                radius_m: wheel.radius_m,
                shaft: driven.transpose()?,
                inverted: wheel.inverted,
                steered: wheel.steered,
                tyre: (!wheel.caster).then(|| wheel.tyre.unwrap_or(table.tyre).into()),
            });
        }
        let axle = table.steering.as_ref().map(|steering| shafts.axle(steering)).transpose()?;
        let chassis = Chassis {
            mass_kg: table.mass_kg,
            inertia_kg_m2: table.inertia_kg_m2,
            centre_m: table.centre_m,
            height_m: table.height_m,
        };
        let channels = shafts.channels;
        let mut wheeled = Wheeled::new(chassis, wheels, axle, channels.len()).map_err(|why| {
            let path = match why {
                ChassisError::Wheel { wheel } | ChassisError::Tyre { wheel, .. } => {
                    format!("body.wheeled.wheel[{wheel}]")
                }
                ChassisError::Axle => "body.wheeled.steering".into(),
                _ => "body.wheeled".into(),
            };
            reader.source.rule(path, why)
        })?;
        if let Some(outline_m) = &table.outline_m {
            let outline = Outline::new(outline_m.clone());
            wheeled = wheeled.with_outline(outline.map_err(|why| reader.source.rule("body.wheeled.outline_m", why))?);
        }
        Ok(SimulatedBody { kind: AnyBody::Wheeled(Box::new(wheeled)), channels })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GripTable {
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
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        for (id, path) in [(self.left, "left"), (self.right, "right"), (self.palm.channel, "palm.channel")] {
            shafts.turning(id, format!("body.two-fingers.{path}"))?;
        }
        let source = shafts.reader.source;
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

/// The channels whose shafts a body couples, each once.
struct Shafts<'r> {
    reader: &'r Reader<'r>,
    config: &'r BoardConfig,
    channels: Vec<ChannelId>,
}

impl Shafts<'_> {
    fn turning(&mut self, id: ChannelId, path: String) -> Result<usize, BoardError> {
        let known = self.may_turn();
        self.reader.one_of("channel that turns", id, known.iter(), path)?;
        Ok(self.number(id))
    }

    /// A relay, which stands at 1 while its contact is closed.
    fn relay(&mut self, id: ChannelId, path: String) -> Result<usize, BoardError> {
        let known: Vec<_> = self.config.relays.iter().map(|relay| relay.id).collect();
        self.reader.one_of("relay", id, known.iter(), path)?;
        Ok(self.number(id))
    }

    fn may_turn(&self) -> Vec<ChannelId> {
        may_turn(&self.config.motors).into_iter().chain(others_that_turn(self.config)).collect()
    }

    fn axle(&mut self, steering: &SteeringTable) -> Result<Axle, BoardError> {
        let path = "body.wheeled.steering";
        let motors = &self.config.motors;
        let (known, rad_per_unit) = match (steering.rad_per_m, steering.rad_per_rad) {
            (Some(rad_per_m), None) => (may_slide(motors), rad_per_m),
            (None, Some(rad_per_rad)) => (self.may_turn(), rad_per_rad),
            _ => return Err(self.reader.rule(path, "needs rad_per_m for an actuator, or rad_per_rad for a motor")),
        };
        self.reader.one_of("channel of that kind", steering.channel, known.iter(), format!("{path}.channel"))?;
        Ok(Axle {
            shaft: self.number(steering.channel),
            rad_per_unit,
            straight: steering.straight,
            fixed_x_m: steering.fixed_x_m,
            trail_m: steering.trail_m,
        })
    }

    fn number(&mut self, id: ChannelId) -> usize {
        self.channels.iter().position(|known| *known == id).unwrap_or_else(|| {
            self.channels.push(id);
            self.channels.len() - 1
        })
    }
}

/// A file of a body alone.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BodyFile {
    body: Body,
}

/// Reads a file with a `[body]` and nothing else, for the motors of a robot.
pub(crate) fn read_body(source: &Source, robot: &Robot) -> Result<SimulatedBody, BoardError> {
    let file: BodyFile = source.parse()?;
    file.body.check(&Reader { source, carrier: &robot.carrier }, &robot.config)
}

/// The tables of a file that describe a robot's body and world, whatever else the file has.
#[derive(Deserialize)]
struct EnvironmentFile {
    body: Option<Body>,
    world: Option<WorldTable>,
}

/// Gives `robot` the `[body]` and the `[world]` of a file, each if it is there.
pub(crate) fn read_environment(source: &Source, robot: &mut Robot) -> Result<(), BoardError> {
    let file: EnvironmentFile = source.parse()?;
    if let Some(body) = file.body {
        let body = body.check(&Reader { source, carrier: &robot.carrier }, &robot.config)?;
        robot.simulation.set_body(body);
    }
    if let Some(world) = file.world {
        let world = world.check(source)?;
        if robot.simulation.body.is_none() {
            let rule = "needs a [body] that stands in it, in this file or in the robot's";
            return Err(BoardError::Rule { at: source.at("world"), channel: None, rule });
        }
        robot.simulation.enter(world);
    }
    Ok(())
}

impl SimulatedBody {
    /// The body, if it is a chassis on wheels.
    #[must_use]
    pub fn wheeled(&self) -> Option<&Wheeled> {
        if let AnyBody::Wheeled(body) = &self.kind { Some(body) } else { None }
    }

    /// A body on wheels as the text of a file, which [`load_body`](crate::load_body) reads back to the bit. `channels` are those of its
    /// shafts; each of `comments` becomes a line at its top: where the numbers are from.
    #[must_use]
    pub fn wheeled_toml(wheeled: &Wheeled, channels: &[ChannelId], comments: &[String]) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail, here and below.
        for line in comments.iter().flat_map(|comment| comment.lines()) {
            let _ = writeln!(text, "# {line}");
        }
        let Chassis { mass_kg, inertia_kg_m2, centre_m, height_m } = *wheeled.chassis();
        let _ = writeln!(text, "[body.wheeled]\nmass_kg = {mass_kg:?}\ninertia_kg_m2 = {inertia_kg_m2:?}");
        let _ = writeln!(text, "centre_m = {centre_m:?}\nheight_m = {height_m:?}");
        if let Some(outline) = wheeled.outline() {
            let _ = writeln!(text, "outline_m = {:?}", outline.corners_m());
        }
        let tyres = || wheeled.wheels().iter().filter_map(|wheel| wheel.tyre);
        // A file needs one, also where nothing but casters carries the body.
        let usual = tyres().next().unwrap_or(Tyre::TYPICAL);
        let _ = writeln!(text, "\n[body.wheeled.tyre]\n{}", tyre_fields(&usual).join("\n"));
        for wheel in wheeled.wheels() {
            let _ = writeln!(text, "\n[[body.wheeled.wheel]]");
            if let Some(channel) = wheel.shaft.and_then(|shaft| channels.get(shaft)) {
                let _ = writeln!(text, "channel = \"{channel}\"");
            }
            let _ = writeln!(text, "place_m = {:?}\nradius_m = {:?}", wheel.place_m, wheel.radius_m);
            for (flag, holds) in
                [("inverted", wheel.inverted), ("steered", wheel.steered), ("caster", wheel.tyre.is_none())]
            {
                if holds {
                    let _ = writeln!(text, "{flag} = true");
                }
            }
            if let Some(own) = wheel.tyre.filter(|tyre| *tyre != usual) {
                let _ = writeln!(text, "tyre = {{ {} }}", tyre_fields(&own).join(", "));
            }
        }
        if let (Some(axle), Some(channel)) = (wheeled.axle(), wheeled.axle().and_then(|axle| channels.get(axle.shaft)))
        {
            let Axle { rad_per_unit, straight, fixed_x_m, trail_m, .. } = axle;
            let unit = if channel.kind == ChannelKind::Actuator { "m" } else { "rad" };
            let _ = writeln!(text, "\n[body.wheeled.steering]\nchannel = \"{channel}\"");
            let _ = writeln!(text, "rad_per_{unit} = {rad_per_unit:?}\nstraight = {straight:?}");
            let _ = writeln!(text, "fixed_x_m = {fixed_x_m:?}\ntrail_m = {trail_m:?}");
        }
        text
    }
}

/// A tyre's fields with their values, as in a table.
fn tyre_fields(tyre: &Tyre) -> [String; 5] {
    let [long, lat] = tyre.compliance_per_n;
    let law = match tyre.law {
        SlipLaw::Brush => "brush",
        SlipLaw::Linear => "linear",
    };
    [
        format!("compliance_long_per_n = {long:?}"),
        format!("compliance_lat_per_n = {lat:?}"),
        format!("friction = {:?}", tyre.friction),
        format!("relaxation_m = {:?}", tyre.relaxation_m),
        format!("law = \"{law}\""),
    ]
}

/// A file of a world alone.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldFile {
    world: WorldTable,
}

/// Reads a file with a `[world]` and nothing else.
pub(crate) fn read_world(source: &Source) -> Result<World, BoardError> {
    source.parse::<WorldFile>()?.world.check(source)
}

/// `[world]`: what is around the robot.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorldTable {
    start: Option<Start>,
    #[serde(default)]
    on_stand: bool,
    #[serde(default, rename = "wall")]
    walls: Vec<Wall>,
    #[serde(default, rename = "post")]
    posts: Vec<Post>,
    #[serde(default, rename = "person")]
    people: Vec<Walker>,
    #[serde(default, rename = "surface")]
    surfaces: Vec<Floor>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Start {
    #[serde(deserialize_with = "finite")]
    x_m: f64,
    #[serde(deserialize_with = "finite")]
    y_m: f64,
    #[serde(default, deserialize_with = "finite")]
    yaw_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wall {
    points_m: Vec<Point>,
    #[serde(default)]
    closed: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Post {
    centre_m: Point,
    radius_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Walker {
    radius_m: f64,
    /// Time, s, and place, m.
    path: Vec<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Floor {
    points_m: Vec<Point>,
    friction: Option<f64>,
    #[serde(default)]
    slope: [f64; 2],
}

impl WorldTable {
    pub(super) fn check(&self, source: &Source) -> Result<World, BoardError> {
        let mut scene = Scene::default();
        let at = |array: &str, index: usize, added: Result<(), SceneError>| {
            added.map_err(|why| source.rule(format!("world.{array}[{index}]"), why))
        };
        for (index, wall) in self.walls.iter().enumerate() {
            at("wall", index, scene.add_walls(&wall.points_m, wall.closed))?;
        }
        for (index, post) in self.posts.iter().enumerate() {
            at("post", index, scene.add_post(post.centre_m, post.radius_m))?;
        }
        for (index, Walker { radius_m, path }) in self.people.iter().enumerate() {
            let path = path.iter().map(|[at_s, x_m, y_m]| (*at_s, [*x_m, *y_m])).collect();
            at("person", index, scene.add_person(Person { radius_m: *radius_m, path }))?;
        }
        for (index, floor) in self.surfaces.iter().enumerate() {
            let surface = Surface { corners_m: floor.points_m.clone(), friction: floor.friction, slope: floor.slope };
            at("surface", index, scene.add_surface(surface))?;
        }
        let start = self.start.map_or(Pose::default(), |Start { x_m, y_m, yaw_rad }| Pose { x_m, y_m, yaw_rad });
        Ok(World { start, on_stand: self.on_stand, scene })
    }
}

/// Where a sensor sits on the body.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MountTable {
    place_m: Point,
    #[serde(default, deserialize_with = "finite")]
    yaw_rad: f64,
}

impl From<MountTable> for Mount {
    fn from(MountTable { place_m, yaw_rad }: MountTable) -> Self {
        Self { place_m, yaw_rad }
    }
}
