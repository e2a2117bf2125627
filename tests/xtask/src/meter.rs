//! Cost of a command: wall-clock time and processor time.

use std::{
    fmt, fs,
    time::{Duration, Instant},
};

/// Ticks of processor time per second (`USER_HZ`), as Linux reports it on all processors that Rust's tools run on.
const TICKS_PER_S: u64 = 100;

/// Cost of a command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    pub(crate) wall: Duration,
    /// Processor time of all processes that were started and waited for, user's and system's. Unlike wall-clock time it
    /// hardly depends on the other load of the machine. `None` where the system does not report it as Linux does.
    pub(crate) processor: Option<Duration>,
}

/// Meter that measures from its creation on.
pub(crate) struct Meter {
    begin: Instant,
    processor: Option<Duration>,
}

impl Meter {
    pub(crate) fn start() -> Self {
        Self { begin: Instant::now(), processor: of_children() }
    }

    /// Returns the cost since the start.
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

/// Returns the processor time of all children that have ended and were waited for, including their children.
fn of_children() -> Option<Duration> {
    parse(&fs::read_to_string("/proc/self/stat").ok()?)
}

/// Reads `cutime` and `cstime`, fields 16 and 17 of proc_pid_stat(5). The second field is a name in parentheses, with
/// any characters.
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
        // The loop uses some 50 ms of processor time, five ticks.
        let shell = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
        assert!(std::process::Command::new("sh").args(["-c", shell]).status().expect("a shell").success());
        assert!(meter.cost().processor >= Some(Duration::from_millis(30)), "{}", meter.cost());
    }
}
