//! A run along a bush: axes, valve and pressure sensor are on the board, decisions on the host.

use r4_driver::TelemetryStream;
use r4_protocol::{Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, Session};
use r4_world::{AnyBody, BerryPicker, Fate};

use super::{
    missing::Closing,
    scene::{BUSH_M, Case, HANDLE, PRESSURE, Setup},
};

/// Telemetry period of the pressure, ms.
const PRESSURE_EVERY_MS: u16 = 2;
/// Telemetry period of axes and handle, ms.
const AXES_EVERY_MS: u16 = 5;
/// Shares of the supply pressure: a chamber counts as filled above the first, as empty below the second.
const FILLED: f64 = 0.9;
const EMPTIED: f64 = 0.25;
/// Distance before the axis' target at which the valve is switched, m: the last 60 ms of its deceleration, of which
/// relay and coil take 20. The pads reach the berry 8 mm before, with the fingers open.
const CLOSES_AHEAD_M: f64 = 0.007;
/// Distance before the tray at which the fingers are opened, m: the spring takes 30 ms at 0.4 m/s, the exhaust more, so
/// that they release over it.
const OPENS_AHEAD_M: f64 = 0.010;
/// Reach at which the tool is clear of the bush, m.
const CLEAR_M: f64 = BUSH_M - 0.04;
/// Reach of the tool at the tray, m.
const REST_M: f64 = 0.012;
/// Threshold for a miss: fill time of the chamber over that of empty fingers. It lies halfway between the 0.75 to 0.88
/// of closings on a berry and the 1.00 of those beside one, seeds 1 to 15.
const EMPTY_SHARE: f64 = 0.94;
/// Largest number of attempts at a berry.
const ATTEMPTS: usize = 4;
/// Waiting times without a pressure sensor, s: our choice. On seeds 1 to 12 they dropped no berry for want of grip.
const CLOSES_S: f64 = 0.16;
const OPENS_S: f64 = 0.12;
/// Debounce time of the handle, s: printed, 20 ms.
const DEBOUNCE_S: f64 = 0.020;
/// Timeout of any wait, s.
const WAIT_S: f64 = 5.0;
/// Tolerance of a reached position, m: two steps.
const REACHED_M: f64 = 1.5e-4;

/// Options of the picking method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Method {
    /// True: the handle switches the valve, pressed by the hand that moves the tool; false: the program switches it.
    pub by_handle: bool,
    /// True: valve and axes move at the same time.
    pub overlaps: bool,
    /// True: the pressure shows when the fingers have closed and whether on a berry; a miss is tried again.
    pub detects: bool,
}

/// Record of a run along a bush.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Fate of each berry, from the simulation.
    pub fates: Vec<Fate>,
    /// Time of each berry, from its approach to its release, s.
    pub picks_s: Vec<f64>,
    /// Number of attempts at each berry.
    pub attempts: Vec<usize>,
    /// Time from the valve's command to a filled chamber, s: first of empty fingers, then of each attempt; empty
    /// without a pressure sensor.
    pub fills_s: Vec<f64>,
    /// Highest force of air on the piston at the end of a pick, N, from the simulation.
    pub air_max_n: f64,
    /// Lowest pressure of the receiver at the end of a pick, Pa, from the simulation.
    pub receiver_min_pa: f64,
    /// Telemetry of the pressure: time, s, and pressure, Pa.
    pub pressure_pa: Vec<(f64, f64)>,
    /// Telemetry of the reach: time, s, and reach, m.
    pub reach_m: Vec<(f64, f64)>,
}

/// Latest telemetry of the board, with its history.
struct Watch<'s, 'b> {
    session: &'s Session<'b>,
    setup: &'s Setup,
    telemetry: TelemetryStream,
    now_s: f64,
    axes_m: [f64; 2],
    pressure_pa: f64,
    handle: (bool, f64),
    trace: [Vec<(f64, f64)>; 2],
}

impl<'s, 'b> Watch<'s, 'b> {
    fn new(session: &'s Session<'b>, setup: &'s Setup) -> Self {
        Self {
            session,
            setup,
            telemetry: session.board.telemetry(),
            now_s: 0.0,
            axes_m: [0.0; 2],
            pressure_pa: 0.0,
            handle: (false, 0.0),
            trace: [const { Vec::new() }; 2],
        }
    }

    /// Receives frames until `is_there` is true. Fails after [`WAIT_S`], or when the board is no longer armed.
    async fn until(&mut self, what: &'static str, is_there: impl Fn(&Self) -> bool) -> Result<(), Error> {
        let begin_s = self.now_s;
        loop {
            let frame = self.telemetry.next().await?;
            if frame.state != SafetyState::Armed {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            self.now_s = frame.device_us as f64 * 1e-6;
            for sample in &frame.samples {
                self.take(sample)?;
            }
            if is_there(self) {
                return Ok(());
            }
            // Before the first frame there is no device time to count from.
            if begin_s > 0.0 && self.now_s - begin_s > WAIT_S {
                return Err(Error::StateTimedOut { state: what, at_most_s: WAIT_S });
            }
        }
    }

    fn take(&mut self, sample: &Sample) -> Result<(), Error> {
        let channel = sample.channel();
        if let Some(axis) = self.setup.axes.iter().position(|of| *of == channel) {
            if let Sample::Motor { position, .. } = *sample {
                let rad = f64::from(position) * f64::from(self.session.board.channel(channel)?.resolution);
                self.axes_m[axis] = rad * self.setup.m_per_rad;
                if axis == 0 {
                    self.trace[1].push((self.now_s, self.axes_m[0]));
                }
            }
            return Ok(());
        }
        let value = match *sample {
            Sample::Scalar { value, .. } | Sample::Reading { value, quality: Quality::Good, .. } => value,
            // An implausible reading is not used; without any other the wait for the pressure times out.
            _ => return Ok(()),
        };
        if channel == PRESSURE {
            let [zero_v, volts_per_pa] = self.setup.pressure_v;
            self.pressure_pa = (f64::from(value) - zero_v) / volts_per_pa;
            self.trace[0].push((self.now_s, self.pressure_pa));
        } else if channel == HANDLE && self.handle.0 != (value > 0.5) {
            self.handle = (value > 0.5, self.now_s);
        }
        Ok(())
    }

    async fn go(&self, axis: usize, to_m: f64) -> Result<(), Error> {
        let value = (to_m / self.setup.m_per_rad) as f32;
        Ok(self.session.board.set(self.setup.axes[axis], Setpoint { mode: Mode::Position, value }).await?)
    }

    async fn there(&mut self, axis: usize, to_m: f64) -> Result<(), Error> {
        self.until("an axis moves", |watch| (watch.axes_m[axis] - to_m).abs() < REACHED_M).await
    }

    async fn wait(&mut self, seconds: f64) -> Result<(), Error> {
        self.wait_until(self.now_s + seconds).await
    }

    async fn wait_until(&mut self, until_s: f64) -> Result<(), Error> {
        self.until("wait", |watch| watch.now_s >= until_s).await
    }

    async fn valve(&self, is_on: bool) -> Result<(), Error> {
        let setpoint = Setpoint { mode: Mode::Switch, value: f32::from(u8::from(is_on)) };
        Ok(self.session.board.set(self.setup.valve, setpoint).await?)
    }

    /// Presses or releases the handle; the relay follows once its switch has been stable for [`DEBOUNCE_S`].
    async fn handle(&mut self, is_pressed: bool) -> Result<(), Error> {
        if let Some(AnyBody::BerryPicker(picker)) = self.session.virtual_board()?.world().body_mut() {
            picker.press(is_pressed);
        }
        self.until("the handle is pressed or released", |watch| {
            watch.handle.0 == is_pressed && watch.now_s - watch.handle.1 >= DEBOUNCE_S
        })
        .await?;
        self.valve(is_pressed).await
    }

    /// Waits until the chamber is filled and returns the time since `begin_s`, s.
    async fn fill(&mut self, begin_s: f64) -> Result<f64, Error> {
        let filled_pa = FILLED * self.setup.regulated_pa;
        self.until("fingers close", |watch| watch.pressure_pa >= filled_pa).await?;
        Ok(self.now_s - begin_s)
    }

    async fn emptied(&mut self) -> Result<(), Error> {
        let emptied_pa = EMPTIED * self.setup.regulated_pa;
        self.until("fingers open", |watch| watch.pressure_pa <= emptied_pa).await
    }
}

/// Picks every berry of a bush and returns the record of the run.
///
/// # Errors
/// The error of the board when it is not virtual, does not arm, or stops.
pub async fn pick(session: &Session<'_>, setup: &Setup, case: &Case, method: Method) -> Result<Outcome, Error> {
    let board = session.board;
    board.subscribe(PRESSURE, PRESSURE_EVERY_MS).await?;
    for channel in setup.axes.into_iter().chain([HANDLE]) {
        board.subscribe(channel, AXES_EVERY_MS).await?;
    }
    let mut watch = Watch::new(session, setup);
    let mut outcome = Outcome {
        fates: Vec::new(),
        picks_s: Vec::new(),
        attempts: Vec::new(),
        fills_s: Vec::new(),
        air_max_n: 0.0,
        receiver_min_pa: f64::INFINITY,
        pressure_pa: Vec::new(),
        reach_m: Vec::new(),
    };
    session.armed(async || run(&mut watch, case, method, &mut outcome).await).await?;
    outcome.fates = look(session, |picker| picker.fates().to_vec())?;
    [outcome.pressure_pa, outcome.reach_m] = watch.trace;
    Ok(outcome)
}

/// Reads the true state of the gripper.
fn look<T: Default>(session: &Session<'_>, of: impl Fn(&BerryPicker) -> T) -> Result<T, Error> {
    let mut world = session.virtual_board()?.world();
    world.catch_up();
    match world.body() {
        Some(AnyBody::BerryPicker(picker)) => Ok(of(picker)),
        // Not reached: `Setup::of` refuses robots without a gripper.
        _ => Ok(T::default()),
    }
}

async fn run(watch: &mut Watch<'_, '_>, case: &Case, method: Method, outcome: &mut Outcome) -> Result<(), Error> {
    watch.go(0, REST_M).await?;
    watch.there(0, REST_M).await?;
    let mut empty_s = f64::INFINITY;
    if method.detects {
        // Reference closing with empty fingers over the tray: the fill time of a miss depends on the day's pressure
        // and valve.
        watch.valve(true).await?;
        let begin_s = watch.now_s;
        empty_s = watch.fill(begin_s).await?;
        outcome.fills_s.push(empty_s);
        watch.valve(false).await?;
        watch.emptied().await?;
        watch.wait(OPENS_S).await?;
    }
    for berry in 0..case.berries.len() {
        let begin_s = watch.now_s;
        let mut attempts = 0;
        loop {
            let [reach_m, row_m] = case.seen_m(berry, attempts);
            attempts += 1;
            let catches = attempt(watch, [reach_m, row_m], method, empty_s, outcome).await?;
            if catches || attempts == ATTEMPTS {
                break;
            }
            // A miss: open again, clear of the bush.
            watch.valve(false).await?;
            watch.go(0, CLEAR_M).await?;
            watch.there(0, CLEAR_M).await?;
            watch.emptied().await?;
        }
        carry(watch, case, berry, method, outcome).await?;
        outcome.picks_s.push(watch.now_s - begin_s);
        outcome.attempts.push(attempts);
    }
    Ok(())
}

/// Approaches a berry and closes. Returns true when the method finds a berry between the fingers, or cannot know.
async fn attempt(
    watch: &mut Watch<'_, '_>,
    [reach_m, row_m]: [f64; 2],
    method: Method,
    empty_s: f64,
    outcome: &mut Outcome,
) -> Result<bool, Error> {
    watch.go(1, row_m).await?;
    if !method.overlaps {
        watch.there(1, row_m).await?;
    }
    watch.go(0, reach_m).await?;
    if method.overlaps {
        watch.until("an axis moves", |watch| reach_m - watch.axes_m[0] < CLOSES_AHEAD_M).await?;
    } else {
        watch.there(0, reach_m).await?;
    }
    let begin_s = watch.now_s;
    if method.by_handle {
        watch.handle(true).await?;
    } else {
        watch.valve(true).await?;
    }
    if !method.detects {
        watch.wait(CLOSES_S).await?;
        return Ok(true);
    }
    let filled_s = watch.fill(begin_s).await?;
    outcome.fills_s.push(filled_s);
    Ok(filled_s < EMPTY_SHARE * empty_s)
}

/// Pulls back to the tray and opens the fingers there; with overlap the row moves on to the next berry meanwhile.
async fn carry(
    watch: &mut Watch<'_, '_>,
    case: &Case,
    berry: usize,
    method: Method,
    outcome: &mut Outcome,
) -> Result<(), Error> {
    watch.go(0, REST_M).await?;
    let (air_n, receiver_pa) = look(watch.session, |picker| (picker.air_n(), picker.receiver_pa()))?;
    outcome.air_max_n = outcome.air_max_n.max(air_n);
    outcome.receiver_min_pa = outcome.receiver_min_pa.min(receiver_pa);
    if method.overlaps {
        watch.until("an axis moves", |watch| watch.axes_m[0] < CLEAR_M).await?;
        if berry + 1 < case.berries.len() {
            // The row may move only now that the fingers are clear of the plants.
            watch.go(1, case.seen_m(berry + 1, 0)[1]).await?;
        }
        let opens_m = watch.setup.tray_m + OPENS_AHEAD_M;
        watch.until("an axis moves", |watch| watch.axes_m[0] < opens_m).await?;
    } else {
        watch.there(0, REST_M).await?;
    }
    if method.by_handle {
        watch.handle(false).await?;
    } else {
        watch.valve(false).await?;
    }
    if method.detects { watch.emptied().await } else { watch.wait(OPENS_S).await }
}

/// Closes and opens over the tray by a schedule of durations, s, and returns each closing.
///
/// # Errors
/// The error of the board when it does not arm, or stops; [`Error::NoReadings`] where the pressure does not rise.
pub async fn close_often(session: &Session<'_>, setup: &Setup, schedule: &[[f64; 2]]) -> Result<Vec<Closing>, Error> {
    session.board.subscribe(PRESSURE, PRESSURE_EVERY_MS).await?;
    let mut watch = Watch::new(session, setup);
    let mut closings = Vec::with_capacity(schedule.len());
    let work = async || {
        for [close_s, open_s] in schedule {
            let at_s = session.board.device_us() as f64 * 1e-6;
            watch.valve(true).await?;
            watch.wait_until(at_s + close_s).await?;
            let pressure_pa = &watch.trace[0];
            let from = pressure_pa.partition_point(|(sampled_s, _)| *sampled_s < at_s);
            closings.push(Closing::of(at_s, &pressure_pa[from..]).ok_or(Error::NoReadings { channel: PRESSURE })?);
            watch.valve(false).await?;
            watch.wait_until(at_s + close_s + open_s).await?;
        }
        Ok::<(), Error>(())
    };
    session.armed(work).await?;
    Ok(closings)
}
