//! What a screen knows of the supervisor, and how it shows that.

use r4_protocol::SafetyState;
use ratatui::{
    style::{Color, Modifier, Style},
    text::{Line, Span},
};

/// The supervisor's state as a badge; `None` when nobody knows.
pub(crate) fn badge(state: Option<SafetyState>) -> Span<'static> {
    let (text, colour) = match state {
        Some(SafetyState::Disarmed) => (" DISARMED ", Color::Blue),
        Some(SafetyState::Armed) => (" ARMED ", Color::Green),
        Some(SafetyState::Tripped) => (" TRIPPED ", Color::Red),
        None => (" NO LINK ", Color::Red),
    };
    // Turned round, so that it stands out without colours too.
    Span::styled(text, Style::new().fg(colour).add_modifier(Modifier::BOLD | Modifier::REVERSED))
}

/// Text in lines of at most `width` characters, broken between words where that goes.
pub(crate) fn wrapped(text: &str, width: u16, style: Style) -> Vec<Line<'static>> {
    let width = usize::from(width.max(1));
    let (mut lines, mut line) = (Vec::new(), String::new());
    for word in text.split_whitespace() {
        let length = |text: &str| text.chars().count();
        if !line.is_empty() && length(&line) + 1 + length(word) > width {
            lines.push(std::mem::take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines.push(line);
    lines.into_iter().map(|line| Line::styled(line, style)).collect()
}

/// Of what is wrong.
pub(crate) const WRONG: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
/// Of what is there to be read once.
pub(crate) const QUIET: Style = Style::new().add_modifier(Modifier::DIM);
