//! Safety state on a screen, and styles that the screens share.

use r4_protocol::SafetyState;
use ratatui::{
    style::{Color, Modifier, Style},
    text::{Line, Span},
};

/// Badge of the safety state; `None` for no link.
pub(crate) fn badge(state: Option<SafetyState>) -> Span<'static> {
    let (text, colour) = match state {
        Some(SafetyState::Disarmed) => (" DISARMED ", Color::Blue),
        Some(SafetyState::Armed) => (" ARMED ", Color::Green),
        Some(SafetyState::Tripped) => (" TRIPPED ", Color::Red),
        None => (" NO LINK ", Color::Red),
    };
    // Reversed, so that it stands out without colours too.
    Span::styled(text, Style::new().fg(colour).add_modifier(Modifier::BOLD | Modifier::REVERSED))
}

/// Text in lines of at most `width` characters, broken between words where possible.
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

/// Style of faults and errors.
pub(crate) const WRONG: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
/// Style of secondary information.
pub(crate) const QUIET: Style = Style::new().add_modifier(Modifier::DIM);
