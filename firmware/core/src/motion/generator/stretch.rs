//! Length of a stretch: the wait for a pulse, and pulses of equal spacing.

use crate::platform::{StepAction, StepEvent};

/// Largest deviation of a pulse from the tick of its event, in either direction, if events are queued [`LEAD`](super::LEAD) ticks
/// before.
pub const ERROR: u32 = 8;
/// Shortest period, ticks. Events closer than this are made this far apart.
pub const SHORTEST: u32 = 100;
/// Longest period of a timer, ticks.
pub const LONGEST: u32 = 1024;
/// Blank period without events, ticks, and the least after a pulse without a near successor.
pub const IDLE: u32 = 256;
/// Maximum number of periods in a stretch of pulses: bounds the duration of the interrupt.
pub const MOST: u32 = 16;

/// Ticks from `now` until `tick`, negative when that is over.
pub(super) const fn until(tick: u32, now: u32) -> i32 {
    tick.wrapping_sub(now).cast_signed()
}

/// Number and length of the blank periods that begin a wait: the whole wait, or all but one more period.
pub(super) fn blank(wait: u32) -> (u32, u32) {
    match wait {
        ..=LONGEST => (1, wait.max(SHORTEST)),
        _ if wait.is_multiple_of(IDLE) => (wait / IDLE, IDLE),
        _ => ((wait - SHORTEST) / IDLE, IDLE),
    }
}

/// Number and spacing of the pulses of a stretch that begins with one at `start`; `events` are those that follow it.
pub(super) fn pulses<'e>(start: u32, events: impl Iterator<Item = &'e StepEvent>) -> (u32, u32) {
    let (mut low, mut high) = (SHORTEST, LONGEST);
    let mut best = None;
    let mut turned = false;
    for (event, count) in events.zip(1..) {
        let after = until(event.at, start).max(0).cast_unsigned();
        match event.action {
            // The length of this period depends on the pulse behind the turn.
            StepAction::Direction(_) if best.is_none() => {
                turned = true;
                continue;
            }
            StepAction::Direction(_) => break,
            StepAction::Pulse if best.is_none() && after > LONGEST => {
                return (1, IDLE + (after - IDLE) % IDLE);
            }
            StepAction::Pulse if turned => return (1, after.max(SHORTEST)),
            StepAction::Pulse => {}
        }
        low = low.max(after.saturating_sub(ERROR).div_ceil(count));
        high = high.min((after + ERROR) / count);
        let spacing = high.min(after / count);
        if count == 1 {
            best = Some((1, after.max(SHORTEST)));
        } else if low <= spacing {
            best = Some((count, spacing));
        }
        if low > high || count == MOST {
            break;
        }
    }
    best.unwrap_or((1, IDLE))
}
