//! Gamepads, with the feature `gamepad`.

use super::hands::Hand;

#[cfg(feature = "gamepad")]
pub(super) use with::Gamepad;
#[cfg(not(feature = "gamepad"))]
pub(super) use without::Gamepad;

#[cfg(feature = "gamepad")]
mod with {
    use anyhow::anyhow;
    use gilrs::{Axis, Button, GamepadId, Gilrs};

    use super::Hand;

    /// Gamepad: its left stick drives, its right shoulder button is the dead-man switch.
    pub(in super::super) struct Gamepad {
        gilrs: Gilrs,
        /// Gamepad whose button was held last.
        id: Option<GamepadId>,
    }

    impl Gamepad {
        pub(in super::super) fn open() -> anyhow::Result<Self> {
            let gilrs = Gilrs::new().map_err(|error| anyhow!("no gamepad can be read: {error}"))?;
            if gilrs.gamepads().next().is_none() {
                return Err(anyhow!("no gamepad was found: connect one, and check that you may read /dev/input"));
            }
            Ok(Self { gilrs, id: None })
        }

        /// Present input. A disconnected gamepad counts as released.
        pub(in super::super) fn hand(&mut self) -> Hand {
            // gilrs updates its state only as events are read.
            while self.gilrs.next_event().is_some() {}
            let mut held =
                self.gilrs.gamepads().filter(|(_, pad)| pad.is_connected() && pad.is_pressed(Button::RightTrigger));
            let held = held.next().map(|(id, _)| id);
            self.id = held.or(self.id);
            let Some(pad) = self.id.and_then(|id| self.gilrs.connected_gamepad(id)) else { return Hand::default() };
            Hand {
                forwards: f64::from(pad.value(Axis::LeftStickY)),
                // gilrs counts right as positive; a positive turn is to the left.
                turn: -f64::from(pad.value(Axis::LeftStickX)),
                is_held: held.is_some(),
            }
        }
    }
}

#[cfg(not(feature = "gamepad"))]
mod without {
    use anyhow::bail;

    use super::Hand;

    /// Type without values, for programs built without gamepads.
    pub(in super::super) enum Gamepad {}

    impl Gamepad {
        pub(in super::super) fn open() -> anyhow::Result<Self> {
            bail!(
                "this program was built without gamepads: build it with `--features gamepad` (it needs pkg-config and \
                 libudev), or omit --gamepad and drive by keys"
            )
        }

        pub(in super::super) fn hand(&mut self) -> Hand {
            match *self {}
        }
    }
}
