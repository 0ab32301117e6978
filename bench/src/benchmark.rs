//! What every benchmark is: options, about how long it takes, and a run from the options to a dataset.

use std::path::PathBuf;

use anyhow::Result;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::Launch;

/// The options of a benchmark, which are those of its command line.
pub trait Benchmark: clap::Args + Send + 'static {
    /// What `all` asks for; `quick`: a look that proves little.
    fn of_report(quick: bool) -> Self;

    fn rounds_mut(&mut self) -> &mut u32;

    /// The configuration of the daemon, where it can be chosen.
    fn config_mut(&mut self) -> Option<&mut Option<PathBuf>> {
        None
    }

    /// What a command line asks for, or why that makes no sense.
    fn resolved(self) -> Result<Self> {
        Ok(self)
    }

    /// About how long a run takes \[s\].
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
