//! The interface of a benchmark: options, expected duration, and a run that returns a dataset.

use std::path::PathBuf;

use anyhow::Result;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::Launch;

pub trait Benchmark: clap::Args + Send + 'static {
    /// Changes the defaults to the options for the report of `all`.
    fn for_report(&mut self) {}

    /// Changes the options to a short run, whose numbers prove little.
    fn quicken(&mut self);

    fn is_quick(&self) -> bool {
        false
    }

    /// The options for the report of `all`.
    fn of_report(quick: bool) -> Self {
        let mut options: Self = defaults();
        if quick {
            options.quicken();
        } else {
            options.for_report();
        }
        options
    }

    fn check(&self) -> Result<()> {
        Ok(())
    }

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

pub fn defaults<A: clap::Args>() -> A {
    let command = A::augment_args(clap::Command::new("defaults"));
    let matches = command.get_matches_from(["defaults"]);
    A::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// The same daemon with another period \[ms\]. Gather lead and late-start limit keep their defaults unless
/// the period is too short: the gather must fit between two cycles.
pub(crate) fn with_period(launch: Launch, period_ms: f64) -> Launch {
    launch
        .with("cycle.period_ms", period_ms)
        .with("cycle.gather_lead_ms", (0.35 * period_ms).min(0.2))
        .with("cycle.late_start_ms", period_ms.min(1.0))
}
