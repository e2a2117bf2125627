//! Export of a run as a table.

use std::io::{self, Write};

use crate::{Log, Signal};

impl Log {
    /// Writes one table: the column `time_s` and one column per [`Signal`], headed by its name; a row per time at
    /// which something was recorded. A cell without a sample is empty: nothing is repeated or interpolated. Numbers
    /// have a decimal point and all their digits, switches are 0 or 1.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write_csv(&self, mut out: impl Write) -> io::Result<()> {
        let signals = self.signals();
        out.write_all(b"time_s")?;
        for signal in &signals {
            write!(out, ",{}", cell(&signal.name))?;
        }
        out.write_all(b"\n")?;
        // Number of samples of each signal that have been written.
        let mut written = vec![0; signals.len()];
        let next = |written: &[usize]| {
            let waiting = signals.iter().zip(written).filter_map(|(signal, &at)| signal.samples.get(at));
            waiting.map(|(time_s, _)| *time_s).min_by(f64::total_cmp)
        };
        // A merge of all signals by time, without a table of all rows in memory.
        while let Some(time_s) = next(&written) {
            // Six decimals are exact: the board's clock counts microseconds.
            write!(out, "{time_s:.6}")?;
            for (signal, at) in signals.iter().zip(&mut written) {
                out.write_all(b",")?;
                if let Some((_, value)) = Signal::at(signal, *at, time_s) {
                    out.write_all(cell(&value.to_string()).as_bytes())?;
                    *at += 1;
                }
            }
            out.write_all(b"\n")?;
        }
        out.flush()
    }
}

impl Signal {
    /// Returns sample number `at` if it is from `time_s`. Two samples of one time get two rows.
    fn at(&self, at: usize, time_s: f64) -> Option<&(f64, crate::Value)> {
        self.samples.get(at).filter(|sample| sample.0 == time_s)
    }
}

/// Returns a cell as in RFC 4180: quoted only where necessary.
fn cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
