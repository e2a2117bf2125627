//! Warnings of windings that approach their temperature limit.

use std::cell::RefCell;

use r4_protocol::{ChannelId, HotWinding};

/// Formats a hot winding for the user, as in `osmc0 winding 91 %`.
#[must_use]
pub fn words(hot: &HotWinding) -> String {
    format!("{} winding {} %", hot.channel, hot.heat_percent)
}

/// Channels whose winding the user was warned of, and that have not cooled since.
#[derive(Default)]
pub(crate) struct Warned(RefCell<Vec<ChannelId>>);

impl Warned {
    /// Returns those of `hot` for which a warning is due: once until the board reports that the winding has cooled.
    pub(crate) fn fresh(&self, hot: &[HotWinding]) -> Vec<HotWinding> {
        let mut warned = self.0.borrow_mut();
        let fresh = hot.iter().filter(|hot| !warned.contains(&hot.channel)).copied().collect();
        *warned = hot.iter().map(|hot| hot.channel).collect();
        fresh
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::ChannelKind;

    use super::*;

    #[test]
    fn a_warning_comes_once_for_each_crossing() {
        let hot = |index, heat_percent| HotWinding { channel: ChannelId::new(ChannelKind::Osmc, index), heat_percent };
        let warned = Warned::default();
        assert_eq!(warned.fresh(&[]), []);
        assert_eq!(warned.fresh(&[hot(0, 81)]), [hot(0, 81)]);
        assert_eq!(warned.fresh(&[hot(0, 90), hot(1, 83)]), [hot(1, 83)]);
        assert_eq!(warned.fresh(&[hot(0, 85)]), []);
        assert_eq!(warned.fresh(&[hot(0, 85), hot(1, 81)]), [hot(1, 81)], "it had cooled");
        assert_eq!(words(&hot(0, 83)), "osmc0 winding 83 %");
    }
}
