//! What every benchmark is: options, about how long it takes, and a run from the options to a dataset.

use std::path::PathBuf;

use anyhow::Result;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::Launch;

/// The options of a benchmark, which are those of its command line.
pub trait Benchmark: clap::Args + Send + 'static {
    /// Becomes what `all` asks for, from the options of an empty command line.
    fn for_report(&mut self) {}

    /// Becomes a look that proves little.
    fn quicken(&mut self);

    /// Whether the command line asks for that.
    fn is_quick(&self) -> bool {
        false
    }

    /// What `all` asks for.
    fn of_report(quick: bool) -> Self {
        let mut options: Self = defaults();
        if quick {
            options.quicken();
        } else {
            options.for_report();
        }
        options
    }

    /// Refuses what makes no sense.
    fn check(&self) -> Result<()> {
        Ok(())
    }

    /// What a command line asks for.
    fn resolved(mut self) -> Result<Self> {
        self.check()?;
        if self.is_quick() {
            self.quicken();
        }
        Ok(self)
    }

    fn rounds_mut(&mut self) -> &mut u32;

    fn config_mut(&mut self) -> Option<&mut Option<PathBuf>> {
        None
    }

    fn expected_s(&self) -> f64;

    fn run(&self, progress: &mut Progress) -> Result<Dataset>;
}

/// The options of a command line without any.
pub fn defaults<A: clap::Args>() -> A {
    let command = A::augment_args(clap::Command::new("defaults"));
    let matches = command.get_matches_from(["defaults"]);
    A::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// The same daemon with another period \[ms\]. Inputs are gathered and late starts counted as by default, where the period
/// is not too short for that: the gather must fit between two cycles.
pub(crate) fn with_period(launch: Launch, period_ms: f64) -> Launch {
    launch
        .with("cycle.period_ms", period_ms)
        .with("cycle.gather_lead_ms", (0.35 * period_ms).min(0.2))
        .with("cycle.late_start_ms", period_ms.min(1.0))
}
