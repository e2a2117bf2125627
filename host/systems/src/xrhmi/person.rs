//! Synthetic participant before a virtual board: perceives lamps, tones and buzzes at the pins, and moves a hand between the
//! zones, whose range sensors see it.
//!
//! All its numbers are synthetic: it exercises cues, zones and the logger, and says nothing about people.

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    convert::Infallible,
};

use r4_rig::{Error, Session};

use super::{
    cue::{Modality, Outputs, ZONES, Zone},
    desk::seen,
    sus::Answers,
};
use crate::sampler::Sampler;

/// Purpose of the random numbers.
const OF_PERSON: u64 = 1_720;
/// Period of the participant, s: also the resolution of its entry times.
const STEP_S: f64 = 0.01;
/// Distance from a zone's centre within which its sensor sees the hand, m: a cone of 15° from 0.4 m.
const RADIUS_M: f64 = 0.11;
/// Range of the desk without a hand, m.
const DESK_M: f64 = 0.6;
/// Places of the zones and of the resting hand, m.
const PLACES_M: [[f64; 2]; ZONES] = [[-0.35, 0.0], [0.0, 0.0], [0.35, 0.0], [0.0, 0.35]];
const HOME_M: [f64; 2] = [0.0, -0.35];
/// Time from the first buzz after which no other is expected, s.
const BUZZES_S: f64 = 0.85;
/// Time in a zone after which a person looks again whether its lamp is lit, s.
const LOOKS_AGAIN_S: f64 = 1.4;
/// Rms noise of the range sensors, mm.
const NOISE_MM: f64 = 3.0;

/// State that the participant shares with the protocol.
#[derive(Default)]
pub struct Shared {
    /// True while the experimenter asks for a hand over the centre zone.
    pub asks_ready: Cell<bool>,
    /// Time at which the hand entered the zone over which it is, ns; 0 before.
    pub entered_ns: Cell<u64>,
    /// Number of stays in zones that the last cue did not mean.
    pub wrong_stays: Cell<usize>,
    /// Trace every 10 ms: time, s, range of each zone, m, and duty of each band.
    pub trace: RefCell<Vec<Moment>>,
}

/// Moment of a trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time of the simulation, s.
    pub time_s: f64,
    /// Distance from each zone's sensor to what is under it, m.
    pub ranges_m: [f64; ZONES],
    /// Outputs at the pins.
    pub outputs: Outputs,
}

/// A participant's habits. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Debug)]
pub struct Person {
    sampler: Sampler,
    pace: f64,
    reach_m: f64,
}

/// Movement of the hand.
#[derive(Clone, Copy, Debug)]
struct Move {
    /// Target of the hand, m.
    to_m: [f64; 2],
    /// Start of the movement after the previous one, s.
    after_s: f64,
    /// True for a movement to a zone that the cue did not mean.
    is_wrong: bool,
}

/// Hand and attention at one time.
struct Hand {
    from_m: [f64; 2],
    now_m: [f64; 2],
    /// Present movement with its start and end, s.
    moving: Option<(Move, f64, f64)>,
    plan: VecDeque<Move>,
    zone: Option<Zone>,
    entered_s: f64,
    /// Buzzes since the first: its time, s, sides and count.
    buzzes: Option<(f64, [bool; 2], usize)>,
    /// Zone that the last cue meant, and the modality by which it came.
    meant: Option<Zone>,
}

impl Person {
    /// Samples the habits of a participant.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_PERSON);
        let (pace, reach_m) = (sampler.normal(0.15).exp(), sampler.uniform(0.35, 0.48));
        Self { sampler, pace, reach_m }
    }

    /// Answers to the usability scale, around the mean score that the paper prints for the modality.
    pub fn answers(&mut self, modality: Modality) -> Answers {
        let score = [78.25, 76.5, 54.25][modality as usize];
        std::array::from_fn(|place| {
            let agrees = (1.0 + score / 25.0 + self.sampler.normal(0.8)).round().clamp(1.0, 5.0) as u8;
            if place % 2 == 0 { agrees } else { 6 - agrees }
        })
    }

    /// Acts until dropped.
    ///
    /// # Errors
    /// The board is not virtual.
    pub async fn act(&mut self, session: &Session<'_>, shared: &Shared) -> Result<Infallible, Error> {
        let mut hand = Hand {
            from_m: HOME_M,
            now_m: HOME_M,
            moving: None,
            plan: VecDeque::new(),
            zone: None,
            entered_s: 0.0,
            buzzes: None,
            meant: None,
        };
        let mut before = Outputs::default();
        let mut was_asked = false;
        for zone in 0..ZONES {
            if let Some(sensor) = session.virtual_board()?.world().range_sensor(zone as u8) {
                sensor.set_noise_rms_mm(NOISE_MM);
            }
        }
        loop {
            let (outputs, now_ns) = seen(session)?;
            let now_s = now_ns as f64 * 1e-9;
            if shared.asks_ready.get() && !was_asked {
                // Off the desk first, so that a new dwell begins.
                hand.meant = None;
                hand.plan = VecDeque::from([
                    Move { to_m: HOME_M, after_s: 0.5, is_wrong: false },
                    Move { to_m: PLACES_M[Zone::Centre as usize], after_s: 1.0, is_wrong: false },
                ]);
            }
            was_asked = shared.asks_ready.get();
            if let Some((modality, meant)) = perceive(&mut hand, now_s, &before, &outputs) {
                self.decide(&mut hand, modality, meant);
            }
            // A lit lamp elsewhere is noticed after a while; tones and buzzes are only heard or felt again.
            let lit = outputs.lamps.iter().position(|on| *on).map(|lamp| Zone::ALL[lamp % ZONES]);
            if let (Some(lit), Some(zone), None, true) = (lit, hand.zone, hand.moving, hand.plan.is_empty())
                && lit != zone
                && now_s - hand.entered_s > LOOKS_AGAIN_S
            {
                let to_m = PLACES_M[lit as usize];
                hand.plan.push_back(Move { to_m, after_s: 0.0, is_wrong: false });
            }
            self.reach(&mut hand, now_s, shared);
            let ranges_m = PLACES_M.map(|place_m| if is_near(place_m, hand.now_m) { self.reach_m } else { DESK_M });
            put_under(session, &ranges_m)?;
            let over = Zone::ALL.into_iter().find(|zone| is_near(PLACES_M[*zone as usize], hand.now_m));
            if over != hand.zone {
                hand.zone = over;
                hand.entered_s = now_s;
                shared.entered_ns.set(now_ns);
            }
            shared.trace.borrow_mut().push(Moment { time_s: now_s, ranges_m, outputs });
            before = outputs;
            session.board.sleep_s(STEP_S).await;
        }
    }

    /// Plans the movement that follows a cue: to the zone meant, or to another by mistake.
    fn decide(&mut self, hand: &mut Hand, modality: Modality, meant: Zone) {
        let is_new = hand.meant.replace(meant) != Some(meant);
        // A cue that is presented again is understood: no mistake lasts indefinitely.
        let mistaken = if is_new { [0.01, 0.02, 0.06][modality as usize] } else { 0.0 };
        let mut zone = meant;
        if self.sampler.uniform(0.0, 1.0) < mistaken {
            zone = Zone::ALL[(meant as usize + 1 + self.sampler.uniform(0.0, 3.0) as usize) % ZONES];
        } else if is_new && modality == Modality::Haptic && self.sampler.uniform(0.0, 1.0) < 0.15 {
            // Both bands buzz for centre and discard; only the count differs.
            zone = match meant {
                Zone::Centre => Zone::Discard,
                Zone::Discard => Zone::Centre,
                other => other,
            };
        }
        let reacts_s = [0.45, 0.40, 0.30][modality as usize] * self.pace * self.sampler.normal(0.2).exp();
        let to_m = PLACES_M[zone as usize];
        if hand.zone == Some(zone) && hand.moving.is_none() {
            // Already there, such as by a mistake that names the zone of the last command: not a movement, but a stay that was reported.
            return;
        }
        hand.plan = VecDeque::from([Move { to_m, after_s: reacts_s, is_wrong: zone != meant }]);
    }

    /// Moves the hand along its plan: with the least jerk, faster over short ways.
    fn reach(&mut self, hand: &mut Hand, now_s: f64, shared: &Shared) {
        if hand.moving.is_none()
            && let Some(next) = hand.plan.pop_front()
        {
            let begin_s = now_s + next.after_s;
            let way_m = (next.to_m[0] - hand.now_m[0]).hypot(next.to_m[1] - hand.now_m[1]);
            let takes_s = (0.25 + 0.6 * way_m) * self.pace * self.sampler.normal(0.1).exp();
            hand.from_m = hand.now_m;
            hand.moving = Some((next, begin_s, begin_s + takes_s));
        }
        let Some((target, begin_s, end_s)) = hand.moving else { return };
        let share = ((now_s - begin_s) / (end_s - begin_s)).clamp(0.0, 1.0);
        // Flash, Hogan, Journal of Neuroscience 5, 1985: the path of least jerk.
        let along = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        hand.now_m = std::array::from_fn(|axis| hand.from_m[axis] + along * (target.to_m[axis] - hand.from_m[axis]));
        if share >= 1.0 {
            hand.moving = None;
            shared.wrong_stays.set(shared.wrong_stays.get() + usize::from(target.is_wrong));
        }
    }
}

/// Puts hand or desk under the zones' sensors, m from them.
fn put_under(session: &Session<'_>, ranges_m: &[f64; ZONES]) -> Result<(), Error> {
    let mut world = session.virtual_board()?.world();
    for (zone, range_m) in ranges_m.iter().enumerate() {
        if let Some(sensor) = world.range_sensor(zone as u8) {
            sensor.set_distance_m(Some(*range_m));
        }
    }
    Ok(())
}

fn is_near(place_m: [f64; 2], hand_m: [f64; 2]) -> bool {
    (place_m[0] - hand_m[0]).hypot(place_m[1] - hand_m[1]) < RADIUS_M
}

/// Returns a cue when it has been perceived completely.
fn perceive(hand: &mut Hand, now_s: f64, before: &Outputs, outputs: &Outputs) -> Option<(Modality, Zone)> {
    let zone_of = |sides: [bool; 2], is_second: bool| match (sides, is_second) {
        ([true, true], false) => Zone::Centre,
        ([true, true], true) => Zone::Discard,
        ([true, false], _) => Zone::Left,
        _ => Zone::Right,
    };
    if outputs.lamps != before.lamps
        && let Some(lamp) = outputs.lamps.iter().position(|on| *on)
    {
        return Some((Modality::Visual, Zone::ALL[lamp % ZONES]));
    }
    // The two outputs change within some milliseconds: a tone is taken from its second period on.
    if outputs.pitch_v != [0.0; 2] && outputs.pitch_v == before.pitch_v && hand.buzzes.is_none() {
        hand.buzzes = Some((now_s, [false; 2], 0));
        let sides = outputs.pitch_v.map(|volts| volts > 0.0);
        return Some((Modality::Auditory, zone_of(sides, outputs.pitch_v.contains(&2.0))));
    }
    let rises = outputs.bands != [false; 2] && before.bands == [false; 2];
    match &mut hand.buzzes {
        None if rises => hand.buzzes = Some((now_s, outputs.bands, 1)),
        Some((_, sides, count)) if *count > 0 => {
            *count += usize::from(rises);
            *sides = [sides[0] | outputs.bands[0], sides[1] | outputs.bands[1]];
        }
        _ => {}
    }
    match hand.buzzes {
        Some((since_s, sides, count)) if now_s - since_s > BUZZES_S => {
            hand.buzzes = None;
            (count > 0).then(|| (Modality::Haptic, zone_of(sides, count > 1)))
        }
        _ => None,
    }
}
