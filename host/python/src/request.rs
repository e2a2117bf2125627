//! Requests to a board: created in Python, carried out on the board's thread.

use std::collections::BTreeMap;

use futures::{FutureExt, future::LocalBoxFuture};
use pyo3::{IntoPyObjectExt, prelude::*};
use r4_driver::{CycleReport, Until};
use r4_protocol::{Causes, ChannelId, ChannelInfo, Mode, SafetyState};
use r4_rig::{Desk, Error, Followed, Paths, Quantity, Unsuitable, path::Waypoint};

use crate::{
    error,
    value::{self, Motion, PathReport, Sample},
};

/// Longest time to live of a stream's set points, s: within the protocol's milliseconds, and more than any link needs.
const MAX_TTL_S: f64 = 60.0;

/// Order to a board, wrapped by [`Request`] for Python.
#[derive(Clone, Debug)]
enum Order {
    Arm,
    Disarm,
    Clear,
    Stop,
    State,
    Time,
    Sleep { seconds: f64 },
    Set { channel: ChannelId, mode: Mode, value: f64 },
    Drive { channel: ChannelId, mode: Mode, value: f64, until: Until },
    Query { channel: ChannelId },
    Follow { paths: Paths },
    OpenStream { number: u64, channels: Vec<(ChannelId, Mode)>, ttl_ms: u16 },
    Cycle { number: u64, values: Vec<f64> },
    CloseStream { number: u64 },
    TruePosition { channel: ChannelId },
}

/// Result of a request, before its conversion to Python.
pub(crate) enum Outcome {
    Nothing,
    Number(f64),
    State(SafetyState, Causes),
    Motion(r4_driver::Motion),
    Sample(r4_driver::ChannelSample, Box<ChannelInfo>),
    Paths(Vec<Followed>),
    Cycle(CycleReport),
}

impl Outcome {
    pub(crate) fn into_python(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(match self {
            Self::Nothing => py.None(),
            Self::Number(number) => number.into_py_any(py)?,
            Self::State(state, causes) => (state.to_string(), error::causes(causes)).into_py_any(py)?,
            Self::Motion(motion) => Motion::from(motion).into_py_any(py)?,
            Self::Sample(sample, info) => Sample::new(&sample, &info).into_py_any(py)?,
            Self::Paths(paths) => paths.into_iter().map(PathReport::from).collect::<Vec<_>>().into_py_any(py)?,
            Self::Cycle(report) => value::Cycle::from(report).into_py_any(py)?,
        })
    }
}

/// A point of a path: time, s; position; speed or None; feed-forward duty.
type Point = (f64, f64, Option<f64>, f64);

/// A request for `Board.call` and `Board.submit`.
#[pyclass(frozen, module = "r4._native")]
pub(crate) struct Request(Order);

/// Parses the name of a channel.
pub(crate) fn channel(name: &str) -> PyResult<ChannelId> {
    name.parse::<ChannelId>().map_err(|bad| error::bad_value(format!("{name:?} is {bad}")))
}

fn mode(name: &str) -> PyResult<Mode> {
    let found = Mode::ALL.into_iter().find(|mode| mode.to_string() == name);
    let known = || Mode::ALL.map(|mode| mode.to_string()).join(", ");
    found.ok_or_else(|| error::bad_value(format!("{name:?} is no mode: one of {}", known())))
}

/// Checks a duration, s: finite and not negative.
fn seconds(value: f64) -> PyResult<f64> {
    if value.is_finite() && value >= 0.0 {
        return Ok(value);
    }
    Err(error::bad_value(format!("{value} s cannot be waited for: give a number of seconds from 0 on")))
}

#[pymethods]
impl Request {
    #[staticmethod]
    fn arm() -> Self {
        Self(Order::Arm)
    }

    #[staticmethod]
    fn disarm() -> Self {
        Self(Order::Disarm)
    }

    #[staticmethod]
    fn clear() -> Self {
        Self(Order::Clear)
    }

    #[staticmethod]
    fn estop() -> Self {
        Self(Order::Stop)
    }

    #[staticmethod]
    fn state() -> Self {
        Self(Order::State)
    }

    #[staticmethod]
    fn time() -> Self {
        Self(Order::Time)
    }

    #[staticmethod]
    fn sleep(duration_s: f64) -> PyResult<Self> {
        Ok(Self(Order::Sleep { seconds: seconds(duration_s)? }))
    }

    #[staticmethod]
    fn set(of: &str, by: &str, value: f64) -> PyResult<Self> {
        Ok(Self(Order::Set { channel: channel(of)?, mode: mode(by)?, value }))
    }

    #[staticmethod]
    fn move_to(of: &str, position: f64, timeout_s: f64) -> PyResult<Self> {
        let until = Until::Settled { timeout_s: seconds(timeout_s)? };
        Ok(Self(Order::Drive { channel: channel(of)?, mode: Mode::Position, value: position, until }))
    }

    #[staticmethod]
    fn home(of: &str, speed: f64, timeout_s: f64) -> PyResult<Self> {
        let until = Until::Homed { timeout_s: seconds(timeout_s)? };
        Ok(Self(Order::Drive { channel: channel(of)?, mode: Mode::Home, value: speed, until }))
    }

    #[staticmethod]
    fn hold(of: &str, by: &str, value: f64, duration_s: f64) -> PyResult<Self> {
        let until = Until::Elapsed { seconds: seconds(duration_s)? };
        Ok(Self(Order::Drive { channel: channel(of)?, mode: mode(by)?, value, until }))
    }

    #[staticmethod]
    fn query(of: &str) -> PyResult<Self> {
        Ok(Self(Order::Query { channel: channel(of)? }))
    }

    #[staticmethod]
    fn true_position(of: &str) -> PyResult<Self> {
        Ok(Self(Order::TruePosition { channel: channel(of)? }))
    }

    #[staticmethod]
    fn follow(paths: BTreeMap<String, Vec<Point>>) -> PyResult<Self> {
        let points = |points: Vec<Point>| {
            let point = |(time_s, position, speed, feed_forward)| Waypoint { time_s, position, speed, feed_forward };
            points.into_iter().map(point).collect::<Vec<_>>()
        };
        let channels = paths.into_iter().map(|(name, given)| Ok((channel(&name)?, points(given))));
        let paths =
            Paths::new(channels.collect::<PyResult<Vec<_>>>()?).map_err(|error| error::bad_value(error.to_string()))?;
        Ok(Self(Order::Follow { paths }))
    }

    #[staticmethod]
    fn open_stream(number: u64, channels: Vec<(String, String)>, ttl_s: f64) -> PyResult<Self> {
        let channels = channels.iter().map(|(name, by)| Ok((channel(name)?, mode(by)?))).collect::<PyResult<_>>()?;
        if !(0.001..=MAX_TTL_S).contains(&ttl_s) {
            return Err(error::bad_value(format!("a time-to-live of {ttl_s} s: give 0.001 to {MAX_TTL_S}")));
        }
        Ok(Self(Order::OpenStream { number, channels, ttl_ms: (ttl_s * 1e3).round() as u16 }))
    }

    #[staticmethod]
    fn cycle(number: u64, values: Vec<f64>) -> Self {
        Self(Order::Cycle { number, values })
    }

    #[staticmethod]
    fn close_stream(number: u64) -> Self {
        Self(Order::CloseStream { number })
    }

    fn __repr__(&self) -> String {
        format!("Request({:?})", self.0)
    }
}

impl Request {
    /// Returns the work of this request for a board's thread.
    pub(crate) fn work(
        &self,
    ) -> impl for<'c, 'b> FnOnce(&'c Desk<'b>) -> LocalBoxFuture<'c, Result<Outcome, Error>> + Send + 'static {
        let order = self.0.clone();
        move |desk| carry_out(order, desk).boxed_local()
    }
}

async fn carry_out(order: Order, desk: &Desk<'_>) -> Result<Outcome, Error> {
    let session = desk.session;
    let board = session.board;
    match order {
        Order::Arm => board.arm().await.map_err(Error::Arm)?,
        Order::Disarm => board.disarm().await.map_err(Error::Disarm)?,
        Order::Clear => board.clear().await?,
        Order::Stop => board.stop().await?,
        Order::State => {
            // The last reported state may be a heartbeat old; the next sample of any channel is not.
            if let Some(info) = board.channels().first() {
                let sample = session.query(info.id).await?;
                return Ok(Outcome::State(sample.state, sample.causes));
            }
            let (state, causes) = board.safety();
            return Ok(Outcome::State(state, causes));
        }
        Order::Time => return Ok(Outcome::Number(board.now_s())),
        Order::Sleep { seconds } => board.sleep_s(seconds).await,
        Order::Set { channel, mode, value } => {
            let setpoint = session.setpoint(channel, mode, quantity(board.channel(channel)?, mode, value)?)?;
            board.set(channel, setpoint).await?;
        }
        Order::Drive { channel, mode, value, until } => {
            let setpoint = session.setpoint(channel, mode, quantity(board.channel(channel)?, mode, value)?)?;
            return Ok(Outcome::Motion(board.drive(channel, setpoint, until).await?));
        }
        Order::Query { channel } => {
            let sample = session.query(channel).await?;
            return Ok(Outcome::Sample(sample, Box::new(board.channel(channel)?.clone())));
        }
        Order::TruePosition { channel } => {
            session.virtual_board()?;
            return Ok(Outcome::Number(session.true_position(channel).unwrap_or(f64::NAN)));
        }
        Order::Follow { paths } => return Ok(Outcome::Paths(session.follow_armed(&paths, None).await?)),
        Order::OpenStream { number, channels, ttl_ms } => {
            let stream = board.stream(&channels, ttl_ms).await?;
            desk.streams.borrow_mut().insert(number, stream);
        }
        Order::Cycle { number, values } => {
            // Removed from the map meanwhile, so that an aborted cycle ends its stream.
            let mut stream = desk.streams.borrow_mut().remove(&number).ok_or(Error::SessionEnded)?;
            let report = stream.cycle(&values).await;
            desk.streams.borrow_mut().insert(number, stream);
            return Ok(Outcome::Cycle(report?));
        }
        Order::CloseStream { number } => drop(desk.streams.borrow_mut().remove(&number)),
    }
    Ok(Outcome::Nothing)
}

/// Quantity of a number in the unit that the channel accepts in this mode.
fn quantity(info: &ChannelInfo, mode: Mode, value: f64) -> Result<Quantity, Error> {
    match info.mode(mode) {
        Some(takes) => Ok(Quantity::new(value, takes.unit)),
        None => {
            let known = info.modes.iter().map(|takes| takes.mode.to_string()).collect::<Vec<_>>().join(", ");
            let why = match known.as_str() {
                "" => format!("takes no {mode}: it only measures"),
                _ => format!("takes no {mode}: it takes {known}"),
            };
            Err(Unsuitable { channel: info.id, why }.into())
        }
    }
}
