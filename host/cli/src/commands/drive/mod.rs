//! `r4 drive`: drives a robot by keys or a gamepad, with a dead-man key.

mod draw;
mod gamepad;
mod hands;

use std::{
    cell::RefCell,
    pin::pin,
    time::{Duration, Instant},
};

use anyhow::bail;
use crossterm::event::{KeyCode, KeyEvent};
use futures::future::{Either, select};
use r4_boards::{Ackermann, Drive as Geometry, Interval, SteeringLaw};
use r4_driver::Error;
use r4_protocol::{ChannelId, HotWinding, Mode, SafetyState, Sample, Setpoint, Unit};
use r4_sim::Pace;

use crate::{
    args::Args,
    screen::{self, Commands, Screen},
    session::{self, Session},
};
use r4_rig::quantity::{Quantity, speed_unit};

use draw::{State, Wheel, draw};
use gamepad::Gamepad;
use hands::{DeadMan, Hand, Stick, mix, steered};

/// Wheels turn only while the space key is held: 0.3 s after its last repeat they get set points of zero. Choose speed
/// and turn by tapping the other keys, then hold space. `docs/program.md` has the details.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Drive {
    /// Motors of the left wheels; example: dhb0,dhb2 [default: those of the robot's file]
    #[arg(long, value_delimiter = ',', value_name = "CHANNEL,..", requires = "right")]
    pub(crate) left: Vec<ChannelId>,
    /// Motors of the right wheels; example: dhb1,dhb3
    #[arg(long, value_delimiter = ',', value_name = "CHANNEL,..", requires = "left")]
    pub(crate) right: Vec<ChannelId>,
    /// Highest speed of the wheels, or highest duty without speed control; examples: 60rpm, 30% [default: the robot's,
    /// or half of the motors' limit]
    #[arg(long, allow_hyphen_values = true)]
    pub(crate) speed: Option<Quantity>,
    /// Taps of a key from standstill to the highest speed
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(i8).range(1..=50))]
    pub(crate) steps: i8,
    /// Drive by the left stick of a gamepad too, while its right shoulder button is held
    #[arg(long)]
    pub(crate) gamepad: bool,
}

/// Period of set points, s.
const SEND_EVERY_S: f64 = 0.02;
/// Period of the screen.
const DRAW_EVERY: Duration = Duration::from_millis(50);
/// Telemetry period of the wheels, ms.
const LOOK_EVERY_MS: u16 = 50;
/// Time without telemetry after which the board counts as silent, s: two link time-outs of 200 ms.
const SILENT_S: f64 = 0.4;
/// Unanswered set points per wheel above which only changed ones are sent: 0.2 s of them.
const MOST_WAITING: usize = 10;
/// Highest duty where nothing else is known: enough to move, slow enough to walk beside.
const CAREFUL_DUTY: f64 = 0.3;
/// Share of the highest speed that a full turn on the spot uses, where the robot's geometry is unknown.
const TURN_SHARE: f64 = 0.5;

/// Motors to drive, and their limits.
struct Pair {
    /// Motors of the left wheels; with steered front wheels, the driving motor.
    left: Vec<ChannelId>,
    /// Motors of the right wheels; empty with steered front wheels.
    right: Vec<ChannelId>,
    mode: Mode,
    /// Highest set point, in the unit of `mode`.
    most: Quantity,
    turn_share: f64,
    /// Steered front wheels; `None` for skid steering.
    steering: Option<Steering>,
}

/// Front wheels that a linear motor steers.
#[derive(Clone, Copy)]
struct Steering {
    channel: ChannelId,
    law: SteeringLaw,
    /// Range of the steering angle, rad; positive to the left.
    limits: Interval,
}

pub(crate) fn run(args: &Args, drive: &Drive) -> anyhow::Result<bool> {
    screen::check(args, "r4 drive", "`r4 speed` and `r4 duty` turn a motor without one")?;
    let mut gamepad = if drive.gamepad { Some(Gamepad::open()?) } else { None };
    session::run(args, Pace::RealTime(1.0), async |session| {
        let pair = Pair::find(drive, session)?;
        let state = RefCell::new(pair.state(args, session));
        let mut screen = Screen::open()?;
        let heard_s = RefCell::new(session.board.now_s());
        let mut telemetry = session.board.telemetry();
        for channel in pair.channels() {
            session.board.subscribe(channel, LOOK_EVERY_MS).await?;
        }
        let listen = async {
            loop {
                match telemetry.next().await {
                    Ok(frame) => {
                        heard_s.replace(session.board.now_s());
                        let state = &mut *state.borrow_mut();
                        (state.safety, state.causes) = (frame.state, frame.causes);
                        state.look(&frame.samples);
                        state.warn_of(&session.board.hot_windings());
                    }
                    Err(error) => return error,
                }
            }
        };
        let steer = steer(session, drive, &pair, gamepad.as_mut(), &mut screen, &state, &heard_s);
        let steered = match select(pin!(steer), pin!(listen)).await {
            Either::Left((result, _)) => result,
            Either::Right((error, _)) => return Err(error.into()),
        };
        // Disarm however the steering ended.
        let disarmed = session.board.disarm().await;
        steered?;
        Ok(disarmed?)
    })?;
    Ok(true)
}

impl Pair {
    fn find(drive: &Drive, session: &Session<'_>) -> anyhow::Result<Self> {
        let geometry = session.ground_drive().map(|drive| drive.drive().clone());
        let mut pair = match (&geometry, drive.left.is_empty()) {
            (_, false) => Self::of(drive.left.clone(), drive.right.clone()),
            (Some(Geometry::SkidSteer(robot)), true) => Self {
                turn_share: (robot.turn_rate_max_rad_s * robot.track_m / 2.0 / robot.speed_max_m_s).min(1.0),
                ..Self::of(robot.left.clone(), robot.right.clone())
            },
            (Some(Geometry::Ackermann(robot)), true) => Self::steered(robot),
            (None, true) => bail!(
                "the left and right motors of this robot are unknown: name them, as in --left dhb0,dhb2 \
                 --right dhb1,dhb3"
            ),
        };
        // A wheel on both sides would get two set points in every period.
        if let Some(twice) =
            pair.wheels().enumerate().find(|(at, id)| pair.wheels().take(*at).any(|before| before == *id))
        {
            bail!("{} is named twice", twice.1);
        }
        let known_rad_s = match geometry {
            Some(Geometry::SkidSteer(robot)) if drive.left.is_empty() => {
                Some(robot.speed_max_m_s / robot.wheel_radius_m)
            }
            Some(Geometry::Ackermann(robot)) if drive.left.is_empty() => {
                Some(robot.speed_max_m_s / robot.wheel_radius_m)
            }
            _ => None,
        };
        (pair.mode, pair.most) = match drive.speed {
            Some(most) => (if most.unit == Unit::Duty { Mode::Duty } else { Mode::Speed }, most),
            None => pair.careful(session, known_rad_s)?,
        };
        if pair.most.value <= 0.0 {
            bail!("the highest speed must be above 0, not {}", pair.most);
        }
        for channel in pair.wheels() {
            // Check both directions.
            session.setpoint(channel, pair.mode, pair.most)?;
            session.setpoint(channel, pair.mode, Quantity { value: -pair.most.value, ..pair.most })?;
        }
        if let Some(Steering { channel, law, limits }) = pair.steering {
            for angle_rad in [limits.min, limits.max] {
                session.setpoint(channel, Mode::Position, Quantity::new(law.position_m(angle_rad), Unit::M))?;
            }
        }
        Ok(pair)
    }

    /// Motors of a robot with steered front wheels.
    fn steered(robot: &Ackermann) -> Self {
        let steering = Steering { channel: robot.steering, law: robot.steering_law, limits: robot.steering_rad };
        let mut pair = Self { steering: Some(steering), ..Self::of(vec![robot.drive], Vec::new()) };
        if let Some(full_m_s) = robot.full_speed_m_s {
            // The drive has no speed control: limit its duty to that of the highest speed.
            pair.most = Quantity::new((robot.speed_max_m_s / full_m_s).min(1.0), Unit::Duty);
        }
        pair
    }

    /// Set points of all channels for the input `hand`.
    fn orders(&self, hand: Hand) -> Vec<(ChannelId, Setpoint)> {
        let [left, right] = match self.steering {
            Some(_) => [mix(Hand { turn: 0.0, ..hand }, 0.0)[0]; 2],
            None => mix(hand, self.turn_share),
        };
        let order = |share: f64| {
            move |channel: &ChannelId| (*channel, Setpoint { mode: self.mode, value: (share * self.most.value) as f32 })
        };
        let mut orders: Vec<_> = self.left.iter().map(order(left)).chain(self.right.iter().map(order(right))).collect();
        orders.extend(self.steering.map(|Steering { channel, law, limits }| {
            // Released: the rod keeps its position, as its spindle holds without power.
            let setpoint = match steered(hand, [limits.min, limits.max]) {
                Some(angle_rad) => Setpoint { mode: Mode::Position, value: law.position_m(angle_rad) as f32 },
                None => Setpoint { mode: Mode::Duty, value: 0.0 },
            };
            (channel, setpoint)
        }));
        orders
    }

    fn of(left: Vec<ChannelId>, right: Vec<ChannelId>) -> Self {
        let most = Quantity::new(CAREFUL_DUTY, Unit::Duty);
        Self { left, right, mode: Mode::Duty, most, turn_share: TURN_SHARE, steering: None }
    }

    /// Highest speed of the robot, or half of what every wheel accepts; a duty where a wheel has no speed control.
    fn careful(&self, session: &Session<'_>, known_rad_s: Option<f64>) -> anyhow::Result<(Mode, Quantity)> {
        let mut half: Option<Quantity> = None;
        for channel in self.wheels() {
            let info = session.board.channel(channel)?;
            let Some(takes) = info.mode(Mode::Speed) else { return Ok((Mode::Duty, self.most)) };
            let value = f64::from(takes.range.max.min(-takes.range.min)) / 2.0;
            half = Some(Quantity::new(half.map_or(value, |half| half.value.min(value)), takes.unit));
        }
        Ok(match (half, known_rad_s) {
            (Some(half), Some(rad_s)) if half.unit == Unit::RadPerS => {
                (Mode::Speed, Quantity { value: rad_s.min(half.value * 2.0), ..half })
            }
            (Some(half), _) => (Mode::Speed, half),
            (None, _) => (Mode::Duty, self.most),
        })
    }

    fn wheels(&self) -> impl Iterator<Item = ChannelId> {
        self.left.iter().chain(&self.right).copied()
    }

    /// Channels of the wheels and the steering, in the order of [`orders`](Self::orders).
    fn channels(&self) -> impl Iterator<Item = ChannelId> {
        self.wheels().chain(self.steering.map(|steering| steering.channel))
    }

    fn state(&self, args: &Args, session: &Session<'_>) -> State {
        let board = session.board;
        let (safety, causes) = board.safety();
        let side = |index: usize| match (self.steering.is_some(), index < self.left.len()) {
            (false, true) => "left",
            (false, false) => "right",
            (true, true) => "drive",
            (true, false) => "steer",
        };
        let wheel = |(index, channel): (usize, ChannelId)| Wheel {
            side: side(index),
            channel,
            told: Quantity::new(0.0, self.most.unit),
            speed: None,
            speed_unit: board.channel(channel).map_or(Unit::RadPerS, |info| speed_unit(info.unit)),
            duty: None,
            hot_percent: None,
        };
        State {
            board: args.board.described(),
            robot: board.info().robot.to_string(),
            safety,
            causes,
            hand: Hand::default(),
            unit: self.most.unit,
            most: self.most.value,
            wheels: self.channels().enumerate().map(wheel).collect(),
            steering: self.steering.map(|Steering { channel, law, .. }| {
                let resolution = board.channel(channel).map_or(0.0, |info| f64::from(info.resolution));
                draw::Steered { channel, law, resolution, told_rad: None, at_rad: None }
            }),
            silent_s: None,
            message: String::new(),
        }
    }
}

impl State {
    fn warn_of(&mut self, hot: &[HotWinding]) {
        for wheel in &mut self.wheels {
            let hot = hot.iter().find(|hot| hot.channel == wheel.channel);
            wheel.hot_percent = hot.map(|hot| hot.heat_percent);
        }
    }

    fn look(&mut self, samples: &[Sample]) {
        for sample in samples {
            let Some(wheel) = self.wheels.iter_mut().find(|wheel| wheel.channel == sample.channel()) else { continue };
            if let Sample::Motor { position, speed, duty, .. } = *sample {
                if let Some(steered) = self.steering.as_mut().filter(|steered| steered.channel == wheel.channel) {
                    steered.at_rad = Some(steered.law.angle_rad(f64::from(position) * steered.resolution));
                }
                wheel.speed = Some(f64::from(speed)).filter(|speed| speed.is_finite());
                wheel.duty = Some(duty.into());
            }
        }
    }
}

/// Meaning of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Key {
    DeadMan,
    Push(i8, i8),
    Centre,
    Arm,
    Disarm,
    Clear,
    Stop,
    Quit,
}

fn meaning(key: KeyEvent) -> Option<Key> {
    Some(match key.code {
        KeyCode::Char(' ') => Key::DeadMan,
        KeyCode::Up | KeyCode::Char('w' | 'W') => Key::Push(1, 0),
        KeyCode::Down | KeyCode::Char('s' | 'S') => Key::Push(-1, 0),
        KeyCode::Left | KeyCode::Char('a' | 'A') => Key::Push(0, 1),
        KeyCode::Right | KeyCode::Char('d' | 'D') => Key::Push(0, -1),
        KeyCode::Char('x' | 'X' | '0') => Key::Centre,
        KeyCode::Enter => Key::Arm,
        KeyCode::Backspace => Key::Disarm,
        KeyCode::Char('c' | 'C') => Key::Clear,
        KeyCode::Esc => Key::Stop,
        KeyCode::Char('q' | 'Q') => Key::Quit,
        _ => return None,
    })
}

/// Reads the input, sends set points and draws, until the user quits.
async fn steer(
    session: &Session<'_>,
    drive: &Drive,
    pair: &Pair,
    mut gamepad: Option<&mut Gamepad>,
    screen: &mut Screen,
    state: &RefCell<State>,
    heard_s: &RefCell<f64>,
) -> anyhow::Result<()> {
    let board = session.board;
    // Hands move in wall time, whatever the pace of the board.
    let begin = Instant::now();
    let (mut stick, mut dead_man) = (Stick::new(drive.steps), DeadMan::default());
    let mut commands: Commands<'_, &str> = Commands::default();
    let mut drawn: Option<Instant> = None;
    let mut told = Vec::new();
    loop {
        let next_s = board.now_s() + SEND_EVERY_S;
        while let Some(key) = screen.key(Duration::ZERO)? {
            let now_s = begin.elapsed().as_secs_f64();
            match meaning(key) {
                Some(Key::DeadMan) => dead_man.pressed(now_s),
                Some(Key::Push(forwards, turn)) => {
                    dead_man.other(now_s);
                    stick.push(forwards, turn);
                }
                Some(Key::Centre) => stick.centre(),
                Some(Key::Arm) => {
                    // After arming, the user must take hold of the dead-man key again.
                    dead_man.release();
                    commands.begin("arm", board.arm());
                }
                Some(Key::Disarm) => commands.begin("disarm", board.disarm()),
                Some(Key::Clear) => commands.begin("clear", board.clear()),
                Some(Key::Stop) => {
                    dead_man.release();
                    commands.begin("stop", board.stop());
                }
                Some(Key::Quit) => return Ok(()),
                None => {}
            }
        }
        let mut hand = stick.hand(dead_man.is_held(begin.elapsed().as_secs_f64()));
        if let Some(of_pad) = gamepad.as_mut().map(|gamepad| gamepad.hand()).filter(|hand| hand.is_held) {
            hand = of_pad;
        }
        let is_armed = {
            let state = &mut *state.borrow_mut();
            state.hand = hand;
            state.silent_s = Some(board.now_s() - *heard_s.borrow()).filter(|silent_s| *silent_s > SILENT_S);
            state.safety == SafetyState::Armed
        };
        // While disarmed, the screen shows set points of zero.
        let orders = pair.orders(if is_armed { hand } else { Hand { is_held: false, ..hand } });
        // Repeat unchanged set points to renew their lease, unless the link already has a queue of them.
        if is_armed && (orders != told || commands.len() < MOST_WAITING * orders.len()) {
            for (channel, setpoint) in &orders {
                commands.begin("set point", board.set(*channel, *setpoint));
            }
        }
        told = orders;
        if drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
            drawn = Some(Instant::now());
            let state = &mut *state.borrow_mut();
            for (wheel, (_, Setpoint { mode, value })) in state.wheels.iter_mut().zip(&told) {
                let unit = if *mode == Mode::Position {
                    Unit::M
                } else if *mode == Mode::Duty {
                    Unit::Duty
                } else {
                    state.unit
                };
                wheel.told = Quantity::new((*value).into(), unit);
                if let Some(steered) = state.steering.as_mut().filter(|steered| steered.channel == wheel.channel) {
                    steered.told_rad = (*mode == Mode::Position).then(|| steered.law.angle_rad((*value).into()));
                }
            }
            screen.draw(|frame| draw(frame, state))?;
        }
        while let Some((what, result)) = commands.until(board.sleep_s(next_s - board.now_s())).await {
            match result {
                Err(error @ (Error::LinkLost { .. } | Error::LinkFailed { .. })) => return Err(error.into()),
                Err(error) => state.borrow_mut().message = format!("{what}: {error}"),
                Ok(()) if what != "set point" => state.borrow_mut().message.clear(),
                Ok(()) => {}
            }
        }
    }
}
