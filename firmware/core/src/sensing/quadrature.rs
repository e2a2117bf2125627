//! Quadrature decoding in software, for an encoder on edge interrupts instead of a timer.

/// Decoder that counts all four edges of an encoder line, up while A leads B, like a timer in encoder mode 3.
///
/// The interrupt of either line passes the levels of both; the count goes to
/// [`Encoders::count`](crate::platform::Encoders::count).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decoder {
    /// Quarter of the encoder line at the last levels.
    quarter: Option<u8>,
    count: u16,
    illegal: u32,
}

impl Decoder {
    /// Creates a decoder at 0 that has not seen the lines yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { quarter: None, count: 0, illegal: 0 }
    }

    /// Takes the levels of both lines; the first call only sets the reference.
    pub const fn update(&mut self, a: bool, b: bool) {
        // Upwards the lines go (A, B) = 00, 10, 11, 01: quarters 0, 1, 2, 3.
        let quarter = (b as u8) << 1 | (a ^ b) as u8;
        if let Some(last) = self.quarter {
            match quarter.wrapping_sub(last) & 3 {
                1 => self.count = self.count.wrapping_add(1),
                3 => self.count = self.count.wrapping_sub(1),
                2 => self.illegal = self.illegal.wrapping_add(1),
                _ => {}
            }
        }
        self.quarter = Some(quarter);
    }

    /// Counts since the first levels, wrapping.
    #[must_use]
    pub const fn count(&self) -> u16 {
        self.count
    }

    /// Number of times that both lines had changed at once, wrapping. Each means two counts lost, in an unknown
    /// direction.
    #[must_use]
    pub const fn illegal(&self) -> u32 {
        self.illegal
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Levels of (A, B) in the order of a shaft that turns forwards.
    const FORWARDS: [(bool, bool); 4] = [(false, false), (true, false), (true, true), (false, true)];

    #[test]
    fn every_transition_counts_as_it_should() {
        // Rows: from 00, 10, 11, 01; columns: to the same. 2 marks an illegal transition.
        let expected = [[0, 1, 2, -1], [-1, 0, 1, 2], [2, -1, 0, 1], [1, 2, -1, 0]];
        for (from, row) in FORWARDS.into_iter().zip(expected) {
            for (to, step) in FORWARDS.into_iter().zip(row) {
                let mut decoder = Decoder::new();
                decoder.update(from.0, from.1);
                assert_eq!((decoder.count(), decoder.illegal()), (0, 0), "the first levels count nothing");
                decoder.update(to.0, to.1);
                let seen = (decoder.count().cast_signed(), decoder.illegal());
                assert_eq!(seen, if step == 2 { (0, 1) } else { (step, 0) }, "{from:?} to {to:?}");
            }
        }
    }

    proptest! {
        /// Any walk by single edges is followed exactly, also over the ends of the counter, and with repeated levels.
        #[test]
        fn a_walk_is_followed(
            start in 0usize..4, runs in prop::collection::vec((-4000i32..=4000, 1usize..3), 1..20),
        ) {
            let mut decoder = Decoder::new();
            let mut position = start as i32;
            let levels = |position: i32| FORWARDS[position.rem_euclid(4) as usize];
            let (a, b) = levels(position);
            decoder.update(a, b);
            for (run, repeats) in runs {
                for _ in 0..run.abs() {
                    position += run.signum();
                    let (a, b) = levels(position);
                    (0..repeats).for_each(|_| decoder.update(a, b));
                }
                prop_assert_eq!(decoder.count(), (position - start as i32) as u16);
            }
            prop_assert_eq!(decoder.illegal(), 0);
        }

        /// For any levels of the lines, counts and illegal transitions together explain the final state.
        #[test]
        fn any_levels_are_explained(levels in prop::collection::vec(any::<(bool, bool)>(), 1..200)) {
            let mut decoder = Decoder::new();
            levels.iter().for_each(|(a, b)| decoder.update(*a, *b));
            let quarter = |levels: &(bool, bool)| FORWARDS.iter().position(|known| known == levels).expect("one of four");
            let moved = quarter(&levels[levels.len() - 1]) + 4 - quarter(&levels[0]);
            prop_assert_eq!((u32::from(decoder.count()) + 2 * decoder.illegal()) % 4, moved as u32 % 4);
        }
    }
}
