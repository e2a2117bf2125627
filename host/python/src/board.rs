//! An opened board: blocking calls, and calls whose results are fetched after a wake-up.

use std::{
    collections::{BTreeMap, HashMap},
    io::{Read, Write},
    os::{fd::AsRawFd, unix::net::UnixStream},
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{self, RecvTimeoutError},
    },
    time::Duration,
};

use futures::future::AbortHandle;
use pyo3::prelude::*;
use r4_links::{Key, ports};
use r4_rig::{BoardThread, Call, Error, PlantFile, Rig, Target};

use crate::{
    error,
    request::{self, Outcome, Request},
    value::{Info, Port},
};

/// Period at which a blocking call checks for signals, such as Ctrl-C.
const SIGNALS_EVERY: Duration = Duration::from_millis(50);

/// Results of submitted calls, on their way to the thread with the event loop.
struct Mailbox {
    results: Mutex<Vec<(u64, Result<Outcome, Error>)>>,
    /// Socket that wakes the event loop: a byte is written for each result.
    bell: UnixStream,
}

/// A board with an open session, on a thread of its own.
#[pyclass(frozen, module = "r4._native")]
pub(crate) struct Board {
    thread: Mutex<Option<BoardThread>>,
    mailbox: Arc<Mailbox>,
    bell: UnixStream,
    /// Submitted calls that can be aborted, by their tickets.
    under_way: Mutex<HashMap<u64, AbortHandle>>,
    info: Py<Info>,
    is_virtual: bool,
}

/// Locks a mutex, also after another thread panicked: every change under a lock is a single step.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Serial ports of this computer, boards first.
#[pyfunction]
pub(crate) fn find(py: Python<'_>) -> PyResult<Vec<Port>> {
    let ports = py.detach(ports::list).map_err(|error| error::plain(py, "LinkError", &error))?;
    Ok(ports.into_iter().map(Port::from).collect())
}

/// Names of the built-in robots.
#[pyfunction]
pub(crate) fn robots() -> Vec<&'static str> {
    r4_boards::names().collect()
}

#[pymethods]
impl Board {
    /// Opens the board at `address`; options for virtual boards are ignored for others.
    #[staticmethod]
    #[pyo3(signature = (address, *, seed=1, world=None, plants=BTreeMap::new(), body=None, hidden=None, flash=None, key=None, log=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn open(
        py: Python<'_>,
        address: &str,
        seed: u64,
        world: Option<String>,
        plants: BTreeMap<String, PathBuf>,
        body: Option<PathBuf>,
        hidden: Option<u64>,
        flash: Option<PathBuf>,
        key: Option<PathBuf>,
        log: Option<PathBuf>,
    ) -> PyResult<Self> {
        let target: Target = address.parse().map_err(|bad| error::plain(py, "BadAddress", &bad))?;
        let plant = |(name, path): (String, PathBuf)| Ok(PlantFile { channel: request::channel(&name)?, path });
        let plants = plants.into_iter().map(plant).collect::<PyResult<Vec<_>>>()?;
        let key = key.map(|file| Key::read(&file)).transpose().map_err(|bad| error::plain(py, "LinkError", &bad))?;
        let make = move || Rig { seed, world, plants, body, hidden, flash, key, ..Rig::new(target) };
        let thread = py.detach(|| BoardThread::start(make, log)).map_err(|error| error::of_rig(py, &error))?;
        let (bell, rung) = UnixStream::pair()?;
        bell.set_nonblocking(true)?;
        rung.set_nonblocking(true)?;
        let info = Info::new(thread.target().to_string(), thread.info(), thread.channels());
        Ok(Self {
            is_virtual: thread.target().is_virtual(),
            info: Py::new(py, info)?,
            thread: Mutex::new(Some(thread)),
            mailbox: Arc::new(Mailbox { results: Mutex::default(), bell: rung }),
            bell,
            under_way: Mutex::default(),
        })
    }

    /// Description of the board, received when the session was opened.
    #[getter]
    fn info(&self, py: Python<'_>) -> Py<Info> {
        self.info.clone_ref(py)
    }

    /// True when the board's time is simulated.
    #[getter]
    fn is_virtual(&self) -> bool {
        self.is_virtual
    }

    /// Carries out a request and waits for its result. Ctrl-C ends the wait, but not the motion of the board.
    fn call(&self, py: Python<'_>, request: &Request) -> PyResult<Py<PyAny>> {
        let (done, answer) = mpsc::channel();
        let (call, abort) = Call::new(request.work(), move |result| drop(done.send(result)));
        self.submit_to_thread(py, vec![call])?;
        // The closure that runs without the interpreter's lock may capture shareable values only.
        let answer = Mutex::new(answer);
        let result = loop {
            match py.detach(|| lock(&answer).recv_timeout(SIGNALS_EVERY)) {
                Ok(result) => break result,
                Err(RecvTimeoutError::Disconnected) => break Err(Error::SessionEnded),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(interrupt) = py.check_signals() {
                        abort.abort();
                        self.submit_to_thread(py, Vec::new())?;
                        return Err(interrupt);
                    }
                }
            }
        };
        python(py, result)
    }

    /// Submits requests with their tickets, and gives a virtual board's clock its next turn. Does not wait.
    fn submit(&self, py: Python<'_>, requests: Vec<(u64, Py<Request>)>) -> PyResult<()> {
        let calls = requests.iter().map(|(ticket, request)| {
            let (ticket, mailbox) = (*ticket, Arc::clone(&self.mailbox));
            let (call, abort) = Call::new(request.get().work(), move |result| {
                lock(&mailbox.results).push((ticket, result));
                // A full buffer wakes the event loop too.
                let _ = (&mailbox.bell).write(&[1]);
            });
            lock(&self.under_way).insert(ticket, abort);
            call.taking_turns()
        });
        self.submit_to_thread(py, calls.collect())
    }

    /// Results of submitted requests that have arrived: ticket, success, and the value or the exception.
    fn drain(&self, py: Python<'_>) -> PyResult<Vec<(u64, bool, Py<PyAny>)>> {
        let mut rung = [0; 64];
        while matches!((&self.bell).read(&mut rung), Ok(count) if count == rung.len()) {}
        let results = std::mem::take(&mut *lock(&self.mailbox.results));
        let mut under_way = lock(&self.under_way);
        let drained = results.into_iter().map(|(ticket, result)| {
            under_way.remove(&ticket);
            Ok(match python(py, result) {
                Ok(value) => (ticket, true, value),
                Err(error) => (ticket, false, error.into_value(py).into_any()),
            })
        });
        drained.collect()
    }

    /// Aborts a submitted request: its result is an error unless it has arrived. The motion of the board continues.
    fn abort(&self, ticket: u64) {
        if let Some(handle) = lock(&self.under_way).remove(&ticket) {
            handle.abort();
        }
    }

    /// File descriptor that becomes readable when results have arrived.
    fn fileno(&self) -> i32 {
        self.bell.as_raw_fd()
    }

    /// Closes the session; closing again is no error.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let thread = lock(&self.thread).take();
        py.detach(|| thread.map_or(Ok(()), BoardThread::close)).map_err(|error| error::of_rig(py, &error))
    }
}

impl Board {
    fn submit_to_thread(&self, py: Python<'_>, calls: Vec<Call>) -> PyResult<()> {
        let submitted = match &*lock(&self.thread) {
            Some(thread) => thread.submit(calls),
            None => Err(Error::SessionEnded),
        };
        submitted.map_err(|error| error::of_rig(py, &error))
    }
}

fn python(py: Python<'_>, result: Result<Outcome, Error>) -> PyResult<Py<PyAny>> {
    match result {
        Ok(outcome) => outcome.into_python(py),
        Err(error) => Err(error::of_rig(py, &error)),
    }
}
