//! Queue of the bytes that wait to be sent to a client.

use std::{
    collections::VecDeque,
    task::{Poll, Waker},
};

use r4_protocol::{ToHost, encode_frame, frame::MAX_FRAME};

/// Bytes that may wait before telemetry and log chunks are dropped. Two seconds of telemetry over the board's fastest
/// link, USB at full speed, would be more; but a client that is that late needs new samples more than old ones.
const ROOM: usize = 256 * 1024;
/// Bytes that may wait in all. A client that does not even read its answers is no longer served.
const MOST: usize = 2 * ROOM;

/// Frames that wait to be sent to one client.
#[derive(Default)]
pub(crate) struct Outbox {
    bytes: VecDeque<u8>,
    /// Number of frames that were dropped for want of room.
    pub(crate) dropped: u64,
    is_full: bool,
    sender: Option<Waker>,
}

impl Outbox {
    /// Queues telemetry or a log chunk; drops and counts it if more than [`ROOM`] bytes wait.
    pub(crate) fn push_if_room(&mut self, message: &ToHost) {
        if self.bytes.len() > ROOM {
            self.dropped += 1;
        } else {
            self.push(message);
        }
    }

    pub(crate) fn push(&mut self, message: &ToHost) {
        if self.bytes.len() > MOST {
            self.is_full = true;
        } else if let Ok(frame) = encode_frame(message, &mut [0; MAX_FRAME]) {
            self.bytes.extend(frame);
        }
        if let Some(sender) = self.sender.take() {
            sender.wake();
        }
    }

    /// Takes all waiting bytes; pending until there are some.
    ///
    /// # Errors
    /// `()` if the client has left more than [`MOST`] bytes unread.
    pub(crate) fn poll(&mut self, context: &std::task::Context<'_>) -> Poll<Result<Vec<u8>, ()>> {
        if self.is_full {
            return Poll::Ready(Err(()));
        }
        if self.bytes.is_empty() {
            self.sender = Some(context.waker().clone());
            return Poll::Pending;
        }
        Poll::Ready(Ok(self.bytes.drain(..).collect()))
    }
}

#[cfg(test)]
mod tests {
    use std::task::Context;

    use r4_protocol::{Refusal, Reply};

    use super::*;

    #[test]
    fn what_is_watched_is_dropped_before_the_client_is() {
        let answer = ToHost::Response { seq: 0, result: Ok(Reply::Done) };
        let context = Context::from_waker(Waker::noop());
        let mut outbox = Outbox::default();
        assert!(outbox.poll(&context).is_pending());
        while outbox.dropped == 0 {
            outbox.push_if_room(&answer);
        }
        let len = encode_frame(&answer, &mut [0; MAX_FRAME]).expect("fits").len();
        assert_eq!(outbox.bytes.len() / len, ROOM / len + 1);
        let refused = ToHost::Response { seq: 0, result: Err(Refusal::Busy) };
        outbox.push(&refused);
        // All frames that waited, with the answer behind them.
        let Poll::Ready(Ok(bytes)) = outbox.poll(&context) else { panic!("nothing waits") };
        assert!(bytes.ends_with(encode_frame(&refused, &mut [0; MAX_FRAME]).expect("fits")));
        (0..=MOST / len + 1).for_each(|_| outbox.push(&answer));
        assert_eq!(outbox.poll(&context), Poll::Ready(Err(())));
    }
}
