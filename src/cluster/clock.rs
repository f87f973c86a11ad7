//! The time of day, and unique names of submissions.

use std::hash::{BuildHasher, RandomState};
use std::time::{SystemTime, UNIX_EPOCH};

/// A random number that differs between processes and between calls.
pub fn random() -> u64 {
    RandomState::new().hash_one(std::process::id())
}

/// Seconds since 1970.
pub fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// A unique name for a new submission: the time in UTC, and six random hexadecimal digits.
pub fn new_name() -> String {
    let seconds = now() as u64;
    let (year, month, day) = civil(seconds / 86_400);
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let digits = random() & 0xff_ffff;
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}-{digits:06x}")
}

/// Year, month and day of a day since 1970-01-01.
///
/// **Source**: `civil_from_days` in Howard Hinnant, chrono-Compatible Low-Level Date Algorithms (2013).
fn civil(days: u64) -> (u64, u64, u64) {
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    (year_of_era + 400 * era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        // Computed by GNU date.
        for (days, date) in [(0, (1970, 1, 1)), (11_016, (2000, 2, 29)), (20_819, (2027, 1, 1))] {
            assert_eq!(civil(days), date);
        }
    }
}
