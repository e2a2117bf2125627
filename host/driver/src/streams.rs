//! Streams of messages from and to the board, with bounded queues that never block the link.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError, Weak},
    task::{Poll, Waker},
};

use r4_protocol::{Causes, ChannelId, ChannelInfo, LogChunk, SafetyState, Sample, Setpoint, Telemetry, ToDevice};

use crate::Error;

/// Capacity of a stream's queue; beyond it the oldest items are dropped.
const CAPACITY: usize = 4096;

struct Queue<T> {
    items: VecDeque<T>,
    dropped: u64,
    reader: Option<Waker>,
    end: Option<Error>,
}

/// Stream of all items of one kind from the moment it was made. A slow reader loses the oldest items, which are
/// counted.
pub struct Stream<T>(Arc<Mutex<Queue<T>>>);

/// Stream of every telemetry frame.
pub type TelemetryStream = Stream<Telemetry>;
/// Stream of one channel's samples.
pub type SampleStream = Stream<ChannelSample>;
/// Stream of messages that the driver has sent.
pub type SentStream = Stream<Sent>;

/// Stream of the board firmware's log.
pub type LogStream = Stream<LogChunk>;

/// Sample of one channel, with the board's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelSample {
    /// Board's clock at the measurement, µs.
    pub device_us: u64,
    /// Host's clock at the measurement, µs, estimated as by [`Board::host_us`](crate::Board::host_us).
    pub host_us: u64,
    /// Safety state of the board.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Measured values of the channel.
    pub sample: Sample,
}

impl ChannelSample {
    /// Returns the position of a motor, stepper or encoder in the unit of its channel, rad or m; `None` without a
    /// position sensor.
    #[must_use]
    pub fn position(&self, channel: &ChannelInfo) -> Option<f64> {
        match self.sample {
            Sample::Motor { position, .. } | Sample::Encoder { position, .. } if channel.resolution > 0.0 => {
                Some(f64::from(position) * f64::from(channel.resolution))
            }
            _ => None,
        }
    }
}

/// Message as it left for the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// Board's clock when it left, µs, estimated from heartbeats.
    pub device_us: u64,
    /// The message itself; heartbeats are left out.
    pub message: ToDevice,
    /// Set points in the message, of one command or of a cycle.
    pub setpoints: Vec<(ChannelId, Setpoint)>,
}

impl<T> Stream<T> {
    /// Waits for the next item.
    ///
    /// # Errors
    /// The error that ended the link, after all items before it have been read.
    pub async fn next(&mut self) -> Result<T, Error> {
        std::future::poll_fn(|context| {
            let mut queue = lock(&self.0);
            if let Some(item) = queue.items.pop_front() {
                return Poll::Ready(Ok(item));
            }
            if let Some(end) = &queue.end {
                return Poll::Ready(Err(end.clone()));
            }
            queue.reader = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    /// Returns the next item without waiting; `None` if there is none yet.
    pub fn try_next(&mut self) -> Option<T> {
        lock(&self.0).items.pop_front()
    }

    /// Returns the number of items dropped because this reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        lock(&self.0).dropped
    }
}

/// Sending side: distributes items to all streams of one kind.
pub(crate) struct Streams<T> {
    queues: Vec<Weak<Mutex<Queue<T>>>>,
    end: Option<Error>,
}

impl<T> Default for Streams<T> {
    fn default() -> Self {
        Self { queues: Vec::new(), end: None }
    }
}

impl<T: Clone> Streams<T> {
    pub(crate) fn open(&mut self) -> Stream<T> {
        // A stream opened after the end returns the error at once.
        let queue = Queue { items: VecDeque::new(), dropped: 0, reader: None, end: self.end.clone() };
        let queue = Arc::new(Mutex::new(queue));
        self.queues.push(Arc::downgrade(&queue));
        Stream(queue)
    }

    /// Returns true while a stream may have a reader.
    pub(crate) fn is_open(&self) -> bool {
        !self.queues.is_empty()
    }

    pub(crate) fn push(&mut self, item: &T) {
        self.each(|queue| {
            if queue.items.len() == CAPACITY {
                queue.items.pop_front();
                queue.dropped += 1;
            }
            queue.items.push_back(item.clone());
        });
    }

    pub(crate) fn end(&mut self, error: &Error) {
        self.end = Some(error.clone());
        self.each(|queue| queue.end = Some(error.clone()));
    }

    fn each(&mut self, mut f: impl FnMut(&mut Queue<T>)) {
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

/// Sending side for streams of single channels.
#[derive(Default)]
pub(crate) struct SampleStreams {
    of_channels: Vec<(ChannelId, Streams<ChannelSample>)>,
    end: Option<Error>,
}

impl SampleStreams {
    pub(crate) fn open(&mut self, channel: ChannelId) -> SampleStream {
        let place = self.of_channels.iter().position(|(of, _)| *of == channel).unwrap_or_else(|| {
            self.of_channels.push((channel, Streams { queues: Vec::new(), end: self.end.clone() }));
            self.of_channels.len() - 1
        });
        self.of_channels[place].1.open()
    }

    pub(crate) fn push(&mut self, frame: &Telemetry, host_us: u64) {
        let Telemetry { device_us, state, causes, ref samples } = *frame;
        for (channel, streams) in &mut self.of_channels {
            for sample in samples.iter().filter(|sample| sample.channel() == *channel) {
                streams.push(&ChannelSample { device_us, host_us, state, causes, sample: *sample });
            }
        }
    }

    pub(crate) fn end(&mut self, error: &Error) {
        self.end = Some(error.clone());
        self.of_channels.iter_mut().for_each(|(_, streams)| streams.end(error));
    }
}

/// Locks a mutex, also after a panic of another thread: each change under a lock is a single step, so the data is
/// consistent.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
