//! HC-SR04 ultrasonic range finder, and an array of four that hear each other.
//!
//! ```text
//!  trigger  __|~~~~|______________________________   high for 10 us or more
//!  sound               8 cycles of 40 kHz
//!  echo     ___________________|~~~~~~~~~~~|______   2 d / c(T), or 38 ms when nothing comes back
//!                 about 0.5 ms ^
//! ```
//!
//! # Source
//! ElecFreaks HC-SR04 sheet: trigger of 10 us, 8 cycles, 2 cm to 4 m, 60 ms between pings. From experience, not from
//! the sheet: the 0.5 ms before the echo rises, the end at 38 ms, and clones that hold it for 200 ms.
//!
//! # Where the sheet leaves room
//! - A trigger acts at its falling edge, and is lost if the module is busy then: from an accepted trigger until the
//!   echo falls.
//! - Target, air and noise are those at that edge.
//! - The width of the echo starts at its rise; for other modules the sound leaves at that time too.
//! - A target nearer than 2 cm reads as 2 cm: until then the transducer still rings.
//! - The first sound that arrives while the echo is high ends it, from any module.

use std::collections::VecDeque;

use rand_pcg::Pcg64;

use super::interference::{Followed, SquareWave};
use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// Shortest trigger that is accepted, ns.
const TRIGGER_NS: u64 = 10_000;
/// Time from the falling edge of the trigger to the rise of the echo, ns.
const ECHO_DELAY_NS: u64 = 500_000;
/// Width of the echo without a target, ns.
const TIME_OUT_NS: u64 = 38_000_000;
/// Width of the echo without a target for some clones, ns.
const STUCK_NS: u64 = 200_000_000;
/// Shortest time from ping to ping, ns, in which late echoes fade.
const PERIOD_NS: u64 = 60_000_000;
const NEAREST_M: f64 = 0.02;
/// Distance of the farthest detectable target, m.
pub(crate) const FARTHEST_M: f64 = 4.0;
/// Longest path of a sound that is detected, m: to the farthest target and back.
const LONGEST_PATH_M: f64 = 2.0 * FARTHEST_M;
/// Number of edges kept for a reader that is late; older ones are dropped.
const EDGES_KEPT: usize = 64;

/// Speed of sound in dry air at `air_c` °C, m/s: the usual linear formula, accurate to 0.2 % from -20 to 40.
#[must_use]
pub fn speed_of_sound_m_s(air_c: f64) -> f64 {
    331.3 + 0.606 * air_c
}

/// Fault of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HcSr04Fault {
    /// Dead or unplugged: the echo line stays low.
    Silent,
    /// Deaf, with the time-out of some clones: every echo lasts 200 ms.
    StuckHigh,
}

/// An edge of the echo line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EchoEdge {
    /// Time of the edge, ns.
    pub at_ns: u64,
    /// Level after the edge.
    pub high: bool,
}

/// An echo in progress.
#[derive(Clone, Copy, Debug)]
struct Echo {
    rise_ns: u64,
    /// Time of its fall, ns, unless another sound arrives before.
    fall_ns: u64,
    /// True if the rise is already among the edges.
    risen: bool,
}

/// One module. Its echo line is that at the processor's pin: the divider from 5 V does not change any time.
#[derive(Clone, Debug)]
pub struct HcSr04 {
    number: u8,
    now_ns: u64,
    distance_m: Option<f64>,
    background_m: Option<f64>,
    air_c: f64,
    noise_rms_mm: f64,
    noise: Pcg64,
    fault: Option<HcSr04Fault>,
    trigger_rose_ns: Option<u64>,
    last_ping_ns: Option<u64>,
    echo: Option<Echo>,
    /// Arrival times of sounds of other modules that are still on their way, ns.
    arrivals_ns: Vec<u64>,
    interference: Option<Followed>,
    /// Level of the line, interference included.
    high: bool,
    /// Time of the line's last falling edge, ns.
    fell_ns: Option<u64>,
    edges: VecDeque<EchoEdge>,
    misuse: MisuseLog,
}

impl HcSr04 {
    /// Name of the module in reports.
    pub const NAME: &str = "HC-SR04";

    /// A module without a target, in air of 20 °C; `number` identifies it in reports.
    #[must_use]
    pub fn new(number: u8, seed: u64) -> Self {
        Self {
            number,
            now_ns: 0,
            distance_m: None,
            background_m: None,
            air_c: 20.0,
            noise_rms_mm: 0.0,
            noise: Pcg64::new(u128::from(seed), u128::from(number)),
            fault: None,
            trigger_rose_ns: None,
            last_ping_ns: None,
            echo: None,
            arrivals_ns: Vec::new(),
            interference: None,
            high: false,
            fell_ns: None,
            edges: VecDeque::new(),
            misuse: MisuseLog::new(),
        }
    }

    /// Sets the distance of the target for the next ping; `None` removes it.
    pub fn set_distance_m(&mut self, distance_m: Option<f64>) {
        self.distance_m = distance_m;
    }

    /// Sets the distance of a background for the next ping; the nearer one of target and background is detected.
    pub fn set_background_m(&mut self, background_m: Option<f64>) {
        self.background_m = background_m;
    }

    /// Sets the air temperature for the next ping: -50 to 100 °C, clipped; NaN is ignored.
    pub fn set_air_c(&mut self, air_c: f64) {
        if !air_c.is_nan() {
            self.air_c = air_c.clamp(-50.0, 100.0);
        }
    }

    /// Sets the Gaussian noise of the measured distance, mm rms.
    pub fn set_noise_rms_mm(&mut self, noise_rms_mm: f64) {
        self.noise_rms_mm = noise_rms_mm;
    }

    /// Sets or clears a fault. A module that goes silent drops a high echo; one that gets stuck is deaf at once, and
    /// holds its next echo.
    pub fn set_fault(&mut self, at_ns: u64, fault: Option<HcSr04Fault>) {
        self.advance(at_ns);
        self.fault = fault;
        if fault == Some(HcSr04Fault::Silent)
            && let Some(echo) = self.echo.take()
            && echo.risen
        {
            self.show(self.now_ns);
        }
    }

    /// Couples a wave into the echo line, replacing another; edges before the last call are omitted.
    pub fn set_interference(&mut self, wave: SquareWave) {
        self.interference = Some(Followed::new(wave, self.now_ns));
    }

    /// Drives the trigger pin. Returns the time at which the sound leaves, ns, if this starts a ping.
    pub fn trigger(&mut self, at_ns: u64, high: bool) -> Option<u64> {
        self.advance(at_ns);
        if high {
            self.trigger_rose_ns.get_or_insert(self.now_ns);
            return None;
        }
        let high_ns = self.now_ns - self.trigger_rose_ns.take()?;
        if high_ns < TRIGGER_NS {
            self.report(MisuseKind::TriggerTooShort { high_ns, needed_ns: TRIGGER_NS });
            return None;
        }
        if let Some(end_ns) = self.echo_end_ns() {
            self.report(MisuseKind::TriggerWhileBusy { free_in_ns: end_ns - self.now_ns });
            return None;
        }
        if self.fault == Some(HcSr04Fault::Silent) {
            return None;
        }
        if let Some(since_ns) = self.last_ping_ns.map(|last_ns| self.now_ns - last_ns)
            && since_ns < PERIOD_NS
        {
            self.report(MisuseKind::PingTooSoon { since_ns, needed_ns: PERIOD_NS });
        }
        self.last_ping_ns = Some(self.now_ns);
        let rise_ns = self.now_ns + ECHO_DELAY_NS;
        let width_ns = self.echo_width_ns();
        self.echo = Some(Echo { rise_ns, fall_ns: rise_ns + width_ns, risen: false });
        Some(rise_ns)
    }

    /// Registers a sound that another module sent at `ping_ns`, over a path of `path_m`; the air is that of now. Paths
    /// that are not finite, negative or over 8 m are ignored, and so are arrivals before a time already seen.
    pub fn hear(&mut self, ping_ns: u64, path_m: f64) {
        if !(0.0..=LONGEST_PATH_M).contains(&path_m) {
            return;
        }
        let arrival_ns = ping_ns + self.flight_ns(path_m);
        if arrival_ns > self.now_ns {
            self.arrivals_ns.push(arrival_ns);
        }
    }

    /// Level of the echo line at a time.
    pub fn echo_is_high(&mut self, at_ns: u64) -> bool {
        self.advance(at_ns);
        self.high
    }

    /// Edges of the echo line up to and at `at_ns` that were not taken before, oldest first. Of more than 64 the oldest
    /// are lost.
    pub fn take_edges(&mut self, at_ns: u64) -> impl Iterator<Item = EchoEdge> {
        self.advance(at_ns);
        self.edges.drain(..)
    }

    /// Time of the last falling edge of the echo line up to the time already seen, ns, whether or not it was taken: with
    /// it a reading can be measured for its age. `None` before the first.
    #[must_use]
    pub const fn echo_fell_ns(&self) -> Option<u64> {
        self.fell_ns
    }

    /// Time of the next known change of the echo line, ns; a sound of another module can end an echo earlier.
    #[must_use]
    pub fn next_edge_ns(&self) -> Option<u64> {
        let wave_ns = self.interference.as_ref().and_then(Followed::next_ns);
        self.next_own_edge_ns().into_iter().chain(wave_ns).min()
    }

    /// Violations of the data sheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Violations so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    fn advance(&mut self, to_ns: u64) {
        self.now_ns = self.now_ns.max(to_ns);
        let now_ns = self.now_ns;
        while let Some(at_ns) = self.next_edge_ns().filter(|at_ns| *at_ns <= now_ns) {
            if self.next_own_edge_ns() == Some(at_ns) {
                match &mut self.echo {
                    Some(echo) if !echo.risen => echo.risen = true,
                    _ => self.echo = None,
                }
            }
            self.show(at_ns);
        }
        self.arrivals_ns.retain(|arrival_ns| *arrival_ns > now_ns);
    }

    /// Time of the module's own next change of the line, ns.
    fn next_own_edge_ns(&self) -> Option<u64> {
        self.echo.filter(|echo| !echo.risen).map(|echo| echo.rise_ns).or(self.echo_end_ns())
    }

    /// Updates the level of the line at `at_ns`.
    fn show(&mut self, at_ns: u64) {
        let own = self.echo.is_some_and(|echo| echo.risen);
        let inverted = self.interference.as_mut().is_some_and(|wave| {
            wave.advance(at_ns);
            wave.inverts(at_ns)
        });
        let high = own ^ inverted;
        if high != self.high {
            self.high = high;
            self.push_edge(at_ns, high);
        }
    }

    /// End of the present echo, ns: the first sound that arrives while it is high, unless the module is deaf.
    fn echo_end_ns(&self) -> Option<u64> {
        let echo = self.echo?;
        let deaf = self.fault == Some(HcSr04Fault::StuckHigh);
        let heard_ns = self.arrivals_ns.iter().copied().filter(|arrival_ns| !deaf && *arrival_ns > echo.rise_ns).min();
        Some(heard_ns.map_or(echo.fall_ns, |arrival_ns| arrival_ns.min(echo.fall_ns)))
    }

    fn push_edge(&mut self, at_ns: u64, high: bool) {
        if !high {
            self.fell_ns = Some(at_ns);
        }
        if self.edges.len() == EDGES_KEPT {
            self.edges.pop_front();
        }
        self.edges.push_back(EchoEdge { at_ns, high });
    }

    fn echo_width_ns(&mut self) -> u64 {
        if self.fault == Some(HcSr04Fault::StuckHigh) {
            return STUCK_NS;
        }
        let noise = super::normal(&mut self.noise);
        let noise_m = noise * self.noise_rms_mm * 1e-3;
        match [self.distance_m, self.background_m].into_iter().flatten().min_by(f64::total_cmp) {
            // written so that NaN counts as no target
            Some(distance_m) if distance_m <= FARTHEST_M => self.flight_ns(2.0 * (distance_m + noise_m).max(NEAREST_M)),
            _ => TIME_OUT_NS,
        }
    }

    fn flight_ns(&self, path_m: f64) -> u64 {
        (path_m / speed_of_sound_m_s(self.air_c) * 1e9).round() as u64
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.number, kind });
    }
}

/// The board's four modules, which hear each other over settable paths.
#[derive(Clone, Debug)]
pub struct HcSr04Array {
    /// The modules, for queries and faults. Triggers go through the array, so that the other modules hear them.
    pub modules: [HcSr04; Self::MODULES],
    path_m: [[f64; Self::MODULES]; Self::MODULES],
}

impl HcSr04Array {
    /// Number of modules for which the board has inputs.
    pub const MODULES: usize = 4;

    /// Four modules that do not hear each other.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            modules: [0, 1, 2, 3].map(|number| HcSr04::new(number, seed)),
            path_m: [[f64::INFINITY; Self::MODULES]; Self::MODULES],
        }
    }

    /// Sets the path between two modules, both ways, directly or over a reflection, m; infinite for none. Numbers above
    /// 3 are ignored.
    pub fn set_path_m(&mut self, from: usize, to: usize, path_m: f64) {
        for [from, to] in [[from, to], [to, from]] {
            if let Some(path) = self.path_m.get_mut(from).and_then(|paths| paths.get_mut(to)) {
                *path = path_m;
            }
        }
    }

    /// Drives the trigger pin of one module; the others hear its ping. Numbers above 3 are ignored.
    pub fn trigger(&mut self, index: usize, at_ns: u64, high: bool) {
        let Some(module) = self.modules.get_mut(index) else { return };
        let Some(ping_ns) = module.trigger(at_ns, high) else { return };
        for (other, path_m) in self.path_m[index].iter().enumerate().filter(|(other, _)| *other != index) {
            self.modules[other].hear(ping_ns, *path_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;
    /// Speed of sound at 20 °C, m/s: 331.3 + 12.12.
    const SPEED_M_S: f64 = 343.42;

    fn pulse(module: &mut HcSr04, at_ns: u64, high_ns: u64) -> Option<u64> {
        assert_eq!(module.trigger(at_ns, true), None);
        module.trigger(at_ns + high_ns, false)
    }

    fn edges(module: &mut HcSr04, at_ns: u64) -> Vec<(u64, bool)> {
        module.take_edges(at_ns).map(|edge| (edge.at_ns, edge.high)).collect()
    }

    /// Width of one echo, ns, with a fresh trigger at `at_ns`.
    fn width_ns(module: &mut HcSr04, at_ns: u64) -> u64 {
        pulse(module, at_ns, 10_000).expect("ping");
        let edges = edges(module, at_ns + 1_000 * MS);
        assert_eq!(edges.iter().map(|(_, high)| *high).collect::<Vec<_>>(), [true, false]);
        assert_eq!(module.echo_fell_ns(), Some(edges[1].0));
        edges[1].0 - edges[0].0
    }

    fn kinds(module: &HcSr04) -> Vec<MisuseKind> {
        module.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    #[test]
    fn echo_width_is_the_round_trip() {
        let mut module = HcSr04::new(0, 1);
        for (index, (distance_m, expected_ns)) in [
            (Some(1.0), (2.0 / SPEED_M_S * 1e9) as u64),
            (Some(4.0), (8.0 / SPEED_M_S * 1e9) as u64),
            (Some(0.02), (0.04 / SPEED_M_S * 1e9) as u64),
            (Some(0.0), (0.04 / SPEED_M_S * 1e9) as u64),
            (Some(-1.0), (0.04 / SPEED_M_S * 1e9) as u64),
            (Some(4.001), 38 * MS),
            (Some(f64::NAN), 38 * MS),
            (None, 38 * MS),
        ]
        .into_iter()
        .enumerate()
        {
            module.set_distance_m(distance_m);
            // rounded, where the expectation is truncated
            assert!(width_ns(&mut module, index as u64 * 2_000 * MS).abs_diff(expected_ns) <= 1, "{distance_m:?}");
        }
        assert!(module.misuse().is_empty());
    }

    #[test]
    fn warm_air_is_faster() {
        let mut module = HcSr04::new(0, 1);
        module.set_distance_m(Some(1.0));
        for (index, (air_c, speed_m_s)) in
            [(0.0, 331.3), (40.0, 355.54), (-1000.0, 301.0), (f64::NAN, 301.0)].into_iter().enumerate()
        {
            module.set_air_c(air_c);
            let width_s = width_ns(&mut module, index as u64 * 2_000 * MS) as f64 * 1e-9;
            // 1 ns of 6 ms
            assert!((2.0 / width_s / speed_m_s - 1.0).abs() < 2e-7, "{air_c}");
        }
    }

    #[test]
    fn edges_come_when_their_time_has_come() {
        let mut module = HcSr04::new(0, 1);
        module.set_distance_m(Some(SPEED_M_S * 0.005));
        assert_eq!(pulse(&mut module, MS, 10_000), Some(1_510_000));
        let [rise_ns, fall_ns] = [1_510_000, 11_510_000];
        assert_eq!(module.next_edge_ns(), Some(rise_ns));
        assert!(!module.echo_is_high(rise_ns - 1));
        assert_eq!(edges(&mut module, rise_ns - 1), []);
        assert!(module.echo_is_high(rise_ns));
        assert_eq!(edges(&mut module, fall_ns - 1), [(rise_ns, true)]);
        assert_eq!(module.next_edge_ns(), Some(fall_ns));
        assert!(!module.echo_is_high(fall_ns));
        assert_eq!(edges(&mut module, fall_ns), [(fall_ns, false)]);
        assert_eq!(module.next_edge_ns(), None);
    }

    #[test]
    fn interference_inverts_the_line() {
        let mut module = HcSr04::new(0, 1);
        module.set_distance_m(Some(SPEED_M_S * 0.0005));
        module.set_interference(SquareWave { from_ns: 400_000, until_ns: 1_300_000, half_period_ns: 400_000 });
        pulse(&mut module, 0, 10_000).expect("ping");
        // The echo is high from 0.51 to 1.51 ms.
        let expected = [
            (400_000, true),
            (510_000, false),
            (800_000, true),
            (1_200_000, false),
            (1_300_000, true),
            (1_510_000, false),
        ];
        assert_eq!(edges(&mut module, 2 * MS), expected);
        assert_eq!(module.next_edge_ns(), None);
    }

    #[test]
    fn a_short_trigger_is_ignored() {
        let mut module = HcSr04::new(2, 1);
        assert_eq!(pulse(&mut module, 0, 9_999), None);
        assert_eq!(module.next_edge_ns(), None);
        assert_eq!(kinds(&module), [MisuseKind::TriggerTooShort { high_ns: 9_999, needed_ns: 10_000 }]);
        assert_eq!(module.misuse().first()[0].address, 2);
        assert!(pulse(&mut module, 20_000, 10_000).is_some());
        assert_eq!(module.misuse().total(), 1);
    }

    #[test]
    fn a_busy_module_ignores_the_trigger() {
        let mut module = HcSr04::new(0, 1);
        pulse(&mut module, 0, 10_000).expect("ping");
        // falls at 0.01 + 0.5 + 38 ms
        for (at_ns, free_in_ns) in [(100_000, 38_400_000), (30 * MS, 8_500_000)] {
            assert_eq!(pulse(&mut module, at_ns, 10_000), None);
            assert_eq!(kinds(&module).last(), Some(&MisuseKind::TriggerWhileBusy { free_in_ns }));
        }
        assert_eq!(edges(&mut module, 100 * MS), [(510_000, true), (38_510_000, false)]);
    }

    #[test]
    fn pings_nearer_than_60_ms_are_reported_and_sent() {
        for (apart_ns, reported) in [(60 * MS - 1, true), (60 * MS, false)] {
            let mut module = HcSr04::new(0, 1);
            pulse(&mut module, 0, 10_000).expect("ping");
            pulse(&mut module, apart_ns, 10_000).expect("ping");
            let expected = MisuseKind::PingTooSoon { since_ns: apart_ns, needed_ns: 60 * MS };
            assert_eq!(kinds(&module), if reported { vec![expected] } else { vec![] });
        }
    }

    #[test]
    fn a_silent_module_has_no_edges() {
        let mut module = HcSr04::new(0, 1);
        module.set_fault(0, Some(HcSr04Fault::Silent));
        assert_eq!(pulse(&mut module, 0, 10_000), None);
        assert_eq!(edges(&mut module, 300 * MS), []);
        module.set_fault(300 * MS, None);
        pulse(&mut module, 300 * MS, 10_000).expect("ping");
        // unplugged in the middle of an echo
        module.set_fault(310 * MS, Some(HcSr04Fault::Silent));
        assert_eq!(edges(&mut module, 400 * MS), [(300_510_000, true), (310 * MS, false)]);
        // and before it rises
        module.set_fault(400 * MS, None);
        pulse(&mut module, 400 * MS, 10_000).expect("ping");
        module.set_fault(400_100_000, Some(HcSr04Fault::Silent));
        assert_eq!(edges(&mut module, 500 * MS), []);
    }

    #[test]
    fn a_stuck_module_holds_its_echo_for_200_ms_whatever_comes() {
        let mut module = HcSr04::new(0, 1);
        module.set_fault(0, Some(HcSr04Fault::StuckHigh));
        module.set_distance_m(Some(1.0));
        let ping_ns = pulse(&mut module, 0, 10_000).expect("ping");
        module.hear(ping_ns, 1.0);
        assert_eq!(pulse(&mut module, 60 * MS, 10_000), None);
        assert_eq!(edges(&mut module, 300 * MS), [(510_000, true), (200_510_000, false)]);
    }

    #[test]
    fn noise_has_the_set_deviation_and_follows_the_seed() {
        let measure = |seed| {
            let mut module = HcSr04::new(0, seed);
            module.set_distance_m(Some(1.0));
            module.set_noise_rms_mm(3.0);
            let distances =
                (0..1_000_u64).map(|ping| width_ns(&mut module, ping * 2_000 * MS) as f64 * SPEED_M_S / 2e9);
            distances.collect::<Vec<_>>()
        };
        let distances_m = measure(7);
        let mean_m = distances_m.iter().sum::<f64>() / 1_000.0;
        let deviation_m = (distances_m.iter().map(|d| (d - mean_m).powi(2)).sum::<f64>() / 1_000.0).sqrt();
        // four standard errors: 3 mm / sqrt(1000) of the mean, 3 mm / sqrt(2000) of the deviation
        assert!((mean_m - 1.0).abs() < 4e-4, "{mean_m}");
        assert!((deviation_m - 3e-3).abs() < 2.7e-4, "{deviation_m}");
        assert_eq!(distances_m, measure(7));
        assert_ne!(distances_m, measure(8));
    }

    #[test]
    fn the_sound_of_another_module_ends_an_echo_early() {
        let mut array = HcSr04Array::new(1);
        array.set_path_m(0, 1, SPEED_M_S * 0.002);
        for index in [0, 1, 2] {
            array.trigger(index, 0, true);
            array.trigger(index, 10_000, false);
        }
        let widths: Vec<_> = array
            .modules
            .iter_mut()
            .map(|module| edges(module, 100 * MS))
            .map(|edges| edges.get(1).map(|fall| fall.0 - edges[0].0))
            .collect();
        // 0 and 1 end each other's after 2 ms of flight; 2 hears no other module; 3 was not triggered
        assert_eq!(widths, [Some(2 * MS), Some(2 * MS), Some(38 * MS), None]);
    }

    #[test]
    fn a_sound_under_way_is_heard_by_a_later_ping_only_while_it_listens() {
        // sent at 0.51 ms; on its way for 10 ms
        for (trigger_ns, heard) in [(5 * MS, true), (10 * MS - 11_000, true), (10 * MS, false), (11 * MS, false)] {
            let mut array = HcSr04Array::new(1);
            array.set_path_m(3, 0, SPEED_M_S * 0.010);
            array.trigger(3, 0, true);
            array.trigger(3, 10_000, false);
            array.trigger(0, trigger_ns, true);
            array.trigger(0, trigger_ns + 10_000, false);
            let edges = edges(&mut array.modules[0], 100 * MS);
            assert_eq!(edges[1].0 == 10_510_000, heard, "{edges:?}");
            assert_eq!(edges[1].0 == edges[0].0 + 38 * MS, !heard, "{edges:?}");
        }
    }

    #[test]
    fn what_a_deaf_module_missed_does_not_count_once_it_is_mended() {
        let mut module = HcSr04::new(0, 1);
        module.set_fault(0, Some(HcSr04Fault::StuckHigh));
        let ping_ns = pulse(&mut module, 0, 10_000).expect("ping");
        module.hear(ping_ns, 1.0);
        module.set_fault(50 * MS, None);
        assert_eq!(module.next_edge_ns(), Some(ping_ns + 200 * MS));
        // from then on it hears
        module.hear(60 * MS, SPEED_M_S * 0.001);
        assert_eq!(module.next_edge_ns(), Some(61 * MS));
        assert_eq!(edges(&mut module, 100 * MS), [(ping_ns, true), (61 * MS, false)]);
    }

    #[test]
    fn paths_that_cannot_be_heard() {
        for path_m in [8.01, -1.0, f64::NAN, f64::INFINITY] {
            let mut module = HcSr04::new(0, 1);
            let ping_ns = pulse(&mut module, 0, 10_000).expect("ping");
            module.hear(ping_ns, path_m);
            assert_eq!(module.next_edge_ns(), Some(ping_ns));
            assert_eq!(edges(&mut module, 100 * MS)[1].0, ping_ns + 38 * MS);
        }
    }

    #[test]
    fn edges_nobody_takes_are_bounded() {
        let mut module = HcSr04::new(0, 1);
        for ping in 0..100 {
            pulse(&mut module, ping * 60 * MS, 10_000).expect("ping");
        }
        let edges = edges(&mut module, 10_000 * MS);
        assert_eq!(edges.len(), 64);
        assert_eq!(edges[63], (99 * 60 * MS + 38_510_000, false));
    }

    proptest! {
        /// The frequency of queries does not change the result.
        #[test]
        fn lazy_equals_eager(
            // (nanoseconds since the last, action, distance or path)
            actions in prop::collection::vec((0..60 * MS, 0..4_u8, 0.0..9.0_f64), 1..30),
            looks in 1..20_u64,
        ) {
            let (mut lazy, mut eager) = (HcSr04::new(0, 5), HcSr04::new(0, 5));
            let mut eager_edges = Vec::new();
            let mut now_ns = 0;
            for module in [&mut lazy, &mut eager] {
                module.set_noise_rms_mm(5.0);
            }
            for (after_ns, what, path_m) in actions {
                for look in 1..=looks {
                    let at_ns = now_ns + after_ns * look / looks;
                    eager.echo_is_high(at_ns);
                    eager_edges.extend(eager.take_edges(at_ns));
                }
                now_ns += after_ns;
                for module in [&mut lazy, &mut eager] {
                    match what {
                        0 => module.hear(now_ns + 500_000, path_m),
                        1 => module.set_fault(now_ns, (path_m > 8.0).then_some(HcSr04Fault::StuckHigh)),
                        _ => {
                            module.set_distance_m(Some(path_m));
                            pulse(module, now_ns, 12_000);
                        }
                    }
                }
                now_ns += 12_000;
            }
            eager_edges.extend(eager.take_edges(u64::MAX));
            let lazy_edges: Vec<_> = lazy.take_edges(u64::MAX).collect();
            prop_assert_eq!(&lazy_edges, &eager_edges);
            prop_assert!(lazy_edges.iter().is_sorted_by_key(|edge| edge.at_ns));
            prop_assert!(lazy_edges.iter().zip([true, false].iter().cycle()).all(|(edge, high)| edge.high == *high));
            prop_assert_eq!(lazy.misuse(), eager.misuse());
        }
    }
}
