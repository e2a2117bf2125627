use r4_maths::statistics::{RootMeanSquare, rms};
use r4_plants::{DcGearMotor, Drive, EffectInfo, Model, PlantKind, PlantSpec};

use crate::{
    Draw, NEVER, NOT_ON_BOARDS,
    dice::Dice,
    experiment::{Experiment, Length, Recording, Setup, experiment},
    hide, hide_as,
    listed::CANDIDATES,
    scale::Scale,
    unlisted,
    watch::{Output, Parts, Plan, left},
};

pub(crate) fn motor() -> PlantSpec {
    let model = DcGearMotor {
        resistance_ohm: 1.0,
        inductance_h: 1e-3,
        torque_constant_nm_per_a: 0.04,
        gear_ratio: 50.0,
        inertia_kg_m2: 0.3,
        viscous_nm_s_per_rad: 0.2,
    };
    PlantSpec::new(Model::DcGearMotor(model), "a test", vec![]).unwrap()
}

fn actuator() -> PlantSpec {
    let text = include_str!("../../../boards/plants/osmc-bench-actuator.toml");
    PlantSpec::from_toml("osmc-bench-actuator.toml", text).unwrap()
}

fn rotary() -> PlantSpec {
    let text = include_str!("../../../boards/plants/osmc-bench-rotary.toml");
    PlantSpec::from_toml("osmc-bench-rotary.toml", text).unwrap()
}

const SHORT: Length = Length { train: 2, holdout: 1, seconds: 8.0 };

#[test]
fn sizes_of_a_motor_are_those_of_its_equations() {
    let scale = Scale::of(&motor(), 24.0);
    // With k = 2: 24 V · 2 / (4 + 1 · 0.2), stalled at 48 N m with 24 A.
    assert!((scale.speed - 48.0 / 4.2).abs() < 1e-6, "{}", scale.speed);
    assert!((scale.force - 48.0).abs() < 1e-6 && (scale.power_w - 576.0).abs() < 1e-3, "{scale:?}");
    assert_eq!(scale.threshold, 0.0);
    // The bench's motor stops below 0.40.
    let scale = Scale::of(&rotary(), 24.0);
    assert!((0.4..0.6).contains(&scale.threshold) && (4.5..5.5).contains(&scale.speed), "{scale:?}");
}

#[test]
fn the_same_seed_hides_the_same_and_another_one_something_else() {
    for plant in [motor(), rotary(), actuator()] {
        let told: Vec<_> = (1..=4).map(|seed| hide(&plant, 24.0, seed).truth().to_vec()).collect();
        let again: Vec<_> = (1..=4).map(|seed| hide(&plant, 24.0, seed).truth().to_vec()).collect();
        assert_eq!(told, again);
        assert!(told.windows(2).any(|pair| pair[0] != pair[1]), "{told:?}");
    }
}

#[test]
fn kinds_come_about_as_often_as_they_should() {
    let of = |draw| (0..8000).filter(|&seed| Draw::of(seed) == draw).count();
    // Expected 1000 each, with a standard deviation of 30.
    for draw in [Draw::Nothing, Draw::Pair, Draw::Unlisted] {
        assert!((850..1150).contains(&of(draw)), "{draw:?}: {}", of(draw));
    }
    assert_eq!(of(Draw::Listed), 8000 - of(Draw::Nothing) - of(Draw::Pair) - of(Draw::Unlisted));
}

#[test]
fn what_is_hidden_cannot_be_had_without_it() {
    for (draw, effects) in [(Draw::Listed, 1), (Draw::Pair, 2), (Draw::Unlisted, 1)] {
        for seed in 1..=3 {
            let setup = Setup::ALL[seed as usize % 3];
            let made = experiment(setup, draw, SHORT, seed);
            assert_eq!(made.hidden.truth().len(), effects, "{draw:?} {seed}");
            let bare = Parts { spec: made.base.clone(), unlisted: vec![] };
            let (difference, left) = against(&made, &bare);
            // Over all train runs; for a pair each effect was checked in both.
            assert!(difference >= 3.0 * made.noise, "{:?}: {difference} of {}", made.hidden.truth(), made.noise);
            assert!(left >= made.noise, "{:?}: {left} of {}", made.hidden.truth(), made.noise);
            assert_eq!(made.hidden.truth().iter().all(|truth| truth.listed), draw != Draw::Unlisted);
        }
    }
}

/// RMS by which the train runs differ from those of other parts, before and after a fit of these.
fn against(made: &Experiment, parts: &Parts) -> (f64, f64) {
    let supply_v = made.supply_v;
    let scale = Scale::of(&made.base, supply_v);
    let output = if made.setup == Setup::MotorSpeed { Output::Speed } else { Output::Position };
    let plans: Vec<Plan> = made.train.iter().map(|run| plan(made, run)).collect();
    let outputs =
        |parts: &Parts| -> Vec<Vec<f64>> { plans.iter().map(|plan| parts.outputs(plan, supply_v, output)).collect() };
    let (with, without) = (outputs(&made.hidden.parts), outputs(parts));
    let apart: RootMeanSquare = with.iter().flatten().zip(without.iter().flatten()).map(|(a, b)| a - b).collect();
    (apart.value().unwrap(), left(&with, parts, &scale, &plans, output))
}

fn plan(made: &Experiment, run: &Recording) -> Plan {
    Plan { start: run.start, duty: run.input.iter().map(|input| input / made.input_per_duty).collect() }
}

#[test]
fn nothing_hidden_is_the_bare_plant_and_its_noise() {
    for setup in Setup::ALL {
        let made = experiment(setup, Draw::Nothing, SHORT, 5);
        assert!(made.hidden.truth().is_empty());
        assert_eq!(made.hidden.spec(), &made.base);
        assert_eq!((made.train.len(), made.holdout.len()), (2, 1));
        let mut errors = Vec::new();
        for run in made.train.iter().chain(&made.holdout) {
            // Stepped here separately, four times as finely.
            let mut plant = r4_plants::Plant::new(&made.base, 0);
            plant.set_position(run.start);
            let zero = if setup == Setup::AxisPosition { run.start } else { 0.0 };
            for (index, duty) in plan(&made, run).duty.into_iter().enumerate() {
                let told = if setup == Setup::MotorSpeed { plant.speed() } else { plant.position() - zero };
                // The linear plant is exact up to the rounding of positions up to 50.
                assert!((told - run.clean[index]).abs() < 1e-9, "{setup:?} {index}: {told} {}", run.clean[index]);
                (0..80).for_each(|_| plant.advance(Drive::with_brake(duty), made.supply_v, 5e-3 / 80.0));
            }
            errors.extend(run.output.iter().zip(&run.clean).map(|(measured, clean)| measured - clean));
        }
        let deviation = rms(&errors).unwrap();
        // With 4800 samples the standard deviation is known to 1 %.
        assert!((deviation / made.noise - 1.0).abs() < 0.05, "{setup:?}: {deviation} of {}", made.noise);
    }
}

#[test]
fn the_same_seed_makes_the_same_recordings_and_runs_are_driven_differently() {
    let [one, again] = [0, 0].map(|_| experiment(Setup::MotorPosition, Draw::Listed, SHORT, 11));
    assert_eq!((&one.train, &one.holdout), (&again.train, &again.holdout));
    let other = experiment(Setup::MotorPosition, Draw::Listed, SHORT, 12);
    assert_ne!(one.train, other.train);
    assert_ne!(one.train[0].input, one.train[1].input);
    assert_ne!(one.train[0].input, one.holdout[0].input);
}

#[test]
fn a_table_has_a_row_for_each_sample() {
    let made = experiment(Setup::MotorPosition, Draw::Nothing, SHORT, 3);
    let mut text = Vec::new();
    made.train[0].write_csv(made.setup, &mut text).unwrap();
    let text = String::from_utf8(text).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time_s,duty,supply_v,theta_rad"));
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 1600);
    assert_eq!(rows[200][0], 1.0);
    assert!(rows.iter().zip(&made.train[0].output).all(|(row, output)| row.len() == 4 && row[3] == *output));
    let axis = experiment(Setup::AxisPosition, Draw::Nothing, SHORT, 3);
    let mut text = Vec::new();
    axis.train[0].write_csv(axis.setup, &mut text).unwrap();
    assert!(text.starts_with(b"time_s,force_n,position_m\n0,"));
}

#[test]
fn an_axis_moves_by_its_force_and_mass() {
    let made = experiment(Setup::AxisPosition, Draw::Nothing, SHORT, 9);
    let Model::LinearActuator(rod) = made.base.model() else { panic!("{:?}", made.base) };
    let run = &made.train[0];
    // M dv = (F - B v) dt over a run from rest: the sum of forces is B times the travel, plus M times the final speed.
    let pushed: f64 = run.input.iter().sum::<f64>() * 5e-3;
    let last = run.clean.len() - 1;
    let speed = (run.clean[last] - run.clean[last - 2]) / 0.01;
    let per_n = made.input_per_duty;
    let damping = rod.viscous_n_s_per_m + per_n * per_n / 1e4;
    let told = damping * run.clean[last] + rod.moving_mass_kg * speed;
    // The last input is half a sample off, and the speed a sample.
    assert!((told - pushed).abs() < 0.02 * per_n, "{told} {pushed}");
}

#[test]
fn every_effect_of_the_catalogue_is_hidden_or_refused_for_a_reason() {
    for info in r4_plants::catalogue() {
        let candidate = CANDIDATES.iter().find(|candidate| candidate.name == info.name);
        let refused = NEVER.iter().find(|(name, _)| *name == info.name);
        assert!(candidate.is_some() != refused.is_some(), "{}", info.name);
        let Some(candidate) = candidate else { continue };
        let scale = Scale::of(&motor(), 24.0);
        let mut dice = Dice::new(1, 1);
        for _ in 0..50 {
            let effect = (candidate.draw)(&mut dice, &scale);
            assert_eq!(effect.name(), candidate.name);
            let kind = if info.kinds.contains(&PlantKind::Rotary) { PlantKind::Rotary } else { PlantKind::Linear };
            assert_eq!(effect.check(kind), Ok(()), "{effect:?}");
        }
    }
    for setup in Setup::ALL {
        assert!(setup.excluded().iter().all(|(name, why)| EffectInfo::named(name).is_some() && !why.is_empty()));
    }
    assert!(NOT_ON_BOARDS.iter().all(|(name, _)| EffectInfo::named(name).is_some()));
    assert!(unlisted::KINDS.iter().all(|(name, _)| EffectInfo::named(name).is_none()));
}

#[test]
fn every_unlisted_effect_can_be_hidden_and_tells_its_name() {
    let scale = Scale::of(&motor(), 24.0);
    for (name, make) in unlisted::KINDS {
        let (_, page) = make(&mut Dice::new(1, 1), &scale);
        assert_eq!(page.name, *name);
        assert!(!page.depends_on.is_empty() && page.parameters.iter().all(|(_, value, _)| value.is_finite()));
    }
    let told: Vec<_> = (0..40).map(|seed| hide_as(Draw::Unlisted, &motor(), 24.0, seed)).collect();
    for (name, _) in unlisted::KINDS {
        assert!(told.iter().any(|hidden| hidden.truth()[0].name == *name), "{name} never shows");
    }
}
