//! The interface of a benchmark: options, expected duration, and a run that returns a dataset.

use std::ffi::OsString;

use anyhow::Result;

use crate::dataset::Dataset;
use crate::progress::Progress;

pub trait Benchmark: clap::Args + Send + 'static {
    /// Whether it measures a daemon with a configuration of the user.
    const HAS_CONFIG: bool = false;

    /// Changes the defaults to the options for the report of `all`.
    fn for_report(&mut self) {}

    /// Changes the options to a short run, whose numbers prove little.
    fn quicken(&mut self);

    /// The options for the report of `all`, changed by these arguments.
    fn of_report(quick: bool, given: &[OsString]) -> Self {
        let mut options: Self = defaults();
        if quick {
            options.quicken();
        } else {
            options.for_report();
        }
        let command = Self::augment_args_for_update(clap::Command::new("report"));
        // What is not given stays as it is.
        let command = command.mut_args(|argument| argument.default_value(None::<&str>));
        let matches = command.no_binary_name(true).get_matches_from(given);
        let updated = options.update_from_arg_matches(&matches);
        updated.map_or_else(|error| error.exit(), |()| options)
    }

    fn check(&self) -> Result<()> {
        Ok(())
    }

    fn expected_s(&self) -> f64;

    fn run(&self, progress: &mut Progress) -> Result<Dataset>;
}

pub fn defaults<A: clap::Args>() -> A {
    let command = A::augment_args(clap::Command::new("defaults"));
    let matches = command.get_matches_from(["defaults"]);
    A::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}
