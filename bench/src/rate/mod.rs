//! How fast the loop can go: the shortest period that holds.
//!
//! A period *holds* when, of a daemon that really tracks, at most 0.1 % of the releases were lost (no cycle, or
//! a command handed over after the end of the period), and no cycle was late by the daemon's own doing (cause
//! compute or page fault). A solve ends with its time, so a period may hold with solves that were cut short: their
//! share, and the distance from the reference, stand beside it.
//!
//! An own miss decides at once. A trial that only lost releases is repeated once; twice where the machine lost
//! them ([`Verdict::Machine`]). Every trial stays in the report.

mod case;
mod report;
mod search;
mod trial;
mod trial_metrics;

use anyhow::Result;

pub use case::Case;
pub use trial::{Length, Trial};
pub use trial_metrics::{TrialMetrics, Verdict};

use crate::benchmark::{Benchmark, defaults};
use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use case::Stage;

/// The periods that are tried, longest first \[ms\]: 200 Hz to 10 kHz.
const PERIODS_MS: [f64; 7] = [5.0, 2.0, 1.0, 0.5, 0.25, 0.2, 0.1];
/// The periods that the default is shown with \[ms\]: the 200 Hz that are asked, 1, 2, 5 and 10 kHz.
const STEPS_MS: [f64; 5] = [5.0, 1.0, 0.5, 0.2, 0.1];
const LENGTH: Length = Length {
    least_s: 2.0,
    least_periods: 4000,
};
const FIRST_GUESS: usize = 4;
/// Trials that the search for one case takes, about: the border from both sides, and a repetition.
const TRIALS: f64 = 3.2;

#[derive(Debug, Clone, clap::Args)]
pub struct RateOptions {
    /// How often the default is measured with each of its periods, 1 to 100. The search for the shortest periods
    /// is made once.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// The default and its solvers only, in short trials: a look of half a minute instead of a measurement of
    /// five.
    #[arg(long, conflicts_with = "rounds")]
    pub quick: bool,
    /// Let the daemon wake up so long before each release and spin to it, 0 to 1000 µs; at most a quarter of the
    /// period.
    #[arg(long = "spin", value_name = "US", default_value_t = 0.0, value_parser = spin_us)]
    pub spin_us: f64,
    #[arg(skip = LENGTH)]
    pub length: Length,
    #[arg(skip = Case::all())]
    pub cases: Vec<Case>,
    /// The periods that are tried, longest first \[ms\].
    #[arg(skip = PERIODS_MS)]
    pub periods_ms: Vec<f64>,
    /// The periods that the default is shown with \[ms\].
    #[arg(skip = STEPS_MS)]
    pub steps_ms: Vec<f64>,
}

fn spin_us(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (0.0..=1000.0).contains(&value) {
        Ok(value)
    } else {
        Err("must be 0 to 1000".to_owned())
    }
}

impl Benchmark for RateOptions {
    /// Quick: the default and its solvers in short trials, about half a minute.
    fn of_report(quick: bool) -> Self {
        let all: Self = defaults();
        if !quick {
            return all;
        }
        let like_default = |case: &Case| {
            case.sections == Case::DEFAULT.sections
                && case.horizon_steps == Case::DEFAULT.horizon_steps
        };
        Self {
            rounds: 1,
            length: Length {
                least_s: 0.5,
                least_periods: 400,
            },
            cases: Case::all().into_iter().filter(like_default).collect(),
            ..all
        }
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn resolved(self) -> Result<Self> {
        Ok(if self.quick {
            Self {
                spin_us: self.spin_us,
                ..Self::of_report(true)
            }
        } else {
            self
        })
    }

    fn expected_s(&self) -> f64 {
        let whole_s = |period_ms: &f64| self.length.whole_s(*period_ms);
        let round_s: f64 = self.steps_ms.iter().map(whole_s).sum();
        f64::from(self.rounds) * round_s + self.cases.len() as f64 * search_s(self)
    }

    /// Measures the default with each of its periods, in rounds, then looks for the shortest period of each case.
    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        report::dataset(measure(self, progress)?)
    }
}

/// How the default does with each of its periods, and the shortest period of each case.
#[derive(Debug)]
pub struct Measured {
    pub realtime: bool,
    /// How long they spun before each release \[µs\], at most a quarter of the period.
    pub spin_us: f64,
    /// When the run began \[ns, `CLOCK_MONOTONIC`\].
    pub begin_ns: u64,
    pub steps: Vec<Tried>,
    pub shortest: Vec<Shortest>,
    /// All trials of the search, in their order.
    pub trials: Vec<Trial>,
}

/// The trials with one period: the rounds of the default, or those of a search.
#[derive(Debug, Clone)]
pub struct Tried {
    pub period_ms: f64,
    /// The last one decides.
    pub trials: Vec<Trial>,
}

impl Tried {
    pub fn held(&self) -> usize {
        self.trials.iter().filter(|trial| trial.holds).count()
    }
}

#[derive(Debug, Clone)]
pub struct Shortest {
    pub case: Case,
    /// The shortest period that held; none when not even the longest did.
    pub held: Option<Tried>,
    /// The next shorter period; none when there is no shorter one.
    pub failed: Option<Tried>,
}

impl Shortest {
    /// Of the trials of one search, which found the period with this index.
    fn of(case: Case, periods_ms: &[f64], index: Option<usize>, trials: &[Trial]) -> Self {
        let with = |index: usize| {
            let period_ms = *periods_ms.get(index)?;
            let is_it = |trial: &&Trial| trial.period_ms.total_cmp(&period_ms).is_eq();
            let trials = trials.iter().filter(is_it).cloned().collect();
            Some(Tried { period_ms, trials })
        };
        Self {
            case,
            held: index.and_then(with),
            failed: with(index.map_or(0, |index| index + 1)),
        }
    }
}

/// How long the search for one case takes, about \[s\].
fn search_s(options: &RateOptions) -> f64 {
    let shortest_ms = options.periods_ms.last();
    shortest_ms.map_or(0.0, |period_ms| TRIALS * options.length.whole_s(*period_ms))
}

pub fn measure(options: &RateOptions, progress: &mut Progress) -> Result<Measured> {
    let cores = Cores::find()?;
    cores.stay_off();
    let stage = Stage::new(cores, may_be_realtime(), options.spin_us)?;
    let begin_ns = cdcr_client::monotonic_ns();
    let mut run = Run {
        options,
        stage,
        progress,
        trials: Vec::new(),
    };
    let steps = run.steps()?;
    let shortest = run.search_all()?;
    Ok(Measured {
        realtime: run.stage.realtime,
        spin_us: options.spin_us,
        begin_ns,
        steps,
        shortest,
        trials: run.trials,
    })
}

/// Index of the shortest of these periods that holds, after as many trials as that takes; all of them are kept.
fn search_case(
    periods_ms: &[f64],
    guess: usize,
    trials: &mut Vec<Trial>,
    mut trial: impl FnMut(f64) -> Result<Trial>,
) -> Result<Option<usize>> {
    search::shortest(periods_ms.len(), guess, |index| {
        let mut count = 0;
        loop {
            let trial = trial(periods_ms[index])?;
            count += 1;
            let (holds, is_decided) = (trial.holds, trial.decides(count));
            trials.push(trial);
            if is_decided {
                return Ok(holds);
            }
        }
    })
}

struct Run<'a> {
    options: &'a RateOptions,
    stage: Stage,
    progress: &'a mut Progress,
    trials: Vec<Trial>,
}

impl Run<'_> {
    /// The default with each of its periods, one after the other in each round.
    fn steps(&mut self) -> Result<Vec<Tried>> {
        let empty = |period_ms: &f64| Tried {
            period_ms: *period_ms,
            trials: Vec::new(),
        };
        let mut steps: Vec<Tried> = self.options.steps_ms.iter().map(empty).collect();
        for _ in 0..self.options.rounds {
            for step in &mut steps {
                step.trials.push(self.trial(Case::DEFAULT, step.period_ms)?);
            }
        }
        Ok(steps)
    }

    /// The shortest period of each case; each search begins where the one before it ended.
    fn search_all(&mut self) -> Result<Vec<Shortest>> {
        let mut guess = FIRST_GUESS;
        let mut all = Vec::new();
        for case in &self.options.cases {
            let mut trials = Vec::new();
            let index = search_case(&self.options.periods_ms, guess, &mut trials, |period_ms| {
                self.trial(*case, period_ms)
            })?;
            guess = index.unwrap_or(0);
            all.push(Shortest::of(
                *case,
                &self.options.periods_ms,
                index,
                &trials,
            ));
            // How many trials a search takes, and how long ones, is known only now.
            let whole_s = |trial: &Trial| self.options.length.whole_s(trial.period_ms);
            let spent_s: f64 = trials.iter().map(whole_s).sum();
            self.progress.expect(spent_s - search_s(self.options));
            self.trials.append(&mut trials);
        }
        Ok(all)
    }

    fn trial(&mut self, case: Case, period_ms: f64) -> Result<Trial> {
        interrupt::check()?;
        self.progress
            .begin(&format!("{} every {period_ms} ms", case.name()));
        let trial = Trial::run(&self.stage, case, period_ms, self.options.length)?;
        self.progress
            .advance(self.options.length.whole_s(period_ms));
        Ok(trial)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::causes::Causes;
    use crate::quantiles::histogram;

    /// A trial that holds, or in which the machine or the loop lost releases.
    fn trial(period_ms: f64, verdict: Verdict) -> Trial {
        let quiet = trial_metrics::tests::quiet();
        let lost = |platform, compute| TrialMetrics {
            skipped_periods: 40,
            causes: Causes {
                platform,
                compute,
                ..Causes::default()
            },
            ..quiet.clone()
        };
        let metrics = match verdict {
            Verdict::Holds => quiet,
            Verdict::Machine => lost(3, 0),
            Verdict::Own => lost(0, 3),
            Verdict::Slow => lost(0, 0),
        };
        assert_eq!(metrics.verdict(period_ms), verdict);
        Trial {
            case: Case::DEFAULT,
            period_ms,
            spin_us: 0.0,
            holds: verdict == Verdict::Holds,
            remarks: metrics.remarks(period_ms),
            metrics: Some(metrics),
            tag: String::new(),
            responses: histogram().unwrap(),
            begin_ns: 0,
        }
    }

    /// Searches where `verdict` says what the trial of a period ends like, the how many-th of that period.
    fn search(guess: usize, verdict: impl Fn(usize, usize) -> Verdict) -> (Shortest, Vec<Trial>) {
        let mut counts = [0; PERIODS_MS.len()];
        let mut trials = Vec::new();
        let index = search_case(&PERIODS_MS, guess, &mut trials, |period_ms| {
            let index = PERIODS_MS.iter().position(|ms| *ms == period_ms).unwrap();
            counts[index] += 1;
            Ok(trial(period_ms, verdict(index, counts[index])))
        });
        let shortest = Shortest::of(Case::DEFAULT, &PERIODS_MS, index.unwrap(), &trials);
        (shortest, trials)
    }

    #[test]
    fn the_border_lies_between_what_held_and_what_failed() {
        for failing in [Verdict::Machine, Verdict::Own, Verdict::Slow] {
            for holding in 0..=PERIODS_MS.len() {
                for guess in 0..PERIODS_MS.len() {
                    let verdict = |index, _| {
                        if index < holding {
                            Verdict::Holds
                        } else {
                            failing
                        }
                    };
                    let (found, trials) = search(guess, verdict);
                    let tallied =
                        |tried: &Tried| (tried.period_ms, tried.held(), tried.trials.len());
                    let expected = |index: usize, held, trials| {
                        PERIODS_MS
                            .get(index)
                            .map(|period_ms| (*period_ms, held, trials))
                    };
                    let held = holding
                        .checked_sub(1)
                        .and_then(|index| expected(index, 1, 1));
                    assert_eq!(found.held.as_ref().map(tallied), held);
                    let failed = expected(holding, 0, failing.trials());
                    assert_eq!(found.failed.as_ref().map(tallied), failed);
                    let said = |trial: &Trial| trial.holds || !trial.remarks.is_empty();
                    assert!(trials.iter().all(said));
                }
            }
        }
    }

    #[test]
    fn a_period_that_the_machine_spoilt_holds_when_it_is_tried_again() {
        for spoilt in 0..Verdict::Machine.trials() {
            let (found, trials) = search(2, |_, count| {
                if count > spoilt {
                    Verdict::Holds
                } else {
                    Verdict::Machine
                }
            });
            let held = found.held.unwrap();
            assert_eq!(Some(&held.period_ms), PERIODS_MS.last());
            assert_eq!((held.held(), held.trials.len()), (1, spoilt + 1));
            assert!(found.failed.is_none());
            assert_eq!(trials.len(), (PERIODS_MS.len() - 2) * (spoilt + 1));
        }
    }
}
