//! Telemetry as a stream that never blocks the link.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError, Weak},
    task::{Poll, Waker},
};

use r4_protocol::Telemetry;

use crate::Error;

/// Frames a reader may fall behind before the oldest are dropped.
const CAPACITY: usize = 4096;

#[derive(Default)]
struct Queue {
    frames: VecDeque<Telemetry>,
    dropped: u64,
    reader: Option<Waker>,
    end: Option<Error>,
}

/// Every telemetry frame from the moment the stream was made.
pub struct TelemetryStream(Arc<Mutex<Queue>>);

impl TelemetryStream {
    /// The next frame.
    ///
    /// # Errors
    /// Why the link ended, once the frames before that are read.
    pub async fn next(&mut self) -> Result<Telemetry, Error> {
        std::future::poll_fn(|context| {
            let mut queue = lock(&self.0);
            if let Some(frame) = queue.frames.pop_front() {
                return Poll::Ready(Ok(frame));
            }
            if let Some(end) = &queue.end {
                return Poll::Ready(Err(end.clone()));
            }
            queue.reader = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    /// The next frame if one is there.
    pub fn try_next(&mut self) -> Option<Telemetry> {
        lock(&self.0).frames.pop_front()
    }

    /// Frames dropped because this reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        lock(&self.0).dropped
    }
}

/// Where the connection puts frames for all streams.
#[derive(Default)]
pub(crate) struct Streams {
    queues: Vec<Weak<Mutex<Queue>>>,
    end: Option<Error>,
}

impl Streams {
    pub(crate) fn open(&mut self) -> TelemetryStream {
        // After the end a stream says so at once.
        let queue = Arc::new(Mutex::new(Queue { end: self.end.clone(), ..Queue::default() }));
        self.queues.push(Arc::downgrade(&queue));
        TelemetryStream(queue)
    }

    pub(crate) fn push(&mut self, frame: &Telemetry) {
        self.each(|queue| {
            if queue.frames.len() == CAPACITY {
                queue.frames.pop_front();
                queue.dropped += 1;
            }
            queue.frames.push_back(frame.clone());
        });
    }

    pub(crate) fn end(&mut self, error: &Error) {
        self.end = Some(error.clone());
        self.each(|queue| queue.end = Some(error.clone()));
    }

    fn each(&mut self, mut f: impl FnMut(&mut Queue)) {
        self.queues.retain(|queue| {
            let Some(queue) = queue.upgrade() else { return false };
            let mut queue = lock(&queue);
            f(&mut queue);
            if let Some(reader) = queue.reader.take() {
                reader.wake();
            }
            true
        });
    }
}

/// Locks, also after another thread panicked: every change below a lock is a single step.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
