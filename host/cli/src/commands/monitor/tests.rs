//! Tests of the screen with a simulated state: no board is involved.

use std::{collections::BTreeSet, f64::consts::TAU};

use crossterm::event::KeyCode::{self, Backspace, Char, Down, Enter, Esc, Home, PageDown, Up};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelInfo, ChannelKind, DeviceInfo, DeviceStats, FaultInfo, Mode, ModeInfo,
    ParameterInfo, ParameterKey, Quality, Range, Refusal, SafetyState, Sample, Setpoint, Telemetry, Unit, Winding,
    message::MAX_SAMPLES,
};
use ratatui::{Terminal, backend::TestBackend};

use super::{
    Ask, Key, draw,
    draw::{HELP, KEYS},
    meaning,
    order::Order,
    state::{SILENT_S, State, View},
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

/// Sample of a channel at time `at_s`, s.
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
            winding: None,
        },
        ChannelKind::Encoder => Sample::Encoder { channel, position, speed: 0.0, illegal: 0 },
        ChannelKind::Range => Sample::Reading { channel, value: 0.0, age_ms: 40, quality: Quality::NoAnswer },
        ChannelKind::Supply => Sample::Reading { channel, value: 12.31, age_ms: 0, quality: Quality::Good },
        _ => Sample::Scalar { channel, value: 1.0 },
    }
}

/// State of a board after `seconds` s of telemetry.
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
fn a_hot_winding_is_named_until_it_has_cooled() {
    let screen = |state: &State| snapshot::text(120, 40, |frame| draw(frame, state));
    let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
    assert!(!screen(&state).contains("winding"));
    for (hot, heat_percent) in [(true, 83), (false, 70)] {
        let mut of = sample(&few()[0], 2.0);
        if let Sample::Motor { winding, .. } = &mut of {
            *winding = Some(Winding { heat_percent, hot });
        }
        let samples = [of].into_iter().collect();
        state.telemetry(
            &Telemetry { device_us: 3_000_000, state: SafetyState::Armed, causes: Causes::NONE, samples },
            102.0,
        );
        let screen = screen(&state);
        assert_eq!(screen.contains("osmc0 winding 83 %"), hot, "{screen}");
        assert!(screen.contains(&format!(", winding {heat_percent} %")), "{screen}");
    }
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

/// Includes size 0, which a terminal has while it is being resized.
#[test]
fn every_size_can_be_drawn() {
    for channels in [vec![], few(), many()] {
        let mut state = heard(&channels, 1.0, SafetyState::Armed, Causes::NONE);
        state.select(isize::MAX);
        for (width, height) in (5..=165).step_by(5).flat_map(|width| (1..=50).map(move |height| (width, height))) {
            state.view = [View::Channels, View::Parameters, View::Trips, View::Help][usize::from(height) % 4];
            snapshot::text(width, height, |frame| draw(frame, &state));
            state.view = View::Channels;
            snapshot::text(width, height, |frame| draw(frame, &state));
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
    // 48 channels fill six frames.
    assert!((state.link.frames.hz(108.0) - 6.0 * HZ).abs() < 3.0, "{}", state.link.frames.hz(108.0));
    assert!((state.rows[0].rate.hz(108.0) - HZ).abs() < 0.01);
    assert_eq!(state.rows[0].rate.hz(111.0), 0.0, "nothing came for three seconds");
}

#[test]
fn a_sparkline_has_the_highest_and_the_lowest() {
    let state = heard(&few(), 10.0, SafetyState::Disarmed, Causes::NONE);
    // A sine of four seconds, an eighth of a second off in the middle of each cell.
    let cells: Vec<f64> = state.rows[0].cells(11.0, 40, 0.25).into_iter().flatten().collect();
    assert_eq!(cells.len(), 40);
    let (low, high) = cells.iter().fold((1.0f64, 0.0f64), |(low, high), cell| (low.min(*cell), high.max(*cell)));
    assert!(low < 0.02 && high > 0.98, "{low} {high}");
    // A constant is drawn in the middle, with or without noise.
    let flat: Vec<f64> = state.rows[5].cells(11.0, 40, 0.25).into_iter().flatten().collect();
    assert!(flat.iter().all(|cell| (cell - 0.5).abs() < 0.01), "{flat:?}");
}

#[test]
fn keys_are_those_of_the_help_page() {
    let key = |code: KeyCode| meaning(code.into());
    for (code, ask) in
        [(Char('a'), Ask::Arm), (Char('d'), Ask::Disarm), (Char('c'), Ask::Clear), (Char(' '), Ask::Stop)]
    {
        assert_eq!(key(code), Some(Key::Ask(ask)));
        assert!(HELP.to_lowercase().contains(ask.name()));
        assert!(KEYS.iter().any(|(_, does)| does.to_lowercase().contains(ask.name())));
    }
    for (code, expected) in [
        (Up, Key::Select(-1)),
        (Down, Key::Select(1)),
        (Char('q'), Key::Quit),
        (Enter, Key::Prompt),
        (Char('s'), Key::Prompt),
        (Char('g'), Key::Mark),
        (Char('p'), Key::Show(View::Parameters)),
        (Char('t'), Key::Show(View::Trips)),
        (Char('?'), Key::Show(View::Help)),
        (Esc, Key::Back),
    ] {
        assert_eq!(key(code), Some(expected));
    }
    assert!(HELP.chars().count() <= 80);
}

/// Presses keys and returns the requests to the board.
fn press(state: &mut State, keys: impl IntoIterator<Item = KeyCode>) -> Vec<Ask> {
    let mut asked = Vec::new();
    for key in keys {
        assert!(!state.press(key.into(), |ask| asked.push(ask)), "nobody quits");
    }
    asked
}

fn text(text: &str) -> impl Iterator<Item = KeyCode> {
    text.chars().map(Char)
}

#[test]
fn a_set_point_is_typed_checked_and_sent() {
    let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
    assert_eq!(press(&mut state, [Char('s')].into_iter().chain(text("12parsec")).chain([Enter])), []);
    let error = state.prompt.as_ref().and_then(|prompt| prompt.error.clone()).unwrap_or_default();
    assert!(error.contains("units are"), "{error}");
    // A unit that the channel does not accept: `d` and `q` are letters here and do nothing else.
    assert_eq!(press(&mut state, [Backspace; 8].into_iter().chain(text("10mm")).chain([Enter])), []);
    let error = state.prompt.as_ref().and_then(|prompt| prompt.error.clone()).unwrap_or_default();
    assert_eq!(error, "osmc0 takes position -572.96 to 572.96 deg");
    let asked = press(&mut state, [Backspace; 4].into_iter().chain(text("-90deg")).chain([Enter]));
    let [Ask::Set(order)] = asked[..] else { panic!("{asked:?}") };
    assert_eq!((order.channel, order.setpoint.mode), (few()[0].id, Mode::Position));
    assert!((f64::from(order.setpoint.value) + TAU / 4.0).abs() < 1e-6);
    assert_eq!(order.to_string(), "osmc0 position -90.00 deg");
    assert!(state.prompt.is_none());
    // Out of range: the board refuses it and stops the channel.
    let asked = press(&mut state, [Enter].into_iter().chain(text("9999deg")).chain([Enter]));
    let [Ask::Set(order)] = asked[..] else { panic!("{asked:?}") };
    state.refused(order, Refusal::OutOfRange { channel: order.channel, asked: 174.5, range: Range::symmetric(10.0) });
    let said = state.message.map(|message| message.text).unwrap_or_default();
    assert_eq!(
        said,
        "osmc0 position 9999.00 deg on serial:/dev/ttyACM0 is refused, which stops osmc0: it takes position -572.96 to 572.96 deg"
    );
}

#[test]
fn a_stop_goes_out_from_everywhere() {
    for before in [&[][..], &[Char('s')], &[Char('s'), Char('9')], &[Char('?')], &[Char('p')], &[Char('t')]] {
        let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
        let asked = press(&mut state, before.iter().copied().chain([Char(' ')]));
        assert_eq!(asked, [Ask::Stop], "{before:?}");
        assert!(state.prompt.is_none());
    }
}

#[test]
fn nothing_is_sent_to_a_board_that_is_not_armed_or_not_there() {
    let send = || [Char('s')].into_iter().chain(text("90deg")).chain([Enter]);
    let said = |state: &State| state.prompt.as_ref().and_then(|prompt| prompt.error.clone()).unwrap_or_default();
    for safety in [SafetyState::Disarmed, SafetyState::Tripped] {
        let mut state = heard(&few(), 1.0, safety, Causes::NONE);
        assert_eq!(press(&mut state, send()), []);
        assert!(said(&state).contains(&format!("is {safety}")), "{}", said(&state));
    }
    let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
    state.lost("gone".into());
    assert_eq!(press(&mut state, send()), []);
    assert!(said(&state).contains("no link"));
    // A channel that only measures has no prompt.
    let mut state = heard(&few(), 1.0, SafetyState::Armed, Causes::NONE);
    state.select(3);
    assert_eq!(press(&mut state, [Enter]), []);
    assert!(state.prompt.is_none() && state.message.is_some_and(|message| message.text.contains("encoder3 takes no")));
}

#[test]
fn switches_brakes_and_shares_are_typed() {
    let mode = |mode, unit, range| ModeInfo { mode, unit, range };
    let drive = ChannelInfo {
        modes: [
            mode(Mode::Duty, Unit::Duty, Range::symmetric(1.0)),
            mode(Mode::Brake, Unit::Bool, Range::new(0.0, 1.0)),
            mode(Mode::Home, Unit::RadPerS, Range::symmetric(1.0)),
        ]
        .into_iter()
        .collect(),
        ..channel(ChannelKind::Bldc, 0, Unit::Duty)
    };
    let read = |text: &str| Order::read(&drive, text).map(|order| order.to_string());
    assert_eq!(read("-30%").as_deref(), Ok("bldc0 duty -0.300"));
    assert_eq!((read("brake").as_deref(), read("release").as_deref()), (Ok("bldc0 brake on"), Ok("bldc0 brake off")));
    // Seeking a home switch is no set point, and this channel is no relay.
    for text in ["1rad/s", "on"] {
        assert_eq!(read(text), Err("bldc0 takes duty -1.000 to 1.000, brake or release".to_owned()));
    }
}

/// State with parameters and trips, as after the first requests.
fn with_lists() -> State {
    let mut state = heard(&few(), 12.0, SafetyState::Armed, Causes::NONE);
    assert_eq!((state.wanted(), state.wanted()), (vec![Ask::Parameters, Ask::Trips], vec![]), "each once");
    let parameter = |key: &str, active: f32, set: f32| {
        let key: ParameterKey = key.parse().unwrap();
        ParameterInfo { key, active, set, built_in: if key.channel.is_some() { active } else { 200.0 } }
    };
    let mut parameters = vec![parameter("board.link_timeout_ms", 250.0, 250.0)];
    for name in ["position_kp", "position_ki", "duty_max", "speed_max", "settle_error"] {
        parameters.push(parameter(&format!("osmc0.{name}"), 1.25, if name == "duty_max" { 0.5 } else { 1.25 }));
        parameters.push(parameter(&format!("actuator1.{name}"), 3.5, 3.5));
    }
    parameters.sort_by_key(|info| info.key.channel);
    state.parameters = Some(parameters);
    let trip = |number: u32| FaultInfo {
        number,
        start: number / 3,
        device_us: u64::from(number) * 1_234_567,
        causes: Causes::only(if number.is_multiple_of(2) { Cause::DeadMan } else { Cause::LinkLost }),
        snapshots: 0,
    };
    state.trips = Some((1..=32).rev().map(trip).collect());
    state
}

#[test]
fn several_signals_have_colours_and_a_legend() {
    let mut state = with_lists();
    press(&mut state, [Char('g'), Down, Down, Down, Char('g')]);
    for (width, height) in [(80, 24), (160, 50)] {
        // Both signals are in degrees and share one axis.
        snapshot::assert_is("monitor-signals", width, height, |frame| draw(frame, &state));
    }
    press(&mut state, [Down, Down, Char('g')]);
    snapshot::assert_is("monitor-units", 160, 50, |frame| draw(frame, &state));
    let mut terminal = Terminal::new(TestBackend::new(160, 50)).unwrap();
    terminal.draw(|frame| draw(frame, &state)).unwrap();
    let cells = terminal.backend().buffer().content();
    let colours: BTreeSet<String> =
        cells.iter().filter(|cell| cell.symbol() == "\u{25cf}").map(|cell| cell.fg.to_string()).collect();
    assert_eq!(colours.len(), 3, "{colours:?}");
    // At most one mark per colour; a second press removes it.
    press(&mut state, [Home].into_iter().chain([Char('g'), Down].into_iter().cycle().take(16)));
    assert!(state.marked.len() <= 6 && !state.marked.contains(&few()[0].id), "{:?}", state.marked);
}

#[test]
fn lists_and_the_help_page() {
    let mut state = with_lists();
    for (name, key) in [("help", '?'), ("parameters", 'p'), ("trips", 't')] {
        press(&mut state, [Char(key)]);
        snapshot::assert_is(&format!("monitor-{name}"), 80, 24, |frame| draw(frame, &state));
        press(&mut state, [Char(key)]);
        assert_eq!(state.view, View::Channels, "the same key leads back");
    }
    press(&mut state, [Char('t'), PageDown, PageDown, Down]);
    let screen = snapshot::text(80, 24, |frame| draw(frame, &state));
    assert!(screen.contains("31  trip 1 ") && !screen.contains(" more"), "the oldest: {screen}");
    press(&mut state, [Esc, Char('s'), Char('9')]);
    snapshot::assert_is("monitor-prompt", 80, 24, |frame| draw(frame, &state));
}

#[test]
fn a_trip_is_looked_up_when_it_was_written() {
    let mut state = with_lists();
    let at = |state: &mut State, now_s: f64, safety| {
        let frame = Telemetry {
            device_us: (now_s * 1e6) as u64,
            state: safety,
            causes: Causes::NONE,
            samples: Default::default(),
        };
        state.telemetry(&frame, now_s);
        state.now_s = now_s;
        state.wanted()
    };
    assert_eq!(at(&mut state, 120.0, SafetyState::Tripped), []);
    assert_eq!(at(&mut state, 120.5, SafetyState::Tripped), []);
    assert_eq!(at(&mut state, 121.1, SafetyState::Tripped), [Ask::Trips]);
    assert_eq!(at(&mut state, 125.0, SafetyState::Tripped), []);
}
