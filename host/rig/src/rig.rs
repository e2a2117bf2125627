//! Opening of a board by its name, and sessions with it.

use std::{cell::Cell, io::Cursor, path::PathBuf, pin::pin, rc::Rc, time::Instant};

use futures::future::{Either, FutureExt as _, LocalBoxFuture, select};
use r4_access::{Presenter, Source, unix_ms};
use r4_boards::Robot;
use r4_driver::{Clock as _, Error as DriverError, with_board};
use r4_links::{Address, Event, Key, OpenError, RealClock, is_of_link, with_reconnect};
use r4_protocol::Refusal;
use r4_sim::{Pace, SimBoard, Simulation, VirtualBoard, flash::Flash};

use crate::{
    Error, FlashFile, HostClock, Interrupt, Interrupted, Notice, PlantFile, Session, Target,
    cable::Cable,
    emulated,
    plant_file::{InRobot, hidden, replace_body, replace_plants},
    recording::{self, Listened, Output, RecordingError, SharedTap},
    session::AtEnd,
    view::{LookAtWorld, SharedLook, WorldLook},
    work::{Again, Once, Repeated, Work},
};

/// Period of the check for an [`Interrupt`], µs on the session's clock.
const INTERRUPT_POLL_US: u64 = 10_000;

/// Callback that changes a virtual board's robot before power-up: its body, its world, its physics.
pub type Alter = Rc<dyn Fn(&mut Robot)>;

/// Callback that shows notices to the user.
pub type Notify = Rc<dyn Fn(&Notice)>;

/// A board with its settings and environment, before a session.
///
/// A virtual board is powered up anew for each session: the same settings give the same bytes.
#[derive(Clone)]
pub struct Rig {
    /// Board that the sessions open.
    pub target: Target,
    /// Seed of a virtual board's noise.
    pub seed: u64,
    /// Pace of a virtual board's time against real time.
    pub pace: Pace,
    /// File with a virtual board's flash; created if it does not exist.
    pub flash: Option<PathBuf>,
    /// File whose `[body]` and `[world]`, as far as present, replace those of a virtual board's robot: a scenario's.
    /// `body` and `world` take precedence.
    pub environment: Option<PathBuf>,
    /// World in which a virtual robot's body stands: a built-in name or a TOML file.
    pub world: Option<String>,
    /// Plants that replace those of a virtual board's motors.
    pub plants: Vec<PlantFile>,
    /// File with a body that replaces that of a virtual board's robot.
    pub body: Option<PathBuf>,
    /// Seed of an effect hidden in the physics of a virtual board's body, or in each of its motors.
    pub hidden: Option<u64>,
    /// Change of a virtual board's robot before power-up: for scenes that a file cannot describe, such as a body with
    /// sampled tyres.
    pub alter: Option<Alter>,
    /// Key of a board on a link; `None` for a board without one.
    pub key: Option<Key>,
    /// World of a virtual board that another thread of this program serves on a link, for the view in recordings.
    pub look: Option<SharedLook>,
    /// Tokens for the guard of a shared board on a link; `None` for a board without one.
    pub token: Option<Source>,
    /// Request to end a session in good order.
    pub interrupt: Interrupt,
    /// Callback for notices to the user; the default discards them.
    pub notify: Notify,
    /// Settings and observer of an emulated board.
    #[cfg(feature = "emu")]
    pub emulated: emulated::Setup,
}

/// Duration of a session, in the board's time and in wall time.
#[derive(Clone, Copy, Debug)]
pub struct Elapsed {
    /// Time on a virtual board's clock, s; wall time on a real board.
    pub simulated_s: f64,
    /// Wall time of the session, s.
    pub wall_s: f64,
}

impl Elapsed {
    /// Simulated seconds per second of wall time.
    #[must_use]
    pub fn real_time_factor(self) -> f64 {
        self.simulated_s / self.wall_s.max(1e-9)
    }
}

/// A session and its recording.
pub struct Recorded<T, E> {
    /// Result of the session.
    pub result: Result<(T, Elapsed), E>,
    /// Log up to the end or the error; empty if the board never described itself.
    pub log: Vec<u8>,
    /// Error when the log is not complete.
    pub log_error: Option<RecordingError>,
}

/// Errors of a session that reconnects: those of the caller's work, and those of link and driver.
enum Ended {
    Open(OpenError),
    Board(DriverError),
    /// An error of the work, which keeps it; the driver's error of a lost link, if it comes from there.
    Work(Option<DriverError>),
}

impl From<OpenError> for Ended {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl From<DriverError> for Ended {
    fn from(error: DriverError) -> Self {
        Self::Board(error)
    }
}

impl Rig {
    /// Creates a rig with default settings: seed 1, as fast as the computer can, the world and physics of its robot's
    /// file.
    #[must_use]
    pub fn new(target: Target) -> Self {
        Self {
            target,
            seed: 1,
            pace: Pace::Free,
            flash: None,
            environment: None,
            world: None,
            plants: Vec::new(),
            body: None,
            hidden: None,
            alter: None,
            key: None,
            look: None,
            token: None,
            interrupt: Interrupt::default(),
            notify: Rc::new(|_| {}),
            #[cfg(feature = "emu")]
            emulated: emulated::Setup::default(),
        }
    }

    /// Loads the robot of a virtual board, with physics and world as the settings define.
    ///
    /// # Errors
    /// [`Error::NotVirtual`] for a board on a link; the error of a file that is not valid.
    pub fn robot(&self) -> Result<Robot, Error> {
        Ok(self.prepared()?.0)
    }

    /// Loads the robot; also returns true when an effect is hidden in its body, so that none is in its motors.
    fn prepared(&self) -> Result<(Robot, bool), Error> {
        let name = self.target.robot()?;
        let mut robot = r4_boards::load(name)?;
        // Later settings override earlier ones: environment file, body, plants, hidden effect, world, the caller's
        // change.
        if let Some(file) = &self.environment {
            r4_boards::load_environment(file, &mut robot)?;
        }
        if let Some(file) = &self.body {
            replace_body(&mut robot, file)?;
        }
        replace_plants(&mut robot, &self.plants)?;
        let mut is_in_body = false;
        if let Some(seed) = self.hidden
            && let InRobot::Body(body, _) = hidden(&robot, seed)?
        {
            robot.simulation.set_body(*body);
            is_in_body = true;
        }
        if let Some(world) = &self.world {
            let world = r4_boards::load_world(world)?;
            if robot.simulation.body.is_none() {
                return Err(Error::NoBody { robot: name.to_owned() });
            }
            robot.simulation.enter(world);
            robot.simulation.check_fields().map_err(r4_boards::BoardError::NoField)?;
        }
        if let Some(alter) = &self.alter {
            alter(&mut robot);
        }
        Ok((robot, is_in_body))
    }

    /// Powers up the virtual board, with the flash in its file.
    ///
    /// # Errors
    /// [`Error::NotVirtual`] for a board on a link; the error of a file that is not valid.
    pub fn power_up(&self, simulation: &mut Simulation) -> Result<(Rc<dyn VirtualBoard>, Option<FlashFile>), Error> {
        let (robot, is_in_body) = self.prepared()?;
        let file = self.flash.as_deref().map(FlashFile::open).transpose()?;
        let flash = file.as_ref().map(FlashFile::flash).transpose()?.flatten();
        if let (Some(file), Some(flash)) = (&file, &flash)
            && let Some(notice) = file.review(flash, &robot.config)
        {
            (self.notify)(&notice);
        }
        let board = self.start(simulation, &robot, flash)?;
        if let Some(seed) = self.hidden.filter(|_| !is_in_body)
            && let InRobot::Motors(motors) = hidden(&robot, seed)?
        {
            for ((channel, hidden), index) in motors.into_iter().zip(0u64..) {
                // Each motor has noise of its own.
                board.world().set_plant(channel, hidden.plant(self.seed.wrapping_add(index)));
            }
        }
        Ok((board, file))
    }

    fn start(
        &self,
        simulation: &mut Simulation,
        robot: &Robot,
        flash: Option<Flash>,
    ) -> Result<Rc<dyn VirtualBoard>, Error> {
        match &self.target {
            Target::Sim(_) => Ok(match flash {
                Some(flash) => Rc::new(SimBoard::start_with(simulation, robot, self.seed, flash)?),
                None => Rc::new(SimBoard::start(simulation, robot, self.seed)?),
            }),
            Target::Emu(name) => self.start_emulated(simulation, robot, name, flash),
            Target::Link(_) => Err(crate::NotVirtual(self.target.clone()).into()),
        }
    }

    #[cfg(feature = "emu")]
    fn start_emulated(
        &self,
        simulation: &mut Simulation,
        robot: &Robot,
        name: &str,
        flash: Option<Flash>,
    ) -> Result<Rc<dyn VirtualBoard>, Error> {
        Ok(Rc::new(self.emulated.start(simulation, (robot, name), self.seed, flash, &self.notify)?))
    }

    #[cfg(not(feature = "emu"))]
    fn start_emulated(
        &self,
        _: &mut Simulation,
        _: &Robot,
        _: &str,
        _: Option<Flash>,
    ) -> Result<Rc<dyn VirtualBoard>, Error> {
        Err(emulated::EmulatedError.into())
    }

    /// Connects to the board and runs `work` in a session with it, recorded by `tap`.
    ///
    /// An [`Interrupt`] disarms the board, closes the session and gives [`Error::Interrupted`].
    ///
    /// # Errors
    /// The error of `work`; the error of opening, closing or interrupting the session.
    pub fn run<T, E: From<Error>>(
        &self,
        tap: Option<SharedTap>,
        work: impl AsyncFnOnce(&Session<'_>) -> Result<T, E>,
    ) -> Result<(T, Elapsed), E> {
        let mut work = Once::new(work);
        let (ended, elapsed) = match &self.target {
            Target::Link(address) => self.run_on_link(address, tap, &mut work),
            Target::Sim(_) | Target::Emu(_) => self.run_on_virtual(tap, &mut work)?,
        };
        Ok((work.value(ended)?, elapsed))
    }

    /// Runs `work` as [`Rig::run`], recorded into memory by `tap`, which gets an [`Output::Memory`].
    pub fn recorded<T, E: From<Error>>(
        &self,
        tap: impl FnOnce(Output) -> SharedTap,
        work: impl AsyncFnOnce(&Session<'_>) -> Result<T, E>,
    ) -> Recorded<T, E> {
        let tap = tap(Output::Memory(Cursor::new(Vec::new())));
        let result = self.run(Some(tap.clone()), work);
        let (log, log_error) = match recording::finish(tap) {
            Ok(output) => (recording::bytes(output), None),
            Err(error) => (Vec::new(), Some(error)),
        };
        Recorded { result, log, log_error }
    }

    /// Runs `work` in a session with a virtual board, and returns how the session ended. An error beside it takes
    /// precedence over the result of `work`: the board's failure, or that of its files.
    fn run_on_virtual(
        &self,
        tap: Option<SharedTap>,
        work: &mut dyn Work,
    ) -> Result<(Result<(), Error>, Elapsed), Error> {
        let mut simulation = Simulation::new(self.pace);
        let (board, file) = self.power_up(&mut simulation)?;
        let clock = simulation.clock();
        let begin = Instant::now();
        let ended = simulation.block_on(self.session_with(board.clone(), &clock, tap, work));
        // Before the result: the failure is what explains a session that stood still.
        if let Some(failure) = board.failure() {
            return Err(Error::Stopped(failure));
        }
        let ended = ended.ok_or(Error::Standstill)?;
        let elapsed = Elapsed { simulated_s: clock.now_ns() as f64 * 1e-9, wall_s: begin.elapsed().as_secs_f64() };
        // Also after a failed session: a real board would have kept its flash.
        if let Some(file) = file {
            file.write(&board.flash())?;
        }
        Ok((ended, elapsed))
    }

    /// Runs `work` in a session with a virtual board that the caller has powered up, on the clock of its simulation.
    ///
    /// The caller runs that simulation. The settings for power-up have no effect.
    ///
    /// # Errors
    /// [`Error::Connected`] for a board that has a host; [`Error::Connect`]; errors of `work`.
    pub async fn attached<T, E: From<Error>>(
        &self,
        board: Rc<dyn VirtualBoard>,
        clock: &r4_sim::Clock,
        work: impl AsyncFnOnce(&Session<'_>) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut work = Once::new(work);
        let ended = self.session_with(board, clock, None, &mut work).await;
        work.value(ended)
    }

    /// Connects to a powered virtual board and runs `work` in a session with it.
    fn session_with<'a>(
        &'a self,
        board: Rc<dyn VirtualBoard>,
        clock: &'a r4_sim::Clock,
        tap: Option<SharedTap>,
        work: &'a mut dyn Work,
    ) -> LocalBoxFuture<'a, Result<(), Error>> {
        // Boxed here: an `async fn` would be compiled again in each crate that awaits it, as that crate is optimised.
        async move {
            let port = board.connect().ok_or(Error::Connected)?;
            let (tx, cable) = Cable::new(port.tx, clock.clone());
            let host_clock = HostClock::Virtual(clock.clone());
            let (rx, tx) =
                (Listened::new(port.rx, tap.as_ref(), &host_clock), Listened::new(tx, tap.as_ref(), &host_clock));
            let environment = Some((board.clone(), cable));
            // Weak, because the recording may outlive the board.
            let board = Rc::downgrade(&board);
            let look = move || board.upgrade().map(|board| WorldLook::of(&board.world()));
            let connected = with_board(rx, tx, host_clock.clone(), async |connected| {
                let session =
                    Session::new(connected, &self.target, host_clock.clone(), tap, self.notify.clone(), environment);
                session.record_view(Box::new(look));
                self.unless_interrupted(&session, work.run(&session)).await
            });
            connected.await.map_err(|source| Error::Connect { board: self.target.to_string(), source })?
        }
        .boxed_local()
    }

    /// Look at the world of a board on a link: there is one only where this program serves the board.
    fn look(&self) -> LookAtWorld {
        let look = self.look.clone();
        Box::new(move || look.as_ref().and_then(SharedLook::get))
    }

    /// Runs `work` in a session with a board on a link, and returns how the session ended.
    fn run_on_link(
        &self,
        address: &Address,
        tap: Option<SharedTap>,
        work: &mut dyn Work,
    ) -> (Result<(), Error>, Elapsed) {
        let begin = Instant::now();
        let ended = r4_links::block_on(async {
            let link = r4_links::open(address, self.key.as_ref()).await?;
            let clock = HostClock::Real(RealClock);
            // Outside of the recording, which must not have a token.
            let tx = Presenter::new(link.tx, self.token.clone(), unix_ms);
            let (rx, tx) = (Listened::new(link.rx, tap.as_ref(), &clock), Listened::new(tx, tap.as_ref(), &clock));
            let connected = with_board(rx, tx, clock.clone(), async |connected| {
                let session = Session::new(connected, &self.target, clock.clone(), tap, self.notify.clone(), None);
                session.record_view(self.look());
                self.unless_interrupted(&session, work.run(&session)).await
            });
            connected.await.map_err(|source| Error::Connect { board: self.target.to_string(), source })?
        });
        let wall_s = begin.elapsed().as_secs_f64();
        (ended, Elapsed { simulated_s: wall_s, wall_s })
    }

    /// Runs `work` in a session with a board on a link, and again each time a lost link is restored; `tell` is called
    /// with both events. While there is no link, `meanwhile` runs; when it ends, everything ends. `lost` extracts from
    /// an error of `work` the driver's error of a lost link.
    ///
    /// A recording continues with the next session; the time between is a gap in it.
    ///
    /// # Errors
    /// The error when the board cannot be reached at the start; errors of `work` that do not come from the link; errors
    /// of `meanwhile`; [`Error::Interrupted`].
    pub fn keep<T, E: From<Error>>(
        &self,
        address: &Address,
        tap: Option<SharedTap>,
        work: impl AsyncFnMut(&Session<'_>) -> Result<T, E>,
        lost: impl Fn(&E) -> Option<&DriverError>,
        mut tell: impl FnMut(Event),
        meanwhile: impl AsyncFnOnce(&HostClock) -> Result<T, E>,
    ) -> Result<T, E> {
        let clock = HostClock::Real(RealClock);
        let has_session = Cell::new(false);
        let mut work = Again::new(work, lost);
        let ended = r4_links::block_on(async {
            // While a session runs, it handles the interrupt itself, because it must disarm first.
            let interrupted = async {
                while !self.interrupt.is_set() || has_session.get() {
                    clock.sleep_until(clock.now_us() + INTERRUPT_POLL_US).await;
                }
            };
            let connected = self.reconnecting(address, tap, &mut work, &mut tell, &has_session);
            match select(connected, select(pin!(interrupted), pin!(meanwhile(&clock)))).await {
                Either::Left((ended, _)) => Either::Left(ended),
                Either::Right((Either::Right((result, _)), _)) => Either::Right(result),
                Either::Right((Either::Left(_), _)) => Either::Right(Err(Error::Interrupted(Interrupted).into())),
            }
        });
        match ended {
            Either::Left(Ok(()) | Err(Ended::Work(_))) => work.value(),
            Either::Left(Err(Ended::Open(error))) => Err(Error::Open(error).into()),
            Either::Left(Err(Ended::Board(source))) => {
                Err(Error::Connect { board: self.target.to_string(), source }.into())
            }
            Either::Right(result) => result,
        }
    }

    /// Runs `work` in a session with a board on a link, and again each time a lost link is restored.
    fn reconnecting<'a>(
        &'a self,
        address: &'a Address,
        tap: Option<SharedTap>,
        work: &'a mut dyn Repeated,
        tell: &'a mut dyn FnMut(Event),
        has_session: &'a Cell<bool>,
    ) -> LocalBoxFuture<'a, Result<(), Ended>> {
        let clock = HostClock::Real(RealClock);
        // Boxed here for the reason in `session_with`.
        async move {
            with_reconnect(
                address,
                self.key.as_ref(),
                clock.clone(),
                |link| {
                    if let Some(tap) = &tap {
                        // Marks the gap in the recording.
                        tap.borrow_mut().reopened();
                    }
                    let tx = Presenter::new(link.tx, self.token.clone(), unix_ms);
                    (Listened::new(link.rx, tap.as_ref(), &clock), Listened::new(tx, tap.as_ref(), &clock))
                },
                async |board| {
                    has_session.set(true);
                    let session =
                        Session::new(board, &self.target, clock.clone(), tap.clone(), self.notify.clone(), None);
                    session.record_view(self.look());
                    let ended = self.unless_interrupted(&session, work.run(&session)).await;
                    has_session.set(false);
                    work.end(ended).map_err(Ended::Work)
                },
                |ended| match ended {
                    Ended::Work(Some(error)) | Ended::Board(error) => {
                        Some(error).filter(|error| is_of_link(error)).cloned()
                    }
                    Ended::Work(None) | Ended::Open(_) => None,
                },
                tell,
            )
            .await
        }
        .boxed_local()
    }

    /// Runs `work` until it ends or is interrupted; then restores what the session has to leave behind.
    async fn unless_interrupted(&self, session: &Session<'_>, work: LocalBoxFuture<'_, ()>) -> Result<(), Error> {
        let interrupted = async {
            while !self.interrupt.is_set() {
                session.clock.sleep_until(session.clock.now_us() + INTERRUPT_POLL_US).await;
            }
        };
        let ended = match select(work, pin!(interrupted)).await {
            Either::Left(((), _)) => Ok(()),
            Either::Right(((), _)) => {
                match session.board.disarm().await {
                    // A shared board commanded by another client: disarming it is not ours to do.
                    Ok(()) | Err(DriverError::Refused(Refusal::InUse)) => {}
                    Err(error) => return Err(Error::NotDisarmed(error)),
                }
                Err(Error::Interrupted(Interrupted))
            }
        };
        let Some(AtEnd { channel, mode, gains, tuning }) = session.take_at_end() else { return ended };
        // Also after an error or an interrupt: the next session must not find the gains of an experiment.
        let put_back = async {
            session.board.set_gains(channel, mode, gains).await?;
            session.board.set_tuning(channel, tuning).await
        };
        let put_back = put_back.await;
        // The interrupt takes precedence over the error of the gains.
        ended?;
        put_back.map_err(|source| Error::GainsLeft { channel, source })
    }
}
