//! Capture and compare channels.

use super::{AOE, CCDS, CEN, MOE, OSSI, Tim, input};
use crate::context::{Context, Signal};

/// State of one of up to four channels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Channel {
    /// CCRx as written, and as in use; captured values are in both.
    pub(super) preload: u64,
    pub(super) compare: u64,
    /// Reference level of the output, OCxREF.
    pub(super) reference: bool,
    /// Output level last reported.
    pub(super) level: bool,
    /// Input edges since the last capture (ICxPSC).
    pub(super) edges: u32,
}

/// Output compare mode, OCxM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Frozen,
    Active,
    Inactive,
    Toggle,
    ForceInactive,
    ForceActive,
    Pwm1,
    Pwm2,
}

impl Tim {
    /// Returns the channel's byte of CCMRx. The fourth bit of OCxM is elsewhere and must be 0.
    pub(super) fn mode_byte(&self, index: usize) -> u32 {
        self.ccmr[index / 2] >> (8 * (index % 2)) & 0xff
    }

    pub(super) fn is_output(&self, index: usize) -> bool {
        self.mode_byte(index) & 3 == 0
    }

    pub(super) fn is_enabled(&self, index: usize) -> bool {
        self.ccer >> (4 * index) & 1 != 0
    }

    pub(super) fn is_preloaded(&self, index: usize) -> bool {
        self.mode_byte(index) & 1 << 3 != 0
    }

    fn mode(&self, index: usize) -> Mode {
        match self.mode_byte(index) >> 4 & 7 {
            0 => Mode::Frozen,
            1 => Mode::Active,
            2 => Mode::Inactive,
            3 => Mode::Toggle,
            4 => Mode::ForceInactive,
            5 => Mode::ForceActive,
            6 => Mode::Pwm1,
            _ => Mode::Pwm2,
        }
    }

    /// Returns the bits CCxP and CCxNP.
    fn polarity(&self, index: usize) -> (bool, bool) {
        let bits = self.ccer >> (4 * index);
        (bits & 2 != 0, bits & 8 != 0)
    }

    pub(super) fn is_driving(&self, index: usize) -> bool {
        let main = !self.kind.has_break() || self.bdtr & (MOE | OSSI) != 0;
        self.is_output(index) && self.is_enabled(index) && main
    }

    /// Updates OCxREF where it follows from the count, and reports outputs that have changed.
    pub(super) fn tell_outputs(&mut self, at_ns: u64, context: &mut Context<'_>) {
        for index in 0..self.kind.channels {
            if !self.is_output(index) {
                self.tell_output(index, false, at_ns, context);
                continue;
            }
            let below = self.count < self.channels[index].compare;
            let reference = match self.mode(index) {
                Mode::Pwm1 => below,
                Mode::Pwm2 => !below,
                Mode::ForceActive => true,
                Mode::ForceInactive => false,
                Mode::Frozen | Mode::Active | Mode::Inactive | Mode::Toggle => self.channels[index].reference,
            };
            self.channels[index].reference = reference;
            let level = if !self.is_driving(index) {
                false
            } else if self.kind.has_break() && self.bdtr & MOE == 0 {
                // Without MOE the output has the idle level OISx.
                self.cr2 >> (8 + 2 * index) & 1 != 0
            } else {
                reference != self.polarity(index).0
            };
            self.tell_output(index, level, at_ns, context);
        }
    }

    fn tell_output(&mut self, index: usize, level: bool, at_ns: u64, context: &mut Context<'_>) {
        let channel = &mut self.channels[index];
        if channel.level != level {
            channel.level = level;
            self.told_ns = context.now_ns.max(at_ns);
            let timer = self.kind.number;
            context.signals.push(Signal::TimerOutput { timer, channel: index as u8 + 1, at_ns, high: level });
        }
    }

    /// Handles a match of the count with the channel's compare value; updates OCxREF.
    pub(super) fn matched(&mut self, index: usize, context: &mut Context<'_>) {
        let reference = &mut self.channels[index].reference;
        let old = *reference;
        let new = match self.mode(index) {
            Mode::Active => true,
            Mode::Inactive => false,
            Mode::Toggle => !old,
            _ => old,
        };
        self.channels[index].reference = new;
        self.compare_event(index, context);
    }

    /// Sets CCxIF, and makes the channel's requests and triggers.
    pub(super) fn compare_event(&mut self, index: usize, context: &mut Context<'_>) {
        self.sr |= 2 << index;
        if self.dier >> index & 0x200 != 0 && self.cr2 & CCDS == 0 {
            self.request(self.kind.channel_requests[index], context);
        }
        // MMS = 3 makes a trigger pulse for each event of channel 1, also while the flag is still set.
        if index == 0 && self.master_mode() == 3 {
            self.trigger(context);
        }
    }

    /// Returns the counts to the channel's next compare event, given those to the overflow.
    pub(super) fn counts_to_match(&self, index: usize, to_overflow: u64) -> u64 {
        let compare = self.channels[index].compare;
        let top = if self.count <= self.arr { self.arr } else { self.kind.top() };
        if compare > self.count && compare <= top {
            compare - self.count
        } else if compare == 0 || compare > self.arr || !self.is_settled() {
            to_overflow
        } else {
            to_overflow + compare
        }
    }

    /// Returns the counts to the next edge of an enabled output; `None` if it does not change.
    pub(super) fn counts_to_edge(&self, index: usize, to_overflow: u64) -> Option<u64> {
        if !self.is_output(index) || !self.is_enabled(index) {
            return None;
        }
        if self.kind.has_break() && self.bdtr & MOE == 0 {
            return (self.bdtr & AOE != 0).then_some(to_overflow);
        }
        let Channel { compare, reference, .. } = self.channels[index];
        let next = match self.mode(index) {
            Mode::Frozen | Mode::ForceActive | Mode::ForceInactive => None,
            Mode::Active if reference => None,
            Mode::Inactive if !reference => None,
            Mode::Active | Mode::Inactive | Mode::Toggle => {
                (compare <= self.arr).then(|| self.counts_to_match(index, to_overflow))
            }
            Mode::Pwm1 | Mode::Pwm2 if compare == 0 || compare > self.arr && self.count <= self.arr => None,
            Mode::Pwm1 | Mode::Pwm2 if self.count < compare => Some(compare - self.count),
            Mode::Pwm1 | Mode::Pwm2 => Some(to_overflow),
        };
        if self.is_settled() { next } else { Some(next.map_or(to_overflow, |next| next.min(to_overflow))) }
    }

    pub(super) fn filter_ns(&self, index: usize) -> u64 {
        // ICxF belongs to the input, whichever channel captures it.
        if self.is_output(index) {
            return 0;
        }
        let division = 1 << (self.cr1 >> 8 & 3).min(2);
        input::filter_ns(self.mode_byte(index) >> 4, division, self.clock.frequency_hz)
    }

    /// Returns the enabled channels that capture input `input`.
    pub(super) fn capturing(&self, input: usize) -> impl Iterator<Item = usize> {
        // CCxS: 1 selects the channel's own input, 2 that of its neighbour.
        let own = move |index: usize, select: u32| index == input && select == 1 || index == input ^ 1 && select == 2;
        (0..self.kind.channels).filter(move |&index| self.is_enabled(index) && own(index, self.mode_byte(index) & 3))
    }

    /// Handles a change of the level behind an input's filter.
    pub(super) fn input_changed(&mut self, input: usize, at_ns: u64, context: &mut Context<'_>) {
        self.crossed = true;
        let encoder = self.encoder_mode().filter(|_| input < 2 && self.cr1 & CEN != 0);
        if let Some(mode) = encoder {
            self.encoder_edge(mode, input, at_ns, context);
        }
        let rising = self.inputs[input].filtered;
        for index in 0..self.kind.channels {
            if !self.capturing(input).any(|capturing| capturing == index) {
                continue;
            }
            let counts = match self.polarity(index) {
                (inverted, false) => rising != inverted,
                // Both edges; CCxNP without CCxP is reserved.
                (_, true) => true,
            };
            if counts {
                self.capture_edge(index, context);
            }
        }
    }

    /// Returns the half periods of a clock at TI1 up to the channel's next capture, `told` of which have passed.
    pub(super) fn halves_to_capture(&self, index: usize, told: u64) -> u64 {
        let every = 1_u64 << (self.mode_byte(index) >> 2 & 3);
        let edges = every.saturating_sub(self.channels[index].edges.into()).max(1);
        match self.polarity(index) {
            (_, true) => edges,
            // Odd half periods begin with a rising edge.
            (inverted, false) => {
                let first = if (told & 1 != 0) == inverted { 1 } else { 2 };
                first + 2 * (edges - 1)
            }
        }
    }

    fn capture_edge(&mut self, index: usize, context: &mut Context<'_>) {
        let every = 1 << (self.mode_byte(index) >> 2 & 3);
        let channel = &mut self.channels[index];
        channel.edges += 1;
        if channel.edges >= every {
            channel.edges = 0;
            self.capture(index, context);
        }
    }

    /// Captures the count in CCRx; sets CCxOF if the last capture was not read.
    pub(super) fn capture(&mut self, index: usize, context: &mut Context<'_>) {
        if self.sr & 2 << index != 0 {
            self.sr |= 0x200 << index;
        }
        self.channels[index].compare = self.count;
        self.channels[index].preload = self.count;
        self.compare_event(index, context);
    }

    /// Returns SMS 1 to 3 of a timer with an encoder interface.
    pub(super) fn encoder_mode(&self) -> Option<u32> {
        Some(self.smcr & 7).filter(|mode| self.kind.has_encoder && (1..=3).contains(mode))
    }

    /// Handles an edge of TI1 or TI2 in encoder mode, which moves the count (RM0399, TIM2 to 5, encoder interface).
    fn encoder_edge(&mut self, mode: u32, input: usize, at_ns: u64, context: &mut Context<'_>) {
        // Mode 1 counts the edges of TI1, mode 2 those of TI2, mode 3 both.
        if mode & 1 << input == 0 {
            return;
        }
        let level = |index: usize| self.inputs[index].filtered != self.polarity(index).0;
        let (first, second) = (level(0), level(1));
        // The count goes up if TI1 leads TI2: TI1 rises while TI2 is low, TI2 rises while TI1 is high, and so on.
        let up = if input == 0 { first != second } else { first == second };
        self.step(up, at_ns, context);
    }
}
