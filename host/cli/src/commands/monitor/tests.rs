//! The screen of a board that nobody has.

use std::f64::consts::TAU;

use r4_protocol::{
    Cause, Causes, ChannelId, ChannelInfo, ChannelKind, DeviceInfo, DeviceStats, Mode, ModeInfo, Quality, Range,
    Refusal, SafetyState, Sample, Setpoint, Telemetry, Unit, message::MAX_SAMPLES,
};

use super::{
    Ask, Key, draw,
    draw::HELP,
    meaning,
    state::{SILENT_S, State},
};
use crate::screen::snapshot;

/// Samples of each channel per second.
const HZ: f64 = 20.0;
const RESOLUTION: f32 = 0.001;

fn info() -> DeviceInfo {
    DeviceInfo {
        robot: "test-rig".try_into().unwrap(),
        firmware: "0.1.0".try_into().unwrap(),
        session: 1,
        channels: 0,
        link_timeout_ms: 200,
        device_us: 1_000_000,
        state: SafetyState::Disarmed,
        causes: Causes::NONE,
    }
}

fn channel(kind: ChannelKind, index: u8, unit: Unit) -> ChannelInfo {
    let is_motor = matches!(kind, ChannelKind::Osmc | ChannelKind::Actuator);
    let mode = ModeInfo { mode: Mode::Position, unit, range: Range::symmetric(10.0) };
    ChannelInfo {
        id: ChannelId::new(kind, index),
        unit,
        range: Range::symmetric(10.0),
        rate_hz: 1000.0,
        resolution: if is_motor || kind == ChannelKind::Encoder { RESOLUTION } else { 0.0 },
        modes: if is_motor { [mode].into_iter().collect() } else { Default::default() },
    }
}

fn few() -> Vec<ChannelInfo> {
    vec![
        channel(ChannelKind::Osmc, 0, Unit::Rad),
        channel(ChannelKind::Actuator, 1, Unit::M),
        channel(ChannelKind::Relay, 0, Unit::Bool),
        channel(ChannelKind::Encoder, 3, Unit::Rad),
        channel(ChannelKind::Range, 0, Unit::M),
        channel(ChannelKind::Supply, 0, Unit::V),
        channel(ChannelKind::DeadMan, 0, Unit::Bool),
        channel(ChannelKind::DeadMan, 1, Unit::Bool),
    ]
}

fn many() -> Vec<ChannelInfo> {
    let encoders = (4..44).map(|index| channel(ChannelKind::Encoder, index, Unit::Rad));
    few().into_iter().chain(encoders).collect()
}

/// What a channel tells at a time, s.
fn sample(info: &ChannelInfo, at_s: f64) -> Sample {
    let channel = info.id;
    let turned = (TAU * at_s / 4.0).sin();
    let position = (turned * (1.0 + f64::from(channel.index) / 4.0) / f64::from(RESOLUTION)) as i32;
    match channel.kind {
        ChannelKind::Osmc | ChannelKind::Actuator => Sample::Motor {
            channel,
            setpoint: Setpoint { mode: Mode::Position, value: 1.0 },
            position,
            speed: (TAU * at_s / 4.0).cos() as f32,
            duty: 0.25,
            settled: false,
            homed: channel.kind == ChannelKind::Actuator,
        },
        ChannelKind::Encoder => Sample::Encoder { channel, position, speed: 0.0, illegal: 0 },
        ChannelKind::Range => Sample::Reading { channel, value: 0.0, age_ms: 40, quality: Quality::NoAnswer },
        ChannelKind::Supply => Sample::Reading { channel, value: 12.31, age_ms: 0, quality: Quality::Good },
        _ => Sample::Scalar { channel, value: 1.0 },
    }
}

/// A board that was listened to for so long, s.
fn heard(channels: &[ChannelInfo], seconds: f64, safety: SafetyState, causes: Causes) -> State {
    let mut state = State::new("serial:/dev/ttyACM0".into(), &info(), channels, 100.0);
    for tick in 0..=(seconds * HZ) as u32 {
        let after_s = f64::from(tick) / HZ;
        for some in channels.chunks(MAX_SAMPLES) {
            let samples = some.iter().map(|info| sample(info, after_s)).collect();
            let device_us = ((1.0 + after_s) * 1e6) as u64;
            state.telemetry(&Telemetry { device_us, state: safety, causes, samples }, 100.0 + after_s);
        }
    }
    state.now_s = 100.0 + seconds;
    let stats = DeviceStats { bad_frames: 2, telemetry_dropped: 7, ..DeviceStats::default() };
    state.measured(0.0021, stats);
    state.measured(0.00066, stats);
    state.link.bad = 1;
    state
}

fn assert_is(name: &str, state: &State) {
    for (width, height) in [(80, 24), (120, 40)] {
        snapshot::assert_is(name, width, height, |frame| draw(frame, state));
    }
}

#[test]
fn an_armed_board() {
    let mut state = heard(&few(), 12.0, SafetyState::Armed, Causes::NONE);
    state.done("arm", Ok(()));
    assert_is("monitor-armed", &state);
}

#[test]
fn a_tripped_board_that_will_not_be_cleared() {
    let causes = Causes::only(Cause::DeadMan).union(Causes::only(Cause::HostStop));
    let mut state = heard(&few(), 3.0, SafetyState::Tripped, causes);
    state.done("clear", Err(Refusal::CausesPresent { causes: Causes::only(Cause::DeadMan) }.into()));
    state.select(1);
    assert_is("monitor-tripped", &state);
}

#[test]
fn more_channels_than_lines() {
    let mut state = heard(&many(), 2.0, SafetyState::Disarmed, Causes::NONE);
    state.select(20);
    assert_is("monitor-many", &state);
}

#[test]
fn a_lost_board_and_one_that_comes_back() {
    let mut state = heard(&few(), 2.0, SafetyState::Armed, Causes::NONE);
    state.select(1);
    state.lost("link lost: no heartbeat from the board for 1000 ms".into());
    assert_is("monitor-lost", &state);
    state.reconnected(&info(), &few(), 200.0);
    assert!(state.link.lost.is_none() && state.safety == SafetyState::Disarmed);
    assert!(state.selected == 1 && !state.rows[0].history.is_empty(), "the same board");
    state.reconnected(&info(), &many(), 300.0);
    assert!(state.selected == 0 && state.rows.len() == many().len(), "another board");
}

#[test]
fn a_silent_board_is_told_before_it_is_given_up() {
    let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
    let screen = |state: &State| snapshot::text(80, 24, |frame| draw(frame, state));
    assert!(!screen(&state).contains("SILENT"));
    state.now_s += SILENT_S + 0.1;
    assert!(screen(&state).contains("SILENT for 0.5 s"), "{}", screen(&state));
}

/// Also one of no size at all, as a terminal has that is being made smaller.
#[test]
fn every_size_can_be_drawn() {
    for channels in [vec![], few(), many()] {
        let mut state = heard(&channels, 1.0, SafetyState::Armed, Causes::NONE);
        state.select(isize::MAX);
        for (width, height) in (0..=130).step_by(5).flat_map(|width| (0..=50).map(move |height| (width, height))) {
            if width > 0 && height > 0 {
                snapshot::text(width, height, |frame| draw(frame, &state));
            }
        }
    }
}

#[test]
fn a_channel_that_is_selected_is_always_on_the_screen() {
    let mut state = heard(&many(), 1.0, SafetyState::Armed, Causes::NONE);
    for selected in 0..many().len() {
        state.selected = selected;
        let screen = snapshot::text(80, 24, |frame| draw(frame, &state));
        assert!(screen.contains(&format!("\u{25b8} {}", state.rows[selected].info.id)), "{screen}");
    }
}

#[test]
fn a_board_that_starts_anew_begins_a_new_history() {
    let mut state = heard(&few(), 5.0, SafetyState::Disarmed, Causes::NONE);
    assert!(state.rows[0].history.len() > 90);
    let samples = [sample(&few()[0], 0.0)].into_iter().collect();
    let frame = Telemetry { device_us: 500_000, state: SafetyState::Disarmed, causes: Causes::NONE, samples };
    state.telemetry(&frame, 105.1);
    assert_eq!(state.rows[0].history.len(), 1);
}

#[test]
fn rates_are_those_of_the_last_seconds() {
    let state = heard(&many(), 8.0, SafetyState::Disarmed, Causes::NONE);
    // 48 channels are six frames.
    assert!((state.link.frames.hz(108.0) - 6.0 * HZ).abs() < 3.0, "{}", state.link.frames.hz(108.0));
    assert!((state.rows[0].rate.hz(108.0) - HZ).abs() < 0.01);
    assert_eq!(state.rows[0].rate.hz(111.0), 0.0, "nothing came for three seconds");
}

#[test]
fn a_sparkline_has_the_highest_and_the_lowest() {
    let state = heard(&few(), 10.0, SafetyState::Disarmed, Causes::NONE);
    // A sine of four seconds, in the middle of each cell an eighth of a second off.
    let cells: Vec<f64> = state.rows[0].cells(11.0, 40, 0.25).into_iter().flatten().collect();
    assert_eq!(cells.len(), 40);
    let (low, high) = cells.iter().fold((1.0f64, 0.0f64), |(low, high), cell| (low.min(*cell), high.max(*cell)));
    assert!(low < 0.02 && high > 0.98, "{low} {high}");
    // What does not change is drawn in the middle, noise or not.
    let flat: Vec<f64> = state.rows[5].cells(11.0, 40, 0.25).into_iter().flatten().collect();
    assert!(flat.iter().all(|cell| (cell - 0.5).abs() < 0.01), "{flat:?}");
}

#[test]
fn keys_are_those_of_the_help_line() {
    let key = |code: crossterm::event::KeyCode| meaning(code.into());
    use crossterm::event::KeyCode::{Char, Down, Enter, Up};
    for (code, ask) in
        [(Char('a'), Ask::Arm), (Char('d'), Ask::Disarm), (Char('c'), Ask::Clear), (Char(' '), Ask::Stop)]
    {
        assert_eq!(key(code), Some(Key::Ask(ask)));
        assert!(HELP.to_lowercase().contains(ask.name()));
    }
    assert_eq!(
        (key(Up), key(Down), key(Char('q')), key(Enter)),
        (Some(Key::Select(-1)), Some(Key::Select(1)), Some(Key::Quit), None)
    );
}
