//! The screen of `r4 drive`: a function of the state and the size, and of nothing else.

use r4_protocol::{Causes, ChannelId, SafetyState, Unit};
use ratatui::{
    Frame,
    layout::{Constraint, Layout},
    style::{Modifier, Style},
    text::{Line, Span},
    widgets::Paragraph,
};

use super::hands::Hand;
use crate::{
    quantity::{Quantity, human},
    screen::state::{QUIET, WRONG, badge, wrapped},
};

/// All that is drawn.
pub(super) struct State {
    pub(super) board: String,
    pub(super) robot: String,
    pub(super) safety: SafetyState,
    pub(super) causes: Causes,
    /// What the hands ask for.
    pub(super) hand: Hand,
    /// Of set points and of `most`.
    pub(super) unit: Unit,
    /// The highest set point.
    pub(super) most: f64,
    pub(super) wheels: Vec<Wheel>,
    /// How long the board has been silent, s, where that is too long.
    pub(super) silent_s: Option<f64>,
    /// Something that did not go well.
    pub(super) message: String,
}

/// One motor.
pub(super) struct Wheel {
    pub(super) is_left: bool,
    pub(super) channel: ChannelId,
    /// Set point, in the state's unit.
    pub(super) told: f64,
    /// In `speed_unit`, as the board tells it; `None` before it does and where nothing measures it.
    pub(super) speed: Option<f64>,
    pub(super) speed_unit: Unit,
    /// Share of the supply.
    pub(super) duty: Option<f64>,
}

const HELP: [&str; 2] = [
    "W/S \u{2191}\u{2193} speed  A/D \u{2190}\u{2192} turn  x centre  hold SPACE to move, let go to stop",
    "Enter arm  Backspace disarm  c clear  Esc STOP (trips)  q quit (disarms)",
];
/// Half the width of a bar.
const HALF: usize = 20;

pub(super) fn draw(frame: &mut Frame<'_>, state: &State) {
    let most = Quantity::new(state.most, state.unit);
    let title = format!("{}  {}  up to {most}", state.robot, state.board);
    let causes = if state.causes.is_empty() { String::new() } else { state.causes.to_string() };
    let advice = match (state.silent_s, state.causes.iter().next(), state.safety) {
        (Some(silent_s), ..) => Span::styled(format!("the board has been silent for {silent_s:.1} s"), WRONG),
        (None, Some(cause), _) => Span::styled(cause.advice(), QUIET),
        (None, None, SafetyState::Armed) => Span::styled("wheels follow while space is held", QUIET),
        (None, None, _) => Span::styled("wheels are safe; Enter arms", QUIET),
    };
    let dead_man = if state.hand.is_held {
        Span::styled(" HELD ", Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED))
    } else {
        Span::raw("released: wheels are told to stand still")
    };
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let mut lines = vec![
        Line::styled(title, bold),
        Line::from(vec![badge(Some(state.safety)), Span::raw("  "), Span::styled(causes, WRONG)]),
        advice.into(),
        "".into(),
        Line::from(vec!["dead-man key   ".into(), dead_man]),
        axis("speed", state.hand.forwards, ["backwards", "forwards"]),
        // Left is left: what turns to the left is drawn to the left.
        axis("turn", -state.hand.turn, ["left", "right"]),
        "".into(),
        Line::styled(
            format!("{:<7}{:<12}{:>18}{:>20}{:>10}", "side", "channel", "told", "speed", "duty"),
            Style::new().add_modifier(Modifier::UNDERLINED),
        ),
    ];
    lines.extend(state.wheels.iter().map(|wheel| wheel_line(wheel, state.unit)));
    let mut below = wrapped(&state.message, frame.area().width, WRONG);
    below.extend(HELP.map(|help| Line::styled(help, Style::new().add_modifier(Modifier::REVERSED))));
    let height = u16::try_from(below.len()).unwrap_or(u16::MAX);
    let [body, foot] = Layout::vertical([Constraint::Fill(1), Constraint::Length(height)]).areas(frame.area());
    frame.render_widget(Paragraph::new(lines), body);
    frame.render_widget(Paragraph::new(below), foot);
}

/// A share from -1 to 1 as a bar, and in words.
fn axis(name: &str, share: f64, [negative, positive]: [&str; 2]) -> Line<'static> {
    let percent = format!("{:.0}", share.abs() * 100.0);
    let direction = if share < 0.0 { negative } else { positive };
    let words = if percent == "0" { String::new() } else { format!("{percent} % {direction}") };
    Line::raw(format!("{name:<15}{} {words}", bar(share)))
}

fn wheel_line(wheel: &Wheel, unit: Unit) -> Line<'static> {
    let number = |value: Option<f64>, unit| match value {
        Some(value) => format!("{} {:<5}", Quantity::new(value, unit).number(), human(unit).1),
        None => "-      ".into(),
    };
    let (told, speed) = (number(Some(wheel.told), unit), number(wheel.speed, wheel.speed_unit));
    let duty = wheel.duty.map_or("-".into(), |value| Quantity::new(value, Unit::Duty).number());
    let side = if wheel.is_left { "left" } else { "right" };
    Line::raw(format!("{side:<7}{:<12}{told:>18}{speed:>20}{duty:>10}", wheel.channel.to_string()))
}

/// A bar from the middle, to the right for positive shares.
fn bar(share: f64) -> String {
    let cells = (share.clamp(-1.0, 1.0) * HALF as f64).round() as isize;
    let left = cells.min(0).unsigned_abs();
    let right = cells.max(0).unsigned_abs();
    let (full, empty) = ("\u{2588}", "\u{b7}");
    format!("[{}{}|{}{}]", empty.repeat(HALF - left), full.repeat(left), full.repeat(right), empty.repeat(HALF - right))
}

#[cfg(test)]
mod tests {
    use r4_protocol::{Cause, ChannelKind};

    use super::*;
    use crate::screen::snapshot;

    fn state() -> State {
        let wheel = |index: u8| Wheel {
            is_left: index.is_multiple_of(2),
            channel: ChannelId::new(ChannelKind::Dhb, index),
            told: if index.is_multiple_of(2) { 2.0 } else { 6.0 },
            speed: Some(2.03).filter(|_| index != 3),
            speed_unit: Unit::RadPerS,
            duty: Some(0.214),
        };
        State {
            board: "serial:/dev/ttyACM0".into(),
            robot: "openscout".into(),
            safety: SafetyState::Armed,
            causes: Causes::NONE,
            hand: Hand { forwards: 0.6, turn: 0.2, is_held: true },
            unit: Unit::RadPerS,
            most: 8.9286,
            wheels: [0, 2, 1, 3].map(wheel).into(),
            silent_s: None,
            message: String::new(),
        }
    }

    #[test]
    fn driving_and_tripped() {
        for (width, height) in [(80, 24), (120, 40)] {
            snapshot::assert_is("drive-held", width, height, |frame| draw(frame, &state()));
        }
        let mut tripped = state();
        (tripped.safety, tripped.causes) = (SafetyState::Tripped, Causes::only(Cause::DeadMan));
        tripped.hand = Hand { forwards: -1.0, turn: -1.0, is_held: false };
        tripped.message = "arm: the board has tripped (dead-man released): clear it first".into();
        snapshot::assert_is("drive-tripped", 80, 24, |frame| draw(frame, &tripped));
    }

    #[test]
    fn every_size_can_be_drawn() {
        for (width, height) in (1..=100).step_by(9).flat_map(|width| (1..=30).map(move |height| (width, height))) {
            snapshot::text(width, height, |frame| draw(frame, &state()));
        }
    }

    #[test]
    fn a_bar_goes_from_its_middle_to_its_ends() {
        for (share, left, right) in [(0.0, 0, 0), (1.0, 0, HALF), (-1.0, HALF, 0), (0.5, 0, HALF / 2), (-9.0, HALF, 0)]
        {
            let bar = bar(share);
            let (before, after) = bar.split_once('|').unwrap();
            let full = |side: &str| side.matches('\u{2588}').count();
            assert_eq!((full(before), full(after), bar.chars().count()), (left, right, 2 * HALF + 3), "{share}");
        }
    }
}
