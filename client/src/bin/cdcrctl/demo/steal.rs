use std::fmt;
use std::fs;
use std::time::Instant;

use cdcr_shared_types::proc_stat::{TICK_NS, core_ticks};
use serde::Serialize;

/// Time that the hypervisor took from the core of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Steal {
    /// Stolen time \[s\], in steps of 0.01 s; without pinning, the mean of all cores.
    pub(super) steal_s: f64,
    /// Duration of the measurement \[s\].
    pub(super) window_s: f64,
}

impl fmt::Display for Steal {
    // Two decimals: a single tick of the counter may explain a miss.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:.2} of {:.1} s", self.steal_s, self.window_s)
    }
}

/// A reading of the steal counter.
#[derive(Debug)]
pub(super) struct StealReading {
    core: Option<u32>,
    time: Instant,
    steal_s: f64,
}

impl StealReading {
    /// Reads the counter of `core`, or of all cores. `None` when the kernel has none.
    pub(super) fn now(core: Option<u32>) -> Option<Self> {
        let text = fs::read_to_string("/proc/stat").ok()?;
        Some(Self {
            core,
            time: Instant::now(),
            steal_s: steal_s(&text, core)?,
        })
    }

    /// Steal since this reading.
    pub(super) fn since(&self) -> Option<Steal> {
        let now = Self::now(self.core)?;
        Some(Steal {
            steal_s: (now.steal_s - self.steal_s).max(0.0),
            window_s: (now.time - self.time).as_secs_f64(),
        })
    }
}

/// The time stolen from a core, or its mean over all cores \[s\].
fn steal_s(text: &str, core: Option<u32>) -> Option<f64> {
    let is_counted = |of: usize| core.is_none_or(|core| of == core as usize);
    let counted: Vec<f64> = core_ticks(text)
        .filter(|(of, _)| of.is_some_and(is_counted))
        .map(|(_, ticks)| (ticks.steal * TICK_NS) as f64 * 1e-9)
        .collect();
    (!counted.is_empty()).then(|| counted.iter().sum::<f64>() / counted.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steal_is_that_of_the_core_or_the_mean_of_all() {
        let text = "cpu  9 9 9 9 9 9 9 997 0 0\ncpu0 1 2 3 4 5 6 7 490 9 10\n\
                    cpu1 1 2 3 4 5 6 7 510 9 10\nintr 5\n";
        let close = |core, expected_s: f64| {
            steal_s(text, core).is_some_and(|is_s| (is_s - expected_s).abs() < 1e-9)
        };
        assert!(close(Some(1), 5.1) && close(Some(0), 4.9) && close(None, 5.0));
        assert_eq!(steal_s(text, Some(7)), None);
    }

    #[test]
    fn two_readings_of_this_machine_have_a_time_between_them() {
        let first = StealReading::now(None).expect("/proc is there");
        let steal = first.since().expect("/proc is there");
        assert!(steal.window_s > 0.0 && steal.steal_s >= 0.0, "{steal:?}");
    }
}
