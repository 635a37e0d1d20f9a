//! The time of day in UTC, as records and logs write it.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;

/// Seconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

/// When a file was last changed, in seconds since 1970.
pub fn changed(path: &Path) -> Option<u64> {
    let time = std::fs::metadata(path).and_then(|m| m.modified()).ok()?;
    time.duration_since(UNIX_EPOCH).ok().map(|d| d.as_secs())
}

/// `2026-11-21T03:35:10Z`, which sorts as time does.
pub fn utc(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Civil date from days since 1970 (H. Hinnant, "chrono-compatible low-level date algorithms").
    let z = days as i64 + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z",
        rest / 3600,
        rest / 60 % 60,
        rest % 60
    )
}

/// Seconds since 1970 of a text as [`utc`] writes it, or of its date alone.
pub fn parse(text: &str) -> Option<u64> {
    let number = |range: std::ops::Range<usize>| text.get(range)?.parse::<i64>().ok();
    let (year, month, day) = (number(0..4)?, number(5..7)?, number(8..10)?);
    if !(1970..10_000).contains(&year) || !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let y = year - i64::from(month <= 2);
    let (era, yoe) = (y.div_euclid(400), y.rem_euclid(400));
    let doy = (153 * (if month > 2 { month - 3 } else { month + 9 }) + 2) / 5 + day - 1;
    let days = era * 146_097 + yoe * 365 + yoe / 4 - yoe / 100 + doy - 719_468;
    let time = match text.len() {
        10 => 0,
        20 => number(11..13)? * 3600 + number(14..16)? * 60 + number(17..19)?,
        _ => return None,
    };
    // 30 February is another day when it is written again.
    u64::try_from(days * 86_400 + time)
        .ok()
        .filter(|&t| utc(t).starts_with(text.trim_end_matches('Z')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_go_there_and_back() {
        assert_eq!(utc(951_827_696), "2000-02-29T12:34:56Z");
        for seconds in (0..4_000_000_000).step_by(8_640_007) {
            assert_eq!(parse(&utc(seconds)), Some(seconds));
        }
        assert_eq!(parse("2000-02-29"), Some(951_782_400));
        assert_eq!(parse("29.2.2000"), None);
    }
}
