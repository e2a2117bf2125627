//! Tests of parameters: the numbers of a configuration, by name.

use std::collections::BTreeSet;

use proptest::{
    arbitrary::any,
    prelude::{Just, ProptestConfig, Strategy},
    prop_assert, prop_assert_eq, prop_oneof, proptest,
    sample::select,
};
use r4_protocol::{
    ChannelId, ChannelKind, Parameter, ParameterKey, SetError,
    config::{BoardConfig, ConfigError},
};

use crate::good::{good, id};

const WHEEL: ChannelId = id(ChannelKind::Osmc, 0);

fn key(text: &str) -> ParameterKey {
    text.parse().unwrap_or_else(|_| panic!("{text} is a parameter"))
}

/// Checks that each parameter changes the field that the firmware reads, and no other.
#[test]
fn a_parameter_is_the_field_of_its_name() {
    type Field = fn(&mut BoardConfig) -> &mut f32;
    let fields: [(&str, f32, Field); 19] = [
        ("board.air_temperature_c", 30.0, |c| &mut c.air_temperature_c),
        ("board.servo_oscillator_hz", 26e6, |c| &mut c.servo_pwm.as_mut().expect("one").oscillator_hz),
        ("osmc2.duty_slew", 3.0, |c| &mut c.motors[2].duty_slew_per_s),
        ("dhb0.position_kd", 0.5, |c| &mut c.motors[3].control.as_mut().expect("one").position_pid.kd),
        ("actuator1.speed_kp", 0.5, |c| &mut c.motors[1].control.as_mut().expect("one").speed_pid.kp),
        ("osmc0.gap_max", 0.2, |c| {
            &mut c.motors[0].control.as_mut().expect("one").motor_side.as_mut().expect("one").gap_max
        }),
        ("osmc0.force_gain", -0.5, |c| {
            &mut c.motors[0].control.as_mut().expect("one").force.as_mut().expect("one").speed_per_n
        }),
        ("osmc0.contact_force", 1.5, |c| {
            &mut c.motors[0].control.as_mut().expect("one").force.as_mut().expect("one").contact_n
        }),
        ("bldc2.neutral_v", 2.25, |c| &mut c.bldcs[2].neutral_v),
        ("servo15.pulse_high", 1.9e-3, |c| &mut c.servos[1].high.pulse_s),
        ("servo15.angle_low", 0.5, |c| &mut c.servos[1].low.angle_rad),
        ("stepper3.home_position", 0.25, |c| &mut c.steppers[1].homing.as_mut().expect("one").position),
        ("dac1.volts_max", 2.5, |c| &mut c.dacs[1].range_v.max),
        ("range0.stop_below", 0.5, |c| c.ranges[0].stop_below_m.as_mut().expect("one")),
        ("supply1.volts_min", 21.0, |c| &mut c.supplies[1].range_v.min),
        ("supply0.regeneration_v", 27.0, |c| c.supplies[0].regeneration_v.as_mut().expect("one")),
        ("actuator1.rated_a", 2.0, |c| &mut c.motors[1].winding.as_mut().expect("one").rated_a),
        ("dhb0.back_emf", 0.25, |c| &mut c.motors[3].winding.as_mut().expect("one").back_emf),
        ("osmc0.current_volts_per_a", 0.1, |c| {
            &mut c.motors[0].winding.as_mut().expect("one").current_sense.as_mut().expect("one").volts_per_a
        }),
    ];
    for (name, value, field) in fields {
        let (mut set, mut written) = (good(), good());
        *field(&mut written) = value;
        assert_eq!(set.set_parameter(key(name), value), Ok(()), "{name}");
        // A value that the good configuration has already would prove nothing.
        assert_ne!(set, good(), "{name}");
        assert_eq!(set, written, "{name}");
    }
}

#[test]
fn every_parameter_is_somewhere_in_the_good_configuration() {
    let listed: BTreeSet<_> = good().parameters().map(|key| key.parameter).collect();
    let missing: Vec<_> = Parameter::all().filter(|parameter| !listed.contains(parameter)).collect();
    assert!(missing.is_empty(), "{missing:?} cannot be reached");
}

#[test]
fn parameters_are_listed_once_in_the_order_of_the_channels() {
    let config = good();
    let keys: Vec<_> = config.parameters().collect();
    let set: BTreeSet<_> = keys.iter().collect();
    assert_eq!(set.len(), keys.len());
    let order: Vec<_> = [None].into_iter().chain(config.channels().map(|(id, _)| Some(id))).collect();
    let place = |key: &ParameterKey| order.iter().position(|channel| *channel == key.channel);
    assert!(keys.is_sorted_by_key(|key| (place(key), key.parameter)));
    let names: Vec<_> = keys.iter().take(7).map(ToString::to_string).collect();
    assert_eq!(
        names,
        [
            "board.link_timeout_ms",
            "board.air_temperature_c",
            "board.servo_oscillator_hz",
            "board.can_rate",
            "board.can_node",
            "board.can_data_rate",
            "osmc0.duty_max"
        ]
    );
}

#[test]
fn only_listed_parameters_are_there() {
    let config = good();
    let listed: BTreeSet<_> = config.parameters().collect();
    let channels = config.channels().map(|(id, _)| Some(id)).chain([None, Some(id(ChannelKind::Osmc, 3))]);
    for channel in channels {
        for parameter in Parameter::all() {
            let key = ParameterKey { channel, parameter };
            assert_eq!(config.parameter(key).is_some(), listed.contains(&key), "{key}");
            if !listed.contains(&key) {
                assert_eq!(good().set_parameter(key, 1.0), Err(SetError::Unknown(key)));
            }
        }
    }
}

#[test]
fn every_parameter_takes_the_value_it_has() {
    let config = good();
    for key in config.parameters() {
        let mut same = config.clone();
        let value = config.parameter(key).expect("it is listed");
        assert_eq!(same.set_parameter(key, value), Ok(()), "{key} {value}");
        assert_eq!(same, config, "{key}");
    }
}

#[test]
fn whole_numbers_are_not_rounded_or_cut() {
    let whole = |rule| Err(SetError::Invalid(ConfigError { channel: Some(WHEEL), rule }));
    let time = whole("this parameter must be a whole number from 0 to 65535");
    let counts = whole("this parameter must be a whole number from 0 to 16777216");
    let time_key = key("osmc0.follow_time_ms");
    let counts_key = key("osmc0.counts_per_turn");
    for (key, value, expected) in [
        (time_key, 65_535.0, Ok(())),
        (time_key, 65_536.0, time),
        (time_key, 100.5, time),
        (time_key, -1.0, time),
        (time_key, f32::NAN, time),
        (time_key, f32::INFINITY, time),
        (counts_key, 16_777_216.0, Ok(())),
        // 2^24 + 2 is an f32, but 2^24 + 1, its neighbour, is not.
        (counts_key, 16_777_218.0, counts),
        (counts_key, 4e9, counts),
        (counts_key, f32::INFINITY, counts),
        (counts_key, f32::NAN, counts),
        (counts_key, 2400.25, counts),
        (counts_key, -2400.0, counts),
    ] {
        let mut config = good();
        assert_eq!(config.set_parameter(key, value), expected, "{key} {value}");
        assert_eq!(config == good(), expected.is_err(), "{key} {value}");
    }
}

/// Sets values of which either alone would be refused.
#[test]
fn several_parameters_are_set_together_or_not_at_all() {
    let (min, max) = (key("osmc0.position_min"), key("osmc0.position_max"));
    let mut config = good();
    assert!(matches!(config.set_parameter(min, 10.0), Err(SetError::Invalid(_))));
    assert_eq!(config.set_parameters([(min, 10.0), (max, 12.0)]), Ok(()));
    assert_eq!((config.parameter(min), config.parameter(max)), (Some(10.0), Some(12.0)));

    let before = config.clone();
    let unknown = key("osmc3.duty_max");
    assert_eq!(config.set_parameters([(max, 13.0), (unknown, 0.5)]), Err(SetError::Unknown(unknown)));
    assert!(matches!(config.set_parameters([(max, 13.0), (min, 14.0)]), Err(SetError::Invalid(_))));
    assert_eq!(config, before);
}

#[test]
fn an_error_says_what_is_wrong() {
    assert_eq!(
        SetError::Unknown(key("board.duty_max")).to_string(),
        "the configuration has no parameter board.duty_max"
    );
    let error = good().set_parameter(key("osmc0.speed_max"), f32::NAN).expect_err("not a number");
    assert_eq!(error.to_string(), "osmc0: speed_max must be positive");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    /// Sets a parameter: either it has that value and nothing else is changed, or the value is refused and nothing is
    /// changed.
    #[test]
    fn a_parameter_is_set_exactly_or_not_at_all((key, value) in settings()) {
        let before = good();
        let mut config = before.clone();
        match config.set_parameter(key, value) {
            Ok(()) => {
                prop_assert_eq!(config.parameter(key), Some(value));
                prop_assert_eq!(config.validate(), Ok(()));
                for other in before.parameters().filter(|other| *other != key) {
                    prop_assert_eq!(config.parameter(other), before.parameter(other), "{} changed {}", key, other);
                }
                prop_assert_eq!(config.set_parameter(key, before.parameter(key).expect("it is listed")), Ok(()));
            }
            Err(SetError::Invalid(_)) => {}
            Err(error) => prop_assert!(false, "{}", error),
        }
        prop_assert_eq!(config, before);
    }
}

#[test]
fn what_is_no_finite_number_is_never_taken() {
    for key in good().parameters() {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut config = good();
            assert!(matches!(config.set_parameter(key, value), Err(SetError::Invalid(_))), "{key} took {value}");
            assert_eq!(config, good());
        }
    }
}

/// Samples a parameter and a value: near the present one, near it and whole, its opposite, or any at all.
fn settings() -> impl Strategy<Value = (ParameterKey, f32)> {
    let config = good();
    let numbers: Vec<_> = config.parameters().filter_map(|key| Some((key, config.parameter(key)?))).collect();
    select(numbers).prop_flat_map(|(key, old)| {
        let value = prop_oneof![
            (0.5..1.5f32).prop_map(move |factor| old * factor),
            (0.5..1.5f32).prop_map(move |factor| (old * factor).round()),
            Just(-old),
            any::<u32>().prop_map(f32::from_bits),
        ];
        (Just(key), value)
    })
}
