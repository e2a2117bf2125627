//! Register-level models of the chips on the board, each written from its datasheet.
//!
//! A model shares no constant with the firmware's driver of the same chip, so that a wrong address in the driver cannot
//! cancel itself out here.

pub mod as5600;
pub mod icm20948;
pub mod ili9488;
pub mod ina226;
pub mod mcp23017;
pub mod mcp4728;
pub mod nau7802;
pub mod pca9685;
pub mod vl6180x;

/// Number of counts in one PWM cycle of a [`Line`].
pub const COUNTS: u16 = 4096;

/// State of one digital output: a steady level, or a pattern that repeats every PWM cycle.
///
/// All lines of one chip share the start of the cycle, so their counts can be compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Line {
    /// Driven to low level.
    #[default]
    Low,
    /// Driven to high level.
    High,
    /// Not driven; the external circuit sets the level.
    HighZ,
    /// High from count `on` up to, not including, count `off`; past the end of the cycle if `off` is not above `on`.
    /// Counts are 0 to 4095 and differ. An open-drain output releases the line while high.
    Pwm {
        /// Count at which the line goes high.
        on: u16,
        /// Count at which the line goes low.
        off: u16,
    },
}

impl Line {
    /// True if the line is high at `count` of a cycle; `floating` is the level of a line that is not driven.
    #[must_use]
    pub const fn is_high_at(self, count: u16, floating: bool) -> bool {
        match self {
            Self::Low => false,
            Self::High => true,
            Self::HighZ => floating,
            Self::Pwm { on, off } if on < off => on <= count && count < off,
            Self::Pwm { on, off } if on > off => on <= count || count < off,
            Self::Pwm { .. } => false,
        }
    }

    /// Number of counts of a cycle with the line high; `floating` is the level of a line that is not driven.
    #[must_use]
    pub const fn counts_high(self, floating: bool) -> u16 {
        match self {
            Self::Low => 0,
            Self::High => COUNTS,
            Self::HighZ => {
                if floating {
                    COUNTS
                } else {
                    0
                }
            }
            Self::Pwm { on, off } => off.wrapping_sub(on) % COUNTS,
        }
    }

    /// The same line behind an inverter.
    #[must_use]
    pub const fn inverted(self) -> Self {
        match self {
            Self::Low => Self::High,
            Self::High => Self::Low,
            Self::HighZ => Self::HighZ,
            Self::Pwm { on, off } => Self::Pwm { on: off, off: on },
        }
    }
}

/// Intervals of a PWM cycle in which none of `lines` changes: start of each, and its number of counts. `EDGES` must
/// have room for two edges of every line and the start of the cycle.
pub(crate) fn stretches<const EDGES: usize>(lines: impl IntoIterator<Item = Line>) -> impl Iterator<Item = (u16, u16)> {
    let mut edges = [0; EDGES];
    let mut used = 1;
    for line in lines {
        if let Line::Pwm { on, off } = line {
            edges[used] = on.min(COUNTS);
            edges[used + 1] = off.min(COUNTS);
            used += 2;
        }
    }
    edges[..used].sort_unstable();
    (0..used).filter_map(move |index| {
        let from = edges[index];
        let to = if index + 1 < used { edges[index + 1] } else { COUNTS };
        (from < to).then(|| (from, to - from))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_high_is_the_number_of_high_counts() {
        let lines = [
            Line::Low,
            Line::High,
            Line::HighZ,
            Line::Pwm { on: 0, off: 1 },
            Line::Pwm { on: 511, off: 3071 },
            Line::Pwm { on: 2047, off: 767 },
            Line::Pwm { on: 4095, off: 0 },
            Line::Pwm { on: 9, off: 9 },
        ];
        for line in lines {
            for floating in [false, true] {
                let counted = (0..COUNTS).filter(|&count| line.is_high_at(count, floating)).count();
                assert_eq!(counted, usize::from(line.counts_high(floating)), "{line:?}");
            }
        }
    }

    #[test]
    fn inverted_is_high_where_the_line_is_low() {
        for line in [Line::Low, Line::High, Line::Pwm { on: 511, off: 3071 }, Line::Pwm { on: 2047, off: 767 }] {
            for count in 0..COUNTS {
                assert_ne!(line.is_high_at(count, false), line.inverted().is_high_at(count, false));
            }
        }
    }
}
