//! Counter, its updates, and the time of the next event.

use super::{AOE, CCDS, CEN, DIR, MOE, OPM, OUTPUT_BATCH_NS, Tim, UDE, UDIS, UIF, URS};
use crate::context::Context;

impl Tim {
    /// Returns true while the timer counts its own clock.
    pub(super) fn is_running(&self) -> bool {
        self.cr1 & CEN != 0 && self.encoder_mode().is_none()
    }

    /// Returns true if no preloaded value waits for the next update.
    pub(super) fn is_settled(&self) -> bool {
        let channels = &self.channels[..self.kind.channels];
        self.psc == self.psc_preload
            && self.arr == self.arr_preload
            && channels.iter().all(|channel| channel.compare == channel.preload)
    }

    /// Computes everything up to `now_ns`: counts, and the edges that filters have passed meanwhile.
    pub(super) fn run_to(&mut self, now_ns: u64, context: &mut Context<'_>) {
        loop {
            let passing = self.inputs.iter().enumerate().filter_map(|(n, input)| Some((input.passes_ns?, Some(n))));
            let ticking = self.next_source_ns().map(|at_ns| (at_ns, None));
            // Of all pending edges the earliest one is handled first, so that counts and captures keep their order.
            let Some((at_ns, index)) = passing.chain(ticking).min().filter(|&(at_ns, _)| at_ns <= now_ns) else {
                break;
            };
            // A late edge counts as of the last access.
            let at_ns = at_ns.max(self.now_ns);
            self.count_to(at_ns, context);
            self.now_ns = at_ns;
            match index {
                Some(index) => {
                    self.inputs[index].pass();
                    self.input_changed(index, at_ns, context);
                }
                None => self.source_edge(at_ns, context),
            }
        }
        self.count_to(now_ns, context);
        self.now_ns = self.now_ns.max(now_ns);
        self.skip_source(self.now_ns);
    }

    fn count_to(&mut self, to_ns: u64, context: &mut Context<'_>) {
        if !self.is_running() || to_ns <= self.now_ns {
            return;
        }
        let target = self.clock.at(to_ns);
        let mut overflows = 0;
        while self.cr1 & CEN != 0 {
            let per_count = u64::from(self.psc) + 1;
            let clocks = self.prescaled + (target - self.done);
            // ARR = 0 stops the counter: "The counter is blocked while the auto-reload value is null" (RM0399,
            // TIMx_ARR).
            let counts = if self.arr == 0 { 0 } else { clocks / per_count };
            let to_boundary = self.counts_to_boundary();
            if counts < to_boundary {
                self.count += counts;
                self.prescaled = clocks % per_count;
                self.done = target;
                return;
            }
            // The prescaler restarts at each boundary, so the clocks already in it are taken off.
            self.done += to_boundary * per_count - self.prescaled;
            self.prescaled = 0;
            let at_ns = self.clock.when_ns(self.done);
            // Periods are skipped from an overflow on.
            if self.cross_boundary(to_boundary, at_ns, context) {
                overflows += 1;
                self.skip_periods(overflows, target);
            }
        }
    }

    fn counts_to_overflow(&self) -> u64 {
        // A count beyond the auto-reload value continues to the end of the range.
        let last = if self.count <= self.arr { self.arr } else { self.kind.top() };
        last + 1 - self.count
    }

    /// Returns the counts to the overflow or the next compare value of a channel.
    fn counts_to_boundary(&self) -> u64 {
        let overflow = self.counts_to_overflow();
        (0..self.kind.channels)
            .filter(|&index| self.is_output(index))
            .map(|index| self.channels[index].compare)
            .filter(|&compare| compare > self.count && compare < self.count + overflow)
            .fold(overflow, |counts, compare| counts.min(compare - self.count))
    }

    /// Counts up to a boundary; returns true if it was the overflow.
    fn cross_boundary(&mut self, counts: u64, at_ns: u64, context: &mut Context<'_>) -> bool {
        self.crossed = true;
        let (last, within) = (self.count + counts, self.count <= self.arr);
        // A count above ARR wraps at the end of the range, which is no update.
        let overflow = within && last > self.arr || last > self.kind.top();
        self.count = if overflow { 0 } else { last };
        if overflow && within {
            self.overflow(context);
        }
        self.compare_all(context);
        self.tell_outputs(at_ns, context);
        overflow
    }

    fn compare_all(&mut self, context: &mut Context<'_>) {
        for index in 0..self.kind.channels {
            if self.is_output(index) && self.channels[index].compare == self.count {
                self.matched(index, context);
            }
        }
    }

    /// Handles an overflow of the count.
    fn overflow(&mut self, context: &mut Context<'_>) {
        for index in 0..self.kind.channels {
            // A compare value that is never reached sets its flag at the overflow (RM0399, TIMx_SR, CC1IF).
            if self.is_output(index) && self.channels[index].compare > self.arr {
                self.compare_event(index, context);
            }
        }
        // The repetition counter delays the update by this many overflows.
        if self.repetitions > 0 {
            self.repetitions -= 1;
            return;
        }
        if self.cr1 & UDIS != 0 {
            return;
        }
        self.update(true, context);
        if self.cr1 & OPM != 0 {
            self.cr1 &= !CEN;
        }
    }

    /// Carries out an update event: preloaded values take effect.
    pub(super) fn update(&mut self, by_counter: bool, context: &mut Context<'_>) {
        self.psc = self.psc_preload;
        self.arr = self.arr_preload;
        self.repetitions = self.rcr_preload;
        for channel in &mut self.channels {
            channel.compare = channel.preload;
        }
        if self.bdtr & AOE != 0 {
            self.bdtr |= MOE;
        }
        // URS limits flag and requests to overflows.
        if by_counter || self.cr1 & URS == 0 {
            self.sr |= UIF;
            if self.dier & UDE != 0 {
                self.request(self.kind.update_request, context);
            }
            for index in 0..self.kind.channels {
                if self.cr2 & CCDS != 0 && self.dier >> index & 0x200 != 0 {
                    self.request(self.kind.channel_requests[index], context);
                }
            }
        }
        if self.master_mode() == 2 {
            self.trigger(context);
        }
    }

    /// Handles EGR.UG: counter and prescaler restart.
    pub(super) fn generate_update(&mut self, context: &mut Context<'_>) {
        let down = self.encoder_mode().is_some() && self.cr1 & DIR != 0;
        self.prescaled = 0;
        if self.cr1 & UDIS == 0 {
            self.update(false, context);
        }
        self.count = if down { self.arr } else { 0 };
        if self.master_mode() == 0 {
            self.trigger(context);
        }
        self.tell_outputs(self.now_ns, context);
    }

    /// Handles one count of the encoder interface.
    pub(super) fn step(&mut self, up: bool, at_ns: u64, context: &mut Context<'_>) {
        self.cr1 = if up { self.cr1 & !DIR } else { self.cr1 | DIR };
        self.prescaled += 1;
        if self.prescaled <= u64::from(self.psc) {
            return;
        }
        self.prescaled = 0;
        if self.arr == 0 {
            return;
        }
        // An update belongs to a wrap at ARR only, not to one at the end of the range.
        if up && (self.count == self.arr || self.count == self.kind.top()) {
            let end = self.count == self.arr;
            self.count = 0;
            if end {
                self.overflow(context);
            }
        } else if !up && self.count == 0 {
            self.overflow(context);
            self.count = self.arr;
        } else {
            self.count = if up { self.count + 1 } else { self.count - 1 };
        }
        self.compare_all(context);
        self.tell_outputs(at_ns, context);
    }

    /// Skips periods that change nothing: flags stay set, and toggled levels are restored after two updates.
    fn skip_periods(&mut self, overflows: u64, target: u64) {
        // Two updates restore the repetition counter, and an even number of periods restores toggled outputs.
        let cycle = 2 * (u64::from(self.rcr_preload) + 1);
        let settled = self.repetitions == self.rcr_preload && self.arr != 0 && self.count == 0;
        if overflows < cycle || !settled || !self.is_quiet() {
            return;
        }
        // Whole cycles are skipped, so that the phase of count, prescaler and repetitions stays.
        let clocks = cycle * (self.arr + 1) * (u64::from(self.psc) + 1);
        self.done += (target - self.done) / clocks * clocks;
    }

    /// Returns true if no period has an effect that others can observe.
    fn is_quiet(&self) -> bool {
        let asks = self.dier & 0x1f00 != 0 || matches!(self.master_mode(), 2 | 3) || self.cr1 & OPM != 0;
        let to_overflow = self.counts_to_overflow();
        self.is_settled() && !asks && (0..self.kind.channels).all(|n| self.counts_to_edge(n, to_overflow).is_none())
    }

    /// Returns the time of the next event of this timer that others can observe, ns.
    pub(super) fn find_next_event(&self) -> u64 {
        let filtered = self.inputs.iter().enumerate().filter(|&(n, _)| self.watches(n as u8 + 1));
        let filtered_ns = filtered.filter_map(|(_, input)| input.passes_ns).min().unwrap_or(u64::MAX);
        let filtered_ns = filtered_ns.min(self.source_event_ns());
        if !self.is_running() || self.arr == 0 {
            return filtered_ns;
        }
        let to_overflow = self.counts_to_overflow();
        let mut counts = u64::MAX;
        let mut edge = u64::MAX;
        // An event counts only if it changes what others observe: a flag that is set already does not.
        let update = self.dier & UIF & !self.sr != 0
            || self.dier & UDE != 0
            || self.master_mode() == 2
            || self.cr2 & CCDS != 0 && self.dier & 0x1e00 != 0;
        if update {
            counts = to_overflow;
        }
        for index in (0..self.kind.channels).filter(|&index| self.is_output(index)) {
            let interrupt = (self.dier & !self.sr) >> index & 2 != 0;
            let request = self.dier >> index & 0x200 != 0 && self.cr2 & CCDS == 0;
            if interrupt || request || index == 0 && self.master_mode() == 3 {
                counts = counts.min(self.counts_to_match(index, to_overflow));
            }
            if let Some(next) = self.counts_to_edge(index, to_overflow) {
                edge = edge.min(next);
            }
        }
        // Edges soon after the last report wait for the batch.
        let edge_ns = self.when_ns(edge).max(self.told_ns.saturating_add(OUTPUT_BATCH_NS));
        let edge_ns = if edge == u64::MAX { u64::MAX } else { edge_ns };
        filtered_ns.min(self.when_ns(counts)).min(edge_ns)
    }

    /// Returns the time after `counts` more counts, ns.
    fn when_ns(&self, counts: u64) -> u64 {
        if counts == u64::MAX {
            return u64::MAX;
        }
        self.clock.when_ns(self.done + counts * (u64::from(self.psc) + 1) - self.prescaled)
    }
}
