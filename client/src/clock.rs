use rustix::time::{ClockId, clock_gettime};

/// Present time on the clock of all message stamps \[ns, `CLOCK_MONOTONIC`\].
///
/// All processes of one machine share this clock. Its values mean nothing on another machine or after a
/// restart.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // Both parts of a monotonic time are non-negative.
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_forward() {
        let first = monotonic_ns();
        std::thread::sleep(std::time::Duration::from_millis(2));
        assert!(monotonic_ns() >= first + 2_000_000);
    }
}
