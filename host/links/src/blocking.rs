//! Blocking interface to the driver: a thread runs the asynchronous driver, keeps its heartbeat and executes the calls.
//! The driver itself is the same.
//!
//! ```no_run
//! use r4_links::{Address, blocking::Board};
//! use r4_protocol::{ChannelId, ChannelKind, Mode, Setpoint};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let board = Board::connect(&"serial:auto".parse::<Address>()?, None)?;
//! let motor = ChannelId::new(ChannelKind::Osmc, 0);
//! board.arm()?;
//! let motion = board.move_to(motor, 1.57, 5.0)?;
//! println!("{} rad", motion.position);
//! board.disarm()?;
//! # Ok(())
//! # }
//! ```

use std::{
    io,
    sync::mpsc::{self, Receiver},
    thread::{self, JoinHandle},
};

use futures::{
    FutureExt, StreamExt,
    channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
    future::{Either, LocalBoxFuture, select},
    stream::FuturesUnordered,
};
use r4_driver::{Error, Motion, with_board};
use r4_protocol::{ChannelId, ChannelInfo, DeviceInfo, Sample, Setpoint, Telemetry};

use crate::{Address, Key, OpenError, RealClock, block_on, open};

type Inner = r4_driver::Board<RealClock>;
type Job = Box<dyn for<'b> FnOnce(&'b Inner) -> LocalBoxFuture<'b, ()> + Send>;

/// Reason why no session was opened.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    /// The link could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The board does not answer, or refuses the session.
    #[error(transparent)]
    Board(#[from] Error),
    /// The operating system could not start a thread.
    #[error("cannot start the thread that keeps the heartbeat: {0}")]
    Thread(#[from] io::Error),
}

/// Session with a board. Several threads may use it at once; no call waits for another thread's call.
///
/// The heartbeat continues whatever the program does, and ends with the program or when this value is dropped: then the
/// board makes its outputs safe.
pub struct Board {
    jobs: Option<UnboundedSender<Job>>,
    thread: Option<JoinHandle<()>>,
    info: DeviceInfo,
    channels: Vec<ChannelInfo>,
}

impl Board {
    /// Opens a session with the board at `address`.
    ///
    /// # Errors
    /// [`ConnectError`] names the reason.
    pub fn connect(address: &Address, key: Option<&Key>) -> Result<Self, ConnectError> {
        let (jobs, queue) = unbounded();
        let (told, outcome) = mpsc::channel();
        let (address, key) = (address.clone(), key.cloned());
        let thread = thread::Builder::new()
            .name("r4-board".into())
            .spawn(move || block_on(run(&address, key.as_ref(), queue, told)))?;
        // The thread always sends an outcome; only a panic can drop the sender before.
        let outcome = outcome.recv().unwrap_or(Err(ConnectError::Board(gone())));
        let (info, channels) = outcome?;
        Ok(Self { jobs: Some(jobs), thread: Some(thread), info, channels })
    }

    /// Description that the board gave when the session was opened.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Channels in the board's order, as the board describes them.
    #[must_use]
    pub fn channels(&self) -> &[ChannelInfo] {
        &self.channels
    }

    /// Calls any function of the asynchronous driver and waits for its result: `board.call(|board|
    /// Box::pin(board.faults()))`.
    ///
    /// # Errors
    /// Those of the called function.
    pub fn call<T: Send + 'static>(
        &self,
        ask: impl for<'b> FnOnce(&'b Inner) -> LocalBoxFuture<'b, Result<T, Error>> + Send + 'static,
    ) -> Result<T, Error> {
        let (told, answer) = mpsc::channel();
        self.give(Box::new(move |board| {
            let asked = ask(board);
            async move {
                // The calling thread may have ended.
                let _ = told.send(asked.await);
            }
            .boxed_local()
        }))?;
        answer.recv().unwrap_or(Err(gone()))
    }

    fn give(&self, job: Job) -> Result<(), Error> {
        self.jobs.as_ref().and_then(|jobs| jobs.unbounded_send(job).ok()).ok_or(gone())
    }

    /// Blocking form of [`r4_driver::Board::arm`].
    ///
    /// # Errors
    /// Those of that function.
    pub fn arm(&self) -> Result<(), Error> {
        self.call(|board| Box::pin(board.arm()))
    }

    /// Blocking form of [`r4_driver::Board::disarm`].
    ///
    /// # Errors
    /// Those of that function.
    pub fn disarm(&self) -> Result<(), Error> {
        self.call(|board| Box::pin(board.disarm()))
    }

    /// Blocking form of [`r4_driver::Board::clear`].
    ///
    /// # Errors
    /// Those of that function.
    pub fn clear(&self) -> Result<(), Error> {
        self.call(|board| Box::pin(board.clear()))
    }

    /// Blocking form of [`r4_driver::Board::stop`].
    ///
    /// # Errors
    /// Those of that function.
    pub fn stop(&self) -> Result<(), Error> {
        self.call(|board| Box::pin(board.stop()))
    }

    /// Blocking form of [`r4_driver::Board::set`].
    ///
    /// # Errors
    /// Those of that function.
    pub fn set(&self, channel: ChannelId, setpoint: Setpoint) -> Result<(), Error> {
        self.call(move |board| Box::pin(board.set(channel, setpoint)))
    }

    /// Blocking form of [`r4_driver::Board::move_to`]: target in rad or m, time-out in s.
    ///
    /// # Errors
    /// Those of that function.
    pub fn move_to(&self, channel: ChannelId, target: f64, timeout_s: f64) -> Result<Motion, Error> {
        self.call(move |board| Box::pin(board.move_to(channel, target, timeout_s)))
    }

    /// Subscribes to these channels every `period_ms` and returns an iterator over their samples from now on.
    ///
    /// # Errors
    /// Those of [`r4_driver::Board::subscribe`].
    pub fn samples(&self, channels: &[ChannelId], period_ms: u16) -> Result<Samples, Error> {
        let channels = channels.to_vec();
        let (told, frames) = mpsc::channel();
        let subscribed = channels.clone();
        self.call(move |board| {
            Box::pin(async move {
                for channel in subscribed {
                    board.subscribe(channel, period_ms).await?;
                }
                Ok(())
            })
        })?;
        self.give(Box::new(move |board| {
            let mut telemetry = board.telemetry();
            async move {
                loop {
                    let frame = telemetry.next().await;
                    let over = frame.is_err();
                    if told.send(frame).is_err() || over {
                        return;
                    }
                }
            }
            .boxed_local()
        }))?;
        Ok(Samples { frames, channels, waiting: Vec::new() })
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        // Dropping the sender closes the queue, which ends the session.
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Iterator over a board's samples as they arrive, from [`Board::samples`]. Ends with the session.
pub struct Samples {
    frames: Receiver<Result<Telemetry, Error>>,
    channels: Vec<ChannelId>,
    /// Remaining samples of the last frame, in reverse order.
    waiting: Vec<(u64, Sample)>,
}

impl Iterator for Samples {
    /// Board's clock at the measurement, µs, and the sample.
    type Item = Result<(u64, Sample), Error>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(sample) = self.waiting.pop() {
                return Some(Ok(sample));
            }
            match self.frames.recv().ok()? {
                Ok(frame) => {
                    let ours = frame.samples.iter().filter(|sample| self.channels.contains(&sample.channel()));
                    self.waiting = ours.rev().map(|sample| (frame.device_us, *sample)).collect();
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

fn gone() -> Error {
    Error::LinkFailed { reason: "the session has ended".into() }
}

type Opened = Result<(DeviceInfo, Vec<ChannelInfo>), ConnectError>;

async fn run(address: &Address, key: Option<&Key>, mut queue: UnboundedReceiver<Job>, told: mpsc::Sender<Opened>) {
    let link = match open(address, key).await {
        Ok(link) => link,
        Err(error) => {
            let _ = told.send(Err(error.into()));
            return;
        }
    };
    let session = with_board(link.rx, link.tx, RealClock, async |board| {
        let _ = told.send(Ok((board.info().clone(), board.channels().to_vec())));
        let mut running = FuturesUnordered::new();
        loop {
            let job = match select(queue.next(), running.next()).await {
                Either::Left((job, _)) => job,
                // `None` means that no job runs: only a new job can change that.
                Either::Right((None, job)) => job.await,
                Either::Right((Some(()), _)) => continue,
            };
            // The [`Board`] was dropped: running jobs are dropped too, and the session closes.
            let Some(job) = job else { return };
            running.push(job(board));
        }
    });
    if let Err(error) = session.await {
        let _ = told.send(Err(error.into()));
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{Mode, Request};

    use super::*;
    use crate::fake_board::{FakeBoard, MOTOR, Session, channel};

    #[test]
    fn what_a_program_asks_for_reaches_the_board() {
        let fake = FakeBoard::new(&[Session { device_us: 7, ..Session::default() }]);
        let board = Board::connect(&fake.address, None).expect("it takes everybody");
        assert_eq!((board.info().robot.as_str(), board.channels()), ("fake", &[channel()][..]));
        let setpoint = Setpoint { mode: Mode::Duty, value: 0.5 };
        board.clear().expect("done");
        board.arm().expect("done");
        board.set(MOTOR, setpoint).expect("done");
        board.stop().expect("done");
        board.disarm().expect("done");
        let mut samples = board.samples(&[MOTOR], 20).expect("done");
        for expected in [2.0, 4.0] {
            let (device_us, sample) = samples.next().expect("one").expect("measured");
            assert!(
                device_us == 7 && matches!(sample, Sample::Reading { channel: MOTOR, value, .. } if value == expected)
            );
        }
        // Dropping waits until the session is closed.
        drop(board);
        let asked: Vec<_> = fake.asked.try_iter().collect();
        assert!(samples.all(|sample| sample.is_ok()), "they end with the session");
        assert!(
            matches!(
                asked[..],
                [
                    Request::Clear,
                    Request::Arm,
                    Request::Set { channel: MOTOR, setpoint: set, .. },
                    Request::Stop,
                    Request::Disarm,
                    Request::Subscribe { channel: MOTOR, period_ms: 20 },
                    Request::Bye,
                ] if set == setpoint
            ),
            "{asked:?}"
        );
    }

    #[test]
    fn a_lost_link_ends_what_is_waited_for() {
        let fake = FakeBoard::new(&[Session { ends_at_stop: true, ..Session::default() }]);
        let board = Board::connect(&fake.address, None).expect("it takes everybody");
        let mut samples = board.samples(&[MOTOR], 20).expect("done");
        assert!(samples.by_ref().take(2).all(|sample| sample.is_ok()));
        let lost = board.stop().expect_err("it cuts the link");
        assert!(matches!(lost, Error::LinkFailed { .. }), "{lost}");
        assert!(samples.next().is_some_and(|sample| sample.is_err()), "the reason");
        assert!(samples.next().is_none(), "and no more");
        assert!(board.arm().is_err());
    }
}
