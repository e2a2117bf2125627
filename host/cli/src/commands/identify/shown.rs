//! Progress of an identification, on stderr.

use std::{
    io::{IsTerminal, stderr},
    sync::Mutex,
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};
use r4_identify::Progress;

/// Shortest time between two lines where there is no bar: our choice, not compared.
const BETWEEN: Duration = Duration::from_secs(5);

/// Progress bar; where stderr is no terminal, a line every few seconds.
pub(crate) struct Shown {
    bar: ProgressBar,
    lines: Option<Mutex<Lines>>,
}

struct Lines {
    begun: Instant,
    /// Time of the last line; initially the start.
    last: Instant,
}

impl Shown {
    pub(super) fn on_stderr() -> Self {
        let style = ProgressStyle::with_template("{bar:30} {percent:>3} %, {elapsed}, {msg}");
        let bar = ProgressBar::new(1_000).with_style(style.unwrap_or(ProgressStyle::default_bar()));
        let now = Instant::now();
        Self { bar, lines: (!stderr().is_terminal()).then(|| Mutex::new(Lines { begun: now, last: now })) }
    }

    /// Shows nothing, for callers that show the progress of several identifications themselves.
    pub(crate) fn nowhere() -> Self {
        Self { bar: ProgressBar::hidden(), lines: None }
    }

    pub(super) fn show(&self, Progress { step, share }: Progress) {
        self.share(share);
        self.step(&step);
    }

    pub(super) fn share(&self, share: f64) {
        self.bar.set_position((share.clamp(0.0, 1.0) * 1_000.0) as u64);
    }

    pub(super) fn step(&self, step: &str) {
        self.bar.set_message(step.to_owned());
        let Some(Ok(mut lines)) = self.lines.as_ref().map(Mutex::lock) else { return };
        if lines.last.elapsed() >= BETWEEN {
            lines.last = Instant::now();
            let percent = self.bar.position() / 10;
            eprintln!("r4: {percent} %, {:.0} s: {step}", lines.begun.elapsed().as_secs_f64());
        }
    }

    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }
}
