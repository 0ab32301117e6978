//! Times on command lines.

use std::ops::RangeInclusive;
use std::time::Duration;

/// Parses a time in a range \[s\], ends included.
pub fn duration_in(
    range_s: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<Duration, String> + Clone {
    move |text| {
        let (duration, least, most) = (parse_duration(text)?, range_s.start(), range_s.end());
        let is_within = range_s.contains(&duration.as_secs_f64());
        let refused = || format!("must be {least} s to {most} s");
        is_within.then_some(duration).ok_or_else(refused)
    }
}

/// Parses `5s`, `4.97s`, `250ms`, `1m 10s`.
///
/// # Errors
///
/// What is wrong: no time, a missing unit, a time below zero or beyond all use.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let seconds = text.trim().strip_suffix('s').map(str::trim_end);
    if let Some(Ok(seconds)) = seconds.map(str::parse::<f64>) {
        // humantime does not accept decimals.
        return Duration::try_from_secs_f64(seconds).map_err(|_| {
            if seconds < 0.0 {
                "is below zero".to_owned()
            } else {
                format!("{seconds:e} s is not a possible time")
            }
        });
    }
    if text.trim().parse::<f64>().is_ok() {
        return Err("a unit is missing: use for example 5s or 250ms".to_owned());
    }
    humantime::parse_duration(text).map_err(|cause| format!("{cause} (for example 5s or 250ms)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_with_decimals_and_units() {
        assert_eq!(parse_duration("4.97s"), Ok(Duration::from_millis(4970)));
        assert_eq!(parse_duration("5 s"), Ok(Duration::from_secs(5)));
        assert_eq!(parse_duration("250ms"), Ok(Duration::from_millis(250)));
        assert_eq!(parse_duration("1m 10s"), Ok(Duration::from_secs(70)));
        let refused = parse_duration("5").expect_err("5 of what");
        assert_eq!(refused, "a unit is missing: use for example 5s or 250ms");
        for text in ["", "nans", "infs", "soon"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
        let refused = parse_duration("1e30s").expect_err("too long");
        assert_eq!(refused, "1e30 s is not a possible time");
        assert_eq!(parse_duration("-2s"), Err("is below zero".to_owned()));
    }

    #[test]
    fn a_time_beyond_its_range_is_refused_with_the_range() {
        let parse = duration_in(0.1..=60.0);
        assert_eq!(parse("100ms"), Ok(Duration::from_millis(100)));
        assert_eq!(parse("61s"), Err("must be 0.1 s to 60 s".to_owned()));
    }
}
