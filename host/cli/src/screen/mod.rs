//! Full-screen terminal for interactive commands.
//!
//! The terminal is restored when the [`Screen`] is dropped, and in a panic before its report.

mod commands;
#[cfg(test)]
pub(crate) mod snapshot;
pub(crate) mod state;

use std::{
    io::{self, IsTerminal, Stdout, stdin, stdout},
    panic,
    sync::{
        Once,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::{Context, bail};
use crossterm::{
    cursor::{Hide, Show},
    event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers},
    execute,
    terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode},
};
use ratatui::{Frame, Terminal, backend::CrosstermBackend};

use crate::{args::Args, session};

pub(crate) use commands::Commands;

/// Terminal in full-screen mode while this value lives.
pub(crate) struct Screen {
    terminal: Terminal<CrosstermBackend<Stdout>>,
    _restore: Restore,
}

/// Restores the terminal when dropped.
struct Restore;

impl Drop for Restore {
    fn drop(&mut self) {
        restore();
    }
}

/// True while the terminal is to be restored, once: a second restore would move the cursor over later output.
static TAKEN: AtomicBool = AtomicBool::new(false);

fn restore() {
    if !TAKEN.swap(false, Ordering::Relaxed) {
        return;
    }
    // Do as much as possible: the terminal may be gone.
    let _ = execute!(stdout(), LeaveAlternateScreen, Show);
    let _ = disable_raw_mode();
}

/// Checks that a full-screen terminal is available and that no log would overwrite it, before the board is touched.
pub(crate) fn check(args: &Args, verb: &str, instead: &str) -> anyhow::Result<()> {
    if args.json {
        bail!("`{verb}` draws on a terminal and prints no JSON: {instead}");
    }
    if !stdin().is_terminal() || !stdout().is_terminal() {
        bail!("`{verb}` needs a terminal for its screen and its keys: {instead}");
    }
    if args.log.is_some() && io::stderr().is_terminal() {
        bail!("the firmware's log would be printed over the screen: send it to a file, as in 2>log.txt");
    }
    Ok(())
}

impl Screen {
    pub(crate) fn open() -> anyhow::Result<Self> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let before = panic::take_hook();
            panic::set_hook(Box::new(move |panic| {
                restore();
                before(panic);
            }));
        });
        TAKEN.store(true, Ordering::Relaxed);
        // Created first, so that an error below restores the terminal too.
        let restore = Restore;
        enable_raw_mode().context("cannot read single keys from this terminal")?;
        execute!(stdout(), EnterAlternateScreen, Hide).context("cannot draw on this terminal")?;
        let terminal = Terminal::new(CrosstermBackend::new(stdout())).context("cannot draw on this terminal")?;
        Ok(Self { terminal, _restore: restore })
    }

    /// Draws the changes since the last frame.
    pub(crate) fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> anyhow::Result<()> {
        self.terminal.draw(draw).context("cannot draw on this terminal")?;
        Ok(())
    }

    /// Next key that is pressed or repeated within `patience`.
    ///
    /// Ctrl-C interrupts the session: in raw mode the terminal reports it as a key.
    pub(crate) fn key(&self, patience: Duration) -> anyhow::Result<Option<KeyEvent>> {
        while event::poll(patience).context("cannot read keys")? {
            match event::read().context("cannot read keys")? {
                Event::Key(key) if key.kind == KeyEventKind::Release => {}
                Event::Key(KeyEvent { code: KeyCode::Char('c'), modifiers: KeyModifiers::CONTROL, .. }) => {
                    session::interrupt();
                }
                Event::Key(key) => return Ok(Some(key)),
                // A new size takes effect with the next drawing.
                _ => {}
            }
        }
        Ok(None)
    }
}
