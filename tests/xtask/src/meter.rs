//! What a command takes: time by the clock on the wall, and time of the processor.

use std::{
    fmt, fs,
    time::{Duration, Instant},
};

/// Ticks of the processor's time in a second, as Linux tells programs on all processors that Rust's tools run on (`USER_HZ`).
const TICKS_PER_S: u64 = 100;

/// What something took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    pub(crate) wall: Duration,
    /// Of all processes that were started and waited for, user's and system's. Unlike the wall's it hardly depends on what else
    /// the machine does. None where the system does not tell it as Linux does.
    pub(crate) processor: Option<Duration>,
}

/// Measures from its start on.
pub(crate) struct Meter {
    begin: Instant,
    processor: Option<Duration>,
}

impl Meter {
    pub(crate) fn start() -> Self {
        Self { begin: Instant::now(), processor: of_children() }
    }

    /// What was taken since the start.
    pub(crate) fn cost(&self) -> Cost {
        let processor = of_children().zip(self.processor).map(|(now, then)| now.saturating_sub(then));
        Cost { wall: self.begin.elapsed(), processor }
    }
}

impl std::ops::AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        self.wall += other.wall;
        self.processor = self.processor.zip(other.processor).map(|(a, b)| a + b);
    }
}

impl fmt::Display for Cost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} s", self.wall.as_secs_f64())?;
        match self.processor {
            Some(processor) => write!(f, ", {:.1} s of processor time", processor.as_secs_f64()),
            None => Ok(()),
        }
    }
}

/// Processor time of all children that have ended and were waited for, with their children.
fn of_children() -> Option<Duration> {
    parse(&fs::read_to_string("/proc/self/stat").ok()?)
}

/// `cutime` and `cstime`, fields 16 and 17 of proc_pid_stat(5). The second field is a name in parentheses, with any characters.
fn parse(stat: &str) -> Option<Duration> {
    let (_, rest) = stat.rsplit_once(')')?;
    let mut fields = rest.split_whitespace().skip(13);
    let mut next = || fields.next()?.parse::<u64>().ok();
    let (user, system) = (next()?, next()?);
    Some(Duration::from_millis((user + system) * 1000 / TICKS_PER_S))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_program_is_no_field() {
        let stat = "7 (a) b 1) S 1 7 7 0 -1 4194560 900 5000 0 0 1 2 250 30 20 0 1 0 100 0 0";
        assert_eq!(parse(stat), Some(Duration::from_millis(2800)));
        assert_eq!(parse("7 (x) S 1"), None);
        assert_eq!(parse(""), None);
    }

    #[test]
    fn a_cost_says_what_is_known() {
        let mut cost = Cost { wall: Duration::from_millis(1500), processor: Some(Duration::from_secs(2)) };
        assert_eq!(cost.to_string(), "1.5 s, 2.0 s of processor time");
        cost += Cost { wall: Duration::from_secs(1), processor: None };
        assert_eq!(cost.to_string(), "2.5 s");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_child_counts() {
        let meter = Meter::start();
        // Until it has had 50 ms of a processor, which its shell's `times` would tell too.
        let shell = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
        assert!(std::process::Command::new("sh").args(["-c", shell]).status().expect("a shell").success());
        assert!(meter.cost().processor >= Some(Duration::from_millis(30)), "{}", meter.cost());
    }
}
