//! All benchmarks, and how one after the other is run.

use std::path::PathBuf;
use std::thread;
use std::time::{Instant, SystemTime};

use anyhow::Result;
use clap::ValueEnum;

use super::{BenchReport, Extent, Part, Start};
use crate::benchmark::Benchmark;
use crate::budget::BudgetOptions;
use crate::dataset::Dataset;
use crate::deadline::DeadlineOptions;
use crate::footprint::FootprintOptions;
use crate::interrupt;
use crate::latency::LatencyOptions;
use crate::progress::Progress;
use crate::quality::QualityOptions;
use crate::rate::RateOptions;
use crate::robustness::RobustnessOptions;
use crate::simulation::Effort;
use crate::solver::SolverOptions;

/// A benchmark, in the order in which they are run: those of real time come first, while the machine is quiet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Name {
    /// Deadline misses and latencies beside a bare loop.
    Deadline,
    /// How long messages take.
    Latency,
    /// The shortest period that holds.
    Rate,
    /// Cores, memory, files, start-up.
    Footprint,
    /// What the time of a solve, the swarm and the horizon buy.
    Quality,
    /// Robots that are not their model.
    Robustness,
    /// The paper's simulations.
    Paper,
    /// Times of a solve.
    Solver,
    /// How late a solve ends after its budget.
    Budget,
}

/// What is asked for.
#[derive(Debug, Clone, clap::Args)]
pub struct Request {
    #[command(flatten)]
    pub extent: Extent,
    /// Only these, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAME")]
    pub only: Vec<Name>,
    /// Configuration of the daemon in deadline and latency; without it the default, three sections. The other
    /// benchmarks choose their own, and with it no figure to reach is judged.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl Request {
    /// Of those that were asked for; of all when none was named.
    fn plans(&self) -> Vec<Plan> {
        let all = Name::value_variants().iter();
        let asked = all.filter(|name| self.only.is_empty() || self.only.contains(name));
        asked.map(|name| name.plan(self)).collect()
    }

    /// About how long it takes \[s\].
    pub fn expected_s(&self) -> f64 {
        self.plans().iter().map(|plan| plan.expected_s).sum()
    }

    /// Runs the benchmarks. One that fails is part of the report and does not keep the others from running.
    pub fn run(&self, start: Start, progress: &mut Progress) -> Result<BenchReport> {
        let plans = self.plans();
        let mut left_s: f64 = plans.iter().map(|plan| plan.expected_s).sum();
        let mut parts = Vec::new();
        for plan in plans {
            interrupt::check()?;
            progress.begin_part(plan.name, left_s);
            left_s -= plan.expected_s;
            parts.push(plan.carry_out(progress));
        }
        interrupt::check()?;
        Ok(BenchReport {
            start,
            extent: self.extent,
            default_config: self.config.is_none(),
            parts,
        })
    }
}

impl Name {
    fn plan(self, request: &Request) -> Plan {
        match self {
            Self::Deadline => Plan::of::<DeadlineOptions>("deadline", request),
            Self::Latency => Plan::of::<LatencyOptions>("latency", request),
            Self::Rate => Plan::of::<RateOptions>("rate", request),
            Self::Footprint => Plan::of::<FootprintOptions>("footprint", request),
            Self::Quality => Plan::of::<QualityOptions>("quality", request),
            Self::Robustness => Plan::of::<RobustnessOptions>("robustness", request),
            Self::Paper => Plan::of::<Effort>("paper", request),
            Self::Solver => Plan::of::<SolverOptions>("solver", request),
            Self::Budget => Plan::of::<BudgetOptions>("budget", request),
        }
    }
}

type Run = dyn FnOnce(&mut Progress) -> Result<Dataset> + Send;

/// A benchmark with its options.
struct Plan {
    name: &'static str,
    expected_s: f64,
    run: Box<Run>,
}

impl Plan {
    fn of<B: Benchmark>(name: &'static str, request: &Request) -> Self {
        let mut options = B::of_report(request.extent.quick);
        if let Some(rounds) = request.extent.rounds {
            *options.rounds_mut() = rounds;
        }
        if let Some(config) = options.config_mut() {
            config.clone_from(&request.config);
        }
        Self {
            name,
            expected_s: options.expected_s(),
            run: Box::new(move |progress| options.run(progress)),
        }
    }

    /// In a thread of its own: cores and priorities that it takes end with it.
    fn carry_out(self, progress: &mut Progress) -> Part {
        let (started, begin) = (SystemTime::now(), Instant::now());
        let run = self.run;
        let result = thread::scope(|scope| scope.spawn(|| run(progress)).join());
        Part {
            name: self.name,
            started,
            took_s: begin.elapsed().as_secs_f64(),
            result: match result {
                Ok(result) => result.map_err(|error| format!("{error:#}")),
                Err(_) => {
                    Err("the benchmark panicked; what it said is on the standard error".to_owned())
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_benchmark_that_fails_or_panics_is_a_part_without_a_result() {
        let fails: Box<Run> = Box::new(|_| anyhow::bail!("no luck"));
        let panics: Box<Run> = Box::new(|_| panic!("a test of a panic"));
        for (run, words) in [(fails, "no luck"), (panics, "panicked")] {
            let plan = Plan {
                name: "budget",
                expected_s: 1.0,
                run,
            };
            let part = plan.carry_out(&mut Progress::silent());
            let cause = part.result.err().expect("no result");
            assert!(cause.contains(words), "{cause}");
        }
    }

    #[test]
    fn a_quick_look_takes_less_time_than_the_whole() {
        let request = |quick| Request {
            extent: Extent {
                quick,
                rounds: None,
            },
            config: None,
            only: Vec::new(),
        };
        assert!(request(true).expected_s() < request(false).expected_s() / 4.0);
    }
}
