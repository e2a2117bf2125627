use super::*;
use crate::{
    Problem, Table,
    effect::{
        friction::CoulombFriction,
        table::{On, Over},
    },
};

const WHEEL: &str = r#"model = "dc-gear-motor"
source = "a test"

[parameters]
resistance_ohm = 1
inductance_h = 1e-3
torque_constant_nm_per_a = 0.04
gear_ratio = 25.0
inertia_kg_m2 = 0.02
viscous_nm_s_per_rad = 0.0

[[effects]]
effect = "dead-zone"
duty = 0.4

[[effects]]
torque_nm = 0.3
effect = "coulomb-friction"
"#;

fn message(from: &str, to: &str) -> String {
    assert!(WHEEL.contains(from), "{from}");
    PlantSpec::from_toml("wheel.toml", &WHEEL.replacen(from, to, 1)).unwrap_err().to_string()
}

#[test]
fn a_file_is_read() {
    let wheel = PlantSpec::from_toml("wheel.toml", WHEEL).unwrap();
    assert_eq!(*wheel.model(), Model::DcGearMotor(MOTOR));
    assert_eq!(wheel.effects()[1], Effect::CoulombFriction(CoulombFriction { level: 0.3 }));
    assert_eq!(wheel.source(), "a test");
}

#[test]
fn errors_name_file_line_and_field() {
    for (from, to, expected) in [
        (
            "inertia_kg_m2 = 0.02",
            "inertia_kg_m2 = -0.02",
            "wheel.toml:9: parameters.inertia_kg_m2: -0.02 is outside 1e-9..=1000000.0 kg m^2",
        ),
        ("gear_ratio = 25.0", "gear_ratio = nan", "wheel.toml:8: parameters.gear_ratio: NaN is outside"),
        ("gear_ratio = 25.0", "gear_ratio = \"25:1\"", "wheel.toml:8: parameters.gear_ratio: not a number"),
        ("gear_ratio = 25.0", "gear = 25.0", "wheel.toml:8: parameters.gear: unknown; known are resistance_ohm, "),
        ("gear_ratio = 25.0\n", "", "wheel.toml:4: parameters.gear_ratio: missing; write a number in 1"),
        ("dc-gear-motor", "ac-motor", "wheel.toml:1: model: unknown; known are dc-gear-motor, linear-actuator"),
        ("duty = 0.4", "duty = 4", "wheel.toml:14: effects[0].duty: 4 is outside 0.0..=1.0 1"),
        ("duty = 0.4", "duty = 0.4\ntorque_nm = 1.0", "wheel.toml:15: effects[0].torque_nm: unknown; known are duty"),
        ("\"dead-zone\"", "\"deadzone\"", "wheel.toml:13: effects[0].effect: unknown; known are dead-zone, "),
        ("effect = \"coulomb-friction\"", "", "wheel.toml:16: effects[1].effect: not the name of an effect"),
        ("torque_nm = 0.3", "force_n = 0.3", "wheel.toml:17: effects[1].force_n: unknown; known are torque_nm"),
        ("torque_nm = 0.3", "torque_nm = 0.3 0.4", "wheel.toml:17: TOML parse error at line 17"),
        ("source", "sauce", "wheel.toml:2: TOML parse error at line 2"),
        ("[parameters]", "[numbers]", "wheel.toml:4: TOML parse error at line 4"),
    ] {
        let message = message(from, to);
        assert!(message.starts_with(expected), "{message}\nexpected {expected}");
    }
}

#[test]
fn a_table_is_read_among_the_others_and_its_errors_name_its_fields() {
    let curve = "[[effects]]\neffect = \"table\"\nover = \"position\"\nperiod = 7\nat = [0, 1.5]\nvalues = [0.1, -2]\n";
    let text = WHEEL.replacen("[[effects]]", &format!("{curve}\n[[effects]]"), 1);
    let wheel = PlantSpec::from_toml("wheel.toml", &text).unwrap();
    let expected = Table::new(Over::Position, On::Force, Some(7.0), vec![0.0, 1.5], vec![0.1, -2.0]).unwrap();
    assert_eq!((wheel.tables(), wheel.effects().len()), (&[expected][..], 2));
    for (from, to, expected) in [
        (
            "\"position\"",
            "\"place\"",
            "wheel.toml:14: effects[0].over: unknown; known are input, speed, position, time, ",
        ),
        ("over = \"position\"\n", "", "wheel.toml:12: effects[0].over: unknown; known are input"),
        (
            "period = 7",
            "on = \"duty\"",
            "wheel.toml:15: effects[0].on: unknown; known are force, friction, gain, input, hysteresis",
        ),
        ("period = 7", "period = 1", "wheel.toml:15: effects[0].period: 1 is outside 1.5..="),
        ("period = 7", "period = \"turn\"", "wheel.toml:15: effects[0].period: not a number"),
        ("period = 7", "turn = 7", "wheel.toml:15: effects[0].turn: unknown; known are over, on, period, at, values"),
        ("[0, 1.5]", "[1.5, 0]", "wheel.toml:16: effects[0].at: corner 1 is not above"),
        ("[0, 1.5]", "[0, \"1\"]", "wheel.toml:16: effects[0].at: not a list of numbers"),
        ("values = [0.1, -2]\n", "", "wheel.toml:12: effects[0].values: missing; write"),
        ("values = [0.1, -2]", "values = [0.1]", "wheel.toml:17: effects[0].values: 1 of them for 2 corners"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = PlantSpec::from_toml("wheel.toml", &text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.starts_with(expected), "{message}\nexpected {expected}");
    }
}

#[test]
fn an_effect_of_the_other_kind_of_plant_is_refused() {
    let rod = format!("{}\n[[effects]]\neffect = \"eccentricity\"\n", {
        let actuator = Model::ALL.into_iter().find(|model| model.name() == "linear-actuator").unwrap();
        spec(actuator, &[]).to_toml()
    });
    let message = PlantSpec::from_toml("rod.toml", &rod).unwrap_err().to_string();
    assert!(message.contains(": effects[0].effect: does not exist on linear plants"), "{message}");
}

#[test]
fn a_plant_within_a_larger_file_is_read_and_its_errors_name_the_field() {
    #[derive(Debug, serde::Deserialize)]
    struct Robot {
        left: PlantSpec,
    }
    let nested = WHEEL.replace("[parameters]", "[left.parameters]").replace("[[effects]]", "[[left.effects]]");
    let robot = format!("[left]\n{nested}");
    assert_eq!(toml::from_str::<Robot>(&robot).unwrap().left, PlantSpec::from_toml("", WHEEL).unwrap());
    let error = toml::from_str::<Robot>(&robot.replace("duty = 0.4", "duty = 4")).unwrap_err().to_string();
    assert!(error.contains("effects[0].duty: 4 is outside"), "{error}");
}

#[test]
fn a_description_cannot_be_made_or_changed_into_a_bad_one() {
    let bad = DcGearMotor { inertia_kg_m2: -1.0, ..MOTOR };
    let error = PlantSpec::new(Model::DcGearMotor(bad), "", vec![]).unwrap_err();
    assert_eq!(error.field, "parameters.inertia_kg_m2");

    let mut wheel = PlantSpec::from_toml("wheel.toml", WHEEL).unwrap();
    let before = wheel.clone();
    assert_eq!(wheel.set_parameter("gear_ratio", 0.0).unwrap_err().field, "parameters.gear_ratio");
    assert_eq!(wheel.set_effect_parameter(1, "torque", 0.1).unwrap_err().field, "effects[1].torque");
    assert_eq!(wheel.set_effect_parameter(7, "duty", 0.1).unwrap_err().problem, Problem::NoSuchEffect { effects: 2 });
    let bad = Effect::CoulombFriction(CoulombFriction { level: f64::NAN });
    assert_eq!(wheel.push_effect(bad).unwrap_err().field, "effects[2].torque_nm");
    assert_eq!(wheel.remove_effect(2), None);
    assert_eq!(wheel, before);

    wheel.set_parameter("gear_ratio", 50.0).unwrap();
    wheel.set_effect_parameter(1, "torque_nm", 0.1).unwrap();
    assert_eq!(wheel.effects()[1], Effect::CoulombFriction(CoulombFriction { level: 0.1 }));
}
