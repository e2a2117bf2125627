//! Gripping sequence on a board, each state with its timeout. The board's force loop holds the force; the host sets its
//! set point and corrects the sensor's zero and drift.

use std::{cell::RefCell, convert::Infallible, f64::consts::PI, pin::pin};

use futures::future::{Either, select};
use r4_driver::TelemetryStream;
use r4_protocol::{ChannelId, Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, Sequence, Session};
use r4_world::{AnyBody, CableLoop};

use super::{
    law::{Contact, SlipWatch, Zero},
    scene::{Seen, Setup},
};

/// Telemetry period of force and spool angle, ms.
const PERIOD_MS: u16 = 10;
/// Telemetry period of the range, ms: the distance sensor's at 50 Hz.
const RANGE_MS: u16 = 20;
/// Change of the sensor's zero for which the board receives a new force set point, N: its force loop rests within 0.05
/// N.
const ZERO_STEP_N: f64 = 0.02;
/// Period of the true states for a figure, s.
const WATCHED_EVERY_S: f64 = 5e-3;

/// Set point of the squeeze, N: it holds 150 g at a friction of 0.45 with 2.4 times the weight. With 3.5 N, 3 of seeds
/// 100 001 to 104 000 slid out of the loop in a knock.
pub const GRIP_N: f64 = 4.0;
/// Set point after slip, N: below what crushes the weakest vial, 8.5 N, by the loop's overshoot.
pub const FIRM_N: f64 = 6.0;
/// Spool speed while the loop is drawn tight, rad/s: a period adds 0.3 N. Twice the speed overshoots by 1.5 N and
/// leaves half the points for the line.
const REEL_RAD_S: f64 = 1.5;
/// Spool speed after slip, rad/s.
const HURRY_RAD_S: f64 = 4.0;
/// Force above which the loop counts as tight, N: ten times the noise.
const TIGHT_N: f64 = 0.3;
/// Force that ends homing, N.
const HOME_N: f64 = 2.0;
/// Diameter margin at which the reel-in changes from fast to slow, m: the largest error of the camera's estimate.
const SLOW_BEFORE_M: f64 = 1.0e-3;
/// Diameter below the seen one from which on there is no vial in the loop, m.
const MISSED_M: f64 = 2.0e-3;
/// Height of the loop during a grip, m.
const GRIP_HEIGHT_M: f64 = 0.020;
/// Time in the air, s: a transport of the vial would take place in it.
const CARRY_S: f64 = 0.9;
/// Number of averaged range readings: 0.13 mm of standard deviation, with 1 mm of noise in steps of 1 mm. The loop must
/// be within 1.1 mm of the vial's middle; camera and range sensor are off by 0.2 mm besides, which leaves a margin of
/// four and a half standard deviations. With half as many readings it is three.
const RANGES: usize = 60;
/// Number of averaged range readings in the air.
const CARRIED_RANGES: usize = 10;
/// Range above which no vial is at the tip, m.
const NO_VIAL_M: f64 = 8e-3;

/// Parts of our controller that are enabled; ablations disable one each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uses {
    /// True: the board's force loop holds the force; false: the spool stops at the threshold.
    pub force_loop: bool,
    /// True: zero and drift of the sensor are estimated while the loop is slack.
    pub drift: bool,
    /// True: a CUSUM detector watches for slip.
    pub slip: bool,
    /// True: the contact is where the line of force over angle begins. False: the contact is where the threshold is
    /// reached, and home is corrected by the datasheet's stretch.
    pub bowden: bool,
}

impl Uses {
    /// All parts of our controller, enabled.
    pub const OURS: Self = Self { force_loop: true, drift: true, slip: true, bowden: true };
    /// No part: the paper's arm reels in up to a threshold.
    pub const PAPER: Self = Self { force_loop: false, drift: false, slip: false, bowden: false };
}

/// Result of a sequence as the program knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Report {
    /// Gripped, carried and put down.
    Placed,
    /// No vial in the loop.
    Missed,
    /// The vial was gripped and is lost.
    Lost,
    /// A state reached its timeout; the value is the state's name.
    TimedOut(&'static str),
}

/// Record of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Result as the program reports it.
    pub report: Report,
    /// Diameter of the vial, from the contact, m; `None` before a contact.
    pub diameter_m: Option<f64>,
    /// Number of slips that were detected.
    pub slips: u32,
    /// True state of the gripper at the end of the time in the air, and the set point then, N.
    pub carried: Option<(CableLoop, f64)>,
    /// True state of the gripper at the end.
    pub end: CableLoop,
    /// Time from arming to the end, s.
    pub lasted_s: f64,
    /// Names of the states with the times at which they began, s.
    pub states: Vec<(&'static str, f64)>,
}

/// True state at one moment, with the sensor's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time of the simulation, s.
    pub time_s: f64,
    /// Squeeze, or force of the retracted loop, and the sensor's reading, N.
    pub force_n: [f64; 2],
    /// Length of the loop, m.
    pub length_m: f64,
    /// Heights of loop and vial, m.
    pub height_m: [f64; 2],
}

/// Copy of the gripper's true state; `None` for a board without one.
pub fn truth(session: &Session<'_>) -> Result<Option<CableLoop>, Error> {
    let mut world = session.virtual_board()?.world();
    world.catch_up();
    Ok(match world.body() {
        Some(AnyBody::CableLoop(body)) => Some((**body).clone()),
        _ => None,
    })
}

fn look(session: &Session<'_>) -> Result<Option<Moment>, Error> {
    use r4_world::Body as _;
    let mut world = session.virtual_board()?.world();
    let time_s = world.clock().now_ns() as f64 * 1e-9;
    world.catch_up();
    let Some(AnyBody::CableLoop(body)) = world.body() else { return Ok(None) };
    Ok(Some(Moment {
        time_s,
        force_n: [body.squeeze_n(), body.reading(0)],
        length_m: body.length_m(),
        height_m: [body.loop_m(), body.height_m()],
    }))
}

/// Runs [`grip`] and returns the true states meanwhile.
///
/// # Errors
/// The errors of [`grip`].
pub async fn watched(
    session: &Session<'_>,
    setup: &Setup,
    seen: Seen,
    uses: Uses,
) -> Result<(Outcome, Vec<Moment>), Error> {
    let moments = RefCell::new(Vec::new());
    let watch = async {
        loop {
            moments.borrow_mut().extend(look(session)?);
            session.board.sleep_s(WATCHED_EVERY_S).await;
        }
    };
    let ended: Either<Result<Outcome, Error>, Result<Infallible, Error>> =
        match select(pin!(grip(session, setup, seen, uses)), pin!(watch)).await {
            Either::Left((ended, _)) => Either::Left(ended),
            Either::Right((ended, _)) => Either::Right(ended),
        };
    match ended {
        Either::Left(outcome) => Ok((outcome?, moments.into_inner())),
        Either::Right(Err(error)) => Err(error),
        Either::Right(Ok(never)) => match never {},
    }
}

/// Grips a vial, carries it and puts it down.
///
/// # Errors
/// The error of the board when it does not arm, stops, or is not virtual. A grip that fails is an [`Outcome`].
pub async fn grip(session: &Session<'_>, setup: &Setup, seen: Seen, uses: Uses) -> Result<Outcome, Error> {
    let begin_s = session.board.now_s();
    let mut carried = None;
    let mut sequence = Sequence::new(session);
    let mut found = Found::default();
    let ended = session
        .armed(async || {
            let mut gripper = Gripper::open(session, setup, uses).await?;
            let report = gripper.run(&mut sequence, seen, &mut found, &mut carried).await;
            // Also after an error: the last set point of the spool would stay in force until the disarm.
            gripper.stop().await?;
            report
        })
        .await;
    let report = match ended {
        Ok(report) => report,
        Err(Error::StateTimedOut { state, .. }) => Report::TimedOut(state),
        Err(error) => return Err(error),
    };
    let Some(end) = truth(session)? else { return Err(Error::NoReadings { channel: setup.force }) };
    let states = sequence.visits().iter().map(|visit| (visit.state, visit.entered_s)).collect();
    let Found { diameter_m, slips } = found;
    Ok(Outcome { report, diameter_m, slips, carried, end, lasted_s: session.board.now_s() - begin_s, states })
}

#[derive(Clone, Copy, Debug, Default)]
struct Found {
    diameter_m: Option<f64>,
    slips: u32,
}

/// State of the loop while an axis moves.
enum Loop<'f> {
    /// Slack: the sensor shows its zero.
    Slack,
    /// Tight against the tip, without a vial.
    Retracted,
    /// Closed round a vial, which the force loop holds.
    Closed(&'f mut Found),
}

/// Latest readings of spool and force sensor.
#[derive(Clone, Copy, Debug, Default)]
struct Read {
    time_s: f64,
    after_s: f64,
    /// Force as the sensor shows it, N.
    force_n: f64,
    angle_rad: f64,
}

/// Spool, sensors, and the estimates of a sequence.
pub(super) struct Gripper<'s, 'b> {
    session: &'s Session<'b>,
    setup: &'s Setup,
    uses: Uses,
    telemetry: TelemetryStream,
    /// Last set point that the spool received.
    told: Option<Setpoint>,
    radian: f64,
    read: Read,
    zero: Zero,
    /// Angle of the spool at which the retracted loop becomes tight, rad.
    home_rad: f64,
    /// Sum, m, and number of the ranges that are averaged; `None` while none are.
    range: Option<(f64, usize)>,
    set_n: f64,
    slip: SlipWatch,
    hurries: bool,
}

/// First quantity of a sensor in a sample; `None` for a sample of another channel or of bad quality.
fn quantity(sensor: ChannelId, sample: &Sample) -> Option<f64> {
    match *sample {
        Sample::Sensor { channel, values, quality: Quality::Good, .. } if channel == sensor => Some(values[0].into()),
        _ => None,
    }
}

impl<'s, 'b> Gripper<'s, 'b> {
    pub(super) async fn open(session: &'s Session<'b>, setup: &'s Setup, uses: Uses) -> Result<Self, Error> {
        let board = session.board;
        let telemetry = board.telemetry();
        for channel in [setup.force, setup.spool] {
            board.subscribe(channel, PERIOD_MS).await?;
        }
        let radian = f64::from(board.channel(setup.spool)?.resolution);
        Ok(Self {
            session,
            setup,
            uses,
            telemetry,
            told: None,
            radian,
            read: Read::default(),
            zero: Zero::default(),
            home_rad: 0.0,
            range: None,
            set_n: GRIP_N,
            slip: SlipWatch::default(),
            hurries: false,
        })
    }

    /// Waits for the next force reading.
    pub(super) async fn next(&mut self) -> Result<(), Error> {
        loop {
            let frame = self.telemetry.next().await?;
            // A trip stops the spool: waiting on would only end in a timeout.
            if frame.state == SafetyState::Tripped {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let mut force_n = None;
            for sample in &frame.samples {
                match *sample {
                    Sample::Motor { channel, position, .. } if channel == self.setup.spool => {
                        self.read.angle_rad = f64::from(position) * self.radian;
                    }
                    _ => {
                        if let Some(value) = quantity(self.setup.force, sample) {
                            force_n = Some(value);
                        } else if let (Some((sum_m, count)), Some(value)) =
                            (&mut self.range, quantity(self.setup.range, sample))
                        {
                            *sum_m += value;
                            *count += 1;
                        }
                    }
                }
            }
            if let Some(force_n) = force_n {
                let time_s = frame.device_us as f64 * 1e-6;
                // 0 for the first reading: the time since power-up is no sample period.
                let after_s = if self.read.time_s > 0.0 { time_s - self.read.time_s } else { 0.0 };
                self.read = Read { time_s, after_s, force_n, ..self.read };
                return Ok(());
            }
        }
    }

    /// Force corrected by the sensor's zero where that is known, N.
    fn force_n(&self) -> f64 {
        if self.uses.drift { self.read.force_n - self.zero.at(self.read.time_s) } else { self.read.force_n }
    }

    /// Sends a set point to the spool, unless it is the last one sent.
    async fn tell(&mut self, mode: Mode, value: f64) -> Result<(), Error> {
        let setpoint = Setpoint { mode, value: value as f32 };
        // Repeated set points are not sent: this runs in every period of 10 ms.
        if self.told != Some(setpoint) {
            self.session.board.set(self.setup.spool, setpoint).await?;
            self.told = Some(setpoint);
        }
        Ok(())
    }

    /// Sets the spool's speed, rad/s.
    async fn turn(&mut self, speed_rad_s: f64) -> Result<(), Error> {
        self.tell(Mode::Speed, speed_rad_s).await
    }

    pub(super) async fn stop(&mut self) -> Result<(), Error> {
        self.turn(0.0).await
    }

    /// Lets the board hold the force's set point, shifted by the sensor's present zero.
    async fn press(&mut self) -> Result<(), Error> {
        // The board's loop works on the uncorrected reading, so that the zero is added to the set point.
        let shown_n = self.set_n + self.read.force_n - self.force_n();
        match self.told {
            Some(Setpoint { mode: Mode::Force, value }) if (f64::from(value) - shown_n).abs() < ZERO_STEP_N => Ok(()),
            _ => self.tell(Mode::Force, shown_n).await,
        }
    }

    /// Length of the unloaded loop at an angle of the spool, m.
    fn length_m(&self, angle_rad: f64) -> f64 {
        let retracted_m = self.setup.tight_m(2.0 * self.setup.bend_radius_m);
        retracted_m + 2.0 * self.setup.spool_radius_m * (angle_rad - self.home_rad)
    }

    fn angle_rad(&self, length_m: f64) -> f64 {
        let retracted_m = self.setup.tight_m(2.0 * self.setup.bend_radius_m);
        self.home_rad + (length_m - retracted_m) / (2.0 * self.setup.spool_radius_m)
    }

    /// Turns the spool to an angle without a load; with `takes_zero` the readings meanwhile belong to the zero.
    async fn turn_to(&mut self, angle_rad: f64, takes_zero: bool) -> Result<(), Error> {
        self.tell(Mode::Position, angle_rad).await?;
        loop {
            self.next().await?;
            if takes_zero {
                self.zero.add(self.read.time_s, self.read.force_n);
            }
            if (angle_rad - self.read.angle_rad).abs() < 0.01 {
                return self.stop().await;
            }
        }
    }

    /// Moves an axis and waits until it has settled, with the force loop on if a vial is held.
    async fn move_and(&mut self, axis: usize, place_m: f64, mut state: Loop<'_>) -> Result<(), Error> {
        let channel = self.setup.axes[axis];
        let mut samples = self.session.board.samples(channel, 20).await?;
        let target = (place_m / self.setup.axes_m_per_rad[axis]) as f32;
        self.session.board.set(channel, Setpoint { mode: Mode::Position, value: target }).await?;
        loop {
            self.next().await?;
            match &mut state {
                Loop::Closed(found) => self.hold(found).await?,
                Loop::Retracted => self.stop().await?,
                Loop::Slack => {
                    self.zero.add(self.read.time_s, self.read.force_n);
                    self.stop().await?;
                }
            }
            while let Some(sample) = samples.try_next() {
                // `settled` alone may still belong to the previous set point.
                if let Sample::Motor { setpoint, settled: true, .. } = sample.sample
                    && setpoint.value == target
                {
                    // A standing axis needs no telemetry.
                    self.session.board.subscribe(channel, 0).await?;
                    return Ok(());
                }
            }
        }
    }

    /// One period of holding: updates the force set point and checks for slip.
    async fn hold(&mut self, found: &mut Found) -> Result<(), Error> {
        if !self.uses.force_loop {
            return self.stop().await;
        }
        let force_n = self.force_n();
        if self.uses.slip && self.slip.next(force_n, self.read.after_s) {
            found.slips += 1;
            (self.set_n, self.hurries) = (FIRM_N, true);
        }
        // The speed is switched off below the set point, by what the loop still gains in the latency of one period.
        self.hurries &= force_n < 0.75 * self.set_n;
        if self.hurries { self.turn(-HURRY_RAD_S).await } else { self.press().await }
    }

    /// Draws the retracted loop against the tip; home is the angle at which it becomes tight.
    async fn home(&mut self) -> Result<(), Error> {
        // The loop is slack at first: ten readings give the zero.
        for _ in 0..10 {
            self.next().await?;
            self.zero.add(self.read.time_s, self.read.force_n);
            self.stop().await?;
        }
        let mut contact = Contact::default();
        loop {
            self.next().await?;
            let force_n = self.force_n();
            if force_n > TIGHT_N {
                contact.add(self.read.angle_rad, force_n);
            }
            // Three points are the least for the line of force over angle.
            if force_n > HOME_N && (contact.count() >= 3 || !self.uses.bowden) {
                self.home_rad = match contact.angle_rad() {
                    Some(angle_rad) if self.uses.bowden => angle_rad,
                    _ => self.read.angle_rad + self.setup.stretch_rad(2.0 * self.setup.bend_radius_m, force_n),
                };
                return self.stop().await;
            }
            self.turn(-REEL_RAD_S).await?;
        }
    }

    /// Starts to average ranges; [`Gripper::ranged`] ends it.
    async fn range(&mut self) -> Result<(), Error> {
        self.range = Some((0.0, 0));
        Ok(self.session.board.subscribe(self.setup.range, RANGE_MS).await?)
    }

    /// Mean of the ranges, m, and end of their telemetry; `None` while there are fewer than `readings`.
    async fn ranged(&mut self, readings: usize) -> Result<Option<f64>, Error> {
        let Some((sum_m, count)) = self.range.filter(|(_, count)| *count >= readings) else { return Ok(None) };
        self.range = None;
        self.session.board.subscribe(self.setup.range, 0).await?;
        Ok(Some(sum_m / count as f64))
    }

    /// Moves the tip to its distance before the vial, by the ranges received since [`Gripper::range`].
    async fn centre(&mut self) -> Result<(), Error> {
        let range_m = loop {
            self.next().await?;
            self.stop().await?;
            if let Some(range_m) = self.ranged(RANGES).await? {
                break range_m;
            }
        };
        self.move_and(1, range_m - self.setup.gap_m, Loop::Retracted).await
    }

    /// Draws the loop tight round its contents. Returns false when there is no vial.
    async fn reel(&mut self, seen_m: f64, found: &mut Found) -> Result<bool, Error> {
        // Fast, up to just before the loop can be tight. It is slack on the way, which gives the sensor's zero.
        self.turn_to(self.angle_rad(self.setup.tight_m(seen_m + SLOW_BEFORE_M)), true).await?;
        let missed_rad = self.angle_rad(self.setup.tight_m(seen_m - MISSED_M)).min(self.home_rad - 0.1);
        let gone_rad = self.angle_rad(self.setup.tight_m(seen_m - MISSED_M));
        let mut contact = Contact::default();
        loop {
            self.next().await?;
            let force_n = self.force_n();
            if force_n > TIGHT_N {
                contact.add(self.read.angle_rad, force_n);
            }
            // One reading above the threshold may be noise; three in a row are a contact.
            let is_there = contact.count() > 2;
            if (!is_there && self.read.angle_rad < gone_rad) || self.read.angle_rad < missed_rad - 1.0 {
                self.stop().await?;
                return Ok(false);
            }
            // The board's force loop takes over below its set point: at the spool's speed the force would overshoot it.
            let enough_n = if self.uses.force_loop { 0.75 * GRIP_N } else { GRIP_N };
            if force_n >= enough_n && (is_there || !self.uses.bowden) {
                let angle_rad = match contact.angle_rad() {
                    Some(angle_rad) if self.uses.bowden => angle_rad,
                    _ => self.read.angle_rad,
                };
                found.diameter_m = Some((self.length_m(angle_rad) - self.setup.legs_m) / PI);
                break;
            }
            self.turn(-REEL_RAD_S).await?;
        }
        self.stop().await?;
        if self.uses.force_loop {
            let mut close = 0;
            // Several readings in a row: a force that only passes the set point does not count.
            while close < 5 {
                self.next().await?;
                let force_n = self.force_n();
                close = if (force_n - self.set_n).abs() < 0.2 { close + 1 } else { 0 };
                self.press().await?;
            }
            // The force changes of the closing itself are no slip.
            self.slip = SlipWatch::default();
        }
        Ok(true)
    }

    /// Holds for [`CARRY_S`] and returns true when the vial is still at the tip.
    async fn carry(&mut self, found: &mut Found) -> Result<bool, Error> {
        let until_s = self.read.time_s + CARRY_S;
        while self.read.time_s < until_s {
            self.next().await?;
            self.hold(found).await?;
        }
        self.range().await?;
        let range_m = loop {
            self.next().await?;
            self.hold(found).await?;
            if let Some(range_m) = self.ranged(CARRIED_RANGES).await? {
                break range_m;
            }
        };
        Ok(range_m < NO_VIAL_M)
    }

    /// Homes the spool and returns its angle at which the retracted loop becomes tight, rad.
    pub(super) async fn find_contact(&mut self) -> Result<f64, Error> {
        self.home().await?;
        Ok(self.home_rad)
    }

    /// Turns the spool to an angle and stays there for `hold_s`; appends time, s, angle, rad, and the sensor's force,
    /// N.
    pub(super) async fn record_to(
        &mut self,
        angle_rad: f64,
        hold_s: f64,
        samples: &mut Vec<[f64; 3]>,
    ) -> Result<(), Error> {
        self.tell(Mode::Position, angle_rad).await?;
        let mut until_s = f64::INFINITY;
        while self.read.time_s < until_s {
            self.next().await?;
            samples.push([self.read.time_s, self.read.angle_rad, self.read.force_n]);
            if until_s.is_infinite() && (angle_rad - self.read.angle_rad).abs() < 0.01 {
                until_s = self.read.time_s + hold_s;
            }
        }
        Ok(())
    }

    async fn run(
        &mut self,
        sequence: &mut Sequence<'_, '_>,
        seen: Seen,
        found: &mut Found,
        carried: &mut Option<(CableLoop, f64)>,
    ) -> Result<Report, Error> {
        let seen_m = seen.diameter_m;
        let open_m = self.setup.tight_m(seen_m + 2.0 * self.setup.gap_m);
        let down_m = self.setup.raised_m - GRIP_HEIGHT_M;
        // Aligned first: a vial beside the tip's axis reads a longer range.
        sequence.state("align", 1.0, self.move_and(2, seen.aside_m, Loop::Slack)).await?;
        self.range().await?;
        sequence.state("home", 3.0, self.home()).await?;
        let open_rad = self.angle_rad(open_m);
        sequence.state("centre", 3.0, self.centre()).await?;
        sequence.state("feed", 2.5, self.turn_to(open_rad, false)).await?;
        sequence.state("lower", 2.0, self.move_and(0, down_m, Loop::Slack)).await?;
        if !sequence.state("reel", 3.0, self.reel(seen_m, found)).await? {
            sequence.state("retract", 2.0, self.move_and(0, 0.0, Loop::Slack)).await?;
            return Ok(Report::Missed);
        }
        sequence.state("lift", 2.0, self.move_and(0, 0.0, Loop::Closed(found))).await?;
        let is_there = sequence.state("carry", 2.0, self.carry(found)).await?;
        // Recorded before the vial is put down: the metrics judge the grip in the air.
        *carried = truth(self.session)?.map(|body| (body, self.set_n));
        if !is_there {
            return Ok(Report::Lost);
        }
        sequence.state("lower", 2.0, self.move_and(0, down_m, Loop::Closed(found))).await?;
        sequence.state("open", 2.5, self.turn_to(open_rad, false)).await?;
        sequence.state("retract", 2.0, self.move_and(0, 0.0, Loop::Slack)).await?;
        // Slack by 0.3 rad, so that the parked loop does not load the sensor.
        let parked_rad = self.home_rad + 0.3;
        sequence.state("park", 2.5, self.turn_to(parked_rad, false)).await?;
        Ok(Report::Placed)
    }
}
