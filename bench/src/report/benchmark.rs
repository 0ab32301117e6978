//! All benchmarks, and how one after the other is run.

use std::path::PathBuf;
use std::thread;
use std::time::{Instant, SystemTime};

use anyhow::Result;
use clap::ValueEnum;

use super::{BenchReport, Extent, Part, Start};
use crate::budget;
use crate::dataset::Dataset;
use crate::deadline;
use crate::footprint;
use crate::interrupt;
use crate::latency;
use crate::paper;
use crate::progress::Progress;
use crate::quality;
use crate::rate;
use crate::robustness;
use crate::solver;

/// A benchmark, in the order in which they are run: those of real time come first, while the machine is quiet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Benchmark {
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
#[derive(Debug, Clone)]
pub struct Request {
    /// How much.
    pub extent: Extent,
    /// Configuration of the daemon; none: the default.
    pub config: Option<PathBuf>,
    /// Which benchmarks, in any order.
    pub benchmarks: Vec<Benchmark>,
}

impl Request {
    /// About how long it takes \[s\].
    pub fn expected_s(&self) -> f64 {
        let plans = Benchmark::value_variants()
            .iter()
            .filter(|b| self.benchmarks.contains(b));
        plans.map(|benchmark| benchmark.plan(self).expected_s).sum()
    }

    /// Runs the benchmarks. One that fails is part of the report and does not keep the others from running.
    pub fn run(&self, start: Start, progress: &mut Progress) -> Result<BenchReport> {
        let asked = Benchmark::value_variants()
            .iter()
            .filter(|b| self.benchmarks.contains(b));
        let plans: Vec<Plan> = asked.map(|benchmark| benchmark.plan(self)).collect();
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

impl Benchmark {
    fn plan(self, request: &Request) -> Plan {
        let Extent { quick, rounds } = request.extent;
        macro_rules! plan {
            ($module:ident, $options:ident) => {{
                let mut options = sized(quick, $module::$options::quick, $module::$options::full);
                options.rounds = rounds.unwrap_or(options.rounds);
                Plan::of(
                    stringify!($module),
                    options,
                    $module::expected_s,
                    $module::run,
                )
            }};
        }
        match self {
            Self::Deadline => {
                let mut options = sized(
                    quick,
                    deadline::DeadlineOptions::quick,
                    deadline::DeadlineOptions::default,
                );
                options.rounds = rounds.unwrap_or(options.rounds);
                options.config.clone_from(&request.config);
                Plan::of("deadline", options, deadline::expected_s, deadline::run)
            }
            Self::Latency => {
                let mut options = sized(quick, quick_latency, latency::LatencyOptions::default);
                options.rounds = rounds.map_or(options.rounds, |rounds| rounds as usize);
                options.config.clone_from(&request.config);
                Plan::of("latency", options, latency::expected_s, latency::run)
            }
            Self::Rate => plan!(rate, RateOptions),
            Self::Footprint => plan!(footprint, FootprintOptions),
            Self::Quality => plan!(quality, QualityOptions),
            Self::Robustness => plan!(robustness, RobustnessOptions),
            Self::Paper => {
                let mut effort = if quick { paper::QUICK } else { paper::FULL };
                effort.seeds = rounds.map_or(effort.seeds, u64::from);
                Plan::of("paper", effort, paper::expected_s, paper::run)
            }
            Self::Solver => plan!(solver, SolverOptions),
            Self::Budget => plan!(budget, BudgetOptions),
        }
    }
}

/// The quick options, or the usual ones.
fn sized<O>(is_quick: bool, quick: fn() -> O, usual: fn() -> O) -> O {
    if is_quick { quick() } else { usual() }
}

fn quick_latency() -> latency::LatencyOptions {
    let (rounds, samples) = latency::LatencyOptions::QUICK;
    latency::LatencyOptions {
        rounds,
        samples,
        ..latency::LatencyOptions::default()
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
    fn of<O: Send + 'static>(
        name: &'static str,
        options: O,
        expected_s: fn(&O) -> f64,
        run: fn(&O, &mut Progress) -> Result<Dataset>,
    ) -> Self {
        Self {
            name,
            expected_s: expected_s(&options),
            run: Box::new(move |progress| run(&options, progress)),
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

    fn fails(_: &budget::BudgetOptions, _: &mut Progress) -> Result<Dataset> {
        anyhow::bail!("no luck")
    }

    fn panics(_: &budget::BudgetOptions, _: &mut Progress) -> Result<Dataset> {
        panic!("a test of a panic")
    }

    #[test]
    fn a_benchmark_that_fails_or_panics_is_a_part_without_a_result() {
        for (run, words) in [
            (
                fails as fn(&budget::BudgetOptions, &mut Progress) -> _,
                "no luck",
            ),
            (panics, "panicked"),
        ] {
            let plan = Plan::of(
                "budget",
                budget::BudgetOptions::quick(),
                budget::expected_s,
                run,
            );
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
            benchmarks: Benchmark::value_variants().to_vec(),
        };
        assert!(request(true).expected_s() < request(false).expected_s() / 4.0);
    }
}
