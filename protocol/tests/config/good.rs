//! A valid configuration that has every kind of channel in every form, and the places of these channels.

use r4_protocol::{
    ChannelId, ChannelKind, Range,
    config::{
        AnalogConfig, As5600Config, BldcConfig, BoardConfig, BridgeConfig, BridgeLines, CanConfig, ControlConfig,
        CurrentSense, DacChipConfig, DacConfig, DhbLines, DriveLine, EncoderConfig, ExpanderConfig, FeedForward,
        Feedback, FollowConfig, ForceConfig, ForceSensor, HomingConfig, Icm20948Config, MotorConfig, MotorSideConfig,
        PidGains, PotPoint, ProfileLimits, PwmConfig, RangeConfig, RelayConfig, RelayRole, Reverse, SensorChip,
        SensorConfig, ServoChipConfig, ServoConfig, ServoPoint, SettleConfig, StallConfig, StepperBankConfig,
        StepperConfig, SupplyConfig, SwitchConfig, WindingConfig,
    },
};

/// Makes the name of channel `index` of `kind`.
pub(crate) const fn id(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// Makes a valid configuration: `osmc0` and `dhb0` with encoders, `actuator1` with a potentiometer, `osmc2` in open
/// loop; brushless drives with every kind of reversal; a servo for either direction; steppers with and without homing;
/// inputs with and without limits.
pub(crate) fn good() -> BoardConfig {
    BoardConfig {
        robot: "test-bench".try_into().expect("short"),
        control_period_us: 1000,
        link_timeout_ms: 200,
        i2c_hz: 400_000,
        auxiliary_stop: true,
        screen: true,
        air_temperature_c: 20.0,
        osmc_pwm: Some(PwmConfig { address: 0x40, frequency_hz: 1526.0 }),
        dhb_pwm: Some(PwmConfig { address: 0x41, frequency_hz: 1526.0 }),
        servo_pwm: Some(ServoChipConfig {
            address: 0x42,
            frequency_hz: 50.0,
            oscillator_hz: 25e6,
            hold_when_safe: true,
        }),
        bldc_dac: Some(DacChipConfig { address: 0x60, full_scale_v: 5.0 }),
        expander: Some(ExpanderConfig { address: 0x20 }),
        stepper_bank: Some(StepperBankConfig {
            enable_active_low: true,
            enable_setup_us: 5000,
            direction_setup_us: 20,
            rate_max_hz: 50e3,
            hold_when_safe: false,
        }),
        motors: motors().into_iter().collect(),
        bldcs: bldcs().into_iter().collect(),
        servos: servos().into_iter().collect(),
        steppers: steppers().into_iter().collect(),
        relays: [(0, 8, RelayRole::MotorPower), (1, 15, RelayRole::General)]
            .map(|(index, bit, role)| RelayConfig { id: id(ChannelKind::Relay, index), bit, active_low: true, role })
            .into_iter()
            .collect(),
        dacs: [0, 1]
            .map(|index| DacConfig { id: id(ChannelKind::Dac, index), range_v: Range::new(0.5, 3.0), safe_v: 0.5 })
            .into_iter()
            .collect(),
        encoders: [0, 3]
            .map(|index| EncoderConfig { id: id(ChannelKind::Encoder, index), counts_per_turn: 2400, inverted: false })
            .into_iter()
            .collect(),
        switches: [0, 1, 3]
            .map(|index| SwitchConfig { id: id(ChannelKind::Switch, index), active_low: true })
            .into_iter()
            .collect(),
        ranges: [(0, Some(0.3)), (1, None)]
            .map(|(index, stop_below_m)| RangeConfig {
                id: id(ChannelKind::Range, index),
                range_m: Range::new(0.02, 4.0),
                stop_below_m,
            })
            .into_iter()
            .collect(),
        analogs: [4, 5]
            .map(|index| AnalogConfig {
                id: id(ChannelKind::Analog, index),
                volts_per_code: 1e-4,
                offset_v: -0.1,
                plausible_v: Range::new(0.2, 5.0),
            })
            .into_iter()
            .collect(),
        supplies: [(0, 1), (1, 2)]
            .map(|(index, analog)| SupplyConfig {
                id: id(ChannelKind::Supply, index),
                analog,
                volts_per_code: 5e-4, // 32.8 V at the highest code
                range_v: Range::new(20.0, 30.0),
                regeneration_v: (index == 0).then_some(28.0),
            })
            .into_iter()
            .collect(),
        can: CanConfig::default(),
        sensors: [
            SensorConfig {
                id: id(ChannelKind::Imu, 0),
                address: 0x68,
                rate_hz: 25,
                chip: SensorChip::Icm20948(Icm20948Config { acceleration_max_g: 4, rate_max_deg_s: 500 }),
            },
            SensorConfig {
                id: id(ChannelKind::Angle, 7),
                address: 0x36,
                rate_hz: 250,
                chip: SensorChip::As5600(As5600Config { averages: 4 }),
            },
        ]
        .into_iter()
        .collect(),
    }
}

fn motors() -> [MotorConfig; 5] {
    let control = ControlConfig {
        feedback: Feedback::Encoder { index: 0, counts_per_turn: 2400, inverted: false, counts_per_index: 2400 },
        position: Range::symmetric(8.0),
        speed_max: 20.0,
        position_pid: PidGains { kp: 1.0, ki: 0.5, kd: 0.01 },
        speed_pid: PidGains { kp: 0.05, ki: 0.5, kd: 0.0 },
        cascade_per_s: 8.0,
        speed_filter_s: 0.002,
        profile: ProfileLimits { speed: 10.0, acceleration: 50.0, jerk: 500.0 },
        feed_forward: FeedForward { static_duty: 0.03, duty_per_speed: 0.04, duty_per_acceleration: 0.0 },
        settle: SettleConfig { error: 0.01, speed: 0.05, time_ms: 50 },
        stall: StallConfig { duty: 0.5, travel: 0.05, time_ms: 500 },
        follow: FollowConfig { error: 0.5, time_ms: 500 },
        homing: None,
        motor_side: Some(MotorSideConfig { index: 2, counts_per_turn: 9600, inverted: false, gap_max: 0.1 }),
        force: Some(ForceConfig {
            sensor: ForceSensor::Analog { analog: 4, zero_v: 0.5, newtons_per_v: 10.0 },
            range: Range::new(0.0, 20.0),
            limit_n: 30.0,
            speed_per_n: 0.1,
            approach_speed: 1.0,
            contact_n: 0.5,
            error_n: 0.2,
            filter_s: 0.005,
            drift_s: 10.0,
        }),
    };
    let wheel = MotorConfig {
        id: id(ChannelKind::Osmc, 0),
        bridge: BridgeConfig::Osmc(BridgeLines { ahi: 0, ali: 1, bhi: 2, bli: 3 }),
        inverted: false,
        duty_max: 0.9,
        duty_slew_per_s: 10.0,
        control: Some(control),
        winding: Some(WindingConfig {
            supply: Some(1),
            nominal_v: 24.0,
            dead_duty: 0.0,
            resistance_ohm: 0.5,
            back_emf: 1.0,
            rated_a: 5.0,
            thermal_s: 30.0,
            current_sense: Some(CurrentSense { analog: 4, zero_v: 2.5, volts_per_a: 0.066 }),
        }),
        stop_brake_ms: 500,
    };
    let rod = MotorConfig {
        id: id(ChannelKind::Actuator, 1),
        bridge: BridgeConfig::Osmc(BridgeLines { ahi: 5, ali: 4, bhi: 7, bli: 6 }),
        control: Some(ControlConfig {
            feedback: Feedback::Potentiometer {
                analog: 0,
                low: PotPoint { code: 60_000, position_m: 0.0 },
                high: PotPoint { code: 4_000, position_m: 0.1 },
            },
            position: Range::new(0.01, 0.09),
            motor_side: None,
            ..control
        }),
        ..wheel
    };
    let fan = MotorConfig {
        id: id(ChannelKind::Osmc, 2),
        bridge: BridgeConfig::Osmc(BridgeLines { ahi: 8, ali: 9, bhi: 10, bli: 11 }),
        control: None,
        winding: None,
        ..wheel
    };
    let arm = MotorConfig {
        id: id(ChannelKind::Dhb, 0),
        bridge: BridgeConfig::Dhb(DhbLines { in1: 0, in2: 1, en: 2 }),
        control: Some(ControlConfig {
            feedback: Feedback::Encoder { index: 1, counts_per_turn: 4000, inverted: true, counts_per_index: 0 },
            homing: Some(HomingConfig { switch: 1, position: -1.5, speed_max: 0.5 }),
            motor_side: None,
            ..control
        }),
        ..wheel
    };
    let hip = MotorConfig {
        id: id(ChannelKind::Dhb, 1),
        bridge: BridgeConfig::Dhb(DhbLines { in1: 3, in2: 4, en: 5 }),
        control: Some(ControlConfig {
            feedback: Feedback::Angle { angle: 7, zero: 1.0, inverted: false },
            position: Range::symmetric(3.0),
            motor_side: None,
            ..control
        }),
        ..wheel
    };
    [wheel, rod, fan, arm, hip]
}

fn bldcs() -> [BldcConfig; 3] {
    let one_way = BldcConfig {
        id: id(ChannelKind::Bldc, 0),
        output: 0,
        neutral_v: 0.0,
        forward_v: 5.0,
        reverse: Reverse::None,
        brake: None,
        slew_per_s: 2.0,
        stop_brake_ms: 0,
    };
    let by_line = BldcConfig {
        id: id(ChannelKind::Bldc, 1),
        output: 1,
        reverse: Reverse::Line { line: DriveLine { bit: 0, active_low: false }, rest_ms: 300 },
        brake: Some(DriveLine { bit: 1, active_low: true }),
        ..one_way
    };
    let by_voltage = BldcConfig {
        id: id(ChannelKind::Bldc, 2),
        output: 3,
        neutral_v: 2.5,
        forward_v: 4.5,
        reverse: Reverse::Voltage { full_v: 0.5 },
        ..one_way
    };
    [one_way, by_line, by_voltage]
}

fn servos() -> [ServoConfig; 2] {
    let pan = ServoConfig {
        id: id(ChannelKind::Servo, 0),
        output: 0,
        low: ServoPoint { pulse_s: 1e-3, angle_rad: -0.75 },
        high: ServoPoint { pulse_s: 2e-3, angle_rad: 0.75 },
        speed_max: 5.0,
    };
    let tilt = ServoConfig {
        id: id(ChannelKind::Servo, 15),
        output: 15,
        low: ServoPoint { angle_rad: 0.75, ..pan.low },
        high: ServoPoint { angle_rad: -0.75, ..pan.high },
        ..pan
    };
    [pan, tilt]
}

fn steppers() -> [StepperConfig; 2] {
    let table = StepperConfig {
        id: id(ChannelKind::Stepper, 0),
        steps_per_turn: 3200,
        inverted: false,
        position: Range::symmetric(100.0),
        speed_max: 60.0,
        acceleration: 200.0,
        jerk: 0.0,
        start_speed: 2.0,
        homing: None,
        stop_brake_ms: 0,
    };
    let slide = StepperConfig {
        id: id(ChannelKind::Stepper, 3),
        jerk: 2000.0,
        homing: Some(HomingConfig { switch: 3, position: 0.0, speed_max: 5.0 }),
        ..table
    };
    [table, slide]
}
