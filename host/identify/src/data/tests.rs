use std::{f64::consts::PI, fmt::Write as _, path::PathBuf};

use proptest::prelude::*;

use super::*;

fn options(roles: &[(&str, &str)]) -> Options {
    let mapping = |&(role, column): &(&str, &str)| {
        if matches!(role, "input" | "supply") {
            Mapping::driving(role, column)
        } else {
            Mapping::measured(role, column)
        }
    };
    Options { roles: roles.iter().map(mapping).collect(), ..Options::default() }
}

fn motor() -> Options {
    options(&[("input", "duty"), ("output", "theta_rad")])
}

fn read_text(text: &str, options: &Options) -> Result<Recorded, DataError> {
    read_bytes("a.csv", text.as_bytes(), options)
}

/// Writes rows of time, duty and angle.
fn table(rows: impl IntoIterator<Item = (f64, f64, f64)>) -> String {
    let mut text = String::from("t_s,duty,theta_rad\n");
    for (time_s, duty, angle) in rows {
        writeln!(text, "{time_s},{duty},{angle}").unwrap();
    }
    text
}

/// Rows of a swinging motor, every 10 ms.
fn swing(rows: usize) -> Vec<(f64, f64, f64)> {
    let at = |row: usize| (row as f64 * 0.01, if row % 100 < 50 { 0.5 } else { -0.5 }, 2.0 * (row as f64 * 0.03).sin());
    (0..rows).map(at).collect()
}

fn notes(recorded: &Recorded) -> Vec<String> {
    recorded.notes.iter().map(ToString::to_string).collect()
}

fn message(text: &str, options: &Options) -> String {
    read_text(text, options).unwrap_err().to_string()
}

#[test]
fn sound_files_are_read_as_they_are() {
    let rows = swing(300);
    let recorded = read_text(&table(rows.clone()), &motor()).unwrap();
    assert_eq!(recorded.notes, []);
    assert_eq!(recorded.groups, [0]);
    let run = &recorded.runs[0];
    assert_eq!(run.name, "a.csv");
    assert_eq!(run.time_s, rows.iter().map(|row| row.0).collect::<Vec<_>>());
    assert_eq!(run.values("input").unwrap(), rows.iter().map(|row| row.1).collect::<Vec<_>>());
    assert_eq!(run.values("output").unwrap(), rows.iter().map(|row| row.2).collect::<Vec<_>>());
    assert_eq!(run.signals["output"].quantity, Quantity::Angle);
}

#[test]
fn separators_marks_and_quotes_of_other_programs_are_read() {
    for text in [
        "\u{feff}t_s;duty;theta_rad\r\n0;1;2\r\n1;1;3\r\n",
        "t_s\tduty\ttheta_rad\n0\t1\t2\n1\t1\t3",
        "\"t_s\", \"duty\" ,theta_rad\n\n0,1,\"2\"\n 1, 1, 3\n\n",
    ] {
        let recorded = read_text(text, &motor()).unwrap();
        assert_eq!(recorded.runs[0].values("output").unwrap(), [2.0, 3.0], "{text}");
    }
}

#[test]
fn files_that_hold_nothing_say_so() {
    for (text, said) in [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("t_s,duty,theta_rad\n", "no rows"),
        ("0,1,2\n1,1,2\n", "no header"),
        ("t_s,duty,theta_rad\n0,1,\n1,1,nan\n", "theta_rad has no number at all"),
        ("\0\u{1}\u{2}", "neither a table nor a log"),
    ] {
        assert!(message(text, &motor()).contains(said), "{text}: {}", message(text, &motor()));
    }
    assert!(matches!(read(&[], &motor()), Err(DataError::NoFile)));
    let gone = read(&[PathBuf::from("/nowhere/run.csv")], &motor()).unwrap_err();
    assert!(gone.to_string().starts_with("cannot read /nowhere/run.csv: "), "{gone}");
}

#[test]
fn a_wrong_name_is_answered_with_the_nearest_and_all() {
    let text = "time_s,duty,theta_rad\n0,1,2\n";
    let said = message(text, &options(&[("input", "dutty"), ("output", "theta_rad")]));
    assert_eq!(said, "a.csv has no column `dutty` (did you mean `duty`?); it has: time_s, duty, theta_rad");
    assert!(message(text, &options(&[("output", "theta")])).contains("(did you mean `theta_rad`?)"));
    assert!(!message(text, &options(&[("output", "xq")])).contains("did you mean"));
    let said = message("time_s,u,u\n0,1,2\n", &options(&[("input", "u")]));
    assert!(said.contains("more than one column `u`"), "{said}");
}

#[test]
fn two_columns_for_one_role_or_two_roles_for_one_column_are_refused() {
    let text = "t_s,duty,theta_rad\n0,1,2\n";
    let twice = options(&[("output", "duty"), ("output", "theta_rad")]);
    assert!(matches!(read_text(text, &twice), Err(DataError::RoleTwice { .. })));
    let same = options(&[("input", "duty"), ("output", "duty")]);
    assert!(matches!(read_text(text, &same), Err(DataError::ColumnTwice { .. })));
}

#[test]
fn text_and_ragged_rows_are_told_with_their_line() {
    let said = message("t_s,duty,theta_rad\n0,1,2\n1,oops,3\n", &motor());
    assert!(said.starts_with("a.csv, line 3, column duty: `oops` is not a number"), "{said}");
    // Text in a column that is not used does not matter.
    assert!(read_text("t_s,what,duty,theta_rad\n0,start,1,2\n1,,1,2\n", &motor()).is_ok());
    let said = message("t_s,duty,theta_rad\n0,1,2\n1,1\n2,1,3\n", &motor());
    assert!(said.starts_with("a.csv, line 3: 2 cells where the header has 3 columns"), "{said}");
}

#[test]
fn a_last_line_that_ends_early_is_left_out() {
    let recorded = read_text("t_s,duty,theta_rad\n0,1,2\n1,1,3\n2,1", &motor()).unwrap();
    assert_eq!(recorded.runs[0].time_s, [0.0, 1.0]);
    assert_eq!(recorded.notes, [Note::CutLine { file: "a.csv".into() }]);
}

#[test]
fn time_is_looked_for_named_or_counted() {
    let named = Options { time: Some("clock_ms".into()), ..motor() };
    let text = "clock_ms,duty,theta_rad\n500,1,2\n510,1,3\n";
    let step_s = read_text(text, &named).unwrap().runs[0].time_s[1];
    // A difference of times near half a second is rounded by 1e-16.
    assert!((step_s - 0.01).abs() < 1e-15, "{step_s}");
    let said = message(text, &motor());
    assert!(said.contains("no time column") && said.contains("--time"), "{said}");
    let counted = read_text(text, &Options { untimed: true, ..motor() }).unwrap();
    assert_eq!(counted.runs[0].time_s, [0.0, 1.0]);
    assert_eq!(counted.notes, [Note::Numbered { file: "a.csv".into() }]);
    let unitless = read_text("time,duty,theta_rad\n0,1,2\n10,1,3\n20,1,4\n", &motor()).unwrap();
    assert_eq!(notes(&unitless), ["a.csv: time has no unit in its name and is taken as seconds: a step is 10 s"]);
}

#[test]
fn rows_out_of_order_are_refused_with_their_line() {
    let mut rows = swing(60);
    rows.swap(40, 41);
    let said = message(&table(rows), &motor());
    assert!(said.starts_with("a.csv, line 43: time goes back from 0.41 s to 0.4 s"), "{said}");
    let backwards: Vec<_> = swing(60).into_iter().rev().collect();
    assert!(message(&table(backwards), &motor()).contains("line 3: time goes back"));
}

#[test]
fn a_clock_that_starts_again_starts_a_run() {
    let twice: Vec<_> = swing(50).into_iter().chain(swing(70)).chain(swing(60)).collect();
    let recorded = read_text(&table(twice), &motor()).unwrap();
    let lengths: Vec<_> = recorded.runs.iter().map(|run| run.time_s.len()).collect();
    assert_eq!(lengths, [50, 70, 60]);
    assert_eq!(recorded.groups, [0, 1, 2]);
    assert_eq!(recorded.runs[1].name, "a.csv (2)");
    assert!(recorded.notes.contains(&Note::Restarts { file: "a.csv".into(), times: 2 }));
}

#[test]
fn repeated_stamps_keep_the_first_and_stampless_rows_go() {
    let text = "t_s,duty,theta_rad\n0,1,0\n0.01,1,1\n0.01,1,99\n,1,98\n0.02,1,2\n";
    let recorded = read_text(text, &motor()).unwrap();
    assert_eq!(recorded.runs[0].values("output").unwrap(), [0.0, 1.0, 2.0]);
    assert_eq!(
        recorded.notes,
        [Note::NoStamp { file: "a.csv".into(), rows: 1 }, Note::Repeated { file: "a.csv".into(), rows: 1 }]
    );
}

#[test]
fn missing_cells_stay_missing_where_measured_and_hold_where_driving() {
    let text = "t_s,duty,theta_rad\n0,,7\n1,0.5,\n2,,3\n3,0.25,inf\n4,0.25,5\n";
    let recorded = read_text(text, &motor()).unwrap();
    let run = &recorded.runs[0];
    assert_eq!(run.time_s, [0.0, 1.0, 2.0, 3.0]);
    assert_eq!(run.values("input").unwrap(), [0.5, 0.5, 0.25, 0.25]);
    let output = run.values("output").unwrap();
    assert!(output[0].is_nan() && output[2].is_nan());
    assert_eq!((output[1], output[3]), (3.0, 5.0));
    assert_eq!(
        notes(&recorded),
        [
            "a.csv: duty has no number in 2 of 5 rows; the value before holds there, and rows before its first are left out",
            "a.csv: theta_rad has no number in 2 of 5 rows; they are not compared",
        ]
    );
}

#[test]
fn columns_split_a_file_into_runs_and_their_values_are_held_out_together() {
    // Five trials, each with two windows in which the clock restarts.
    let mut text = String::from("trial,t_s,duty,theta_rad\n");
    for trial in 0..5 {
        for row in (0..4).chain(0..4) {
            writeln!(text, "{trial},{row},0.1,{trial}").unwrap();
        }
    }
    let split = Options { split: vec!["trial".into()], ..motor() };
    let recorded = read_text(&text, &split).unwrap();
    assert_eq!(recorded.runs.len(), 10);
    assert_eq!(recorded.runs[3].name, "a.csv trial=1 (2)");
    let (train, holdout) = recorded.alternate(2).unwrap();
    let trials = |part: &Recorded| part.runs.iter().map(|run| run.values("output").unwrap()[0]).collect::<Vec<_>>();
    assert_eq!(trials(&train), [0.0, 0.0, 2.0, 2.0, 4.0, 4.0]);
    assert_eq!(trials(&holdout), [1.0, 1.0, 3.0, 3.0]);
}

#[test]
fn interleaved_trials_are_sorted_out_and_ones_that_come_back_later_are_runs() {
    let split = Options { split: vec!["who".into()], ..motor() };
    let mut interleaved = String::from("who,t_s,duty,theta_rad\n");
    let mut later = interleaved.clone();
    for row in 0..12 {
        for who in ["x", "y"] {
            writeln!(interleaved, "{who},{row},1,{row}").unwrap();
        }
        writeln!(later, "{},{row},1,{row}", if (4..10).contains(&row) { "y" } else { "x" }).unwrap();
    }
    let recorded = read_text(&interleaved, &split).unwrap();
    assert_eq!(recorded.runs.iter().map(|run| run.time_s.len()).collect::<Vec<_>>(), [12, 12]);
    let recorded = read_text(&later, &split).unwrap();
    assert_eq!(recorded.runs.iter().map(|run| run.time_s.len()).collect::<Vec<_>>(), [4, 6, 2]);
    assert_eq!(recorded.groups, [0, 1, 0]);
}

#[test]
fn hold_out_is_files_or_every() {
    let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
    assert_eq!(Holdout::parse(&paths(&["every:2"])).unwrap(), Holdout::Every(2));
    assert_eq!(Holdout::parse(&paths(&["a.csv", "b.csv"])).unwrap(), Holdout::Files(paths(&["a.csv", "b.csv"])));
    for wrong in [&["every:1"][..], &["every:"], &["every:x"], &["every:2", "a.csv"]] {
        assert!(matches!(Holdout::parse(&paths(wrong)), Err(DataError::Holdout { .. })), "{wrong:?}");
    }
    let one = read_text(&table(swing(50)), &motor()).unwrap();
    let said = one.alternate(2).unwrap_err().to_string();
    assert!(said.contains("--run") && said.contains("--holdout"), "{said}");
}

#[test]
fn irregular_clocks_and_gaps_are_told() {
    // Steps of 8, 10 and 12 ms in turn, and twice 50 ms where samples were lost.
    let mut time_s = 0.0;
    let mut uneven = swing(400);
    for (row, sample) in uneven.iter_mut().enumerate() {
        sample.0 = time_s;
        time_s += [0.008, 0.010, 0.012][row % 3];
    }
    let recorded = read_text(&table(uneven), &motor()).unwrap();
    assert_eq!(
        notes(&recorded),
        ["a.csv: irregular sampling, every 10.000 ms, one step in twenty more than 2.000 ms off"]
    );
    let lost = |row: &(usize, (f64, f64, f64))| !(100..104).contains(&row.0) && row.0 != 200;
    let rows = swing(400).into_iter().enumerate().filter(lost).map(|(_, row)| row);
    let recorded = read_text(&table(rows), &motor()).unwrap();
    assert_eq!(
        notes(&recorded),
        ["a.csv: 2 gaps, about 5 samples missing, the longest 0.050 s; nothing was put there"]
    );
}

#[test]
fn values_held_between_samples_are_told_and_coarse_ones_are_not() {
    let held =
        swing(600).into_iter().enumerate().map(|(row, (t, u, _))| (t, u, 2.0 * ((row / 2 * 2) as f64 * 0.03).sin()));
    let recorded = read_text(&table(held), &motor()).unwrap();
    let [Note::Held { column, share, rate_hz, .. }] = &recorded.notes[..] else { panic!("{:?}", recorded.notes) };
    assert_eq!(column, "theta_rad");
    // Every second sample at 100 Hz; near the turning points two values may be equal by chance.
    assert!((share - 0.5).abs() < 0.02 && (rate_hz - 50.0).abs() < 1.0, "{share} {rate_hz}");
    let coarse = swing(600).into_iter().map(|(t, u, angle)| (t, u, (angle / 0.05).round() * 0.05));
    assert_eq!(read_text(&table(coarse), &motor()).unwrap().notes, []);
    let rests =
        swing(600).into_iter().enumerate().map(|(row, (t, u, angle))| (t, u, if row % 100 < 60 { angle } else { 0.5 }));
    assert_eq!(read_text(&table(rests), &motor()).unwrap().notes, []);
}

#[test]
fn lone_spikes_are_set_aside_and_sharp_motion_is_not() {
    let mut rows = swing(500);
    rows[123].2 += 40.0;
    rows[321].2 -= 3.0;
    let recorded = read_text(&table(rows), &motor()).unwrap();
    let output = recorded.runs[0].values("output").unwrap();
    let missing: Vec<_> = (0..500).filter(|&row| output[row].is_nan()).collect();
    assert_eq!(missing, [123, 321]);
    assert_eq!(
        notes(&recorded),
        ["a.csv: 2 lone values of theta_rad far from both neighbours were set aside, the first at 1.230 s"]
    );

    // Steps, a saw tooth, an impulse of two samples, and spikes everywhere.
    let shapes: [fn(usize) -> f64; 4] = [
        |row| f64::from(row as u32 / 50 % 2),
        |row| (row % 20) as f64,
        |row| if row == 200 || row == 201 { 50.0 } else { (row as f64 * 0.05).sin() },
        |row| if row % 25 == 0 { 5.0 } else { (row as f64 * 0.05).sin() },
    ];
    for (number, shape) in shapes.iter().enumerate() {
        let rows = swing(500).into_iter().enumerate().map(|(row, (t, u, _))| (t, u, shape(row)));
        let recorded = read_text(&table(rows), &motor()).unwrap();
        assert!(recorded.runs[0].values("output").unwrap().iter().all(|value| value.is_finite()), "shape {number}");
    }
}

#[test]
fn an_angle_kept_within_a_turn_is_added_up() {
    let turning: Vec<f64> = (0..400).map(|row| 0.1 * f64::from(row)).collect();
    for low in [-PI, 0.0] {
        let rows = turning
            .iter()
            .enumerate()
            .map(|(row, angle)| (row as f64 * 0.01, 0.5, (angle - low).rem_euclid(2.0 * PI) + low));
        let recorded = read_text(&table(rows), &motor()).unwrap();
        let output = recorded.runs[0].values("output").unwrap();
        // Printing and parsing are exact; adding turns is rounded.
        assert!(output.iter().zip(&turning).all(|(found, angle)| (found - angle).abs() < 1e-12), "{low}");
        assert_eq!(recorded.notes, [Note::Unwrapped { file: "a.csv".into(), column: "theta_rad".into(), times: 6 }]);
    }
    // An angle beyond a turn is unwrapped already, so its jump stays.
    let jumps = swing(200).into_iter().map(|(t, u, angle)| (t, u, if t > 1.0 { angle + 9.0 } else { angle }));
    assert_eq!(read_text(&table(jumps), &motor()).unwrap().notes, []);
}

#[test]
fn files_of_one_name_are_told_apart_by_their_paths() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, table(swing(50))).unwrap();
        path
    };
    let files = [write("one/run.csv"), write("two/run.csv"), write("two/other.csv")];
    let recorded = read(&files, &motor()).unwrap();
    assert_eq!(recorded.runs[0].name, files[0].display().to_string());
    assert_eq!(recorded.runs[2].name, "other.csv");
    assert_eq!(recorded.groups, [0, 1, 2]);
}

/// Requirements of a model of a motor.
fn needs() -> [Need; 2] {
    let need = |role: &str, driving, quantities: &[Quantity]| Need {
        role: role.into(),
        what: "what was measured".into(),
        quantities: quantities.to_vec(),
        required: true,
        driving,
        varies: true,
        samples: 50,
    };
    [need("input", true, &[Quantity::Number, Quantity::Voltage]), need("output", false, &[Quantity::Angle])]
}

#[test]
fn what_cannot_be_identified_is_told_with_the_experiment_that_would_do() {
    let checked = |text: &str, options: &Options| {
        check(&read_text(text, options).unwrap().runs, &needs()).map_err(|error| error.to_string())
    };
    assert_eq!(checked(&table(swing(100)), &motor()), Ok(()));
    let still = swing(100).into_iter().map(|(t, _, angle)| (t, 0.3, angle));
    let said = checked(&table(still), &motor()).unwrap_err();
    assert!(said.contains("0.3 all the time") && said.contains("record steps"), "{said}");
    let stuck = swing(100).into_iter().map(|(t, u, _)| (t, u, 1.0));
    assert!(checked(&table(stuck), &motor()).unwrap_err().contains("nothing moved"));
    for rows in [1, 49] {
        assert!(checked(&table(swing(rows)), &motor()).unwrap_err().contains("50 are needed"));
    }
    let unitless = table(swing(100)).replace("theta_rad", "theta");
    let said = checked(&unitless, &options(&[("input", "duty"), ("output", "theta")])).unwrap_err();
    assert!(said.contains("no unit") && said.contains("`_rad` or `_deg`"), "{said}");
    let counts = table(swing(100)).replace("theta_rad", "theta_cnt");
    let counting = options(&[("input", "duty"), ("output", "theta_cnt")]);
    assert!(checked(&counts, &counting).unwrap_err().contains("counts_per_turn"));
    assert_eq!(checked(&counts, &Options { counts_per_turn: Some(4096.0), ..counting }), Ok(()));
    let said = checked(&table(swing(100)), &options(&[("input", "duty")])).unwrap_err();
    assert!(said.contains("--map output=COLUMN"), "{said}");
}

/// Numbers of rows and the notes of each measured data set, as on the provenance pages in `data/`.
#[test]
fn the_measured_sets_are_read() {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../data");
    let read = |files: &[&str], options: &Options| {
        let paths: Vec<_> = files.iter().map(|file| PathBuf::from(format!("{data}/{file}"))).collect();
        read(&paths, options).unwrap()
    };
    let axis = read(&["emps/train_trajectory.csv"], &options(&[("input", "u_V"), ("output", "q_meas_m")]));
    assert_eq!((axis.runs.len(), axis.runs[0].time_s.len()), (1, 24841));
    assert_eq!(axis.notes, []);

    let wheels = [("left", "wheel_left_rad_s"), ("right", "wheel_right_rad_s"), ("yaw", "yaw_rad")];
    let husky = read(&["husky_skidsteer/husky.csv"], &Options { split: vec!["step".into()], ..options(&wheels) });
    assert_eq!((husky.runs.len(), husky.groups.last()), (603, Some(&200)));
    let held = husky.notes.iter().filter(|note| matches!(note, Note::Held { share, .. } if (0.4..0.6).contains(share)));
    assert_eq!(held.count(), 3, "{:?}", husky.notes);

    let pendulum = [("input", "goal_rad"), ("output", "pos_rad"), ("supply", "supply_V")];
    let servo = read(&["bam_xl330_pendulum/kp100_lift_and_drop.csv"], &options(&pendulum));
    assert_eq!(servo.runs[0].time_s.len(), 1510);
    assert!(matches!(servo.notes[..], [Note::Irregular { .. }]), "{:?}", servo.notes);

    let counts =
        Options { counts_per_turn: Some(4096.0), ..options(&[("input", "dut_target_cnt"), ("output", "dut_pos_cnt")]) };
    let backlash = read(&["sts_servo_backlash/sts3250_single.csv"], &counts);
    assert_eq!(
        notes(&backlash),
        ["sts3250_single.csv: dut_pos_cnt has no number in 1 of 402 rows; they are not compared"]
    );
    assert_eq!(backlash.runs[0].signals["output"].quantity, Quantity::Angle);
}

/// A log of a motor every 10 ms, its supply every 30 ms, and commands.
fn log() -> Vec<u8> {
    use r4_log::{Header, Recorder};
    use r4_protocol::{
        Causes, ChannelId, ChannelInfo, ChannelKind, Mode, ModeInfo, Range, SafetyState, Sample, Setpoint, Telemetry,
        Unit,
    };
    let osmc = |number| ChannelId::new(ChannelKind::Osmc, number);
    let supply = ChannelId::new(ChannelKind::Supply, 0);
    let duty = ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(1.0) };
    let channel = |id, unit, resolution, modes: &[ModeInfo]| ChannelInfo {
        id,
        unit,
        range: Range::symmetric(100.0),
        rate_hz: 1_000.0,
        resolution,
        modes: modes.iter().cloned().collect(),
    };
    let header = Header {
        robot: "bench".into(),
        board: "sim:bench".into(),
        firmware: "0.1.0".into(),
        protocol_version: r4_protocol::VERSION,
        channels: vec![
            channel(osmc(0), Unit::Rad, 0.5, std::slice::from_ref(&duty)),
            channel(osmc(1), Unit::Rad, 0.5, &[duty]),
            channel(supply, Unit::V, 0.0, &[]),
        ],
        seed: None,
        recorded: None,
    };
    let mut recorder = Recorder::new(std::io::Cursor::new(Vec::new()), &header).unwrap();
    for tick in 0..8_i16 {
        let device_us = 100_000 + 10_000 * u64::from(tick.unsigned_abs());
        if tick == 2 {
            recorder.command(device_us - 1_000, osmc(0), Setpoint { mode: Mode::Duty, value: 0.5 }).unwrap();
        }
        let motor = |channel| Sample::Motor {
            channel,
            setpoint: Setpoint { mode: Mode::Duty, value: 0.5 },
            position: i32::from(tick) * 2,
            speed: 0.0,
            duty: f32::from(tick) / 8.0,
            settled: false,
            homed: false,
            winding: None,
        };
        let mut samples = vec![motor(osmc(0)), motor(osmc(1))];
        if tick % 3 == 0 {
            samples.push(Sample::Scalar { channel: supply, value: 20.0 + f32::from(tick) });
        }
        let samples = samples.into_iter().collect();
        recorder.telemetry(&Telemetry { device_us, state: SafetyState::Armed, causes: Causes::NONE, samples }).unwrap();
    }
    recorder.finish().unwrap().into_inner()
}

#[test]
fn a_log_gives_channels_at_the_moments_of_what_is_compared() {
    let mut roles = options(&[("output", "osmc0.position_rad")]);
    roles.roles.push(Mapping::driving("input", "osmc0.duty"));
    roles.roles.push(Mapping::driving("supply", "voltage_v"));
    let recorded = read_bytes("a.mcap", &log(), &roles).unwrap();
    let run = &recorded.runs[0];
    assert_eq!(run.values("output").unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(run.values("input").unwrap()[..3], [0.0, 0.125, 0.25]);
    assert_eq!(run.values("supply").unwrap(), [20.0, 20.0, 20.0, 23.0, 23.0, 23.0, 26.0, 26.0]);
    assert_eq!(run.signals["supply"].quantity, Quantity::Voltage);
    // The board's clock counts whole microseconds.
    assert!(run.time_s.iter().enumerate().all(|(row, time_s)| (time_s - row as f64 * 0.01).abs() < 1e-9));
    assert_eq!(
        notes(&recorded),
        [
            "a.mcap: supply0.voltage_v has moments of its own; at each sample of osmc0.position_rad its latest value is used"
        ]
    );

    // A command holds from its sending on; before it, the input is unknown.
    let mut roles = options(&[("output", "osmc0.position_rad")]);
    roles.roles.push(Mapping::driving("input", "osmc0.command_duty"));
    let run = read_bytes("a.mcap", &log(), &roles).unwrap().runs.remove(0);
    assert_eq!((run.time_s[0], run.values("output").unwrap()[0]), (0.0, 2.0));
    assert_eq!(run.values("input").unwrap(), [0.5; 6]);
}

#[test]
fn what_a_log_has_not_is_told() {
    let said = |roles: &[(&str, &str)]| read_bytes("a.mcap", &log(), &options(roles)).unwrap_err().to_string();
    assert!(said(&[("output", "position_rad")]).contains("name one of: osmc0.position_rad, osmc1.position_rad"));
    assert!(said(&[("output", "osmc2.position_rad")]).contains("did you mean `osmc"));
    let split = Options { split: vec!["trial".into()], ..options(&[("output", "osmc0.position_rad")]) };
    assert!(matches!(read_bytes("a.mcap", &log(), &split), Err(DataError::SplitLog { .. })));
    assert!(matches!(read_bytes("a.mcap", b"no log", &motor()), Err(DataError::Log { .. })));
}

proptest! {
    #[test]
    fn any_bytes_give_runs_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..400), log in any::<bool>()) {
        let file = if log { "a.mcap" } else { "a.csv" };
        let _ = read_bytes(file, &bytes, &motor());
    }

    /// Tables of cells that occur in files: numbers, words and empty cells in any order.
    #[test]
    fn any_cells_give_runs_that_keep_their_promises(
        rows in prop::collection::vec(prop::collection::vec(
            prop::sample::select(vec!["0", "1", "2", "3.5", "-1", "1e300", "-1e308", "nan", "", "inf", "x", "true", "6.2", "0.1", "1e-320"]), 4), 0..40),
        split in any::<bool>(),
        mcap in any::<bool>(),
    ) {
        let mut text = String::from("t_s,duty,theta_rad,trial\n");
        for row in rows {
            text += &(row.join(",") + "\n");
        }
        let options = Options { split: if split { vec!["trial".into()] } else { Vec::new() }, ..motor() };
        let _ = read_bytes(if mcap { "a.mcap" } else { "a.csv" }, text.as_bytes(), &options);
        if let Ok(recorded) = read_text(&text, &options) {
            prop_assert_eq!(recorded.runs.len(), recorded.groups.len());
            for run in &recorded.runs {
                prop_assert_eq!(run.time_s[0], 0.0);
                prop_assert!(run.time_s.windows(2).all(|pair| pair[0] < pair[1]));
                prop_assert!(run.values("input").unwrap().iter().all(|value| value.is_finite()));
                prop_assert_eq!(run.values("output").unwrap().len(), run.time_s.len());
            }
            let _ = check(&recorded.runs, &needs());
            let _ = recorded.alternate(2);
        }
    }
}
