//! Work at a rate.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;

use super::task::Signals;

/// So much that is late is made up for.
const MADE_UP: Duration = Duration::from_millis(100);

/// Does `work` every `period` until the end. What is late is made up for, so that the rate is kept; but not
/// what a stall, or too little of the processor, took beyond 100 ms.
pub(super) fn every(
    period: Duration,
    signals: &Signals,
    mut work: impl FnMut() -> Result<()>,
) -> Result<()> {
    let mut next = Instant::now();
    while !signals.is_ending() {
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
        let signals = Signals::default();
        let (begin, mut turns) = (Instant::now(), 0_u32);
        let period = Duration::from_millis(1);
        let result = every(period, &signals, || {
            turns += 1;
            if turns == 1 {
                thread::sleep(Duration::from_millis(20));
            }
            if turns == 21 {
                signals.end();
            }
            Ok(())
        });
        assert!(result.is_ok() && turns == 21);
        // Never ahead of its rate: the 21st turn is due after 20 periods.
        assert!(begin.elapsed() >= 20 * period);
    }

    #[test]
    fn a_failure_ends_it() {
        let result = every(Duration::ZERO, &Signals::default(), || bail!("no"));
        assert!(result.is_err());
    }
}
