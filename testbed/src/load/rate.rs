//! Work at a fixed rate.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;

/// Longest delay that is caught up.
const MADE_UP: Duration = Duration::from_millis(100);

/// Calls `work` every `period` until the end. Delays up to 100 ms are caught up, so that the rate is kept;
/// longer ones (a stall, a lack of processor time) are skipped.
pub fn every(
    period: Duration,
    is_ending: impl Fn() -> bool,
    mut work: impl FnMut() -> Result<()>,
) -> Result<()> {
    let mut next = Instant::now();
    while !is_ending() {
        work()?;
        next += period;
        let now = Instant::now();
        if next > now {
            thread::sleep(next - now);
        } else if now - next > MADE_UP {
            next = now;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use anyhow::bail;

    use super::*;

    #[test]
    fn late_work_is_made_up_for() {
        let (begin, turns) = (Instant::now(), std::cell::Cell::new(0_u32));
        let period = Duration::from_millis(1);
        let result = every(
            period,
            || turns.get() == 21,
            || {
                turns.set(turns.get() + 1);
                if turns.get() == 1 {
                    thread::sleep(Duration::from_millis(20));
                }
                Ok(())
            },
        );
        assert!(result.is_ok());
        // Never ahead of the rate: turn 21 is due after 20 periods.
        assert!(begin.elapsed() >= 20 * period);
    }

    #[test]
    fn a_failure_ends_it() {
        assert!(every(Duration::ZERO, || false, || bail!("no")).is_err());
    }
}
