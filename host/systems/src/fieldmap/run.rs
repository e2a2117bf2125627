//! Trials: calibration, surveys, swarms and searches, and their metrics.

use r4_maps::{
    grid::Grid,
    pose::{Point, distance_m},
    process::{Process, ProcessError, Sample},
};
use r4_rig::{Fleet, Place, Rig, Session};
use r4_world::{ElectricSpec, Person};

use super::{
    PRINTED, ROWS, SITES, is_kinematic, kinematic, map,
    mill::{self, Calibration, NO_FIELD, REFERENCES_V_PER_M, Reads, Turns},
    missing::{self, Change, Crossings},
    scene::{Mill, OPEN, PLOT, Scene},
    survey::{self, Strategy, Survey, Taken, limits},
    swarm::{self, Base, Member},
    unsuitable,
};
use crate::{
    Error, Trial, Values,
    rover::{self, Driven, Program, Setup},
};

/// Side of the squares of the per-cell means, m: the distance of the lawn-mower's rows. Our choice; other values were not compared.
pub(super) const SQUARE_M: f64 = 5.0;
/// Half-width of a 95 % interval, in standard deviations.
const WIDTH: f64 = 1.96;

/// Result of a completed survey.
#[derive(Debug)]
pub(super) struct Surveyed {
    pub(super) taken: Vec<Taken>,
    /// True path of the robot: time, s, and position, m.
    pub(super) path: Vec<(f64, Point)>,
    /// Record of the drive; `None` without a board.
    pub(super) driven: Option<Driven>,
}

fn put(values: &mut Values, name: &str, value: f64) {
    values.insert(name.to_owned(), value);
}

fn failed(trial: &Trial) -> impl Fn(String) -> Error {
    let board = trial.board.to_string();
    move |why| unsuitable(&board, why)
}

fn of_process(trial: &Trial) -> impl Fn(ProcessError) -> Error {
    let failed = failed(trial);
    move |error| failed(error.to_string())
}

/// Runs a program on a board and returns the record of the drive.
pub(super) fn on_board(trial: &Trial, rig: &Rig, program: &mut impl Program) -> Result<Driven, Error> {
    let setup = Setup::of(rig, limits().stop_m).map_err(failed(trial))?.in_volts();
    let mut receiver = super::gnss::Receiver::of(&rig.robot()?).map_err(failed(trial))?;
    let work = async |session: &Session<'_>| rover::run(session, &setup, &mut receiver, program).await;
    Ok(rig.run(None, work)?.0)
}

/// Calibrates a mill between plates, on the trial's board or on perfect actuators.
pub(super) fn calibrated(trial: &Trial, mill: Mill) -> Result<Calibration, Error> {
    let between = |reference: usize| {
        // The program assumes the nominal references; the plates' gap and voltages are off.
        let actual = REFERENCES_V_PER_M[reference] * (1.0 + mill.voltage_errors[reference]) / (1.0 + mill.gap_error);
        Scene::with(ElectricSpec { uniform_v_per_m: actual, ..ElectricSpec::default() }, mill)
    };
    let run = |scene: &Scene, program: &mut dyn Program| {
        let start = Place::default();
        if is_kinematic(trial.arm) {
            kinematic::run(scene, &[start], &mut [program]);
            return Ok(());
        }
        let rig = scene.rig(&trial.board, trial.seed, start, Vec::new());
        on_board(trial, &rig, &mut { program }).map(|_| ())
    };
    let mut means_v = Vec::new();
    for reference in 0..REFERENCES_V_PER_M.len() {
        let mut reads = Reads::default();
        run(&between(reference)?, &mut reads)?;
        means_v.push(reads.mean_v().ok_or_else(|| unsuitable("the mill", "it gave no sample at rest".into()))?);
    }
    let mut turns = Turns::default();
    run(&between(NO_FIELD)?, &mut turns)?;
    mill::calibrated(&means_v, &turns).map_err(|why| unsuitable("the mill", why))
}

/// Runs a survey of a plot by the trial's arm.
pub(super) fn surveyed(
    trial: &Trial,
    scene: &Scene,
    calibration: Calibration,
    people: Vec<Person>,
) -> Result<Surveyed, Error> {
    let strategy = match trial.arm {
        PRINTED => Strategy::Loop,
        SITES => Strategy::Sites,
        ROWS => Strategy::LawnMower,
        _ => Strategy::Crossing,
    };
    let until_s = survey::mission_s(strategy, scene.plot.side_m);
    let mut survey = Survey::new(strategy, scene.plot.side_m, until_s, calibration).map_err(failed(trial))?;
    let start = survey::start(strategy, scene.plot.side_m);
    if is_kinematic(trial.arm) {
        let path = kinematic::run(scene, &[start], &mut [&mut survey]).remove(0);
        return Ok(Surveyed { taken: survey.taken().to_vec(), path, driven: None });
    }
    let driven = on_board(trial, &scene.rig(&trial.board, trial.seed, start, people), &mut survey)?;
    let path = driven.path.iter().map(|(time_s, _, truth)| (*time_s, *truth)).collect();
    Ok(Surveyed { taken: survey.taken().to_vec(), path, driven: Some(driven) })
}

/// Runs a trial on a plot of 40 m and computes its metrics.
pub(super) fn plot(trial: &Trial) -> Result<Values, Error> {
    let scene = Scene::of(trial.seed, PLOT)?;
    let calibration = calibrated(trial, scene.mill)?;
    let surveyed = surveyed(trial, &scene, calibration, Vec::new())?;
    let until_s = surveyed.path.last().map_or(0.0, |(time_s, _)| *time_s);
    let readings = readings(&surveyed.taken, &calibration);
    let mut values = Values::new();
    put(&mut values, "duration_s", until_s);
    put(&mut values, "form_error", (calibration.form / scene.mill.form - 1.0).abs());
    let offset_off_v = calibration.offset_v - scene.mill.offset_v();
    put(&mut values, "offset_error", (offset_off_v / scene.mill.offset_v()).abs());
    let per_volt = super::scene::VOLTS_PER_UNIT * scene.mill.form;
    put(&mut values, "offset_error_v_m", (offset_off_v / per_volt).abs());
    if let Some(driven) = &surveyed.driven {
        let off_m = driven.path.iter().map(|(_, at, truth)| distance_m(*at, *truth));
        put(&mut values, "pose_error_m", off_m.fold(0.0, f64::max));
    }
    // Only the paper's arm drives a loop that can be closed.
    if trial.arm == PRINTED {
        loop_closure(&scene, &readings, until_s, &mut values).map_err(of_process(trial))?;
    }
    maps(&scene, &surveyed.taken, &calibration, until_s, &mut values)?;
    Ok(values)
}

/// Converts raw readings to fields by a calibration.
pub(super) fn readings(taken: &[Taken], calibration: &Calibration) -> Vec<Sample> {
    taken.iter().map(|taken| taken.by(calibration)).collect()
}

/// Computes the errors of the maps of one set of readings: with and without time, form factor and charge.
fn maps(
    scene: &Scene,
    taken: &[Taken],
    calibration: &Calibration,
    until_s: f64,
    values: &mut Values,
) -> Result<(), Error> {
    let truth = scene.truth(until_s)?;
    let frame = scene.plot.frame()?;
    let of = |calibration: &Calibration, has_time| {
        map::by_process(frame, &readings(taken, calibration), until_s, has_time)
            .map_err(|error| unsuitable("the readings", error.to_string()))
    };
    // All maps use the same readings, so that only the method differs.
    let ours = of(calibration, true)?;
    let cells = map::per_cell(frame, &readings(taken, calibration), SQUARE_M);
    let (error, error_per_cell) = (map::rmse(&ours.mean, &truth), map::rmse(&cells, &truth));
    put(values, "rmse_v_m", error);
    put(values, "rmse_per_cell_v_m", error_per_cell);
    put(values, "rmse_over_per_cell", error / error_per_cell);
    put(values, "pattern_rmse_v_m", map::pattern_rmse(&ours.mean, &truth));
    put(values, "pattern_rmse_per_cell_v_m", map::pattern_rmse(&cells, &truth));
    put(values, "rmse_without_time_v_m", map::rmse(&of(calibration, false)?.mean, &truth));
    put(values, "rmse_without_form_v_m", map::rmse(&of(&calibration.without_form(), true)?.mean, &truth));
    put(values, "rmse_without_charge_v_m", map::rmse(&of(&calibration.without_charge(), true)?.mean, &truth));
    put(values, "structure_v_m", map::pattern_rmse(&truth.map(|_| 0.0), &truth));
    let drift = scene.drift(&ours.time_part.iter().map(|(time_s, _)| *time_s).collect::<Vec<_>>())?;
    let estimated: Vec<f64> = centred(ours.time_part.iter().map(|(_, value)| *value).collect());
    let deviation = r4_maths::statistics::rms(&drift)?;
    put(values, "drift_v_m", deviation);
    put(values, "drift_error_share", r4_maths::statistics::rmse(&drift, &estimated)? / deviation);
    put(values, "in_interval", covered(&ours, &truth));
    Ok(())
}

/// Share of cells whose true pattern lies within the map's 95 % interval.
fn covered(map: &map::Map, truth: &Grid<f64>) -> f64 {
    let mean = |grid: &Grid<f64>| grid.values().iter().sum::<f64>() / grid.values().len() as f64;
    // The interval is that of the pattern: a difference of the means belongs to the temporal part.
    let shift = mean(&map.mean) - mean(truth);
    let cells = map.mean.values().iter().zip(map.deviation.values()).zip(truth.values());
    let inside = cells.filter(|((mean, deviation), truth)| (*mean - shift - *truth).abs() <= WIDTH * *deviation);
    inside.count() as f64 / truth.values().len() as f64
}

fn centred(values: Vec<f64>) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.into_iter().map(|value| value - mean).collect()
}

/// Error of the pattern along the loop: by its first lap alone, and by all laps, with the same kernel.
fn loop_closure(scene: &Scene, readings: &[Sample], until_s: f64, values: &mut Values) -> Result<(), ProcessError> {
    // Laps have equal lengths and so about equal numbers of readings.
    let lap = readings.len() / survey::LAPS;
    let along: Vec<Point> = readings[..lap].iter().map(|sample| sample.at).collect();
    let truth = centred(scene.means_at(&along, until_s));
    let error = |readings: &[Sample]| {
        let mean = readings.iter().map(|sample| sample.value).sum::<f64>() / readings.len().max(1) as f64;
        let samples: Vec<Sample> =
            readings.iter().map(|sample| Sample { value: sample.value - mean, ..*sample }).collect();
        let process = Process::of(survey::EXPECTED, &samples)?;
        let pattern = centred(along.iter().map(|at| process.predict(*at, 0.0).place.mean).collect());
        Ok(r4_maths::statistics::rmse(&truth, &pattern).unwrap_or(f64::NAN))
    };
    let (once, closed) = (error(&readings[..lap])?, error(readings)?);
    put(values, "loop_once_v_m", once);
    put(values, "loop_closed_v_m", closed);
    put(values, "loop_closed_over_once", closed / once);
    Ok(())
}

/// Runs a trial with six robots, and with one, on an open field.
pub(super) fn swarm(trial: &Trial) -> Result<Values, Error> {
    let scene = Scene::of(trial.seed, OPEN)?;
    let calibration = calibrated(trial, scene.mill)?;
    let [one_s, six_s] = [swarmed(trial, &scene, calibration, 1)?, swarmed(trial, &scene, calibration, 6)?]
        .map(|swarmed| swarmed.reached_s);
    let mut values = Values::new();
    put(&mut values, "reached", f64::from(u8::from(one_s.is_some() && six_s.is_some())));
    // A mission that did not reach the accuracy counts with its time limit; for the single robot this is an
    // underestimate.
    let [one_s, six_s] = [one_s, six_s].map(|reached_s| reached_s.unwrap_or(swarm::LATEST_S));
    put(&mut values, "one_robot_s", one_s);
    put(&mut values, "six_robots_s", six_s);
    put(&mut values, "time_share_of_six", six_s / one_s);
    Ok(values)
}

/// Result of a swarm's mission.
pub(super) struct Swarmed {
    /// Time at which the map was accurate enough, s; `None` when it never was.
    pub(super) reached_s: Option<f64>,
    /// Samples that the base received.
    pub(super) samples: Vec<Sample>,
}

pub(super) fn swarmed(trial: &Trial, scene: &Scene, calibration: Calibration, robots: usize) -> Result<Swarmed, Error> {
    let base = Base::new(&scene.plot, robots).map_err(of_process(trial))?;
    let starts = swarm::starts(&scene.plot, robots);
    let member = |number: usize| Member::new(base.clone(), number, trial.seed, calibration);
    if is_kinematic(trial.arm) {
        let mut members: Vec<Member> = (0..robots).map(member).collect();
        kinematic::run(scene, &starts, &mut members);
    } else {
        // Each robot's board has noise of its own.
        let seed = |number: usize| trial.seed.wrapping_mul(100).wrapping_add(number as u64);
        let rig = |number: usize| scene.rig(&trial.board, seed(number), starts[number], Vec::new());
        let fleet = Fleet::new((0..robots).map(rig).collect());
        let setup = Setup::of(&fleet.rigs[0], limits().stop_m).map_err(failed(trial))?.in_volts();
        let receiver = super::gnss::Receiver::of(&fleet.rigs[0].robot()?).map_err(failed(trial))?;
        let drive = async |number: usize, session: &Session<'_>| {
            let (mut receiver, mut program) = (receiver.clone(), member(number));
            rover::run(session, &setup, &mut receiver, &mut program).await
        };
        fleet.run(drive, async |_| Ok::<_, r4_rig::Error>(()))?;
    }
    let base = base.borrow();
    Ok(Swarmed { reached_s: base.reached_s, samples: base.samples().to_vec() })
}

/// Runs a blind arm: searches laps between plates for an effect missing from the mill's model.
pub(super) fn blind(trial: &Trial, hidden: &str) -> Result<Values, Error> {
    let change = Change::named(hidden, trial.seed);
    let found = missing::found(&laps(trial, change)?)?;
    let mut values = Values::new();
    put(&mut values, "effect_claimed", f64::from(u8::from(found.is_some())));
    if let Some(change) = change {
        let named = found.filter(|found| found.name == hidden);
        put(&mut values, "effect_named", f64::from(u8::from(named.is_some())));
        if let Some(found) = named {
            put(&mut values, "size_in_interval", f64::from(u8::from(found.interval.contains(change.size()))));
            put(&mut values, "size_error", (found.size / change.size() - 1.0).abs());
            put(&mut values, "held_out_before", found.before);
            put(&mut values, "held_out_after", found.after);
        }
    }
    Ok(values)
}

/// Drives laps through the plates on the trial's board.
fn laps(trial: &Trial, change: Option<Change>) -> Result<Vec<missing::Lap>, Error> {
    let scene = missing::scene()?;
    let [x_m, y_m] = missing::ENDS_M[0];
    let mut rig = scene.rig(&trial.board, trial.seed, Place { x_m, y_m, yaw_rad: 0.0 }, Vec::new());
    let altered = rig.alter.take();
    rig.alter = Some(std::rc::Rc::new(move |robot| {
        if let Some(altered) = &altered {
            altered(robot);
        }
        missing::hide(change, robot);
    }));
    let mut program = Crossings::default();
    on_board(trial, &rig, &mut program)?;
    Ok(program.into_laps())
}
