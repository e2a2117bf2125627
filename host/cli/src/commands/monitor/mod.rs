//! `r4 monitor`: all channels of a board on one screen.

mod draw;
mod order;
mod state;
#[cfg(test)]
mod tests;

use std::{
    cell::{OnceCell, RefCell},
    pin::pin,
    time::{Duration, Instant},
};

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use futures::future::{Either, select};
use r4_driver::{Clock, Error};
use r4_links::Event;
use r4_protocol::{Refusal, SafetyState};
use r4_sim::Pace;

use crate::{
    args::Args,
    screen::{self, Commands, Screen},
    session::{self, HostClock, Session},
};

use draw::draw;
use order::Order;
use state::{Prompt, State, View};

/// A board has one host at a time: while this runs, no other program can command the board, and quitting disarms it. A shared board
/// (`r4 serve`) that another program commands is left as it is.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Monitor {
    /// Samples of each channel per second
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=100))]
    pub(crate) rate: u16,
}

/// Polling period of keys and answers, s.
const LOOK_EVERY_S: f64 = 0.02;
/// Period of the screen, whatever the board's pace.
const DRAW_EVERY: Duration = Duration::from_millis(50);
/// Period of the requests for the board's counters, s.
const MEASURE_EVERY_S: f64 = 0.5;

/// Meaning of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Key {
    Ask(Ask),
    Select(isize),
    /// Type a set point for the selected channel.
    Prompt,
    /// Put the selected channel on the graph, or take it off.
    Mark,
    Show(View),
    /// Return to the channels.
    Back,
    Quit,
}

/// Request to the board.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ask {
    Arm,
    Disarm,
    Clear,
    Stop,
    Set(Order),
    /// Parameters, for the list on the screen; `Trips` likewise.
    Parameters,
    Trips,
}

impl Ask {
    fn name(self) -> &'static str {
        match self {
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Clear => "clear",
            Self::Stop => "stop",
            Self::Set(_) => "set point",
            Self::Parameters => "parameters",
            Self::Trips => "trips",
        }
    }
}

/// Meaning of a key while a set point is typed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Typed {
    Character(char),
    Erase,
    EraseAll,
    Send,
    Leave,
    /// The space key stops the board here too: no number or unit contains a space.
    Stop,
}

fn typed(key: KeyEvent) -> Option<Typed> {
    Some(match key.code {
        KeyCode::Char(' ') => Typed::Stop,
        KeyCode::Char('u') if key.modifiers.contains(KeyModifiers::CONTROL) => Typed::EraseAll,
        KeyCode::Char(typed) if !key.modifiers.contains(KeyModifiers::CONTROL) => Typed::Character(typed),
        KeyCode::Backspace => Typed::Erase,
        KeyCode::Enter => Typed::Send,
        KeyCode::Esc => Typed::Leave,
        _ => return None,
    })
}

fn meaning(key: KeyEvent) -> Option<Key> {
    Some(match key.code {
        KeyCode::Char('s') | KeyCode::Enter => Key::Prompt,
        KeyCode::Char('g') => Key::Mark,
        KeyCode::Char('p') => Key::Show(View::Parameters),
        KeyCode::Char('t') => Key::Show(View::Trips),
        KeyCode::Char('?' | 'h') | KeyCode::F(1) => Key::Show(View::Help),
        KeyCode::Esc => Key::Back,
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

/// Terminal and state of its screen.
struct Seen {
    screen: Screen,
    state: State,
    drawn: Option<Instant>,
}

impl Seen {
    /// Handles keys and draws, with `ask` for requests to the board; true to quit.
    fn look(&mut self, mut ask: impl FnMut(Ask)) -> anyhow::Result<bool> {
        while let Some(key) = self.screen.key(Duration::ZERO)? {
            if self.state.press(key, &mut ask) {
                return Ok(true);
            }
        }
        // Lists that are due without a key.
        for what in self.state.wanted() {
            ask(what);
        }
        if self.drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
            self.drawn = Some(Instant::now());
            self.screen.draw(|frame| draw(frame, &self.state))?;
        }
        Ok(false)
    }
}

impl State {
    /// Handles one key, with `ask` for requests to the board; true to quit.
    fn press(&mut self, key: KeyEvent, mut ask: impl FnMut(Ask)) -> bool {
        if self.prompt.is_some() {
            if let Some(typed) = typed(key) {
                self.type_in(typed, ask);
            }
            return false;
        }
        match meaning(key) {
            Some(Key::Ask(what)) => ask(what),
            Some(Key::Select(down)) => self.select(down),
            Some(Key::Prompt) => self.open_prompt(),
            Some(Key::Mark) => self.mark(),
            Some(Key::Show(view)) => self.show(view),
            Some(Key::Back) => self.show(View::Channels),
            Some(Key::Quit) => return true,
            None => {}
        }
        false
    }

    fn type_in(&mut self, typed: Typed, mut ask: impl FnMut(Ask)) {
        let Some(Prompt { text, error }) = &mut self.prompt else { return };
        match typed {
            Typed::Character(character) => {
                text.push(character);
                *error = None;
            }
            Typed::Erase => {
                text.pop();
                *error = None;
            }
            Typed::EraseAll => text.clear(),
            Typed::Leave => self.prompt = None,
            Typed::Stop => {
                self.prompt = None;
                ask(Ask::Stop);
            }
            Typed::Send => {
                let Some(row) = self.rows.get(self.selected) else { return };
                // Leave the range check to the board: it stops a channel whose newer set point it refuses.
                match Order::read(&row.info, text) {
                    Ok(_) if self.link.lost.is_some() => *error = Some("not sent: there is no link".into()),
                    Ok(_) if self.safety != SafetyState::Armed => {
                        *error = Some(format!("not sent: {} is {}; press Esc, then a to arm", self.board, self.safety));
                    }
                    Ok(order) => {
                        self.prompt = None;
                        ask(Ask::Set(order));
                    }
                    Err(why) => *error = Some(why),
                }
            }
        }
    }
}

pub(crate) fn run(args: &Args, monitor: &Monitor) -> anyhow::Result<bool> {
    screen::check(args, "r4 monitor", "`r4 watch` prints lines, and with --json objects")?;
    let seen: OnceCell<RefCell<Seen>> = OnceCell::new();
    let work = async |session: &Session<'_>| {
        let now_s = session.board.now_s();
        let (info, channels) = (session.board.info(), session.board.channels());
        // After a reconnection the screen and its history continue.
        if let Some(seen) = seen.get() {
            seen.borrow_mut().state.reconnected(info, channels, now_s);
            return watch(session, monitor, seen).await;
        }
        let state = State::new(args.board.described(), info, channels, now_s);
        let new = Seen { screen: Screen::open()?, state, drawn: None };
        watch(session, monitor, seen.get_or_init(|| RefCell::new(new))).await
    };
    let tell = |event: Event| {
        let Some(mut seen) = seen.get().map(RefCell::borrow_mut) else { return };
        match &event {
            Event::Lost { why } => seen.state.lost(why.to_string()),
            Event::Back { .. } => seen.state.back(session::told(&event)),
        }
    };
    let meanwhile = async |clock: &HostClock| loop {
        clock.sleep_until(clock.now_us() + (LOOK_EVERY_S * 1e6) as u64).await;
        let Some(mut seen) = seen.get().map(RefCell::borrow_mut) else { continue };
        // `steer` draws while the link is up; requests are ignored without it.
        if seen.state.link.lost.is_some() && seen.look(|_| {})? {
            return Ok(());
        }
    };
    session::keep(args, Pace::RealTime(1.0), work, tell, meanwhile)?;
    Ok(true)
}

/// Runs the screen until the user quits or the link ends.
async fn watch(session: &Session<'_>, monitor: &Monitor, seen: &RefCell<Seen>) -> anyhow::Result<()> {
    let mut telemetry = session.board.telemetry();
    for channel in session.board.channels() {
        session.board.subscribe(channel.id, 1000 / monitor.rate).await?;
    }
    let listen = async {
        loop {
            match telemetry.next().await {
                Ok(frame) => {
                    let state = &mut seen.borrow_mut().state;
                    state.telemetry(&frame, session.board.now_s());
                    (state.link.bad, state.link.dropped) = (session.board.bad_frames(), telemetry.dropped());
                }
                Err(error) => return error,
            }
        }
    };
    let (listen, measure) = (pin!(listen), pin!(measure(session, seen)));
    match select(pin!(steer(session, seen)), select(listen, measure)).await {
        Either::Left((result, _)) => {
            // Disarm however the screen ended.
            let disarmed = session.board.disarm().await;
            result?;
            match disarmed {
                // Another program commands the shared board: nothing of this one is in force.
                Err(Error::Refused(Refusal::InUse)) => Ok(()),
                disarmed => Ok(disarmed?),
            }
        }
        Either::Right((Either::Left((error, _)) | Either::Right((error, _)), _)) => Err(error.into()),
    }
}

/// Requests the board's counters periodically, which also measures the round trip.
async fn measure(session: &Session<'_>, seen: &RefCell<Seen>) -> Error {
    loop {
        let begin_s = session.board.now_s();
        match session.board.stats().await {
            Ok(stats) => seen.borrow_mut().state.measured(session.board.now_s() - begin_s, stats),
            Err(error @ (Error::LinkLost { .. } | Error::LinkFailed { .. })) => return error,
            // A late answer is shown as a number; only the end of the link ends the screen.
            Err(_) => seen.borrow_mut().state.link.unanswered += 1,
        }
        session.board.sleep_s(MEASURE_EVERY_S).await;
    }
}

/// Draws and handles keys until the user quits.
async fn steer(session: &Session<'_>, seen: &RefCell<Seen>) -> anyhow::Result<()> {
    let board = session.board;
    let mut commands = Commands::default();
    loop {
        let begin = |ask: Ask| {
            commands.begin(ask, async move {
                match ask {
                    Ask::Arm => board.arm().await,
                    Ask::Disarm => board.disarm().await,
                    Ask::Clear => board.clear().await,
                    Ask::Stop => board.stop().await,
                    Ask::Set(order) => board.set(order.channel, order.setpoint).await,
                    Ask::Parameters => {
                        let parameters = board.parameters().await?;
                        seen.borrow_mut().state.parameters = Some(parameters);
                        Ok(())
                    }
                    Ask::Trips => {
                        let trips = board.faults().await?;
                        seen.borrow_mut().state.trips = Some(trips);
                        Ok(())
                    }
                }
            });
        };
        seen.borrow_mut().state.now_s = board.now_s();
        if seen.borrow_mut().look(begin)? {
            return Ok(());
        }
        if let Some((ask, result)) = commands.until(board.sleep_s(LOOK_EVERY_S)).await {
            let state = &mut seen.borrow_mut().state;
            match (ask, result) {
                (Ask::Parameters | Ask::Trips, Ok(())) => {}
                (Ask::Set(order), Ok(())) => state.say(format!("{order} on {}", state.board)),
                (Ask::Set(order), Err(Error::Refused(refusal))) => state.refused(order, refusal),
                (ask, result) => state.done(ask.name(), result),
            }
        }
    }
}
