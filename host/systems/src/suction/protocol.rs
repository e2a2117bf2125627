//! Inflation on a board: switches pumps or valves in an order, receives pressures by telemetry, and samples the true
//! state meanwhile.

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    pin::pin,
};

use futures::future::{Either, select};
use r4_protocol::{ChannelId, Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, Sequence, Session};
use r4_world::{AnyBody, MEMBRANES, MIDDLE, SuctionPad};

use super::{
    law::{Order, Settings, Signature},
    scene::Setup,
};

/// Period of the samples of the true state, s.
const WATCHED_EVERY_S: f64 = 5e-3;
/// Period of the pressures' telemetry, ms.
const SENT_EVERY_MS: u16 = 5;
/// Time for which the pressure lags behind a pump that starts or stops, s: the motor's ramp of 75 ms, then tube and
/// viscosity of 30 ms.
const FOLLOWS_S: f64 = 0.3;
/// Timeout for a frame with all pressures, s.
const FRAMES_S: f64 = 0.5;
/// Flow of a pump that withdraws, m³/s: below the motors' top speed.
const WITHDRAWS_M3_S: f64 = 1.4e-6;
/// Waiting time for the vented membranes to empty, s.
const VENTS_S: f64 = 0.6;

/// True state at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time of the simulation, s.
    pub time_s: f64,
    /// Gauge pressure in the lines, Pa.
    pub line_pa: [f64; MEMBRANES],
    /// Gauge pressure in the membranes, Pa.
    pub balloon_pa: [f64; MEMBRANES],
    /// Stretch of the membranes; 1 at rest.
    pub stretch: [f64; MEMBRANES],
    /// True for each membrane that has burst.
    pub is_burst: [bool; MEMBRANES],
    /// Pull-off force of each cup, N.
    pub adhesion_n: [f64; 2],
    /// True for each cup that holds on the tissue.
    pub is_attached: [bool; 2],
    /// Tangential force of each cup on the tissue, N.
    pub shear_n: [f64; 2],
}

/// True states over a trial, and the decisions of the program.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// True states every 5 ms.
    pub moments: Vec<Moment>,
    /// Time at which the first membrane was fed, s on the clock of the moments.
    pub began_s: f64,
    /// Time at which the signature ended the inflation, s; `None` where it did not.
    pub signature_s: Option<f64>,
    /// True when a line reached the interlock's pressure.
    pub is_interlocked: bool,
}

/// Inflation method of a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Volume control by syringes.
    Volume(Settings),
    /// Pressure control by valves, group by group.
    Pressure {
        /// Time for which a group's valves are open before the next group's, s.
        group_s: f64,
    },
}

/// One pressure reading of a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time since the recording began, s.
    pub time_s: f64,
    /// Volume that the pump has displaced, counted by its steps, m³.
    pub pushed_m3: f64,
    /// Gauge pressure as measured, Pa.
    pub pressure_pa: f64,
}

/// Inflates the membranes in an order, and vents them.
///
/// # Errors
/// The error of the board when it is not virtual, does not arm, or stops; [`Error::NoReadings`] when pressures are
/// missing.
pub async fn inflate(session: &Session<'_>, setup: &Setup, order: Order, method: Method) -> Result<Trace, Error> {
    let moments = RefCell::new(Vec::new());
    let watch = async {
        loop {
            moments.borrow_mut().push(look(session)?);
            session.board.sleep_s(WATCHED_EVERY_S).await;
        }
    };
    let trace = Cell::new(Trace::default());
    let work = async {
        subscribe(session, setup.lines.iter().map(|line| line.sensor)).await?;
        let began_s = look(session)?.time_s;
        let done = session.armed(async || match method {
            Method::Volume(settings) => by_volume(session, setup, order, &settings).await,
            Method::Pressure { group_s } => by_pressure(session, setup, order, group_s).await,
        });
        let (signature_s, is_interlocked) = done.await?;
        // The residual adhesion is that of vented membranes.
        session.board.sleep_s(VENTS_S).await;
        trace.set(Trace { moments: Vec::new(), began_s, signature_s, is_interlocked });
        Ok::<_, Error>(())
    };
    let ended: Result<(), Error> = match select(pin!(work), pin!(watch)).await {
        Either::Left((ended, _)) => ended,
        Either::Right((ended, _)) => {
            let ended: Result<Infallible, Error> = ended;
            ended.map(|never| match never {})
        }
    };
    ended?;
    Ok(Trace { moments: moments.into_inner(), ..trace.take() })
}

/// Calls `of` with the board's pad and the simulation time, s; `None` when the body is no pad.
pub(super) fn with_pad<T>(session: &Session<'_>, of: impl FnOnce(&SuctionPad, f64) -> T) -> Result<Option<T>, Error> {
    let mut world = session.virtual_board()?.world();
    let time_s = world.clock().now_ns() as f64 * 1e-9;
    world.catch_up();
    Ok(match world.body() {
        Some(AnyBody::SuctionPad(pad)) => Some(of(pad, time_s)),
        _ => None,
    })
}

fn look(session: &Session<'_>) -> Result<Moment, Error> {
    let moment = with_pad(session, |pad, time_s| {
        let state = pad.state();
        Moment {
            time_s,
            line_pa: state.line.map(|chamber| chamber.gauge_pa()),
            balloon_pa: state.balloon.map(|chamber| chamber.gauge_pa()),
            stretch: state.membrane.map(|membrane| membrane.stretch),
            is_burst: state.membrane.map(|membrane| membrane.is_burst),
            adhesion_n: [pad.adhesion_n(0), pad.adhesion_n(1)],
            is_attached: state.is_attached,
            shear_n: state.shear_n,
        }
    })?;
    // Not reached: `Setup::of` refuses robots without a pad.
    Ok(moment.unwrap_or(Moment {
        time_s: 0.0,
        line_pa: [0.0; MEMBRANES],
        balloon_pa: [0.0; MEMBRANES],
        stretch: [1.0; MEMBRANES],
        is_burst: [false; MEMBRANES],
        adhesion_n: [0.0; 2],
        is_attached: [false; 2],
        shear_n: [0.0; 2],
    }))
}

async fn subscribe(session: &Session<'_>, channels: impl Iterator<Item = ChannelId>) -> Result<(), Error> {
    for channel in channels {
        session.board.subscribe(channel, SENT_EVERY_MS).await?;
    }
    Ok(())
}

async fn set(session: &Session<'_>, channel: ChannelId, mode: Mode, value: f64) -> Result<(), Error> {
    Ok(session.board.set(channel, Setpoint { mode, value: value as f32 }).await?)
}

async fn by_pressure(
    session: &Session<'_>,
    setup: &Setup,
    order: Order,
    group_s: f64,
) -> Result<(Option<f64>, bool), Error> {
    for group in order {
        for number in *group {
            set(session, setup.lines[*number].valve, Mode::Switch, 1.0).await?;
        }
        session.board.sleep_s(group_s).await;
    }
    // Valves that are switched off vent the membranes, on every path out of this method.
    for line in &setup.lines {
        set(session, line.valve, Mode::Switch, 0.0).await?;
    }
    Ok((None, false))
}

/// State of a fill: detectors and interlocks of the lines.
struct Fill<'a> {
    settings: &'a Settings,
    signatures: [Signature; MEMBRANES],
    /// Lines that the interlock has stopped.
    stopped: [bool; MEMBRANES],
}

async fn by_volume(
    session: &Session<'_>,
    setup: &Setup,
    order: Order,
    settings: &Settings,
) -> Result<(Option<f64>, bool), Error> {
    let fill = RefCell::new(Fill { settings, signatures: Default::default(), stopped: [false; MEMBRANES] });
    let mut sequence = Sequence::new(session);
    for line in &setup.lines {
        set(session, line.valve, Mode::Switch, 1.0).await?;
    }
    let fills_s = settings.volume_max_m3 / settings.rate_m3_s;
    let mut signature_s = None;
    for group in order {
        let pumps = |rate_m3_s: f64| {
            let fill = &fill;
            async move {
                for number in *group {
                    let line = &setup.lines[*number];
                    if !fill.borrow().stopped[*number] {
                        set(session, line.stepper, Mode::Speed, rate_m3_s / line.m3_per_rad).await?;
                    }
                }
                Ok::<_, Error>(())
            }
        };
        let filling = async {
            pumps(settings.rate_m3_s).await?;
            watch_pressures(session, setup, &fill, fills_s).await
        };
        // The margin of 2 s lets the state end by itself; its timeout is for a board that stalls.
        let seen = sequence.state("fill", fills_s + 2.0, filling).await?;
        let watching = async {
            pumps(0.0).await?;
            // A detached cup needs no further watch.
            if seen { Ok(true) } else { watch_pressures(session, setup, &fill, settings.watched_s).await }
        };
        if sequence.state("watch", settings.watched_s + 2.0, watching).await? {
            signature_s = Some(look(session)?.time_s);
            // The remaining groups are not inflated.
            break;
        }
    }
    let withdraws_s = settings.volume_max_m3 / WITHDRAWS_M3_S + FOLLOWS_S;
    let withdrawing = async {
        for line in &setup.lines {
            set(session, line.stepper, Mode::Position, 0.0).await?;
        }
        session.board.sleep_s(withdraws_s).await;
        for line in &setup.lines {
            set(session, line.valve, Mode::Switch, 0.0).await?;
        }
        Ok(())
    };
    sequence.state("withdraw", withdraws_s + 2.0, withdrawing).await?;
    let is_interlocked = fill.borrow().stopped.contains(&true);
    Ok((signature_s, is_interlocked))
}

/// Watches the pressures for `seconds` after pumps started or stopped, and returns true as soon as a detachment's
/// signature is detected. Withdraws lines whose pressure exceeds the interlock's limit.
async fn watch_pressures(
    session: &Session<'_>,
    setup: &Setup,
    fill: &RefCell<Fill<'_>>,
    seconds: f64,
) -> Result<bool, Error> {
    let began_s = session.board.now_s();
    // The pump's start or stop changes the slope of the pressure: the trend begins anew.
    fill.borrow_mut().signatures.iter_mut().for_each(Signature::restart);
    let mut telemetry = session.board.telemetry();
    let mut complete_s = began_s;
    loop {
        let frame = telemetry.next().await?;
        let now_s = session.board.now_s();
        if frame.state == SafetyState::Tripped {
            return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
        }
        // Without an interlock a saturated sensor stops nothing: the ablation continues with its last value.
        let is_strict = fill.borrow().settings.pressure_max_pa.is_some();
        let Some(pressures_pa) = pressures(setup, &frame.samples, is_strict)? else {
            if now_s - complete_s > FRAMES_S {
                return Err(Error::NoReadings { channel: setup.lines[MIDDLE].sensor });
            }
            continue;
        };
        complete_s = now_s;
        let (mut seen, mut over) = (false, [false; MEMBRANES]);
        {
            let fill = &mut *fill.borrow_mut();
            for (number, pressure_pa) in pressures_pa.into_iter().enumerate() {
                // A withdrawing line loses pressure by itself, which is no signature.
                if fill.stopped[number] {
                    continue;
                }
                over[number] = fill.settings.pressure_max_pa.is_some_and(|most_pa| pressure_pa > most_pa);
                fill.stopped[number] |= over[number];
                // A pump that starts or stops bends the pressure curve, which would look like a drop.
                if now_s - began_s > FOLLOWS_S {
                    let drop_pa = fill.signatures[number].drop_pa(pressure_pa).unwrap_or(0.0);
                    seen |= fill.settings.drop_pa.is_some_and(|least_pa| drop_pa > least_pa) && !over[number];
                }
            }
        }
        for (line, _) in setup.lines.iter().zip(over).filter(|(_, over)| *over) {
            set(session, line.stepper, Mode::Position, 0.0).await?;
        }
        if seen || now_s - began_s >= seconds {
            return Ok(seen);
        }
    }
}

/// Gauge pressures, Pa, when a frame has those of all lines, else `None`. A reading that is not good is an error if
/// `is_strict`; otherwise its value is used.
fn pressures(setup: &Setup, samples: &[Sample], is_strict: bool) -> Result<Option<[f64; MEMBRANES]>, Error> {
    let mut pressures_pa = [0.0; MEMBRANES];
    for (pressure_pa, line) in pressures_pa.iter_mut().zip(&setup.lines) {
        let Some(volts) = volts(line.sensor, samples, is_strict)? else { return Ok(None) };
        *pressure_pa = (volts - line.zero_v) / line.volts_per_pa;
    }
    Ok(Some(pressures_pa))
}

/// Voltage of a sensor in a frame, V; `None` when the frame does not contain it.
fn volts(sensor: ChannelId, samples: &[Sample], is_strict: bool) -> Result<Option<f64>, Error> {
    for sample in samples {
        match *sample {
            Sample::Scalar { channel, value } if channel == sensor => return Ok(Some(value.into())),
            Sample::Reading { channel, value, quality, .. } if channel == sensor => {
                return if quality == Quality::Good || !is_strict {
                    Ok(Some(value.into()))
                } else {
                    Err(Error::NoReadings { channel: sensor })
                };
            }
            _ => {}
        }
    }
    Ok(None)
}

/// Records pressure over displaced volume of the middle line. Its pump moves at `rate_m3_s` from one of `volumes_m3` to
/// the next and rests for `rests_s` at each.
///
/// # Errors
/// When the board does not arm, or stops.
pub async fn record(
    session: &Session<'_>,
    setup: &Setup,
    volumes_m3: &[f64],
    rate_m3_s: f64,
    rests_s: f64,
) -> Result<Vec<Reading>, Error> {
    let line = &setup.lines[MIDDLE];
    subscribe(session, [line.sensor, line.stepper].into_iter()).await?;
    let readings = RefCell::new(Vec::new());
    let rad_per_count = f64::from(session.board.channel(line.stepper)?.resolution);
    let listen = async {
        let mut telemetry = session.board.telemetry();
        let mut first_us = None;
        let mut pushed_m3 = None;
        loop {
            let frame = telemetry.next().await?;
            for sample in &frame.samples {
                if let Sample::Motor { channel, position, .. } = *sample
                    && channel == line.stepper
                {
                    pushed_m3 = Some(f64::from(position) * rad_per_count * line.m3_per_rad);
                }
            }
            if let (Some(volts), Some(pushed_m3)) = (volts(line.sensor, &frame.samples, true)?, pushed_m3) {
                let first_us = *first_us.get_or_insert(frame.device_us);
                readings.borrow_mut().push(Reading {
                    time_s: frame.device_us.saturating_sub(first_us) as f64 * 1e-6,
                    pushed_m3,
                    pressure_pa: (volts - line.zero_v) / line.volts_per_pa,
                });
            }
        }
    };
    let pump = session.armed(async || {
        set(session, line.valve, Mode::Switch, 1.0).await?;
        let mut at_m3 = 0.0;
        for volume_m3 in volumes_m3 {
            let by_m3 = volume_m3 - at_m3;
            at_m3 = *volume_m3;
            // Timed, not positioned: the recorded volume comes from the counted steps anyway.
            set(session, line.stepper, Mode::Speed, rate_m3_s.copysign(by_m3) / line.m3_per_rad).await?;
            session.board.sleep_s(by_m3.abs() / rate_m3_s).await;
            set(session, line.stepper, Mode::Speed, 0.0).await?;
            session.board.sleep_s(rests_s).await;
        }
        Ok::<_, Error>(())
    });
    let ended: Result<(), Error> = match select(pin!(pump), pin!(listen)).await {
        Either::Left((ended, _)) => ended,
        Either::Right((ended, _)) => {
            let ended: Result<Infallible, Error> = ended;
            ended.map(|never| match never {})
        }
    };
    ended?;
    Ok(readings.into_inner())
}
