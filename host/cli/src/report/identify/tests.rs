use std::collections::BTreeMap;

use r4_identify::report::{Evidence, Explained, Rejected, ResidualReport, Rival, Scores, Unexplained};

use super::*;

const HOSTILE: &str = "<script>alert('&\"')</script><!--body-->";

fn score(rmse: f64) -> Score {
    Score { rmse, nrmse: rmse / 0.07, mae: 0.8 * rmse }
}

fn estimate(value: f64, std: Option<f64>, unit: &str) -> Estimate {
    Estimate {
        value,
        std,
        unit: unit.into(),
        interval: std.map(|std| [value - 2.0 * std, value + 2.0 * std]),
        assumed: None,
    }
}

fn effect(name: &str, over: &str, parameters: &[(&str, Estimate)], rmse: [f64; 2]) -> EffectReport {
    EffectReport {
        name: name.into(),
        depends_on: vec![over.into()],
        parameters: parameters.iter().map(|(name, estimate)| ((*name).to_owned(), estimate.clone())).collect(),
        holdout_rmse_before: rmse[0],
        holdout_rmse_after: rmse[1],
        evidence: Evidence {
            blocked_rmse_before: rmse[0],
            blocked_rmse_after: rmse[1],
            p_value: 2e-7,
            blocks_better: [19, 20],
            z: 41.3,
        },
        rivals: Vec::new(),
        table: None,
    }
}

/// Report of an axis with friction and an unnamed effect over its position.
fn found() -> Report {
    let mut friction = effect(
        "coulomb-friction",
        "direction",
        &[("force_n", estimate(20.262, Some(0.083), "N"))],
        [0.005_51, 0.002_93],
    );
    friction.rivals.push(Rival {
        name: "stribeck-friction".into(),
        blocked_rmse: 0.002_95,
        experiment: "ramps so slow that it sticks and slips, both ways".into(),
    });
    let mut unknown = effect("unknown", "position", &[], [0.002_93, 0.002_64]);
    unknown.table = Some(Curve {
        over: "position".into(),
        at_unit: "m".into(),
        unit: "N".into(),
        at: (0..9).map(|at| f64::from(at) * 0.03).collect(),
        values: (0..9).map(|at| (f64::from(at) * 0.7).sin()).collect(),
        std: vec![0.12; 9],
    });
    let mut mass = estimate(95.108, Some(0.31), "kg");
    mass.assumed = Some("for a drive of 35.15 N per V".into());
    Report {
        model: "axis".into(),
        unit: "m".into(),
        baseline: Scores { train: score(0.004_98), holdout: score(0.005_51) },
        effects: vec![friction, unknown],
        last: Scores { train: score(0.001_12), holdout: score(0.002_64) },
        parameters: BTreeMap::from([
            ("mass_kg".to_owned(), mass),
            ("viscous_n_s_per_m".to_owned(), estimate(204.8, Some(2.4), "N s/m")),
            ("offset_n".to_owned(), estimate(1.5e-10, None, "N")),
        ]),
        residual: ResidualReport {
            white: false,
            unexplained: vec![Unexplained { depends_on: "time".into(), share: 0.042, p_value: 0.003_1 }],
        },
        timing: BTreeMap::new(),
        rejected: vec![Rejected {
            name: "position-dependent-friction".into(),
            blocked_rmse: 0.002_66,
            reason: "better on 11 of 20 blocks only, which chance does as well".into(),
        }],
        notes: vec!["train_trajectory.csv: 2 gaps, about 5 samples missing, the longest 0.050 s; nothing was put there".into()],
        explained: Explained::InPart,
        suspicions: Vec::new(),
        verdict: "Coulomb friction of 20.3 N is missing from the model, and a force over the position that has no name; with \
                  both the error on held-out data falls from 5.51 mm to 2.64 mm."
            .into(),
    }
}

fn figures() -> Figures {
    let time_s: Vec<f64> = (0..5_000).map(|row| f64::from(row) * 0.005).collect();
    let position = |time_s: f64| 0.12 + 0.11 * (0.6 * time_s).sin() + 0.02 * (1.9 * time_s).sin();
    let noise = |row: usize| ((row * 7_919 % 1_000) as f64 / 1_000.0 - 0.5) * 4e-4;
    let of = |value: &dyn Fn(usize, f64) -> f64| {
        time_s.iter().enumerate().map(|(row, time_s)| value(row, *time_s)).collect()
    };
    let run = Traces {
        name: "test_trajectory_with_pulses.csv".into(),
        held_out: true,
        time_s: time_s.clone(),
        input: ("u_V".into(), of(&|_, time_s| 2.5 * (0.6 * time_s).cos() + if time_s % 1.0 < 0.5 { 0.0 } else { 5.0 })),
        output: ("q_meas_m".into(), "m".into()),
        measured: of(&|row, time_s| position(time_s) + noise(row)),
        before: of(&|_, time_s| position(time_s) + 0.007 * (0.6 * time_s).cos().signum() * (1.0 - (-time_s).exp())),
        after: of(&|_, time_s| position(time_s) + 0.002 * (3.0 * time_s).sin()),
    };
    let at: Vec<f64> = (-10..=10).map(|bin| f64::from(bin) * 0.012).collect();
    let cause = |over: &str, unit: &str, before: Vec<f64>| Cause {
        depends_on: over.into(),
        at_unit: unit.into(),
        unit: "m".into(),
        at: at.clone(),
        after: before.iter().map(|value| 0.05 * value).collect(),
        error: vec![0.000_4; before.len()],
        before,
    };
    Figures {
        ladder: vec![
            ("base model".into(), 0.005_51),
            ("+ coulomb-friction".into(), 0.002_93),
            ("+ unknown over position".into(), 0.002_64),
        ],
        runs: vec![
            run.clone(),
            Traces { name: "train_trajectory.csv".into(), held_out: false, input: (String::new(), vec![]), ..run },
        ],
        causes: vec![
            cause("direction", "", at.iter().map(|at| if *at < 0.0 { -0.006 } else { 0.006 }).collect()),
            cause("position", "m", at.iter().map(|at| 0.001 * (60.0 * at).sin()).collect()),
        ],
    }
}

#[test]
fn the_page_tells_what_was_found_and_needs_nothing_else() {
    let page = identify(&found(), &figures(), &[("Fitted to", "train_trajectory.csv".into())]);
    for told in [
        "Coulomb friction of 20.3 N is missing",
        "5.51 \u{2192} 2.64 mm (\u{2212}52 %)",
        "coulomb-friction",
        ">20.262<",
        "\u{b1} 0.083",
        "20.096 to 20.428",
        "for a drive of 35.15 N per V",
        "not fixed by the data",
        ">1.50e\u{2212}10<",
        "below 0.0001",
        "19 of 20",
        "ramps so slow that it sticks and slips",
        "position-dependent-friction",
        "better on 11 of 20 blocks only",
        "4.20 %",
        "nothing was put there",
        "held out",
        "The residual is not white",
    ] {
        assert!(page.contains(told), "{told}");
    }
    for foreign in ["http:", "https:", "<link", "src=", "url(h", "url(/", "@import"] {
        let own = page.replace("http://www.w3.org/2000/svg", "");
        assert!(!own.contains(foreign), "{foreign}");
    }
    // Ladder, shape of the unknown effect, two runs, two causes.
    assert_eq!(page.matches("<svg ").count(), 6);
    assert_eq!(page, identify(&found(), &figures(), &[("Fitted to", "train_trajectory.csv".into())]));
}

#[test]
fn nothing_found_is_said() {
    let mut report = found();
    report.effects.clear();
    report.rejected.clear();
    report.residual = ResidualReport { white: true, unexplained: vec![] };
    let page = identify(&report, &Figures::default(), &[]);
    assert!(page.contains("no effect explains the base model's residual"));
    assert!(page.contains("The residual is white") && !page.contains("<svg "));
}

#[test]
fn names_of_files_and_columns_stay_text() {
    let mut report = found();
    report.verdict = HOSTILE.into();
    report.notes = vec![HOSTILE.into()];
    report.effects[0].name = HOSTILE.into();
    report.effects[0].rivals[0].experiment = HOSTILE.into();
    report.rejected[0].reason = HOSTILE.into();
    let mut figures = figures();
    figures.runs[0].name = HOSTILE.into();
    figures.runs[0].output.0 = HOSTILE.into();
    figures.runs[0].input.0 = HOSTILE.into();
    figures.causes[0].depends_on = HOSTILE.into();
    figures.ladder[1].0 = HOSTILE.into();
    let page = identify(&report, &figures, &[("Fitted to", HOSTILE.into())]);
    assert!(page.matches("<script").count() == 1 && !page.contains("<!--body"));
    assert!(page.contains("&lt;script&gt;"));
}

#[test]
fn numbers_that_are_none_are_drawn_around() {
    let mut report = found();
    report.baseline.holdout = Score { rmse: f64::NAN, nrmse: f64::INFINITY, mae: f64::NAN };
    report.effects[0].evidence.p_value = f64::NAN;
    let mut figures = figures();
    figures.ladder[0].1 = f64::NAN;
    let run = &mut figures.runs[0];
    run.measured[100] = f64::NAN;
    run.before.fill(f64::NAN);
    run.after.fill(1e300);
    figures.runs[1].measured.fill(f64::NAN);
    figures.runs.push(Traces::default());
    figures.causes[0].error.fill(f64::INFINITY);
    figures.causes[1].at.fill(0.5);
    figures.causes.push(Cause::default());
    let page = identify(&report, &figures, &[]);
    assert!(!page.contains("NaN") && !page.contains("inf"), "a dash stands for what is no number");
    assert!(page.contains("</html>"));
}

#[test]
fn numbers_have_digits_that_mean_something() {
    assert_eq!(significant(0.002_644), "0.00264");
    assert_eq!(significant(12_345.6), "12346");
    assert_eq!(significant(0.0), "0");
    assert_eq!(significant(-3.0e-12), "\u{2212}3.00e\u{2212}12");
    assert_eq!(significant(2.5e9), "2.50e9");
    assert_eq!(significant(f64::NAN), "\u{2013}");
    assert_eq!(Scale::of("m", 0.005).with_unit(0.005_51), "5.51 mm");
    assert_eq!(Scale::of("rad/s", 0.3).with_unit(0.162), "0.162 rad/s");
    assert_eq!(change(0.88, 0.162), " (\u{2212}82 %)");
    assert_eq!(change(0.1, 0.2), " (+100 %)");
}
