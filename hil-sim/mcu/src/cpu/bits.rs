//! Set of exception numbers.

/// Set with one bit for each exception number, 0 to 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Bits([u32; 8]);

impl Bits {
    pub(crate) fn get(&self, index: u16) -> bool {
        self.0[usize::from(index / 32)] >> (index % 32) & 1 == 1
    }

    pub(crate) fn set(&mut self, index: u16, on: bool) {
        let bit = 1 << (index % 32);
        let word = &mut self.0[usize::from(index / 32)];
        *word = if on { *word | bit } else { *word & !bit };
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.iter().all(|word| *word == 0)
    }

    pub(crate) fn and(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|index| self.0[index] & other.0[index]))
    }

    /// Iterates over the members in ascending order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = u16> + '_ {
        self.0.iter().enumerate().flat_map(|(index, word)| {
            let mut left = *word;
            std::iter::from_fn(move || {
                let bit = left.trailing_zeros();
                (left != 0).then(|| {
                    left &= left - 1;
                    index as u16 * 32 + bit as u16
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_are_listed_in_order() {
        let mut bits = Bits::default();
        for index in [255, 0, 31, 32, 64] {
            bits.set(index, true);
        }
        bits.set(64, false);
        assert_eq!(bits.iter().collect::<Vec<_>>(), [0, 31, 32, 255]);
        assert!(bits.get(255) && !bits.get(64));
    }
}
