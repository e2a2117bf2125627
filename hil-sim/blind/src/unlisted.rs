//! Unlisted effects: those in no catalogue.

use std::fmt::Debug;

use r4_plants::{
    Dependence, Unlisted,
    effect::unlisted::{Doing, Moment},
};

use crate::{dice::Dice, scale::Scale};

/// Description of an unlisted effect: name, dependences, and name, value and unit of each parameter.
#[derive(Clone, Debug)]
pub(crate) struct Page {
    pub(crate) name: &'static str,
    pub(crate) depends_on: &'static [Dependence],
    pub(crate) parameters: Vec<(&'static str, f64, &'static str)>,
}

/// Unlisted effect with its description.
pub(crate) type Drawn = (Box<dyn Unlisted>, Page);

/// Function that samples an unlisted effect for a plant of a given scale.
pub(crate) type Draw = fn(&mut Dice, &Scale) -> Drawn;

/// Names of the unlisted effects, with their sampling functions.
pub(crate) const KINDS: &[(&str, Draw)] = &[
    ("presliding-hysteresis", presliding),
    ("torque-ripple-by-drive", ripple),
    ("worn-track", worn_track),
    ("fading-drive", fading),
    ("drag-at-one-speed", speed_bump),
    ("friction-after-reversal", after_reversal),
    ("weak-band-of-the-drive", weak_band),
    ("push-by-time", push_by_time),
];

/// Effect defined by a function `act` of its parameters or state `p` and the moment.
#[derive(Clone, Debug)]
struct Formula<P: Debug + Clone> {
    p: P,
    act: fn(&mut P, &Moment) -> Doing,
}

impl<P: Debug + Clone + Send + Sync + 'static> Unlisted for Formula<P> {
    fn act(&mut self, moment: &Moment) -> Doing {
        (self.act)(&mut self.p, moment)
    }

    fn copied(&self) -> Box<dyn Unlisted> {
        Box::new(self.clone())
    }
}

fn nothing(moment: &Moment) -> Doing {
    Doing { duty: moment.duty, friction: 0.0, force: 0.0 }
}

/// Gaussian bell curve `exp(-x²)`.
fn bell(x: f64) -> f64 {
    libm::exp(-x * x)
}

/// Friction that acts as a spring for small displacements and as a constant force for long ones: `dF/dx = s (1 -
/// sign(v) F / Fc)`.
///
/// # Source
/// Dahl, *A solid friction model*, The Aerospace Corporation TOR-0158(3107-18)-1, 1968.
#[derive(Clone, Debug)]
struct Presliding {
    level: f64,
    way: f64,
    force: f64,
    before: Option<f64>,
}

fn presliding(dice: &mut Dice, scale: &Scale) -> Drawn {
    let level = scale.force * dice.between(0.12, 0.3);
    let way = scale.way * dice.ratio_between(0.02, 0.1);
    let act = |p: &mut Presliding, moment: &Moment| {
        let way = moment.position - p.before.unwrap_or(moment.position);
        p.before = Some(moment.position);
        let slid = p.level.copysign(way);
        // Exact for a displacement in one direction.
        p.force = slid + (p.force - slid) * libm::exp(-way.abs() / p.way);
        Doing { force: -p.force, ..nothing(moment) }
    };
    let page = Page {
        name: "presliding-hysteresis",
        depends_on: &[Dependence::History, Dependence::Direction, Dependence::Position],
        parameters: vec![("level", level, "N m or N"), ("way", way, "rad or m")],
    };
    (Box::new(Formula { p: Presliding { level, way, force: 0.0, before: None }, act }), page)
}

fn ripple(dice: &mut Dice, scale: &Scale) -> Drawn {
    let (share, periods, phase) = (
        dice.between(0.35, 0.8),
        libm::round(dice.between(1.0, 4.0)) * std::f64::consts::TAU / scale.way,
        dice.angle(),
    );
    let act = |p: &mut [f64; 3], moment: &Moment| {
        let [share, per_position, phase] = *p;
        Doing {
            duty: moment.duty * (1.0 + share * libm::sin(per_position * moment.position + phase)),
            ..nothing(moment)
        }
    };
    let page = Page {
        name: "torque-ripple-by-drive",
        depends_on: &[Dependence::Position, Dependence::Input],
        parameters: vec![("share", share, "1"), ("per_position", periods, "rad per unit"), ("phase", phase, "rad")],
    };
    (Box::new(Formula { p: [share, periods, phase], act }), page)
}

fn worn_track(dice: &mut Dice, scale: &Scale) -> Drawn {
    let (depth, at, width) =
        (dice.between(0.4, 0.8), scale.way * dice.between(-0.5, 0.5), scale.way * dice.between(0.1, 0.25));
    let act = |p: &mut [f64; 4], moment: &Moment| {
        let [depth, at, width, way] = *p;
        // Offset from the nearest of the places, one in each `way`.
        let off = moment.position - at;
        let off = off - way * libm::round(off / way);
        Doing { duty: moment.duty * (1.0 - depth * bell(off / width)), ..nothing(moment) }
    };
    let page = Page {
        name: "worn-track",
        depends_on: &[Dependence::Position, Dependence::Input],
        parameters: vec![
            ("depth", depth, "1"),
            ("at", at, "rad or m"),
            ("width", width, "rad or m"),
            ("again_after", scale.way, "rad or m"),
        ],
    };
    (Box::new(Formula { p: [depth, at, width, scale.way], act }), page)
}

fn fading(dice: &mut Dice, _: &Scale) -> Drawn {
    let (lost, after, power) = (dice.between(0.25, 0.6), dice.between(2.0, 8.0), dice.between(1.5, 4.0));
    let act = |p: &mut [f64; 3], moment: &Moment| {
        let [lost, after_s, power] = *p;
        let gone = -libm::expm1(-libm::pow(moment.time_s / after_s, power));
        Doing { duty: moment.duty * (1.0 - lost * gone), ..nothing(moment) }
    };
    let page = Page {
        name: "fading-drive",
        depends_on: &[Dependence::Time, Dependence::Input],
        parameters: vec![("lost", lost, "1"), ("after", after, "s"), ("power", power, "1")],
    };
    (Box::new(Formula { p: [lost, after, power], act }), page)
}

fn speed_bump(dice: &mut Dice, scale: &Scale) -> Drawn {
    let (height, at) = (scale.force * dice.between(0.2, 0.5), scale.speed * dice.between(0.2, 0.55));
    let width = at * dice.between(0.15, 0.4);
    let act = |p: &mut [f64; 3], moment: &Moment| {
        let [height, at, width] = *p;
        Doing { friction: height * bell((moment.speed.abs() - at) / width), ..nothing(moment) }
    };
    let page = Page {
        name: "drag-at-one-speed",
        depends_on: &[Dependence::Speed],
        parameters: vec![("height", height, "N m or N"), ("at", at, "rad/s or m/s"), ("width", width, "rad/s or m/s")],
    };
    (Box::new(Formula { p: [height, at, width], act }), page)
}

/// Friction that is increased for a while after a reversal.
#[derive(Clone, Debug)]
struct AfterReversal {
    level: f64,
    for_s: f64,
    moved: f64,
    turned_s: f64,
}

fn after_reversal(dice: &mut Dice, scale: &Scale) -> Drawn {
    let (level, for_s) = (scale.force * dice.between(0.25, 0.6), dice.ratio_between(0.1, 0.5));
    let act = |p: &mut AfterReversal, moment: &Moment| {
        if moment.speed * p.moved < 0.0 {
            p.turned_s = moment.time_s;
        }
        if moment.speed != 0.0 {
            p.moved = moment.speed;
        }
        Doing { friction: p.level * libm::exp(-(moment.time_s - p.turned_s) / p.for_s), ..nothing(moment) }
    };
    let page = Page {
        name: "friction-after-reversal",
        depends_on: &[Dependence::History, Dependence::Direction],
        parameters: vec![("level", level, "N m or N"), ("for", for_s, "s")],
    };
    // No reversal yet: its time is infinitely long ago, so there is no friction.
    let start = AfterReversal { level, for_s, moved: 0.0, turned_s: f64::NEG_INFINITY };
    (Box::new(Formula { p: start, act }), page)
}

fn weak_band(dice: &mut Dice, scale: &Scale) -> Drawn {
    let headroom = 0.95 - scale.threshold;
    let (depth, at, width) = (
        headroom * dice.between(0.2, 0.4),
        scale.threshold + headroom * dice.between(0.3, 0.6),
        headroom * dice.between(0.1, 0.25),
    );
    let act = |p: &mut [f64; 3], moment: &Moment| {
        let [depth, at, width] = *p;
        let taken = depth * bell((moment.duty.abs() - at) / width);
        Doing { duty: (moment.duty.abs() - taken).max(0.0).copysign(moment.duty), ..nothing(moment) }
    };
    let page = Page {
        name: "weak-band-of-the-drive",
        depends_on: &[Dependence::Input],
        parameters: vec![("depth", depth, "1"), ("at", at, "1"), ("width", width, "1")],
    };
    (Box::new(Formula { p: [depth, at, width], act }), page)
}

fn push_by_time(dice: &mut Dice, scale: &Scale) -> Drawn {
    let (force, at, width) =
        (dice.sign() * scale.force * dice.between(0.12, 0.35), dice.between(3.0, 9.0), dice.between(0.8, 2.5));
    let act = |p: &mut [f64; 3], moment: &Moment| {
        let [force, at_s, width_s] = *p;
        Doing { force: force * bell((moment.time_s - at_s) / width_s), ..nothing(moment) }
    };
    let page = Page {
        name: "push-by-time",
        depends_on: &[Dependence::Time],
        parameters: vec![("force", force, "N m or N"), ("at", at, "s"), ("width", width, "s")],
    };
    (Box::new(Formula { p: [force, at, width], act }), page)
}
