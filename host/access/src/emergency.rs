//! Break-glass state of one subject.

/// Emergency that a subject has declared by a flag in its token.
///
/// It is in force for a time that the policy limits. A flag that stays on afterwards is not in force, and declares no
/// further one until it was off for the policy's rest: a flag that somebody forgot gives no permanent access.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emergency(Option<Times>);

/// Times of the last emergency, Unix ms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Times {
    began_ms: u64,
    /// Time at which the flag was last seen on.
    seen_ms: u64,
}

impl Emergency {
    /// Notes that the flag is on at `now_ms`, and returns true while an emergency is in force. It lasts `life_ms`; the
    /// next one begins at the earliest when the flag was off for `rest_ms` after that.
    pub fn flagged(&mut self, now_ms: u64, life_ms: u64, rest_ms: u64) -> bool {
        let Some(times) = &mut self.0 else {
            self.0 = Some(Times { began_ms: now_ms, seen_ms: now_ms });
            return true;
        };
        let ends_ms = times.began_ms.saturating_add(life_ms);
        let off_since_ms = times.seen_ms.max(ends_ms);
        times.seen_ms = times.seen_ms.max(now_ms);
        if now_ms < ends_ms {
            return true;
        }
        // From the later of both: the rest counts from the end of access, and begins again with each use of the flag.
        let is_anew = now_ms >= off_since_ms.saturating_add(rest_ms);
        if is_anew {
            times.began_ms = now_ms;
        }
        is_anew
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIFE_MS: u64 = 600;
    const REST_MS: u64 = 3600;

    #[test]
    fn a_flag_left_on_ends_and_does_not_begin_again() {
        let mut emergency = Emergency::default();
        let in_force: u64 = (0..100_000).map(|ms| u64::from(emergency.flagged(ms, LIFE_MS, REST_MS))).sum();
        assert_eq!(in_force, LIFE_MS);
        // It was last seen at 99 999.
        assert!(!emergency.flagged(99_999 + REST_MS - 1, LIFE_MS, REST_MS));
        assert!(!emergency.flagged(99_999 + 2 * REST_MS - 2, LIFE_MS, REST_MS));
        assert!(emergency.flagged(99_999 + 3 * REST_MS, LIFE_MS, REST_MS));
    }

    proptest! {
        /// Whatever the pattern of uses: within any window of life and rest, access is at most one life long.
        #[test]
        fn access_is_a_bounded_share_of_time(steps in prop::collection::vec(0_u64..2000, 1..300)) {
            let (mut emergency, mut now_ms, mut last) = (Emergency::default(), 1_000_000, None::<(u64, u64)>);
            for step_ms in steps {
                now_ms += step_ms;
                if emergency.flagged(now_ms, LIFE_MS, REST_MS) {
                    let begins = last.is_none_or(|(began_ms, _)| now_ms >= began_ms + LIFE_MS);
                    if begins {
                        if let Some((began_ms, _)) = last {
                            prop_assert!(now_ms >= began_ms + LIFE_MS + REST_MS);
                        }
                        last = Some((now_ms, now_ms));
                    }
                }
            }
        }

        #[test]
        fn a_clock_that_goes_back_extends_nothing(back_ms in 0_u64..10_000) {
            let mut emergency = Emergency::default();
            prop_assert!(emergency.flagged(20_000, LIFE_MS, REST_MS));
            prop_assert!(!emergency.flagged(20_000 + LIFE_MS, LIFE_MS, REST_MS));
            emergency.flagged(20_000 - back_ms, LIFE_MS, REST_MS);
            prop_assert!(!emergency.flagged(20_000 + LIFE_MS + REST_MS - 1, LIFE_MS, REST_MS));
        }
    }
}
