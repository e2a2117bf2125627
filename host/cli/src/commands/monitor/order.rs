//! Set point typed on the screen.

use std::fmt;

use r4_protocol::{ChannelId, ChannelInfo, Mode, ModeInfo, Setpoint, Unit};

use r4_rig::quantity::Quantity;

/// Set point for one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Order {
    pub(super) channel: ChannelId,
    pub(super) setpoint: Setpoint,
    unit: Unit,
}

impl Order {
    /// Parses `text` for `channel`; its unit selects the mode. The range is not checked.
    pub(super) fn read(channel: &ChannelInfo, text: &str) -> Result<Self, String> {
        let text = text.trim();
        let takes = takes(channel).ok_or_else(|| format!("{} takes no set points", channel.id))?;
        let with = |mode: &ModeInfo, value: f64| {
            let setpoint = Setpoint { mode: mode.mode, value: value as f32 };
            Self { channel: channel.id, setpoint, unit: mode.unit }
        };
        let wanted = |wanted: fn(&ModeInfo) -> bool| channel.modes.iter().find(|mode| wanted(mode));
        let switch = match text {
            "on" => wanted(|mode| mode.mode == Mode::Switch).map(|mode| with(mode, 1.0)),
            "off" => wanted(|mode| mode.mode == Mode::Switch).map(|mode| with(mode, 0.0)),
            "brake" => wanted(|mode| mode.mode == Mode::Brake).map(|mode| with(mode, 1.0)),
            "release" => wanted(|mode| mode.mode == Mode::Brake).map(|mode| with(mode, 0.0)),
            _ => {
                let quantity: Quantity = text.parse()?;
                let of_unit = |mode: &&ModeInfo| mode.unit == quantity.unit && is_typed(mode);
                channel.modes.iter().find(of_unit).map(|mode| with(mode, quantity.value))
            }
        };
        switch.ok_or_else(|| format!("{} takes {takes}", channel.id))
    }
}

/// Text of the message after the board accepted it.
impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Setpoint { mode, value } = self.setpoint;
        let on = if value == 0.0 { "off" } else { "on" };
        match mode {
            Mode::Switch => write!(f, "{} {on}", self.channel),
            Mode::Brake => write!(f, "{} brake {on}", self.channel),
            _ => write!(f, "{} {mode} {}", self.channel, Quantity::new(value.into(), self.unit)),
        }
    }
}

/// True for modes that a number with a unit can select. `r4 home` seeks a home switch and waits for it.
fn is_typed(mode: &ModeInfo) -> bool {
    !matches!(mode.mode, Mode::Switch | Mode::Brake | Mode::Home)
}

/// Set points that a channel accepts, as text; `None` for none.
pub(super) fn takes(channel: &ChannelInfo) -> Option<String> {
    let each = channel.modes.iter().filter_map(|info| {
        let number = |value: f32| Quantity::new(value.into(), info.unit);
        match info.mode {
            Mode::Switch => Some("on or off".to_owned()),
            Mode::Brake => Some("brake or release".to_owned()),
            Mode::Home => None,
            mode if info.range.max.is_finite() => {
                let (min, max) = (number(info.range.min).number(), number(info.range.max));
                Some(format!("{mode} {min} to {max}"))
            }
            mode => Some(format!("{mode} in {}", r4_rig::quantity::human(info.unit).1)),
        }
    });
    let all = each.collect::<Vec<_>>().join(", ");
    (!all.is_empty()).then_some(all)
}
