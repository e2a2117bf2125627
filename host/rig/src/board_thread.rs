//! A board on a thread of its own, for programs that wait for each call, and for other languages.
//!
//! A [`Session`] is a closure on one thread, and a simulation cannot leave its thread. A [`BoardThread`] keeps both on
//! a thread that receives [calls](Call) from any other. The same code opens simulated, emulated and real boards.
//!
//! **Time of a virtual board passes only while a call is waited for.** Between calls its thread sleeps and the clock
//! stands still, so that results do not depend on how fast the calls come. Calls that take turns
//! ([`Call::taking_turns`]) go further: when one of them ends, the clock stands still until the next
//! [`BoardThread::submit`], even while others are in progress.
//!
//! ```
//! use r4_rig::{BoardThread, Rig};
//!
//! let target = "sim:osmc-bench".parse()?;
//! let board = BoardThread::start(move || Rig::new(target), None)?;
//! let osmc0 = "osmc0".parse().expect("a channel");
//! board.call(|desk| Box::pin(async move { Ok(desk.session.board.arm().await?) }))?;
//! let motion = board.call(move |desk| Box::pin(async move { Ok(desk.session.board.move_to(osmc0, 1.57, 5.0).await?) }))?;
//! assert!(motion.settled);
//! board.close()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::{
    cell::RefCell,
    collections::BTreeMap,
    path::PathBuf,
    sync::mpsc,
    thread::{self, JoinHandle},
};

use futures::{
    FutureExt, StreamExt,
    channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
    future::{AbortHandle, Abortable, Either, LocalBoxFuture, select},
    stream::FuturesUnordered,
};
use r4_driver::Cycles;
use r4_protocol::{ChannelInfo, DeviceInfo};

use crate::{
    Error, HostClock, Rig, Session, Target,
    recording::{self, Recording},
};

/// Session with the state that calls share.
pub struct Desk<'b> {
    /// Session on the board's thread.
    pub session: &'b Session<'b>,
    /// Streams of set points that calls opened, by the numbers that the calls chose. A stream ends when it is removed
    /// and dropped.
    pub streams: RefCell<BTreeMap<u64, Cycles<'b, HostClock>>>,
}

type Work = Box<dyn for<'c, 'b> FnOnce(&'c Desk<'b>) -> LocalBoxFuture<'c, ()> + Send>;

/// A unit of work for the board's thread, before it is submitted.
pub struct Call {
    work: Work,
    takes_turns: bool,
}

/// Callback of a call's result. Dropped without a result, it reports [`Error::SessionEnded`].
struct Answer<T, F: FnOnce(Result<T, Error>)>(Option<F>, std::marker::PhantomData<fn(T)>);

impl<T, F: FnOnce(Result<T, Error>)> Answer<T, F> {
    fn give(mut self, result: Result<T, Error>) {
        if let Some(done) = self.0.take() {
            done(result);
        }
    }
}

impl<T, F: FnOnce(Result<T, Error>)> Drop for Answer<T, F> {
    fn drop(&mut self) {
        if let Some(done) = self.0.take() {
            done(Err(Error::SessionEnded));
        }
    }
}

impl Call {
    /// Creates a call of `work`. `done` receives its result on the board's thread: [`Error::SessionEnded`] when the
    /// handle aborted the call or the session ended before.
    pub fn new<T: 'static>(
        work: impl for<'c, 'b> FnOnce(&'c Desk<'b>) -> LocalBoxFuture<'c, Result<T, Error>> + Send + 'static,
        done: impl FnOnce(Result<T, Error>) + Send + 'static,
    ) -> (Self, AbortHandle) {
        let answer = Answer(Some(done), std::marker::PhantomData);
        let (handle, registration) = AbortHandle::new_pair();
        let work: Work = Box::new(move |desk| {
            let asked = Abortable::new(work(desk), registration);
            async move {
                if let Ok(result) = asked.await {
                    answer.give(result);
                }
            }
            .boxed_local()
        });
        (Self { work, takes_turns: false }, handle)
    }

    /// Returns the same call, after whose end a virtual board's clock waits for the next [`BoardThread::submit`].
    #[must_use]
    pub fn taking_turns(mut self) -> Self {
        self.takes_turns = true;
        self
    }
}

/// An opened board on a thread of its own.
///
/// Time of a virtual board passes only while a call is waited for: between calls its clock stands still.
///
/// Several threads may use it at once. Dropping it closes the session: the board makes its outputs safe.
pub struct BoardThread {
    calls: Option<UnboundedSender<Vec<Call>>>,
    thread: Option<JoinHandle<Result<(), Error>>>,
    target: Target,
    info: DeviceInfo,
    channels: Vec<ChannelInfo>,
}

type Opened = (Target, DeviceInfo, Vec<ChannelInfo>);

impl BoardThread {
    /// Opens the board of the rig that `make` creates on the new thread, recorded into the file `log` if one is given.
    ///
    /// # Errors
    /// The error of opening the board or the log; [`Error::Thread`] when the operating system gives no thread.
    pub fn start(make: impl FnOnce() -> Rig + Send + 'static, log: Option<PathBuf>) -> Result<Self, Error> {
        let (calls, queue) = unbounded();
        let (opened, outcome) = mpsc::channel();
        let thread = thread::Builder::new()
            .name("r4-board".into())
            .spawn(move || run(&make(), log, queue, opened))
            .map_err(Error::Thread)?;
        match outcome.recv() {
            Ok((target, info, channels)) => {
                Ok(Self { calls: Some(calls), thread: Some(thread), target, info, channels })
            }
            // The thread ended before there was a session; its result is the reason.
            Err(_) => Err(thread.join().unwrap_or(Err(Error::SessionEnded)).err().unwrap_or(Error::SessionEnded)),
        }
    }

    /// Name of the board, as the caller gave it.
    #[must_use]
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Description of the board, received when the session opened.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Descriptions of the board's channels.
    #[must_use]
    pub fn channels(&self) -> &[ChannelInfo] {
        &self.channels
    }

    /// Submits calls, all at once, without waiting for them. An empty list gives the next turn to those in progress.
    ///
    /// # Errors
    /// [`Error::SessionEnded`] after the end of the session.
    pub fn submit(&self, calls: Vec<Call>) -> Result<(), Error> {
        let sent = self.calls.as_ref().and_then(|queue| queue.unbounded_send(calls).ok());
        sent.ok_or(Error::SessionEnded)
    }

    /// Runs `work` on the board's thread and waits for its result.
    ///
    /// # Errors
    /// Those of `work`; [`Error::SessionEnded`].
    pub fn call<T: Send + 'static>(
        &self,
        work: impl for<'c, 'b> FnOnce(&'c Desk<'b>) -> LocalBoxFuture<'c, Result<T, Error>> + Send + 'static,
    ) -> Result<T, Error> {
        let (done, answer) = mpsc::channel();
        // Sending fails only when the caller below no longer waits.
        let (call, _) = Call::new(work, move |result| drop(done.send(result)));
        self.submit(vec![call])?;
        answer.recv().unwrap_or(Err(Error::SessionEnded))
    }

    /// Closes the session and waits for its end.
    ///
    /// # Errors
    /// The error of the session, or of its recording when that is not complete.
    pub fn close(mut self) -> Result<(), Error> {
        self.end()
    }

    fn end(&mut self) -> Result<(), Error> {
        self.calls = None;
        self.thread.take().map_or(Ok(()), |thread| thread.join().unwrap_or(Err(Error::SessionEnded)))
    }
}

impl Drop for BoardThread {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

fn run(
    rig: &Rig,
    log: Option<PathBuf>,
    mut queue: UnboundedReceiver<Vec<Call>>,
    opened: mpsc::Sender<Opened>,
) -> Result<(), Error> {
    let tap = |output| recording::tap(&rig.target, rig.seed, "r4-rig".into(), "BoardThread".into(), output);
    let recording = log.map(|path| Recording::create(path, tap)).transpose()?;
    let result = rig.run(recording.as_ref().map(Recording::tap), async |session| {
        let board = session.board;
        // Sending fails only when the caller is gone; its queue of calls then ends at once.
        let _ = opened.send((session.target().clone(), board.info().clone(), board.channels().to_vec()));
        serve(&Desk { session, streams: RefCell::default() }, &mut queue).await;
        Ok::<_, Error>(())
    });
    let closed = recording.map_or(Ok(()), |recording| recording.close().result);
    result?;
    Ok(closed?)
}

/// Runs calls until all senders are dropped; calls in progress are dropped then.
async fn serve(desk: &Desk<'_>, queue: &mut UnboundedReceiver<Vec<Call>>) {
    let is_virtual = desk.session.target().is_virtual();
    let mut running = FuturesUnordered::new();
    let mut waits_for_turn = false;
    loop {
        let calls = if is_virtual && (running.is_empty() || waits_for_turn) {
            // Blocking here, inside of a poll, is what stops the virtual clock.
            r4_links::block_on(queue.next())
        } else {
            match select(queue.next(), running.next()).await {
                Either::Left((calls, _)) => calls,
                // None when no call is in progress: only a new call can change that.
                Either::Right((None, calls)) => calls.await,
                Either::Right((Some(takes_turns), _)) => {
                    waits_for_turn = takes_turns;
                    continue;
                }
            }
        };
        let Some(calls) = calls else { return };
        waits_for_turn = false;
        for Call { work, takes_turns } in calls {
            running.push(work(desk).map(move |()| takes_turns));
        }
    }
}
