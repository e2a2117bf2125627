//! Tables `[body]` and `[world]`: the body that couples a robot's shafts, and the world it moves in. Only for
//! simulation.

mod berry_picker;
mod cable_loop;
mod deformable;
mod flow;
mod suction_pad;
mod two_fingers;

use std::fmt::Write;

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::BoardConfig,
};
use r4_world::{
    Ankle, AnyBody, Axle, BalanceTail, Body as _, BoxSpec, Cable, Chassis, ChassisError, Lift, Link, Outline, Person,
    Point, Pose, Scene, SceneError, SlipLaw, Surface, TailError, Tyre, Wearer, Wheel, Wheeled,
};
use serde::Deserialize;

use super::{
    Mount, Robot, SimulatedBody, World,
    field::{self, FieldTable},
    read::Reader,
    simulation::{may_slide, may_turn, others_that_turn},
};
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, optional_channel, optional_finite, positive},
    source::Source,
};

/// Table `[body]`: one kind of body.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Body {
    /// Chassis on wheels, with an outline.
    Wheeled(Box<WheeledTable>),
    /// Robot on wheels in a shell that narrows.
    Deformable(Box<deformable::DeformableTable>),
    /// Person with a tail of two links.
    BalanceTail(Box<TailTable>),
    /// Two fingers with an object between them.
    TwoFingers(Box<two_fingers::GripTable>),
    /// Gripper with a loop that closes round a vial.
    CableLoop(Box<cable_loop::CableLoopTable>),
    /// Pneumatic gripper before a bush.
    BerryPicker(Box<berry_picker::PickerTable>),
    /// Strip with suction cups and inflatable membranes.
    SuctionPad(Box<suction_pad::SuctionTable>),
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
    /// Channel that drives the wheel; left out for one that rolls freely.
    #[serde(default, deserialize_with = "optional_channel")]
    channel: Option<ChannelId>,
    place_m: Point,
    #[serde(deserialize_with = "positive")]
    radius_m: f64,
    #[serde(default)]
    inverted: bool,
    #[serde(default)]
    steered: bool,
    /// True for a caster or ball: it carries weight, and gives way in every direction.
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
    /// Checks the table and returns the body at the origin, with the channels whose shafts it couples.
    pub(super) fn check(&self, reader: &Reader<'_>, config: &BoardConfig) -> Result<SimulatedBody, BoardError> {
        let shafts = Shafts { reader, config, channels: Vec::new() };
        match self {
            Self::Wheeled(table) => table.check(shafts),
            Self::Deformable(table) => table.check(shafts),
            Self::BalanceTail(table) => table.check(shafts),
            Self::TwoFingers(table) => table.check(shafts),
            Self::CableLoop(table) => table.check(shafts),
            Self::BerryPicker(table) => table.check(shafts),
            Self::SuctionPad(table) => table.check(shafts),
        }
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
        // `turning` takes a channel only once, so that a shared motor leaves the list shorter.
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

impl WheeledTable {
    fn check(&self, mut shafts: Shafts<'_>) -> Result<SimulatedBody, BoardError> {
        let mut wheeled = self.chassis(&mut shafts, "body.wheeled")?;
        if let Some(outline_m) = &self.outline_m {
            let outline = Outline::new(outline_m.clone());
            let source = shafts.reader.source;
            wheeled = wheeled.with_outline(outline.map_err(|why| source.rule("body.wheeled.outline_m", why))?);
        }
        Ok(SimulatedBody { kind: AnyBody::Wheeled(Box::new(wheeled)), channels: shafts.channels })
    }

    /// Makes wheels and what they carry, without an outline; `table` is where they are described.
    fn chassis(&self, shafts: &mut Shafts<'_>, table: &str) -> Result<Wheeled, BoardError> {
        let reader = shafts.reader;
        let mut wheels = Vec::new();
        for (index, wheel) in self.wheel.iter().enumerate() {
            let path = format!("{table}.wheel[{index}]");
            if wheel.caster && (wheel.channel.is_some() || wheel.steered || wheel.tyre.is_some()) {
                return Err(reader.rule(path, "a caster has no channel, no tyre and is not steered"));
            }
            // A wheel without a channel rolls freely.
            let driven = wheel.channel.map(|id| shafts.turning(id, format!("{path}.channel")));
            wheels.push(Wheel {
                place_m: wheel.place_m,
                radius_m: wheel.radius_m,
                shaft: driven.transpose()?,
                inverted: wheel.inverted,
                steered: wheel.steered,
                tyre: (!wheel.caster).then(|| wheel.tyre.unwrap_or(self.tyre).into()),
            });
        }
        let steering = format!("{table}.steering");
        let axle = self.steering.as_ref().map(|axle| shafts.axle(axle, &steering)).transpose()?;
        let chassis = Chassis {
            mass_kg: self.mass_kg,
            inertia_kg_m2: self.inertia_kg_m2,
            centre_m: self.centre_m,
            height_m: self.height_m,
        };
        Wheeled::new(chassis, wheels, axle, shafts.channels.len()).map_err(|why| {
            let path = match why {
                ChassisError::Wheel { wheel } | ChassisError::Tyre { wheel, .. } => format!("{table}.wheel[{wheel}]"),
                ChassisError::Axle => steering,
                _ => table.into(),
            };
            reader.source.rule(path, why)
        })
    }
}

/// Channels whose shafts a body couples, each once.
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

    /// Takes a relay as a shaft, which is at 1 while its contact is closed.
    fn relay(&mut self, id: ChannelId, path: String) -> Result<usize, BoardError> {
        let known: Vec<_> = self.config.relays.iter().map(|relay| relay.id).collect();
        self.reader.one_of("relay", id, known.iter(), path)?;
        Ok(self.number(id))
    }

    fn may_turn(&self) -> Vec<ChannelId> {
        may_turn(&self.config.motors).into_iter().chain(others_that_turn(self.config)).collect()
    }

    fn axle(&mut self, steering: &SteeringTable, path: &str) -> Result<Axle, BoardError> {
        let motors = &self.config.motors;
        // The steering channel may slide (an actuator) or turn (a motor).
        let (known, rad_per_unit) = match (steering.rad_per_m, steering.rad_per_rad) {
            (Some(rad_per_m), None) => (may_slide(motors), rad_per_m),
            (None, Some(rad_per_rad)) => (self.may_turn(), rad_per_rad),
            // The unit of the factor says whether the steering channel slides or turns, so exactly one is needed.
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
        // Wheels of one motor share a shaft.
        self.channels.iter().position(|known| *known == id).unwrap_or_else(|| {
            self.channels.push(id);
            self.channels.len() - 1
        })
    }
}

/// File of a body alone.
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

/// Tables of a file that describe a robot's body and world; other tables are ignored.
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
        // A world is entered by a body: without one its walls would act on nothing.
        if robot.simulation.body.is_none() {
            let rule = "needs a [body] that stands in it, in this file or in the robot's";
            return Err(BoardError::Rule { at: source.at("world"), channel: None, rule });
        }
        robot.simulation.enter(world);
        robot.simulation.check_fields().map_err(|why| source.rule("world.field", why))?;
    }
    Ok(())
}

impl SimulatedBody {
    /// Returns the body if it is a chassis on wheels.
    #[must_use]
    pub fn wheeled(&self) -> Option<&Wheeled> {
        if let AnyBody::Wheeled(body) = &self.kind { Some(body) } else { None }
    }

    /// Writes a body on wheels as the text of a file, which [`load_body`](crate::load_body) reads back to the bit.
    /// `channels` are those of its shafts; each of `comments`, on the origin of the numbers, becomes a line at its top.
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
        // A file needs one tyre, even if only casters carry the body.
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

/// Returns a tyre's fields with their values, as in a table.
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

/// File of a world alone.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldFile {
    world: WorldTable,
}

/// Reads a file with a `[world]` and nothing else.
pub(crate) fn read_world(source: &Source) -> Result<World, BoardError> {
    source.parse::<WorldFile>()?.world.check(source)
}

/// Table `[world]`: the environment of the robot.
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
    #[serde(default, rename = "box")]
    boxes: Vec<Carton>,
    #[serde(default, rename = "person")]
    people: Vec<Walker>,
    #[serde(default, rename = "surface")]
    surfaces: Vec<Floor>,
    #[serde(default, rename = "field")]
    fields: Vec<FieldTable>,
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
struct Carton {
    size_m: [f64; 2],
    mass_kg: f64,
    /// Coefficient of static friction on the floor, dimensionless.
    friction: f64,
    #[serde(default = "alike")]
    kinetic_share: f64,
    /// Place of the centre in the world, m.
    place_m: Point,
    #[serde(default, deserialize_with = "finite")]
    yaw_rad: f64,
}

/// Default of kinetic friction: as the static friction.
const fn alike() -> f64 {
    1.0
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Walker {
    radius_m: f64,
    /// Time, s, and place, m, of each point.
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
        for (index, carton) in self.boxes.iter().enumerate() {
            let Carton { size_m, mass_kg, friction, kinetic_share, place_m: [x_m, y_m], yaw_rad } = *carton;
            let spec = BoxSpec { size_m, mass_kg, friction, kinetic_share };
            at("box", index, scene.add_box(spec, Pose { x_m, y_m, yaw_rad }))?;
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
        // After the scene, because a gas spreads around its walls.
        let fields = field::check(&self.fields, &scene, source)?;
        Ok(World { start, on_stand: self.on_stand, scene, fields })
    }
}

/// Table of the place and direction of a sensor on the body.
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
