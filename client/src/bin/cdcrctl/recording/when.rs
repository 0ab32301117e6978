use std::time::{Duration, SystemTime, UNIX_EPOCH};

use cdcr_client::monotonic_ns;

/// Present offset from `CLOCK_MONOTONIC` to the time since 1970 \[ns\]: one value for all stamps of a
/// recording.
pub(super) fn unix_offset_ns() -> u64 {
    let unix_ns = |time: SystemTime| {
        time.duration_since(UNIX_EPOCH)
            .unwrap_or_default()
            .as_nanos() as u64
    };
    unix_ns(SystemTime::now()).saturating_sub(monotonic_ns())
}

/// Date and time in UTC for a file name: `20260131-235959`.
pub(super) fn date_time(unix_ns: u64) -> String {
    let time = UNIX_EPOCH + Duration::from_nanos(unix_ns);
    let text = humantime::format_rfc3339_seconds(time).to_string();
    text.replace(['-', ':', 'Z'], "").replace('T', "-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_their_dates() {
        assert_eq!(date_time(86_399_999_999_999), "19700101-235959");
        assert_eq!(date_time(951_782_400_000_000_000), "20000229-000000");
    }
}
