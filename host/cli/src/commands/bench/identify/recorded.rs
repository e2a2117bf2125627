//! Recordings of real machines, split as the page of each recording says.

use std::slice::from_ref;

use anyhow::{Context, ensure};
use r4_identify::{
    Task,
    data::{Mapping, Options, Run},
    motion::{Kind, Known, bench::mean_absolute},
    report::Report,
    statics::{
        hold_out,
        hysteresis::{Gap, play},
        map::StaticMap,
    },
    task::Protocol,
};

use super::{Bench, Row};
use crate::args::IdentifyRows;

/// Names of the effects found, in the order in which they were added.
pub(super) fn names(report: &Report) -> String {
    let name = |effect: &r4_identify::report::EffectReport| match &effect.table {
        Some(table) => format!("unknown over {}", table.over),
        None => effect.name.clone(),
    };
    let names: Vec<_> = report.effects.iter().map(name).collect();
    if names.is_empty() { "no effect".to_owned() } else { names.join(", ") }
}

fn has(report: &Report, wanted: &[&str]) -> bool {
    report.effects.iter().any(|effect| wanted.contains(&effect.name.as_str()))
}

fn options(roles: Vec<Mapping>) -> Options {
    Options { roles, ..Options::default() }
}

/// Row of the free-run error before and after; `size` converts the model's unit to `unit`.
fn free_runs(data: &str, metric: &str, (unit, size): (&'static str, f64), report: &Report, at_most: f64) -> Row {
    let [before, after] = [&report.baseline, &report.last].map(|scores| scores.holdout.rmse / size);
    Row::error(data, metric, unit, [before, after, at_most]).with(names(report))
}

/// Measures EMPS on the published split: one trajectory to fit, the one with pulses held out.
pub(super) fn emps(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const DATA: &str = "EMPS, axis";
    /// Gain of the drive, N/V, as published with the recordings.
    const GAIN: f64 = 35.150_651_88;
    let options = options(vec![Mapping::driving("input", "u_V"), Mapping::measured("output", "q_meas_m")]);
    let read = |name| bench.read(IdentifyRows::Emps, &[name], &options);
    let (train, test) = (read("train_trajectory.csv")?, read("test_trajectory_with_pulses.csv")?);
    let by = |protocol: Protocol| -> anyhow::Result<Report> {
        let parameters = [("gain_per_unit".to_owned(), GAIN)].into();
        let task = Task { model: "axis".to_owned(), parameters, protocol, ..bench.task() };
        Ok(bench.answer(&task, &train, &test)?.report)
    };
    let (report, published) = (by(Protocol::FirstTenth)?, by(Protocol::First20)?);
    let detail = |report: &Report| format!("MAE {:.2} mm; {}", 1e3 * report.last.holdout.mae, names(report));
    let in_mm = [&published.baseline, &published.last].map(|scores| 1e3 * scores.holdout.rmse);
    let on_position: Vec<_> = report
        .effects
        .iter()
        .filter(|effect| effect.depends_on.iter().any(|over| over == "position"))
        .map(|effect| effect.name.clone())
        .collect();
    let refused = report.rejected.iter().find(|rejected| rejected.name == "position-friction");
    let why = match refused {
        _ if !on_position.is_empty() => format!("taken: {}", on_position.join(", ")),
        Some(refused) => format!("position-friction: {}", refused.reason),
        None => "position-friction was not looked for".to_owned(),
    };
    Ok(vec![
        free_runs(DATA, "position, RMSE", ("mm", 1e-3), &report, 4.7).with(detail(&report)),
        // Same protocol as in other publications.
        Row::told(DATA, "the same, initial state by 20 samples", "mm", in_mm).with(detail(&published)),
        Row::claim(DATA, "Coulomb friction found", has(&report, &["coulomb-friction", "direction-friction"]))
            .with(names(&report)),
        Row::claim(DATA, "dependence on position refused", on_position.is_empty() && refused.is_some()).with(why),
    ])
}

/// Length of a window: samples, s.
const WINDOW: (usize, f64) = (40, 2.0);

/// Runs of the even and of the odd steps of the command, each made of consecutive windows. The file counts some
/// transient windows to the previous step: here, a step begins where a window is not steady.
fn steps(bench: &Bench<'_>, roles: &[Mapping], steady_only: bool) -> anyhow::Result<[Vec<Run>; 2]> {
    let own = [Mapping::driving("number", "step"), Mapping::driving("steady", "steady")];
    let options = Options {
        roles: roles.iter().cloned().chain(own).collect(),
        split: vec!["step".to_owned(), "window".to_owned()],
        ..Options::default()
    };
    let mut steps: Vec<(f64, usize, Run)> = Vec::new();
    for mut window in bench.read(IdentifyRows::Husky, &["husky.csv"], &options)? {
        ensure!(window.time_s.len() == WINDOW.0, "{} has {} samples", window.name, window.time_s.len());
        let mut taken = |role| window.signals.remove(role).and_then(|signal| signal.values.first().copied());
        let (number, steady) = (taken("number").context("no step")?, taken("steady").context("no `steady`")? == 1.0);
        if steady_only && !steady {
            for mapping in roles.iter().filter(|mapping| !mapping.driving) {
                let values = window.signals.get_mut(&mapping.role).map(|signal| &mut signal.values);
                values.context("a column is missing")?.fill(f64::NAN);
            }
        }
        match steps.last_mut().filter(|_| steady) {
            Some((of, windows, step)) => {
                step.time_s.extend(window.time_s.iter().map(|time_s| time_s + *windows as f64 * WINDOW.1));
                for (role, signal) in &mut step.signals {
                    signal.values.extend(&window.signals[role].values);
                }
                // The last window has the step's own number.
                (*of, *windows) = (number, *windows + 1);
            }
            None => steps.push((number, 1, window)),
        }
    }
    let (even, odd): (Vec<_>, Vec<_>) = steps.into_iter().partition(|(number, ..)| number % 2.0 == 0.0);
    Ok([even, odd].map(|steps| steps.into_iter().map(|(.., run)| run).collect()))
}

/// Measures the Husky: even steps to fit, odd ones held out.
pub(super) fn husky(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const WHEELS: &str = "Husky, wheels";
    const COMMANDS: &str = "Husky, commands";
    const GEOMETRY: [(&str, f64); 2] = [("wheel_radius_m", 0.165), ("track_m", 0.55)];
    let roles = [
        Mapping::driving("left", "wheel_left_rad_s"),
        Mapping::driving("right", "wheel_right_rad_s"),
        Mapping::measured("yaw", "yaw_rad"),
    ];
    let [train, test] = steps(bench, &roles, true)?;
    let [radius, track] = GEOMETRY;
    let wheels = bench.identify("skid-steer", &[radius, track, ("average_s", WINDOW.1)], &train, &test)?.report;
    let roles = [
        Mapping::driving("left", "cmd_left_rad_s"),
        Mapping::driving("right", "cmd_right_rad_s"),
        Mapping::measured("wheel_left", "wheel_left_rad_s"),
        Mapping::measured("wheel_right", "wheel_right_rad_s"),
    ];
    let [train, test] = steps(bench, &roles, false)?;
    let commands = bench.identify("skid-steer", &GEOMETRY, &train, &test)?.report;
    let slip = wheels.effects.first().is_some_and(|effect| effect.name.starts_with("slip-"));
    Ok(vec![
        free_runs(WHEELS, "yaw rate over 2 s, RMSE", ("rad/s", 1.0), &wheels, 0.162),
        Row::claim(WHEELS, "slip named first", slip).with(names(&wheels)),
        Row::claim(COMMANDS, "rate limit found", has(&commands, &["rate-limit"])).with(names(&commands)),
        Row::claim(COMMANDS, "lag found", has(&commands, &["drive-lag", "drive-lag-sides"])).with(names(&commands)),
    ])
}

/// Measures the pendulum: gains 100 and 400 to fit, 200 and 800 held out.
pub(super) fn pendulum(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const DATA: &str = "XL330, pendulum";
    /// Duty per rad of error and unit of gain, from the recordings' page.
    const DUTY_PER_RAD: f64 = 651.9 / (256.0 * 885.0);
    let options = options(vec![
        Mapping::driving("input", "goal_rad"),
        Mapping::measured("output", "pos_rad"),
        Mapping::driving("supply", "supply_V"),
        Mapping::driving("enabled", "torque_on"),
        Mapping::driving("gain", "kp"),
    ]);
    let of_gains = |gains: [u32; 2]| {
        let moves = ["lift_and_drop", "sin_sin", "sin_time_square", "up_and_down"];
        let names = gains.iter().flat_map(|gain| moves.map(|name| format!("kp{gain}_{name}.csv")));
        let names: Vec<String> = names.collect();
        bench.read(IdentifyRows::Pendulum, &names.iter().map(String::as_str).collect::<Vec<_>>(), &options)
    };
    let (train, test) = (of_gains([100, 400])?, of_gains([200, 800])?);
    let known = [("duty_per_rad", DUTY_PER_RAD), ("arm_m", 0.1)];
    let known = known.map(|(name, value)| (name.to_owned(), value)).into_iter().collect();
    let known = Known::from_parameters(Kind::Servo, &known, None)?;
    let found =
        mean_absolute(Kind::Servo, &known, (&train, &test), &|step| bench.progress.set_message(step.to_owned()))?;
    let effects = found.effects.join(", ");
    let named = found.effects.contains(&"load-friction");
    Ok(vec![
        Row::error(DATA, "angle, mean absolute error", "rad", [found.before, found.after, 0.061]).with(effects.clone()),
        Row::claim(DATA, "friction that depends on load named", named).with(effects),
    ])
}

/// Measures the micromouse: even rows to fit, odd ones held out.
pub(super) fn micromouse(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const RPM: f64 = std::f64::consts::TAU / 60.0;
    let mut rows = Vec::new();
    for (wheel, at_most) in [("left", 17.0), ("right", 7.0)] {
        let data = format!("micromouse, {wheel} wheel");
        let options = options(vec![
            Mapping::driving("input", "command_duty256"),
            Mapping::measured("output", &format!("{wheel}_rpm")),
            Mapping::driving("supply", "battery_mV"),
        ]);
        let halves = |name: &str| {
            let runs = bench.read(IdentifyRows::Micromouse, &[name], &options)?;
            runs.first()
                .and_then(|run| hold_out(StaticMap::NAME, run, 2))
                .with_context(|| format!("{name} is too short"))
        };
        let (fresh, fresh_test) = halves("static_3.csv")?;
        let (used, used_test) = halves("static_4.csv")?;
        let one = bench.identify(StaticMap::NAME, &[], from_ref(&fresh), from_ref(&fresh_test))?.report;
        let both = bench.identify(StaticMap::NAME, &[], &[fresh, used], &[fresh_test, used_test])?.report;
        let per_direction = |name: &str| {
            one.effects.iter().any(|effect| {
                effect.name == name && ["forward", "backward"].iter().all(|way| effect.parameters.contains_key(*way))
            })
        };
        let battery = both.effects.iter().any(|effect| effect.name.starts_with("supply"));
        rows.extend([
            free_runs(&data, "speed, RMSE", ("rpm", RPM), &one, at_most),
            Row::claim(&data, "dead-zone of each direction", per_direction("dead-zone")).with(names(&one)),
            Row::claim(&data, "saturation of each direction", per_direction("saturation")).with(names(&one)),
            Row::claim(&data, "battery between two logs found", battery).with(names(&both)),
        ]);
    }
    Ok(rows)
}

/// Measures backlash against the values published by the recordings' author.
pub(super) fn backlash(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (servo, file, published_deg) in
        [("STS3215", "sts3215_single.csv", 1.30), ("STS3250", "sts3250_single.csv", 0.33)]
    {
        let roles = vec![
            Mapping::measured("output", "dut_pos_cnt"),
            Mapping::driving("goal", "dut_target_cnt"),
            Mapping::driving("pull_a", "pullA_target_cnt"),
            Mapping::driving("pull_b", "pullB_target_cnt"),
        ];
        let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
        let runs = bench.read(IdentifyRows::Backlash, &[file], &options)?;
        let play = play(runs.first().context("no run")?)?;
        let show = |gap: &Gap| format!("{:.3} ± {:.3} deg", gap.value.abs().to_degrees(), gap.std.to_degrees());
        let off = (play.loaded.value.abs().to_degrees() - published_deg).abs();
        rows.push(
            Row::error(
                &format!("{servo}, held shaft"),
                &format!("gap under load, off the published {published_deg:.2} deg"),
                "deg",
                [f64::NAN, off, 0.1],
            )
            .with(format!("loaded {}, unloaded {}", show(&play.loaded), show(&play.unloaded))),
        );
    }
    Ok(rows)
}
