//! Dates of a policy as Unix time.

use toml::value::{Datetime, Offset};

/// Days from 1970-01-01 to a date of the Gregorian calendar. Source: E. G. Richards in Urban and Seidelmann,
/// *Explanatory Supplement to the Astronomical Almanac*, 3rd edition, 2013, 15.11: the Julian day number, less that of 1970.
fn days(year: i64, month: i64, day: i64) -> i64 {
    let shifted = (month - 14) / 12;
    let julian = (1461 * (year + 4800 + shifted)) / 4 + (367 * (month - 2 - 12 * shifted)) / 12
        - (3 * ((year + 4900 + shifted) / 100)) / 4
        + day
        - 32_075;
    julian - 2_440_588
}

/// Unix time of a date, ms. A date without a time is its midnight; without an offset, UTC. `None` for a time without a
/// date, and before 1970.
pub(super) fn unix_ms(at: &Datetime) -> Option<u64> {
    let date = at.date?;
    let days = days(date.year.into(), date.month.into(), date.day.into());
    let seconds = at.time.map_or(0, |time| {
        i64::from(time.hour) * 3600 + i64::from(time.minute) * 60 + i64::from(time.second.unwrap_or(0))
    });
    let offset_minutes = match at.offset {
        Some(Offset::Custom { minutes }) => i64::from(minutes),
        Some(Offset::Z) | None => 0,
    };
    u64::try_from((days * 86_400 + seconds - offset_minutes * 60) * 1000).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected seconds are those of `date -u -d TEXT +%s`.
    #[test]
    fn dates_are_unix_times() {
        for (text, seconds) in [
            ("1970-01-01", 0),
            ("2000-02-29T12:00:00Z", 951_825_600),
            ("2026-11-28T01:00:00+01:00", 1_795_824_000),
            ("2100-03-01T00:00:00", 4_107_542_400),
        ] {
            let date: Datetime = text.parse().expect(text);
            assert_eq!(unix_ms(&date), Some(seconds * 1000), "{text}");
        }
        for none in ["12:00:00", "1969-12-31"] {
            assert_eq!(unix_ms(&none.parse().expect(none)), None, "{none}");
        }
    }
}
