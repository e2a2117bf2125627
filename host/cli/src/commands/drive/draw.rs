//! Screen of `r4 drive`: a pure function of the state and the size.

use r4_boards::SteeringLaw;
use r4_protocol::{Causes, ChannelId, SafetyState, Unit};
use ratatui::{
    Frame,
    layout::{Constraint, Layout},
    style::{Modifier, Style},
    text::{Line, Span},
    widgets::Paragraph,
};

use super::hands::Hand;
use crate::screen::state::{QUIET, WRONG, badge, wrapped};
use r4_rig::quantity::{Quantity, human};

/// State that the screen shows.
pub(super) struct State {
    pub(super) board: String,
    pub(super) robot: String,
    pub(super) safety: SafetyState,
    pub(super) causes: Causes,
    /// Input of the keys or the gamepad.
    pub(super) hand: Hand,
    /// Unit of `most` and of the wheels' set points.
    pub(super) unit: Unit,
    /// Highest set point, in `unit`.
    pub(super) most: f64,
    pub(super) wheels: Vec<Wheel>,
    /// Steered front wheels; `None` for skid steering.
    pub(super) steering: Option<Steered>,
    /// Time without telemetry, s; `None` within the limit.
    pub(super) silent_s: Option<f64>,
    /// Error of the last request; empty for none.
    pub(super) message: String,
}

/// Steered front wheels, their set point and angle.
pub(super) struct Steered {
    pub(super) channel: ChannelId,
    pub(super) law: SteeringLaw,
    /// Resolution of the steering motor's position, m per count.
    pub(super) resolution: f64,
    /// Set point of the angle, rad; `None` while the wheels hold their angle.
    pub(super) told_rad: Option<f64>,
    /// Measured angle, rad; `None` before the first telemetry.
    pub(super) at_rad: Option<f64>,
}

/// One motor of the table.
pub(super) struct Wheel {
    /// Role of the motor: `left`, `right`, `drive` or `steer`.
    pub(super) side: &'static str,
    pub(super) channel: ChannelId,
    /// Set point that was sent last.
    pub(super) told: Quantity,
    /// Measured speed in `speed_unit`; `None` before the first telemetry and without a sensor.
    pub(super) speed: Option<f64>,
    pub(super) speed_unit: Unit,
    /// Duty as a share of the supply, -1 to 1.
    pub(super) duty: Option<f64>,
    /// Winding heat, % of its limit, while the board warns of it.
    pub(super) hot_percent: Option<u8>,
}

const HELP: [&str; 2] = [
    "W/S \u{2191}\u{2193} speed  A/D \u{2190}\u{2192} turn  x centre  hold SPACE to move, let go to stop",
    "Enter arm  Backspace disarm  c clear  Esc STOP (trips)  q quit (disarms)",
];
/// Half the width of a bar, cells.
const HALF: usize = 20;

pub(super) fn draw(frame: &mut Frame<'_>, state: &State) {
    let most = Quantity::new(state.most, state.unit);
    let title = format!(
        "{}  {}  up to {}{most}",
        state.robot,
        state.board,
        if state.unit == Unit::Duty { "duty " } else { "" }
    );
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
        Span::raw("released: the wheels get set points of zero")
    };
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let mut lines = vec![
        Line::styled(title, bold),
        Line::from(vec![badge(Some(state.safety)), Span::raw("  "), Span::styled(causes, WRONG)]),
        advice.into(),
        "".into(),
        Line::from(vec!["dead-man key   ".into(), dead_man]),
        axis("speed", state.hand.forwards, ["backwards", "forwards"]),
        // A positive turn is to the left, and is drawn to the left.
        axis("turn", -state.hand.turn, ["left", "right"]),
        state.steering.as_ref().map_or_else(Line::default, front_wheels),
        Line::styled(
            format!("{:<7}{:<12}{:>18}{:>20}{:>10}", "side", "channel", "set point", "speed", "duty"),
            Style::new().add_modifier(Modifier::UNDERLINED),
        ),
    ];
    lines.extend(state.wheels.iter().map(wheel_line));
    let mut below = wrapped(&state.message, frame.area().width, WRONG);
    below.extend(HELP.map(|help| Line::styled(help, Style::new().add_modifier(Modifier::REVERSED))));
    let height = u16::try_from(below.len()).unwrap_or(u16::MAX);
    let [body, foot] = Layout::vertical([Constraint::Fill(1), Constraint::Length(height)]).areas(frame.area());
    frame.render_widget(Paragraph::new(lines), body);
    frame.render_widget(Paragraph::new(below), foot);
}

/// Line of an axis: the share from -1 to 1 as a bar and as text.
fn axis(name: &str, share: f64, [negative, positive]: [&str; 2]) -> Line<'static> {
    let percent = format!("{:.0}", share.abs() * 100.0);
    let direction = if share < 0.0 { negative } else { positive };
    let words = if percent == "0" { String::new() } else { format!("{percent} % {direction}") };
    Line::raw(format!("{name:<15}{} {words}", bar(share)))
}

/// Line of the front wheels: angle and set point.
fn front_wheels(steered: &Steered) -> Line<'static> {
    let angle = |rad: f64| {
        let degrees = Quantity::new(rad.abs(), Unit::Rad).number();
        // Judge the rounded text: "0.00 deg left" would be wrong.
        let is_straight = !degrees.contains(|digit: char| ('1'..='9').contains(&digit));
        let side = if rad < 0.0 { " right" } else { " left" };
        format!("{degrees} deg{}", if is_straight { "" } else { side })
    };
    let told = steered.told_rad.map_or("stay as they are".into(), |rad| format!("set point {}", angle(rad)));
    let at = steered.at_rad.map_or("-".into(), angle);
    Line::raw(format!("{:<15}at {at}, {told}", "front wheels"))
}

fn wheel_line(wheel: &Wheel) -> Line<'static> {
    let number = |quantity: Option<Quantity>| match quantity {
        Some(quantity) => format!("{} {:<5}", quantity.number(), human(quantity.unit).1),
        None => "-      ".into(),
    };
    let speed = number(wheel.speed.map(|speed| Quantity::new(speed, wheel.speed_unit)));
    let (told, side) = (number(Some(wheel.told)), wheel.side);
    let duty = wheel.duty.map_or("-".into(), |value| Quantity::new(value, Unit::Duty).number());
    let row = Span::raw(format!("{side:<7}{:<12}{told:>18}{speed:>20}{duty:>10}", wheel.channel.to_string()));
    let hot = wheel.hot_percent.map(|percent| Span::styled(format!(" winding {percent} %"), WRONG));
    Line::from_iter([row].into_iter().chain(hot))
}

/// Bar from the middle: positive shares to the right.
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
            side: if index.is_multiple_of(2) { "left" } else { "right" },
            channel: ChannelId::new(ChannelKind::Dhb, index),
            told: Quantity::new(if index.is_multiple_of(2) { 2.0 } else { 6.0 }, Unit::RadPerS),
            speed: Some(2.03).filter(|_| index != 3),
            speed_unit: Unit::RadPerS,
            duty: Some(0.214),
            hot_percent: (index == 1).then_some(91),
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
            steering: None,
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
    fn front_wheels_that_steer() {
        let mut state = state();
        state.robot = "openpodcar".into();
        (state.unit, state.most) = (Unit::Duty, 0.098);
        let (drive, steer) = (ChannelId::new(ChannelKind::Osmc, 0), ChannelId::new(ChannelKind::Dhb, 0));
        state.wheels = vec![
            Wheel {
                side: "drive",
                channel: drive,
                told: Quantity::new(0.059, Unit::Duty),
                speed: None,
                ..state.wheels.remove(0)
            },
            Wheel {
                side: "steer",
                channel: steer,
                told: Quantity::new(0.028, Unit::M),
                speed: Some(0.004),
                speed_unit: Unit::MPerS,
                ..state.wheels.remove(0)
            },
        ];
        let law = SteeringLaw { rad_at_zero: -0.45079, rad_per_m: 19.080 };
        state.steering =
            Some(Steered { channel: steer, law, resolution: 1e-6, told_rad: Some(0.087), at_rad: Some(-0.012) });
        snapshot::assert_is("drive-steered", 80, 24, |frame| draw(frame, &state));
        let angle = |rad: f64| {
            let steered = Steered { channel: steer, law, resolution: 1e-6, told_rad: None, at_rad: Some(rad) };
            front_wheels(&steered).to_string()
        };
        assert!(angle(-0.00001).ends_with("at 0.00 deg, stay as they are"), "{}", angle(-0.00001));
        assert!(angle(-0.1).contains("at 5.73 deg right") && angle(0.1).contains("at 5.73 deg left"));
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
