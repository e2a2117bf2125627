//! What comes from the board, or goes to it, as streams that never block the link.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError, Weak},
    task::{Poll, Waker},
};

use r4_protocol::{Causes, ChannelId, ChannelInfo, LogChunk, SafetyState, Sample, Setpoint, Telemetry, ToDevice};

use crate::Error;

/// Items a reader may fall behind before the oldest are dropped.
const CAPACITY: usize = 4096;

struct Queue<T> {
    items: VecDeque<T>,
    dropped: u64,
    reader: Option<Waker>,
    end: Option<Error>,
}

/// Everything of its kind from the moment the stream was made. A reader that falls behind loses the oldest, counted.
pub struct Stream<T>(Arc<Mutex<Queue<T>>>);

/// Every telemetry frame.
pub type TelemetryStream = Stream<Telemetry>;
/// The samples of one channel.
pub type SampleStream = Stream<ChannelSample>;
/// What the driver has sent.
pub type SentStream = Stream<Sent>;

/// What the board's firmware logs.
pub type LogStream = Stream<LogChunk>;

/// A sample of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelSample {
    /// The board's clock when it was taken, µs.
    pub device_us: u64,
    /// The host's clock then, as [`Board::host_us`](crate::Board::host_us) tells.
    pub host_us: u64,
    /// Where the supervisor stood.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// What was measured.
    pub sample: Sample,
}

impl ChannelSample {
    /// The position of a motor, stepper or encoder in the unit of its channel, rad or m; `None` where nothing measures one.
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

/// A message as it left for the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// The board's clock then, as far as heartbeats tell, µs.
    pub device_us: u64,
    /// Any but heartbeats.
    pub message: ToDevice,
    /// The set points in it, of one command or of a cycle.
    pub setpoints: Vec<(ChannelId, Setpoint)>,
}

impl<T> Stream<T> {
    /// The next item.
    ///
    /// # Errors
    /// Why the link ended, once the items before that are read.
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

    /// The next item if one is there.
    pub fn try_next(&mut self) -> Option<T> {
        lock(&self.0).items.pop_front()
    }

    /// Items dropped because this reader was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        lock(&self.0).dropped
    }
}

/// Where the connection puts items for all streams of a kind.
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
        // After the end a stream says so at once.
        let queue = Queue { items: VecDeque::new(), dropped: 0, reader: None, end: self.end.clone() };
        let queue = Arc::new(Mutex::new(queue));
        self.queues.push(Arc::downgrade(&queue));
        Stream(queue)
    }

    /// Whether anybody may be reading.
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

/// Where the connection puts samples for those who want one channel.
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

/// Locks, also after another thread panicked: every change below a lock is a single step.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
