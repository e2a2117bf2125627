//! Lines of a quadrature encoder, and the processor's counter behind them.
//!
//! Levels follow the whole counts of the shaft's position, `floor(position)`:
//!
//! | count mod 4 | A | B |
//! | --- | --- | --- |
//! | 0 | low | low |
//! | 1 | high | low |
//! | 2 | high | high |
//! | 3 | low | high |
//!
//! Between two calls the shaft is assumed to turn at constant speed, which gives every edge its time.

use std::num::NonZeroU32;

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use super::{
    interference::{Followed, SquareWave},
    uniform,
};

/// Largest number of counts processed edge by edge in one call.
const MAX_COUNTS: u64 = 4096;

/// Levels of both lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Levels {
    /// Level of line A, which leads when the count rises.
    pub a: bool,
    /// Level of line B.
    pub b: bool,
}

impl Levels {
    /// Levels at a count.
    #[must_use]
    pub const fn of_count(count: i64) -> Self {
        let quarter = count.rem_euclid(4);
        Self { a: quarter == 1 || quarter == 2, b: quarter >= 2 }
    }

    /// Count modulo 4 of the levels.
    const fn quarter(self) -> u8 {
        match (self.a, self.b) {
            (false, false) => 0,
            (true, false) => 1,
            (true, true) => 2,
            (false, true) => 3,
        }
    }
}

/// A change of the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// Time of the change, ns.
    pub at_ns: u64,
    /// Levels after the change. They differ from those before in one line; in both after a lost edge.
    pub levels: Levels,
    /// State of the index track from then on.
    pub index: bool,
}

/// One of the two lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Line A, which leads when the count rises.
    A,
    /// Line B, which lags when the count rises.
    B,
}

/// Random faults, sampled once for every edge of the shaft.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EdgeNoise {
    /// Share of edges with chatter, 0 to 1: the line goes back once more, [`chatter_ns`](Self::chatter_ns) later and
    /// for as long.
    pub chatter_share: f64,
    /// Delay and length of the chatter, ns.
    pub chatter_ns: u64,
    /// Share of edges that are lost, 0 to 1.
    pub lost_share: f64,
}

/// A line inverted for a time.
#[derive(Clone, Copy, Debug)]
struct Glitch {
    channel: Channel,
    from_ns: u64,
    until_ns: u64,
    begun: bool,
}

impl Glitch {
    const fn next_ns(&self) -> u64 {
        if self.begun { self.until_ns } else { self.from_ns }
    }
}

/// Converts a shaft's position to edges.
#[derive(Clone, Debug)]
pub struct QuadratureSignal {
    now_ns: u64,
    position_counts: f64,
    count: i64,
    /// Levels as last output: those of the count, except for glitches and lost edges.
    levels: Levels,
    glitches: Vec<Glitch>,
    /// Interference on lines A and B.
    interference: [Option<Followed>; 2],
    edges_to_lose: u32,
    noise: EdgeNoise,
    generator: Pcg64,
    /// Number of counts from one index pulse to the next.
    index_every: Option<NonZeroU32>,
}

impl QuadratureSignal {
    /// A shaft at rest; a position that is not finite counts as 0.
    #[must_use]
    pub fn new(position_counts: f64, seed: u64) -> Self {
        let position_counts = if position_counts.is_finite() { position_counts } else { 0.0 };
        let count = position_counts.floor() as i64;
        Self {
            now_ns: 0,
            position_counts,
            count,
            levels: Levels::of_count(count),
            glitches: Vec::new(),
            interference: [None; 2],
            edges_to_lose: 0,
            noise: EdgeNoise::default(),
            generator: Pcg64::seed_from_u64(seed),
            index_every: None,
        }
    }

    /// Adds an index track, on for one count in `every`, starting with 0: a pulse of a quarter of an encoder period.
    pub fn set_index(&mut self, every: NonZeroU32) {
        self.index_every = Some(every);
    }

    /// Number of counts from one index pulse to the next; `None` without an index track.
    #[must_use]
    pub const fn index_every(&self) -> Option<NonZeroU32> {
        self.index_every
    }

    /// True while the index track is on, at the last [`advance`](Self::advance).
    #[must_use]
    pub fn index(&self) -> bool {
        self.index_every.is_some_and(|every| self.count.rem_euclid(every.get().into()) == 0)
    }

    /// Levels at the last [`advance`](Self::advance).
    #[must_use]
    pub const fn levels(&self) -> Levels {
        self.levels
    }

    /// True count at the last [`advance`](Self::advance).
    #[must_use]
    pub const fn count(&self) -> i64 {
        self.count
    }

    /// Time of the next start or end of a glitch, or edge of interference, ns, if there is one.
    #[must_use]
    pub fn next_glitch_ns(&self) -> Option<u64> {
        let waves_ns = self.interference.iter().flatten().filter_map(Followed::next_ns);
        self.glitches.iter().map(Glitch::next_ns).chain(waves_ns).min()
    }

    /// Sets the random faults from now on.
    pub fn set_noise(&mut self, noise: EdgeNoise) {
        self.noise = noise;
    }

    /// Inverts a line for `width_ns`, starting at `from_ns` or the last call if that is later.
    pub fn inject_glitch(&mut self, channel: Channel, from_ns: u64, width_ns: u64) {
        let from_ns = from_ns.max(self.now_ns);
        self.glitches.push(Glitch { channel, from_ns, until_ns: from_ns.saturating_add(width_ns), begun: false });
    }

    /// Couples a wave into a line, replacing another; edges before the last call are omitted.
    pub fn set_interference(&mut self, channel: Channel, wave: SquareWave) {
        self.interference[channel as usize] = Some(Followed::new(wave, self.now_ns));
    }

    /// Drops the next edges of the shaft: the lines show the change only with the edge after them.
    pub fn lose_edges(&mut self, count: u32) {
        self.edges_to_lose = self.edges_to_lose.saturating_add(count);
    }

    /// Turns the shaft to `position_counts` by `at_ns`: `sink` gets every change of the lines since the last call, in
    /// order. A position that is not finite is ignored: the shaft stays.
    ///
    /// Work is bounded: of more than 4096 counts the first are skipped, in multiples of four. Returns their number,
    /// with sign; 0 in any sensible use. Added to the decoded count it gives the exact one. Skipped counts have no
    /// noise.
    #[must_use = "counts left out have to be added by whoever counts"]
    pub fn advance(&mut self, at_ns: u64, position_counts: f64, mut sink: impl FnMut(Transition)) -> i64 {
        let from_ns = self.now_ns;
        let from_counts = self.position_counts;
        self.now_ns = at_ns.max(from_ns);
        if position_counts.is_finite() {
            self.position_counts = position_counts;
        }
        let target = self.position_counts.floor() as i64;
        let direction = target.saturating_sub(self.count).signum();
        let left_out = target.abs_diff(self.count).saturating_sub(MAX_COUNTS).next_multiple_of(4);
        let left_out = direction.wrapping_mul(left_out as i64);
        self.count = self.count.wrapping_add(left_out);

        let dt_ns = (self.now_ns - from_ns) as f64;
        let way_counts = self.position_counts - from_counts;
        let crossing_ns = |count: i64| {
            // upwards a count begins at its own position, downwards it ends there
            let edge_counts = if direction > 0 { count + 1 } else { count } as f64;
            from_ns + ((edge_counts - from_counts) / way_counts * dt_ns).round().clamp(0.0, dt_ns) as u64
        };
        loop {
            let crossing_ns = (self.count != target).then(|| crossing_ns(self.count));
            let glitch_ns = self.next_glitch_ns().filter(|next_ns| *next_ns <= self.now_ns);
            match (crossing_ns, glitch_ns) {
                (crossing_ns, Some(glitch_ns)) if crossing_ns.is_none_or(|crossing_ns| glitch_ns <= crossing_ns) => {
                    for glitch in &mut self.glitches {
                        glitch.begun |= glitch.from_ns <= glitch_ns;
                    }
                    self.glitches.retain(|glitch| glitch.until_ns > glitch_ns);
                    self.show(glitch_ns, &mut sink);
                }
                (Some(crossing_ns), _) => {
                    if self.cross(crossing_ns, direction) {
                        self.show(crossing_ns, &mut sink);
                    }
                }
                _ => return left_out,
            }
        }
    }

    /// Handles one edge of the shaft; returns false if it is lost.
    fn cross(&mut self, at_ns: u64, direction: i64) -> bool {
        let before = Levels::of_count(self.count);
        self.count += direction;
        let EdgeNoise { chatter_share, chatter_ns, lost_share } = self.noise;
        if self.edges_to_lose > 0 {
            self.edges_to_lose -= 1;
            return false;
        }
        if lost_share > 0.0 && uniform(&mut self.generator) < lost_share {
            return false;
        }
        if chatter_share > 0.0 && uniform(&mut self.generator) < chatter_share {
            let channel = if before.a == Levels::of_count(self.count).a { Channel::B } else { Channel::A };
            let from_ns = at_ns.saturating_add(chatter_ns);
            let until_ns = from_ns.saturating_add(chatter_ns);
            self.glitches.push(Glitch { channel, from_ns, until_ns, begun: false });
        }
        true
    }

    fn show(&mut self, at_ns: u64, sink: &mut impl FnMut(Transition)) {
        for wave in self.interference.iter_mut().flatten() {
            wave.advance(at_ns);
        }
        let glitching = |channel| {
            let wave = self.interference[channel as usize].is_some_and(|wave| wave.inverts(at_ns));
            self.glitches.iter().any(|glitch| glitch.begun && glitch.channel == channel) ^ wave
        };
        let Levels { a, b } = Levels::of_count(self.count);
        let levels = Levels { a: a ^ glitching(Channel::A), b: b ^ glitching(Channel::B) };
        if levels != self.levels {
            self.levels = levels;
            sink(Transition { at_ns, levels, index: self.index() });
        }
    }
}

/// One input of the counter.
#[derive(Clone, Copy, Debug)]
struct FilteredLine {
    /// Level behind the filter.
    level: bool,
    /// Time since which the pin has had the other level, ns.
    other_since_ns: Option<u64>,
}

impl FilteredLine {
    const fn new(level: bool) -> Self {
        Self { level, other_since_ns: None }
    }

    fn set(&mut self, at_ns: u64, level: bool) {
        if level == self.level {
            self.other_since_ns = None;
        } else {
            self.other_since_ns.get_or_insert(at_ns);
        }
    }

    fn change_if_due(&mut self, due_ns: Option<u64>, at_ns: u64) {
        if due_ns == Some(at_ns) {
            *self = Self::new(!self.level);
        }
    }
}

/// STM32 timer in encoder mode 3: counts both edges of both lines, in 16 bits.
///
/// It detects no illegal transition: edges of both lines that leave the filter together are one up and one down, and
/// the count stays.
#[derive(Clone, Debug)]
pub struct HardwareCounter {
    filter_ns: u64,
    count: u16,
    a: FilteredLine,
    b: FilteredLine,
}

impl HardwareCounter {
    /// A counter at 0, with the lines at `levels`. Its input filter (ICxF) passes levels that last `filter_ns` or
    /// longer, and delays them by as much; 0 disables it.
    #[must_use]
    pub const fn new(filter_ns: u64, levels: Levels) -> Self {
        Self { filter_ns, count: 0, a: FilteredLine::new(levels.a), b: FilteredLine::new(levels.b) }
    }

    /// Takes a change of the lines. Times must not decrease.
    pub fn take(&mut self, transition: Transition) {
        let Transition { at_ns, levels, .. } = transition;
        self.settle(at_ns);
        self.a.set(at_ns, levels.a);
        self.b.set(at_ns, levels.b);
        self.settle(at_ns);
    }

    /// Adds counts that [`QuadratureSignal::advance`] skipped.
    pub const fn add(&mut self, counts: i64) {
        self.count = self.count.wrapping_add(counts as u16);
    }

    /// Value of the counter register at a time.
    pub fn count(&mut self, at_ns: u64) -> u16 {
        self.settle(at_ns);
        self.count
    }

    /// Passes changes whose filter time is over.
    fn settle(&mut self, at_ns: u64) {
        loop {
            let filter_ns = self.filter_ns;
            let due_ns = |line: &FilteredLine| {
                line.other_since_ns.map(|since_ns| since_ns.saturating_add(filter_ns)).filter(|due_ns| *due_ns <= at_ns)
            };
            let due = [due_ns(&self.a), due_ns(&self.b)];
            let Some(first_ns) = due.into_iter().flatten().min() else { return };
            let before = self.filtered().quarter();
            self.a.change_if_due(due[0], first_ns);
            self.b.change_if_due(due[1], first_ns);
            match self.filtered().quarter().wrapping_sub(before) % 4 {
                1 => self.add(1),
                3 => self.add(-1),
                _ => {}
            }
        }
    }

    const fn filtered(&self) -> Levels {
        Levels { a: self.a.level, b: self.b.level }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Collects the changes, and asserts that none is skipped.
    fn advance(signal: &mut QuadratureSignal, at_ns: u64, position_counts: f64) -> Vec<Transition> {
        let mut seen = Vec::new();
        assert_eq!(signal.advance(at_ns, position_counts, |transition| seen.push(transition)), 0);
        seen
    }

    fn shown(transitions: &[Transition]) -> Vec<(u64, u8)> {
        transitions.iter().map(|transition| (transition.at_ns, transition.levels.quarter())).collect()
    }

    /// Software decoder: its count, and the number of simultaneous changes of both lines.
    #[derive(Debug, Default, PartialEq)]
    struct Software {
        levels: Levels,
        count: i64,
        illegal: u32,
    }

    impl Software {
        fn take(&mut self, transition: Transition) {
            match (transition.levels.quarter() + 4 - self.levels.quarter()) % 4 {
                1 => self.count += 1,
                3 => self.count -= 1,
                2 => self.illegal += 1,
                _ => {}
            }
            self.levels = transition.levels;
        }
    }

    #[test]
    fn a_rising_count_goes_00_10_11_01() {
        let levels: Vec<_> = (-1..5).map(Levels::of_count).map(|levels| (levels.a, levels.b)).collect();
        let (low, high) = (false, true);
        assert_eq!(levels, [(low, high), (low, low), (high, low), (high, high), (low, high), (low, low)]);
        assert!((0..4).all(|count| Levels::of_count(count).quarter() == count as u8));
    }

    #[test]
    fn edges_have_the_time_of_an_even_turn() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        assert_eq!(shown(&advance(&mut signal, 400, 4.5)), [(50, 1), (150, 2), (250, 3), (350, 0)]);
        assert_eq!(shown(&advance(&mut signal, 600, 2.5)), [(450, 3), (550, 2)]);
        assert_eq!(shown(&advance(&mut signal, 700, 2.5)), []);
        // a position counts when it is reached; downwards it does until it is left
        assert_eq!(shown(&advance(&mut signal, 800, 3.0)), [(800, 3)]);
        assert_eq!(shown(&advance(&mut signal, 900, 2.0)), [(800, 2)]);
        assert_eq!((signal.count(), signal.levels()), (2, Levels { a: true, b: true }));
        // not a position
        assert_eq!(shown(&advance(&mut signal, 1_000, f64::NAN)), []);
        assert_eq!(signal.count(), 2);
    }

    /// The index is on for one count in 12, in either direction.
    #[test]
    fn an_index_pulse_is_one_count_wide() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        assert!(!signal.index());
        signal.set_index(NonZeroU32::new(12).unwrap());
        assert!(signal.index());
        for (to, pulses) in [(25.5, vec![12, 24]), (-13.5, vec![24, 12, 0, -12])] {
            let side = if to > 0.0 { 1 } else { -1 };
            let mut count = signal.count();
            let mut seen = Vec::new();
            let at_ns = signal.now_ns + 1_000;
            for Transition { index, .. } in advance(&mut signal, at_ns, to) {
                count += side;
                seen.extend(index.then_some(count));
            }
            assert_eq!(seen, pulses);
        }
    }

    #[test]
    fn many_counts_are_bounded_work_and_exact() {
        for way in [4_096_i64, 4_097, 4_100, 1_000_003, -4_099, -123_456_789] {
            let mut signal = QuadratureSignal::new(0.5, 1);
            let mut counter = HardwareCounter::new(0, signal.levels());
            let mut software = Software::default();
            let mut edges = 0;
            let left_out = signal.advance(1_000_000, way as f64 + 0.5, |transition| {
                edges += 1;
                counter.take(transition);
                software.take(transition);
            });
            counter.add(left_out);
            assert!((4_093..=4_096).contains(&edges), "{edges}");
            assert_eq!(left_out % 4, 0);
            assert_eq!(software.count + left_out, way);
            assert_eq!(counter.count(1_000_000), way as u16);
            assert_eq!(software.levels, Levels::of_count(way));
        }
        // the largest possible position
        let mut signal = QuadratureSignal::new(-f64::MAX, 1);
        let _ = signal.advance(1, f64::MAX, |_| {});
        assert_eq!(signal.count(), i64::MAX);
    }

    #[test]
    fn a_glitch_is_a_pulse_on_one_line_of_a_shaft_at_rest() {
        for (channel, glitched) in [(Channel::A, 1), (Channel::B, 3)] {
            let mut signal = QuadratureSignal::new(0.5, 1);
            let mut software = Software::default();
            signal.inject_glitch(channel, 1_000, 300);
            let seen =
                [advance(&mut signal, 999, 0.5), advance(&mut signal, 1_100, 0.5), advance(&mut signal, 2_000, 0.5)];
            assert_eq!(seen.each_ref().map(|seen| shown(seen)), [vec![], vec![(1_000, glitched)], vec![(1_300, 0)]]);
            seen.into_iter().flatten().for_each(|transition| software.take(transition));
            assert_eq!(software, Software::default());
        }
    }

    #[test]
    fn a_glitch_in_motion_is_in_the_order_of_time() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        signal.inject_glitch(Channel::B, 100, 20);
        let seen = advance(&mut signal, 200, 2.5);
        // count 10 at 50, the glitch to 11 and back, 11 at 150
        assert_eq!(shown(&seen), [(50, 1), (100, 2), (120, 1), (150, 2)]);
    }

    #[test]
    fn a_glitch_at_the_time_of_an_edge_comes_first_however_often_one_looks() {
        let turning_back = |looks: &[u64]| {
            let mut signal = QuadratureSignal::new(3.0, 1);
            signal.inject_glitch(Channel::A, 100, 50);
            let seen = looks.iter().flat_map(|at_ns| advance(&mut signal, *at_ns, 3.0 - *at_ns as f64 / 100.0));
            shown(&seen.collect::<Vec<_>>())
        };
        // left 3 at 0; at 100 the glitch on 11, then 10 under it; its end
        let expected = [(0, 2), (100, 3), (100, 0), (150, 1)];
        assert_eq!(turning_back(&[199]), expected);
        assert_eq!(turning_back(&[100, 199]), expected);
    }

    #[test]
    fn a_glitch_in_the_past_begins_now() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        assert_eq!(shown(&advance(&mut signal, 1_000, 0.5)), []);
        signal.inject_glitch(Channel::A, 10, 20);
        assert_eq!(shown(&advance(&mut signal, 2_000, 0.5)), [(1_000, 1), (1_020, 0)]);
    }

    #[test]
    fn chatter_goes_back_on_the_line_that_changed() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        signal.set_noise(EdgeNoise { chatter_share: 1.0, chatter_ns: 5, lost_share: 0.0 });
        let seen = shown(&advance(&mut signal, 200, 2.5));
        assert_eq!(seen, [(50, 1), (55, 0), (60, 1), (150, 2), (155, 1), (160, 2)]);
    }

    #[test]
    fn a_lost_edge_shows_as_an_illegal_step() {
        let mut signal = QuadratureSignal::new(0.5, 1);
        let mut software = Software::default();
        let mut counter = HardwareCounter::new(0, signal.levels());
        signal.lose_edges(1);
        let seen = advance(&mut signal, 400, 4.5);
        assert_eq!(shown(&seen), [(150, 2), (250, 3), (350, 0)]);
        for transition in seen {
            software.take(transition);
            counter.take(transition);
        }
        assert_eq!(software, Software { count: 2, illegal: 1, levels: Levels::default() });
        // the timer does not report it, and is two counts off as well
        assert_eq!(counter.count(400), 2);
    }

    #[test]
    fn shares_of_noise_are_what_was_set() {
        let mut signal = QuadratureSignal::new(0.5, 3);
        signal.set_noise(EdgeNoise { chatter_share: 0.1, chatter_ns: 10, lost_share: 0.0 });
        let mut software = Software::default();
        let mut edges = 0_u32;
        for look in 1..=10_u64 {
            for transition in advance(&mut signal, look * 1_000_000, look as f64 * 1_000.0) {
                edges += 1;
                software.take(transition);
            }
        }
        // 10000 edges, a tenth of them with two more; four standard errors of 2 x 30
        assert!(edges.abs_diff(12_000) < 240, "{edges}");
        assert_eq!((software.count, software.illegal), (10_000, 0));

        signal.set_noise(EdgeNoise { lost_share: 0.01, ..EdgeNoise::default() });
        for look in 11..=20_u64 {
            advance(&mut signal, look * 1_000_000, look as f64 * 1_000.0).into_iter().for_each(|it| software.take(it));
        }
        // 10000 edges, a hundredth lost, and seldom two in a row; four standard errors of 10
        assert!(software.illegal.abs_diff(99) < 40, "{software:?}");
    }

    #[test]
    fn the_filter_swallows_pulses_shorter_than_its_length() {
        for (width_ns, extremes) in [(99, 0), (100, 1)] {
            let mut signal = QuadratureSignal::new(0.5, 1);
            let mut counter = HardwareCounter::new(100, signal.levels());
            signal.inject_glitch(Channel::A, 1_000, width_ns);
            let mut highest = 0;
            for transition in advance(&mut signal, 5_000, 0.5) {
                counter.take(transition);
                highest = highest.max(counter.count(transition.at_ns));
            }
            assert_eq!((highest, counter.count(5_000)), (extremes, 0));
        }
    }

    #[test]
    fn the_filter_delays_and_stops_what_is_too_fast() {
        // an edge of one line every 200 ns; each line keeps its level for 400 ns
        for (filter_ns, counted) in [(0, 100), (400, 100), (401, 0)] {
            let mut signal = QuadratureSignal::new(0.5, 1);
            let mut counter = HardwareCounter::new(filter_ns, signal.levels());
            advance(&mut signal, 20_000, 100.5).into_iter().for_each(|transition| counter.take(transition));
            assert_eq!(counter.count(21_000), counted, "{filter_ns}");
        }
        let mut counter = HardwareCounter::new(100, Levels::default());
        counter.take(Transition { at_ns: 1_000, levels: Levels { a: true, b: false }, index: false });
        assert_eq!((counter.count(1_099), counter.count(1_100)), (0, 1));
    }

    #[test]
    fn the_counter_wraps_at_16_bits() {
        let mut counter = HardwareCounter::new(0, Levels::default());
        counter.take(Transition { at_ns: 0, levels: Levels { a: false, b: true }, index: false });
        assert_eq!(counter.count(0), u16::MAX);
        counter.add(65_537);
        assert_eq!(counter.count(0), 0);
    }

    proptest! {
        /// Any motion of the shaft ends at its count, in software and in the timer.
        #[test]
        fn counts_follow_the_shaft(ways in prop::collection::vec((0..1_000_000_u64, -3_000.0..3_000.0_f64), 1..20)) {
            let mut signal = QuadratureSignal::new(0.0, 1);
            let mut software = Software::default();
            let mut counter = HardwareCounter::new(0, signal.levels());
            let (mut at_ns, mut position) = (0, 0.0_f64);
            for (after_ns, way) in ways {
                let from_ns = at_ns;
                at_ns += after_ns;
                position += way;
                let mut last_ns = from_ns;
                let mut left_out = 0;
                left_out += signal.advance(at_ns, position, |transition| {
                    assert!((last_ns..=at_ns).contains(&transition.at_ns));
                    last_ns = transition.at_ns;
                    software.take(transition);
                    counter.take(transition);
                });
                software.count += left_out;
                counter.add(left_out);
                let expected = position.floor() as i64;
                prop_assert_eq!((software.count, software.illegal), (expected, 0));
                prop_assert_eq!(counter.count(at_ns), expected as u16);
            }
        }

        /// A constant-speed turn with all kinds of faults, queried once or often.
        #[test]
        fn lazy_equals_eager(
            // edges fall on whole nanoseconds, so that rounding cannot move them; at most 4000 of them
            ns_per_count in 250..5_000_u64,
            turns_back in any::<bool>(),
            mut looks_ns in prop::collection::vec(0..1_000_000_u64, 0..40),
            glitches in prop::collection::vec((any::<bool>(), 0..1_000_000_u64, 0..3_000_u64), 0..6),
            filter_ns in 0..500_u64,
        ) {
            let mut eager = QuadratureSignal::new(0.0, 9);
            eager.set_noise(EdgeNoise { chatter_share: 0.2, chatter_ns: 70, lost_share: 0.05 });
            for (a, from_ns, width_ns) in glitches {
                eager.inject_glitch(if a { Channel::A } else { Channel::B }, from_ns, width_ns);
            }
            eager.lose_edges(2);
            let mut lazy = eager.clone();
            let ns_per_count = ns_per_count as f64 * if turns_back { -1.0 } else { 1.0 };
            looks_ns.sort_unstable();
            looks_ns.push(1_000_000);
            let mut seen = Vec::new();
            let mut often = HardwareCounter::new(filter_ns, eager.levels());
            for at_ns in looks_ns {
                let already = seen.len();
                let left_out = eager.advance(at_ns, at_ns as f64 / ns_per_count, |transition| seen.push(transition));
                prop_assert_eq!(left_out, 0);
                seen[already..].iter().for_each(|transition| often.take(*transition));
                often.count(at_ns);
            }
            let mut once = HardwareCounter::new(filter_ns, lazy.levels());
            let mut all = Vec::new();
            let left_out = lazy.advance(1_000_000, 1e6 / ns_per_count, |transition| all.push(transition));
            all.iter().for_each(|transition| once.take(*transition));
            prop_assert_eq!(left_out, 0);
            prop_assert_eq!(all, seen);
            prop_assert_eq!(once.count(1_000_000), often.count(1_000_000));
        }
    }
}
