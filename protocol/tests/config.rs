//! `BoardConfig::validate`: every rule can be broken, by one change to a good configuration, and nothing panics.

use proptest::{
    arbitrary::any,
    collection::vec,
    prelude::{BoxedStrategy, Strategy},
    prop_assert, prop_assert_eq, prop_oneof, proptest,
    sample::select,
};
use r4_protocol::{
    ChannelId, ChannelKind, Range,
    config::{
        ANALOG_INPUTS, BoardConfig, BridgeLines, ConfigError, ENCODERS, ExpanderConfig, FeedForward, Feedback,
        FollowConfig, MAX_MOTORS, MAX_RELAYS, MAX_SUPPLIES, MotorConfig, OSMC_DUTY_HARD_MAX, PidGains, PotPoint,
        ProfileLimits, PwmConfig, RelayConfig, RelayRole, SettleConfig, StallConfig, SupplyConfig,
    },
};

const OSMC0: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
const ACTUATOR1: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
const RELAY0: ChannelId = ChannelId::new(ChannelKind::Relay, 0);
const RELAY1: ChannelId = ChannelId::new(ChannelKind::Relay, 1);
const SUPPLY0: ChannelId = ChannelId::new(ChannelKind::Supply, 0);
const SUPPLY1: ChannelId = ChannelId::new(ChannelKind::Supply, 1);

/// Channel of the error (`None` is the board), the rule, and the one change that breaks it.
type Case = (Option<ChannelId>, &'static str, fn(&mut BoardConfig));

#[test]
fn the_good_configuration_is_taken() {
    assert_eq!(good().validate(), Ok(()));
    assert_eq!(
        BoardConfig { motors: heapless::Vec::new(), supplies: heapless::Vec::new(), ..good() }.validate(),
        Ok(())
    );
}

#[test]
fn the_ends_of_what_is_allowed_are_taken() {
    let ends: [fn(&mut BoardConfig); 12] = [
        |c| c.control_period_us = 500,
        |c| c.control_period_us = 20_000,
        |c| c.link_timeout_ms = 20,
        |c| c.link_timeout_ms = 1000,
        |c| c.osmc_pwm.frequency_hz = 24.0,
        |c| c.osmc_pwm.frequency_hz = 1526.0,
        |c| c.osmc_pwm.address = 0x77,
        |c| c.motors[0].duty_max = OSMC_DUTY_HARD_MAX,
        |c| c.motors[0].id.index = 3,
        |c| c.motors[0].speed_filter_s = 0.0,
        |c| c.motors[0].position_pid = PidGains { kp: 0.0, ki: 0.0, kd: PidGains::MAX },
        |c| c.motors[0].feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0 },
    ];
    for (number, change) in ends.into_iter().enumerate() {
        let mut config = good();
        change(&mut config);
        assert_eq!(config.validate(), Ok(()), "end number {number}");
    }
}

#[test]
fn every_rule_of_the_board_can_be_broken() {
    let period = "control_period_us must be 500 to 20000";
    let timeout = "link_timeout_ms must be 20 to 1000";
    let frequency = "the PWM chip has 24 to 1526 Hz";
    let address = "a PCA9685 has an address from 0x40 to 0x77";
    let cases: [Case; 11] = [
        (None, period, |c| c.control_period_us = 499),
        (None, period, |c| c.control_period_us = 20_001),
        (None, period, |c| c.control_period_us = u32::MAX),
        (None, timeout, |c| c.link_timeout_ms = 19),
        (None, timeout, |c| c.link_timeout_ms = 1001),
        (None, frequency, |c| c.osmc_pwm.frequency_hz = 24.0f32.next_down()),
        (None, frequency, |c| c.osmc_pwm.frequency_hz = 1526.0f32.next_up()),
        (None, frequency, |c| c.osmc_pwm.frequency_hz = f32::NAN),
        (None, address, |c| c.osmc_pwm.address = 0x3F),
        (None, address, |c| c.osmc_pwm.address = 0x78),
        (None, address, |c| c.osmc_pwm.address = u8::MAX),
    ];
    check(&cases);
}

#[test]
fn every_rule_of_a_motor_can_be_broken() {
    let osmc = Some(OSMC0);
    let (wheel, arm) = (0, 1);
    assert_eq!((good().motors[wheel].id, good().motors[arm].id), (OSMC0, ACTUATOR1), "the indices used below");
    let kind = "an osmc channel needs an encoder, an actuator a potentiometer";
    let low_high = "the low calibration point must be below the high one";
    let duty = "duty_max must be above 0 and at most 0.98";
    let position = "position must have a finite min below a finite max";
    let speed = "speed_max must be positive";
    let slew = "duty_slew_per_s must be positive";
    let gains = "gains must be 0 to 1000000";
    let filter = "speed_filter_s must not be negative";
    let profile = "profile speed and acceleration must be positive";
    let forward = "feed-forward must not be negative, and static_duty must stay below duty_max";
    let settle = "settle error and speed must be positive";
    let stall = "stall duty, travel and time must be positive";
    let unseen = "stall duty must be below duty_max, or a stall is never seen";
    let follow = "follow error and time must be positive";
    let cases: [Case; 49] = [
        (osmc, kind, |c| c.motors[0].feedback = c.motors[1].feedback),
        (Some(ACTUATOR1), kind, |c| c.motors[1].feedback = c.motors[0].feedback),
        (Some(SUPPLY0), kind, |c| c.motors[0].id = SUPPLY0),
        (osmc, "counts_per_turn must be positive", |c| {
            c.motors[0].feedback = Feedback::Encoder { index: 0, counts_per_turn: 0, inverted: false };
        }),
        (Some(ACTUATOR1), "the calibration points need different codes", |c| pot(c, |low, high| low.code = high.code)),
        (Some(ACTUATOR1), low_high, |c| pot(c, |low, high| low.position_m = high.position_m)),
        (Some(ACTUATOR1), low_high, |c| pot(c, |low, _| low.position_m = f32::NEG_INFINITY)),
        (Some(ACTUATOR1), low_high, |c| pot(c, |_, high| high.position_m = f32::NAN)),
        (Some(ChannelId::new(ChannelKind::Osmc, 4)), "bridges are numbered 0 to 3", |c| c.motors[0].id.index = 4),
        (osmc, position, |c| c.motors[0].position = Range::new(1.0, 1.0)),
        (osmc, position, |c| c.motors[0].position = Range::new(f32::NAN, 1.0)),
        (osmc, position, |c| c.motors[0].position.min = f32::NEG_INFINITY),
        (osmc, position, |c| c.motors[0].position.max = f32::INFINITY),
        (osmc, speed, |c| c.motors[0].speed_max = 0.0),
        (osmc, speed, |c| c.motors[0].speed_max = f32::INFINITY),
        (osmc, duty, |c| c.motors[0].duty_max = 0.0),
        (osmc, duty, |c| c.motors[0].duty_max = OSMC_DUTY_HARD_MAX.next_up()),
        (osmc, duty, |c| c.motors[0].duty_max = f32::NAN),
        (osmc, slew, |c| c.motors[0].duty_slew_per_s = 0.0),
        (osmc, slew, |c| c.motors[0].duty_slew_per_s = f32::NAN),
        (osmc, gains, |c| c.motors[0].position_pid.kp = -1.0),
        (osmc, gains, |c| c.motors[0].position_pid.ki = f32::NAN),
        (osmc, gains, |c| c.motors[0].position_pid.kd = f32::INFINITY),
        (osmc, gains, |c| c.motors[0].speed_pid.kp = f32::NAN),
        (osmc, gains, |c| c.motors[0].speed_pid.ki = -f32::MIN_POSITIVE),
        (osmc, gains, |c| c.motors[0].speed_pid.kd = -1.0),
        (osmc, gains, |c| c.motors[0].position_pid.kp = PidGains::MAX.next_up()),
        (osmc, filter, |c| c.motors[0].speed_filter_s = -0.001),
        (osmc, filter, |c| c.motors[0].speed_filter_s = f32::NAN),
        (osmc, profile, |c| c.motors[0].profile.speed = 0.0),
        (osmc, profile, |c| c.motors[0].profile.acceleration = -1.0),
        (osmc, forward, |c| c.motors[0].feed_forward.static_duty = -0.01),
        (osmc, forward, |c| c.motors[0].feed_forward.static_duty = c.motors[0].duty_max),
        (osmc, forward, |c| c.motors[0].feed_forward.duty_per_speed = -0.01),
        (osmc, forward, |c| c.motors[0].feed_forward.duty_per_speed = f32::NAN),
        (osmc, settle, |c| c.motors[0].settle.error = 0.0),
        (osmc, settle, |c| c.motors[0].settle.speed = f32::NAN),
        (osmc, stall, |c| c.motors[0].stall.duty = 0.0),
        (osmc, stall, |c| c.motors[0].stall.duty = f32::NAN),
        (osmc, stall, |c| c.motors[0].stall.travel = -1.0),
        (osmc, stall, |c| c.motors[0].stall.time_ms = 0),
        (osmc, unseen, |c| c.motors[0].stall.duty = c.motors[0].duty_max),
        (osmc, unseen, |c| c.motors[0].stall.duty = 1.0),
        (osmc, follow, |c| c.motors[0].follow.error = 0.0),
        (osmc, follow, |c| c.motors[0].follow.error = f32::NAN),
        (osmc, follow, |c| c.motors[0].follow.error = f32::INFINITY),
        (osmc, follow, |c| c.motors[0].follow.time_ms = 0),
        // The second motor's numbers are looked at too.
        (Some(ACTUATOR1), speed, |c| c.motors[1].speed_max = -1.0),
        (Some(ACTUATOR1), stall, |c| c.motors[1].stall.travel = f32::INFINITY),
    ];
    check(&cases);
}

#[test]
fn every_rule_of_a_relay_can_be_broken() {
    let bits = "expander bits must be 0 to 15, each used once";
    let address = "an MCP23017 has an address from 0x20 to 0x27";
    let cases: [Case; 7] = [
        (Some(OSMC0), "a relay needs a relay channel name", |c| c.relays[0].id = OSMC0),
        (Some(RELAY0), "a relay needs the expander", |c| c.expander = None),
        (Some(RELAY0), bits, |c| c.relays[0].bit = 16),
        (Some(RELAY1), bits, |c| c.relays[1].bit = c.relays[0].bit),
        (Some(RELAY1), "the channel is named twice", |c| c.relays[0].id = RELAY1),
        (None, address, |c| c.expander = Some(ExpanderConfig { address: 0x1F })),
        (None, address, |c| c.expander = Some(ExpanderConfig { address: 0x28 })),
    ];
    check(&cases);
}

#[test]
fn every_rule_of_a_supply_can_be_broken() {
    let volts = "volts_per_code must be positive";
    let range = "range_v must have a finite min below a finite max";
    let cases: [Case; 7] = [
        (Some(SUPPLY0), range, |c| c.supplies[0].range_v = Range::new(f32::NEG_INFINITY, f32::INFINITY)),
        (Some(OSMC0), "a supply needs a supply channel name", |c| c.supplies[0].id = OSMC0),
        (Some(SUPPLY0), volts, |c| c.supplies[0].volts_per_code = 0.0),
        (Some(SUPPLY0), volts, |c| c.supplies[0].volts_per_code = f32::NAN),
        (Some(SUPPLY0), range, |c| c.supplies[0].range_v = Range::new(30.0, 20.0)),
        (Some(SUPPLY0), range, |c| c.supplies[0].range_v = Range::new(20.0, f32::NAN)),
        (Some(SUPPLY1), range, |c| c.supplies[1].range_v = Range::new(20.0, 20.0)),
    ];
    check(&cases);
}

#[test]
fn every_rule_between_channels_can_be_broken() {
    let lines = "bridge lines must be 0 to 15, each used once";
    let encoder = "the encoder must exist and be used once";
    let analog = "the analog input must exist and be used once";
    let twice = "the channel is named twice";
    let in_a_row = "a bridge's lines must be four in a row, so that one transfer sets them";
    let cases: [Case; 13] = [
        (Some(OSMC0), in_a_row, |c| c.motors[0].lines = BridgeLines { ahi: 0, ali: 1, bhi: 2, bli: 12 }),
        (Some(ChannelId::new(ChannelKind::Actuator, 0)), "the bridge connector is used twice", |c| {
            c.motors[1].id.index = c.motors[0].id.index
        }),
        (Some(OSMC0), lines, |c| c.motors[0].lines = BridgeLines { ahi: 13, ali: 14, bhi: 15, bli: 16 }),
        (Some(OSMC0), lines, |c| c.motors[0].lines.bli = u8::MAX),
        (Some(OSMC0), lines, |c| c.motors[0].lines.bli = c.motors[0].lines.ahi),
        (Some(ACTUATOR1), lines, |c| c.motors[1].lines = c.motors[0].lines),
        (Some(OSMC0), encoder, |c| {
            c.motors[0].feedback = Feedback::Encoder { index: ENCODERS as u8, counts_per_turn: 4000, inverted: false };
        }),
        (Some(ChannelId::new(ChannelKind::Osmc, 2)), encoder, |c| {
            let second = MotorConfig {
                id: ChannelId::new(ChannelKind::Osmc, 2),
                lines: BridgeLines { ahi: 8, ali: 9, bhi: 10, bli: 11 },
                ..c.motors[0]
            };
            c.motors.push(second).expect("there is room for four");
        }),
        (Some(ACTUATOR1), analog, |c| {
            if let Feedback::Potentiometer { analog, .. } = &mut c.motors[1].feedback {
                *analog = ANALOG_INPUTS as u8;
            }
        }),
        (Some(SUPPLY0), analog, |c| c.supplies[0].analog = u8::MAX),
        (Some(SUPPLY0), analog, |c| c.supplies[0].analog = 0), // the actuator's
        (Some(SUPPLY1), analog, |c| c.supplies[1].analog = c.supplies[0].analog),
        (Some(SUPPLY0), twice, |c| c.supplies[1].id = SUPPLY0),
    ];
    check(&cases);
    let mut config = good();
    config.motors[1] = MotorConfig {
        lines: config.motors[1].lines,
        feedback: Feedback::Encoder { index: 1, counts_per_turn: 4000, inverted: false },
        ..config.motors[0]
    };
    assert_eq!(config.validate(), Err(ConfigError { channel: Some(OSMC0), rule: twice }));
}

#[test]
fn an_error_names_its_channel() {
    let error = ConfigError { channel: Some(ACTUATOR1), rule: "speed_max must be positive" };
    assert_eq!(error.to_string(), "actuator1: speed_max must be positive");
    let error = ConfigError { channel: None, rule: "link_timeout_ms must be 20 to 1000" };
    assert_eq!(error.to_string(), "link_timeout_ms must be 20 to 1000");
}

proptest! {
    #[test]
    fn no_configuration_panics(config in configs()) {
        let checked = config.validate();
        prop_assert_eq!(checked, config.clone().validate());
        if let Err(ConfigError { channel: Some(id), .. }) = checked {
            let known = config.motors.iter().map(|m| m.id).chain(config.supplies.iter().map(|s| s.id)).any(|k| k == id);
            prop_assert!(known, "{id} is not in the configuration");
        }
    }

    /// Where `configs` is too wild to get past the first rules: a good one with one motor's or supply's part replaced.
    #[test]
    fn no_part_of_a_configuration_panics(
        motor in motors(),
        supply in supplies(),
        lines in lines(),
        feedback in feedbacks(),
        which in 0..4u8,
    ) {
        let mut config = good();
        match which {
            0 => config.motors[0] = motor,
            1 => config.supplies[0] = supply,
            2 => config.motors[1].lines = lines,
            _ => config.motors[0].feedback = feedback,
        }
        // Either answer will do.
        let _ = config.validate();
    }
}

fn check(cases: &[Case]) {
    for (number, (channel, rule, change)) in cases.iter().enumerate() {
        let mut config = good();
        change(&mut config);
        assert_eq!(config.validate(), Err(ConfigError { channel: *channel, rule }), "case number {number}");
    }
}

fn pot(config: &mut BoardConfig, change: fn(&mut PotPoint, &mut PotPoint)) {
    if let Feedback::Potentiometer { low, high, .. } = &mut config.motors[1].feedback {
        change(low, high);
    }
}

fn good() -> BoardConfig {
    let wheel = MotorConfig {
        id: OSMC0,
        lines: BridgeLines { ahi: 0, ali: 1, bhi: 2, bli: 3 },
        inverted: false,
        feedback: Feedback::Encoder { index: 0, counts_per_turn: 4000, inverted: false },
        position: Range::symmetric(8.0),
        speed_max: 20.0,
        duty_max: 0.9,
        duty_slew_per_s: 10.0,
        position_pid: PidGains { kp: 1.0, ki: 0.5, kd: 0.01 },
        speed_pid: PidGains { kp: 0.05, ki: 0.5, kd: 0.0 },
        speed_filter_s: 0.002,
        profile: ProfileLimits { speed: 10.0, acceleration: 50.0 },
        feed_forward: FeedForward { static_duty: 0.03, duty_per_speed: 0.04 },
        settle: SettleConfig { error: 0.01, speed: 0.05, time_ms: 50 },
        stall: StallConfig { duty: 0.5, travel: 0.05, time_ms: 500 },
        follow: FollowConfig { error: 0.5, time_ms: 500 },
    };
    let arm = MotorConfig {
        id: ACTUATOR1,
        lines: BridgeLines { ahi: 4, ali: 5, bhi: 6, bli: 7 },
        feedback: Feedback::Potentiometer {
            analog: 0,
            low: PotPoint { code: 60_000, position_m: 0.0 },
            high: PotPoint { code: 4_000, position_m: 0.1 },
        },
        position: Range::new(0.01, 0.09),
        ..wheel
    };
    let rail = |id, analog| SupplyConfig { id, analog, volts_per_code: 5e-4, range_v: Range::new(20.0, 30.0) };
    BoardConfig {
        robot: "test-bench".try_into().expect("short"),
        control_period_us: 1000,
        link_timeout_ms: 200,
        osmc_pwm: PwmConfig { address: 0x40, frequency_hz: 1000.0 },
        motors: [wheel, arm].into_iter().collect(),
        supplies: [rail(SUPPLY0, 1), rail(SUPPLY1, 2)].into_iter().collect(),
        expander: Some(ExpanderConfig { address: 0x20 }),
        relays: [(RELAY0, 8, RelayRole::MotorPower), (RELAY1, 15, RelayRole::General)]
            .map(|(id, bit, role)| RelayConfig { id, bit, active_low: true, role })
            .into_iter()
            .collect(),
    }
}

fn configs() -> impl Strategy<Value = BoardConfig> {
    let pwm = (0x38..0x80u8, f32s()).prop_map(|(address, frequency_hz)| PwmConfig { address, frequency_hz });
    let motors = vec(motors(), 0..=MAX_MOTORS);
    let supplies = vec(supplies(), 0..=MAX_SUPPLIES);
    let expander = proptest::option::of(any::<u8>().prop_map(|address| ExpanderConfig { address }));
    let role = any::<bool>().prop_map(|power| if power { RelayRole::MotorPower } else { RelayRole::General });
    let relay = (ids(), any::<u8>(), any::<bool>(), role).prop_map(|(id, bit, active_low, role)| RelayConfig {
        id,
        bit,
        active_low,
        role,
    });
    let relays = vec(relay, 0..=MAX_RELAYS);
    (0..25_000u32, 0..1200u16, pwm, motors, supplies, expander, relays).prop_map(
        |(control_period_us, link_timeout_ms, osmc_pwm, motors, supplies, expander, relays)| BoardConfig {
            robot: heapless::String::new(),
            control_period_us,
            link_timeout_ms,
            osmc_pwm,
            motors: motors.into_iter().collect(),
            supplies: supplies.into_iter().collect(),
            expander,
            relays: relays.into_iter().collect(),
        },
    )
}

fn motors() -> BoxedStrategy<MotorConfig> {
    let pid = || [f32s(), f32s(), f32s()].prop_map(|[kp, ki, kd]| PidGains { kp, ki, kd });
    let numbers = vec(f32s(), 15);
    (ids(), lines(), feedbacks(), any::<bool>(), pid(), pid(), numbers, any::<(u16, u16, u16)>())
        .prop_map(|(id, lines, feedback, inverted, position_pid, speed_pid, n, (settle_ms, stall_ms, follow_ms))| {
            MotorConfig {
                id,
                lines,
                inverted,
                feedback,
                position: Range { min: n[0], max: n[1] },
                speed_max: n[2],
                duty_max: n[3],
                duty_slew_per_s: n[4],
                position_pid,
                speed_pid,
                speed_filter_s: n[5],
                profile: ProfileLimits { speed: n[6], acceleration: n[7] },
                feed_forward: FeedForward { static_duty: n[8], duty_per_speed: n[9] },
                settle: SettleConfig { error: n[10], speed: n[11], time_ms: settle_ms },
                stall: StallConfig { duty: n[12], travel: n[13], time_ms: stall_ms },
                follow: FollowConfig { error: n[14], time_ms: follow_ms },
            }
        })
        .boxed()
}

fn supplies() -> impl Strategy<Value = SupplyConfig> {
    (ids(), any::<u8>(), [f32s(), f32s(), f32s()]).prop_map(|(id, analog, [volts_per_code, min, max])| SupplyConfig {
        id,
        analog,
        volts_per_code,
        range_v: Range { min, max },
    })
}

fn lines() -> impl Strategy<Value = BridgeLines> {
    any::<[u8; 4]>().prop_map(|[ahi, ali, bhi, bli]| BridgeLines { ahi, ali, bhi, bli })
}

fn feedbacks() -> impl Strategy<Value = Feedback> {
    let point = || (any::<u16>(), f32s()).prop_map(|(code, position_m)| PotPoint { code, position_m });
    prop_oneof![
        (any::<u8>(), any::<u32>(), any::<bool>()).prop_map(|(index, counts_per_turn, inverted)| Feedback::Encoder {
            index,
            counts_per_turn,
            inverted
        }),
        (any::<u8>(), point(), point()).prop_map(|(analog, low, high)| Feedback::Potentiometer { analog, low, high }),
    ]
}

fn ids() -> impl Strategy<Value = ChannelId> {
    (select(vec![ChannelKind::Osmc, ChannelKind::Actuator, ChannelKind::Supply, ChannelKind::Dac]), any::<u8>())
        .prop_map(|(kind, index)| ChannelId::new(kind, index))
}

/// Every bit pattern, and often a number a configuration could have.
fn f32s() -> impl Strategy<Value = f32> {
    prop_oneof![0.001..1.0f32, any::<u32>().prop_map(f32::from_bits)]
}
