//! Search for a period in time. A small relative error of it is large at the end of a long recording.

/// Number of periods of a recording that the first search uses.
const COUNT: f64 = 100.0;
/// Distance of neighbouring periods, as the shift of the last period used over the noticeable shift; in the first
/// search and in the last refinement.
const APART: f64 = 0.5;
const CLOSER: f64 = 0.1;
/// Largest divisor of a peak's period that is tried in its place.
const PARTS: u32 = 8;

/// Parameters of the search.
pub(super) struct Search<N> {
    /// Shortest and longest period, s.
    pub(super) between_s: [f64; 2],
    /// Latest first sample of the recordings, s since the first period began.
    pub(super) from_s: f64,
    /// Latest last sample of the recordings, s since the first period began.
    pub(super) until_s: f64,
    /// Smallest shift that is noticeable for a period, s.
    pub(super) noticed_s: N,
    /// Largest number of periods that are returned.
    pub(super) offered: usize,
}

impl<N: Fn(f64) -> f64> Search<N> {
    /// Returns the periods that stand out most, s; best first. `stands_out` receives a period and the end of the
    /// evaluated stretch, s; its value must not grow by chance with the length of the stretch.
    pub(super) fn best(&self, stands_out: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let [shortest_s, longest_s] = self.between_s;
        let noticed_s = &self.noticed_s;
        let all = |period_s: f64| self.until_s / period_s;
        let few = |period_s: f64| (COUNT + self.from_s / period_s).min(all(period_s));
        if !(shortest_s > 0.0 && noticed_s(shortest_s) > 0.0) {
            return vec![];
        }
        let mut tried: Vec<(f64, f64)> = vec![];
        let mut period_s = shortest_s;
        while period_s <= longest_s.min(self.until_s) {
            let count = few(period_s);
            tried.push((stands_out(period_s, count * period_s), period_s));
            period_s += APART * noticed_s(period_s) / count;
        }
        let is_peak = |place: &usize| {
            let around = place.saturating_sub(1)..(place + 2).min(tried.len());
            tried[around].iter().all(|other| other.0 <= tried[*place].0)
        };
        let mut peaks: Vec<(f64, f64)> = (0..tried.len()).filter(is_peak).map(|place| tried[place]).collect();
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.truncate(self.offered);
        let best = |periods_s: &mut dyn Iterator<Item = (f64, f64)>| {
            periods_s
                .map(|(period_s, stretch_s)| (stands_out(period_s, stretch_s), period_s))
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        // The stretch is doubled as the distance is halved, so that each refinement resolves the last period it uses.
        for peak in &mut peaks {
            let mut count = few(peak.1);
            let mut apart_s = APART * noticed_s(peak.1) / count;
            while apart_s * all(peak.1) > CLOSER * noticed_s(peak.1) {
                apart_s *= 0.5;
                count = (2.0 * count).min(all(peak.1));
                let around = [peak.1 - apart_s, peak.1, peak.1 + apart_s];
                *peak = best(&mut around.into_iter().map(|period_s| (period_s, count * period_s))).unwrap_or(*peak);
            }
            // The first search uses a longer stretch for a multiple of a short period, which may therefore win.
            let parts = (1..=PARTS).map(|part| peak.1 / f64::from(part)).filter(|&part_s| part_s >= shortest_s);
            *peak = best(&mut parts.map(|part_s| (part_s, self.until_s))).unwrap_or(*peak);
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.dedup_by(|a, b| (a.1 - b.1).abs() * all(b.1) < noticed_s(b.1));
        peaks.into_iter().map(|(_, period_s)| period_s).collect()
    }
}
