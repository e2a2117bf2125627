//! `r4 monitor`

mod draw;
mod state;
#[cfg(test)]
mod tests;

use std::{
    cell::RefCell,
    pin::pin,
    time::{Duration, Instant},
};

use anyhow::Context;
use crossterm::event::{KeyCode, KeyEvent};
use futures::future::{Either, select};
use r4_driver::Error;
use r4_sim::Pace;

use crate::{
    args::Args,
    screen::{self, Commands, Screen},
    session::{self, Interrupted, Session, Target},
};

use draw::draw;
use state::State;

/// A board has one host at a time: while it is watched, no other program can command it, and quitting disarms it.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Monitor {
    /// Samples of each channel per second
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=100))]
    pub(crate) rate: u16,
}

/// How often keys and answers are looked for, s.
const LOOK_EVERY_S: f64 = 0.02;
/// How often is drawn, whatever the pace.
const DRAW_EVERY: Duration = Duration::from_millis(50);
/// How often the board is asked what it has counted, s.
const MEASURE_EVERY_S: f64 = 0.5;
/// How long is waited before a lost board is looked for again.
const RETRY_AFTER: Duration = Duration::from_millis(300);

/// What a key means.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Key {
    Ask(Ask),
    Select(isize),
    Quit,
}

/// What a board can be asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ask {
    Arm,
    Disarm,
    Clear,
    Stop,
}

impl Ask {
    fn name(self) -> &'static str {
        match self {
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Clear => "clear",
            Self::Stop => "stop",
        }
    }
}

fn meaning(key: KeyEvent) -> Option<Key> {
    Some(match key.code {
        KeyCode::Char('a') => Key::Ask(Ask::Arm),
        KeyCode::Char('d') => Key::Ask(Ask::Disarm),
        KeyCode::Char('c') => Key::Ask(Ask::Clear),
        KeyCode::Char(' ') => Key::Ask(Ask::Stop),
        KeyCode::Up | KeyCode::Char('k') => Key::Select(-1),
        KeyCode::Down | KeyCode::Char('j') => Key::Select(1),
        KeyCode::PageUp => Key::Select(-10),
        KeyCode::PageDown => Key::Select(10),
        KeyCode::Home => Key::Select(isize::MIN),
        KeyCode::End => Key::Select(isize::MAX),
        KeyCode::Char('q') => Key::Quit,
        _ => return None,
    })
}

pub(crate) fn run(args: &Args, monitor: &Monitor) -> anyhow::Result<bool> {
    screen::check(args, "r4 monitor", "`r4 watch` prints lines, and with --json objects")?;
    let mut args = args.clone();
    let mut seen: Option<(Screen, State)> = None;
    loop {
        let watched = session::run(&args, Pace::RealTime(1.0), async |session| {
            let now_s = session.board.now_s();
            let (info, channels) = (session.board.info(), session.board.channels());
            let (screen, state) = match &mut seen {
                Some((screen, state)) => {
                    state.reconnected(info, channels, now_s);
                    (screen, state)
                }
                seen => {
                    let state = State::new(args.board.to_string(), info, channels, now_s);
                    let (screen, state) = seen.insert((Screen::open()?, state));
                    (screen, state)
                }
            };
            watch(session, monitor, screen, state).await
        });
        let (error, (screen, state)) = match (watched, &mut seen) {
            (Ok(_), _) => return Ok(true),
            (Err(error), Some(seen)) if is_lost(&args, &error) => (error, seen),
            (Err(error), _) => return Err(error),
        };
        // Said once, and not over the screen.
        (args.flash, args.pace) = (None, None);
        state.lost(format!("{error:#}"));
        if wait(screen, state)? {
            return Ok(true);
        }
    }
}

/// Whether the board may come back.
fn is_lost(args: &Args, error: &anyhow::Error) -> bool {
    matches!(args.board, Target::Link(_)) && !error.is::<Interrupted>() && !error.is::<Broken>()
}

/// The screen cannot go on, whatever the board does.
#[derive(Debug, thiserror::Error)]
#[error("the screen ended")]
struct Broken;

/// Shows that there is no board, for a while; true when somebody quits.
fn wait(screen: &mut Screen, state: &mut State) -> anyhow::Result<bool> {
    let begin = Instant::now();
    screen.draw(|frame| draw(frame, state))?;
    while let Some(left) = RETRY_AFTER.checked_sub(begin.elapsed()) {
        let key = screen.key(left)?;
        if session::is_interrupted() {
            return Err(Interrupted.into());
        }
        match key.and_then(meaning) {
            Some(Key::Quit) => return Ok(true),
            Some(Key::Select(down)) => state.select(down),
            Some(Key::Ask(_)) | None => {}
        }
        screen.draw(|frame| draw(frame, state))?;
    }
    Ok(false)
}

/// Until somebody quits, or the link ends.
async fn watch(session: &Session<'_>, monitor: &Monitor, screen: &mut Screen, state: &mut State) -> anyhow::Result<()> {
    let mut telemetry = session.board.telemetry();
    for channel in session.board.channels() {
        session.board.subscribe(channel.id, 1000 / monitor.rate).await?;
    }
    let state = RefCell::new(state);
    let listen = async {
        loop {
            match telemetry.next().await {
                Ok(frame) => {
                    let state = &mut *state.borrow_mut();
                    state.telemetry(&frame, session.board.now_s());
                    (state.link.bad, state.link.dropped) = (session.board.bad_frames(), telemetry.dropped());
                }
                Err(error) => return error,
            }
        }
    };
    let (listen, measure) = (pin!(listen), pin!(measure(session, &state)));
    match select(pin!(steer(session, screen, &state)), select(listen, measure)).await {
        Either::Left((result, _)) => result.context(Broken),
        Either::Right((Either::Left((error, _)) | Either::Right((error, _)), _)) => Err(error.into()),
    }
}

/// Asks the board again and again what it has counted, which is a round trip too.
async fn measure(session: &Session<'_>, state: &RefCell<&mut State>) -> Error {
    loop {
        let begin_s = session.board.now_s();
        match session.board.stats().await {
            Ok(stats) => state.borrow_mut().measured(session.board.now_s() - begin_s, stats),
            Err(error @ (Error::LinkLost { .. } | Error::LinkFailed { .. })) => return error,
            Err(_) => state.borrow_mut().link.unanswered += 1,
        }
        session.board.sleep_s(MEASURE_EVERY_S).await;
    }
}

/// Draws, and does what keys say, until one says to quit.
async fn steer(session: &Session<'_>, screen: &mut Screen, state: &RefCell<&mut State>) -> anyhow::Result<()> {
    let board = session.board;
    let mut commands = Commands::default();
    let mut drawn: Option<Instant> = None;
    loop {
        while let Some(key) = screen.key(Duration::ZERO)? {
            match meaning(key) {
                Some(Key::Ask(ask)) => commands.begin(ask.name(), async move {
                    match ask {
                        Ask::Arm => board.arm().await,
                        Ask::Disarm => board.disarm().await,
                        Ask::Clear => board.clear().await,
                        Ask::Stop => board.stop().await,
                    }
                }),
                Some(Key::Select(down)) => state.borrow_mut().select(down),
                Some(Key::Quit) => return Ok(()),
                None => {}
            }
        }
        if drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
            drawn = Some(Instant::now());
            let state = &mut *state.borrow_mut();
            state.now_s = board.now_s();
            screen.draw(|frame| draw(frame, state))?;
        }
        if let Some((name, result)) = commands.until(board.sleep_s(LOOK_EVERY_S)).await {
            state.borrow_mut().done(name, result);
        }
    }
}
