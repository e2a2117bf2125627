//! Transmitter of a USART (RM0399, 51.5.5).

use std::collections::VecDeque;

use crate::context::{Context, Ticks};

use super::Usart;
use super::registers::{cr1, isr};

/// Frame in the shift register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Frame {
    /// Idle frame that a transmitter sends when it is switched on.
    Idle,
    Data(u8),
}

/// TDR with its FIFO, and the shift register.
#[derive(Clone, Debug, Default)]
pub(super) struct Transmitter {
    waiting: VecDeque<u8>,
    /// TE was set since the last frame, so an idle frame is due.
    idle_frame_due: bool,
    shifting: Option<Shifting>,
}

#[derive(Clone, Copy, Debug)]
struct Shifting {
    frame: Frame,
    /// Half bits of a run of frames without a gap.
    half_bits: Ticks,
    /// End of this frame, in these half bits.
    end: u64,
}

impl Transmitter {
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Returns the end of the frame on the line, ns; `None` for an idle line.
    pub(super) fn next_ns(&self) -> Option<u64> {
        self.shifting.map(|shifting| shifting.half_bits.when_ns(shifting.end))
    }

    pub(super) fn sends_data(&self) -> bool {
        matches!(self.shifting, Some(Shifting { frame: Frame::Data(_), .. }))
    }

    pub(super) fn flush(&mut self) {
        self.waiting.clear();
    }

    /// Aborts the frame on the line, when TE or UE is cleared.
    pub(super) fn cut(&mut self) {
        self.shifting = None;
        self.idle_frame_due = false;
    }

    pub(super) fn send_idle_frame(&mut self) {
        self.idle_frame_due = true;
    }
}

impl Usart {
    /// Handles a write to TDR.
    pub(super) fn put(&mut self, value: u8, context: &mut Context<'_>) {
        if !self.enabled() {
            context.misuse(self.port.name, "TDR is written while UE is 0: the character is lost (RM0399, 51.5.5)");
            return;
        }
        if !self.on(cr1::TE) {
            context.misuse(self.port.name, "TDR is written while TE is 0; TE is to be set first (RM0399, 51.5.5)");
        }
        if self.transmitter.waiting() == self.transmit_capacity() {
            context.misuse(self.port.name, "TDR is written while it is full: a character is lost (RM0399, 51.8.13)");
            if self.fifo() {
                return;
            }
            // Without FIFO the new character replaces the one in TDR.
            self.transmitter.flush();
        }
        self.transmitter.waiting.push_back(value);
        self.txfe_cleared = false;
        self.kept &= !isr::TC;
        self.load(self.half_bits_from(context.now_ns), 0);
    }

    /// Moves the next frame to the shift register, if that is free; the frame starts `at` half bits into the run.
    pub(super) fn load(&mut self, half_bits: Ticks, at: u64) {
        if self.transmitter.shifting.is_some() || !self.enabled() || !self.on(cr1::TE) {
            return;
        }
        let frame = if std::mem::take(&mut self.transmitter.idle_frame_due) {
            Frame::Idle
        } else if let Some(value) = self.transmitter.waiting.pop_front() {
            Frame::Data(value)
        } else {
            return;
        };
        self.transmitter.shifting = Some(Shifting { frame, half_bits, end: at + self.frame_half_bits() });
    }

    /// Handles the end of the frame on the line.
    pub(super) fn frame_sent(&mut self, at_ns: u64, context: &mut Context<'_>) {
        let Some(sent) = self.transmitter.shifting.take() else { return };
        if let Frame::Data(value) = sent.frame {
            context.outside.uart_sent(self.port.number, at_ns, value & self.data_mask());
            if self.transmitter.waiting.is_empty() {
                self.kept |= isr::TC;
            }
        }
        // The next frame follows without a gap, in the same count of half bits.
        self.load(sent.half_bits, sent.end);
    }

    /// Takes over a changed kernel clock for the rest of the frame.
    pub(super) fn retime(&mut self, context: &mut Context<'_>) {
        let Some(shifting) = self.transmitter.shifting else { return };
        if shifting.frame != Frame::Idle {
            context.misuse(self.port.name, "the kernel clock changes within a frame (RM0399, 51.5.7)");
        }
        let done = shifting.half_bits.at(context.now_ns);
        let half_bits = self.half_bits_from(context.now_ns);
        self.transmitter.shifting = Some(Shifting { half_bits, end: shifting.end.saturating_sub(done), ..shifting });
    }
}
