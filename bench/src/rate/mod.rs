//! How fast the loop can go: the shortest period that holds.
//!
//! What *holds* is, and how often a trial is repeated: `bench/README.md`. Every trial stays in the report.

mod case;
mod report;
mod trial;

use anyhow::Result;

pub use case::Case;
pub use report::picture;
pub use trial::{Length, Observed, Trial, TrialMetrics, TrialOutcome};

use crate::benchmark::Benchmark;
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
    /// Let the daemon wake up so long before each release and spin to it, 0 (no rehearsal) to 1000 µs; at most a quarter
    /// of the period. Without it, as the daemon does by default.
    #[arg(long = "spin", value_name = "US", value_parser = spin_us)]
    pub spin_us: Option<f64>,
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
    let value = text.parse().map_err(|_| "must be a number")?;
    let is_within = (0.0..=1000.0).contains(&value);
    is_within
        .then_some(value)
        .ok_or_else(|| "must be 0 to 1000".to_owned())
}

impl Benchmark for RateOptions {
    fn quicken(&mut self) {
        self.rounds = 1;
        self.length = Length {
            least_s: 0.5,
            least_periods: 400,
        };
        let is_default = |case: &Case| (case.sections, case.horizon_steps) == (3, 2);
        self.cases.retain(is_default);
    }

    fn is_quick(&self) -> bool {
        self.quick
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
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
    /// How long they were asked to spin before each release \[µs\], at most a quarter of the period; none: the daemon's
    /// default.
    pub spin_us: Option<f64>,
    /// When the run began \[ns, `CLOCK_MONOTONIC`\].
    pub begin_ns: u64,
    /// The rounds of the default with each period.
    pub steps: Vec<Vec<Trial>>,
    pub shortest: Vec<Shortest>,
}

#[derive(Debug, Clone)]
pub struct Shortest {
    pub case: Case,
    /// In their order.
    pub trials: Vec<Trial>,
    /// Those of the shortest period that held, the last of which decides; none when not even the longest did.
    pub held: Vec<Trial>,
    /// Those of the next shorter period; none when there is no shorter one.
    pub failed: Vec<Trial>,
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
    let mut measured = Measured {
        realtime: stage.realtime,
        spin_us: options.spin_us,
        begin_ns: cdcr_client::monotonic_ns(),
        steps: Vec::new(),
        shortest: Vec::new(),
    };
    let length = options.length;
    let trial = |progress: &mut Progress, case: Case, period_ms: f64| {
        interrupt::check()?;
        progress.begin(&format!("{} every {period_ms} ms", case.name()));
        let trial = Trial::run(&stage, case, period_ms, length)?;
        progress.advance(length.whole_s(period_ms));
        anyhow::Ok(trial)
    };
    // The default with each of its periods, one after the other in each round.
    measured.steps.resize(options.steps_ms.len(), Vec::new());
    for _ in 0..options.rounds {
        for (step, period_ms) in measured.steps.iter_mut().zip(&options.steps_ms) {
            step.push(trial(progress, Case::DEFAULT, *period_ms)?);
        }
    }
    // Each search begins where the one before it ended.
    let mut guess = FIRST_GUESS;
    for case in &options.cases {
        let (index, found) = search(*case, &options.periods_ms, guess, |period_ms| {
            trial(progress, *case, period_ms)
        })?;
        guess = index.unwrap_or(0);
        // How many trials a search takes, and how long ones, is known only now.
        let whole_s = |trial: &Trial| length.whole_s(trial.period_ms);
        let spent_s: f64 = found.trials.iter().map(whole_s).sum();
        progress.expect(spent_s - search_s(options));
        measured.shortest.push(found);
    }
    Ok(measured)
}

/// The shortest of these periods that holds, longest first, and its index. Goes step by step from the guess towards the
/// border, so that a good guess costs two trials. It takes for granted what is so in every loop: with more time a
/// period does not hold worse.
fn search(
    case: Case,
    periods_ms: &[f64],
    guess: usize,
    mut trial: impl FnMut(f64) -> Result<Trial>,
) -> Result<(Option<usize>, Shortest)> {
    let mut tried = vec![Vec::new(); periods_ms.len()];
    let mut trials = Vec::new();
    let mut index = guess.min(periods_ms.len().saturating_sub(1));
    while let Some(period_ms) = periods_ms.get(index).filter(|_| tried[index].is_empty()) {
        let of_period: &mut Vec<Trial> = &mut tried[index];
        while of_period
            .last()
            .is_none_or(|trial| !trial.decides(of_period.len()))
        {
            of_period.push(trial(*period_ms)?);
        }
        trials.extend(of_period.iter().cloned());
        index = match of_period.last() {
            Some(trial) if trial.holds() => index + 1,
            _ => index.saturating_sub(1),
        };
    }
    let held = tried
        .iter()
        .rposition(|trials| trials.iter().any(Trial::holds));
    let mut take = |index: usize| tried.get_mut(index).map(std::mem::take).unwrap_or_default();
    let found = Shortest {
        case,
        trials,
        held: held.map(&mut take).unwrap_or_default(),
        failed: take(held.map_or(0, |index| index + 1)),
    };
    Ok((held, found))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantiles::histogram;
    use trial::tests::{lossy, quiet};

    /// A trial that holds, or in which the machine or the loop lost releases.
    pub(super) fn trial(period_ms: f64, outcome: TrialOutcome) -> Trial {
        let metrics = match outcome {
            TrialOutcome::Holds => quiet(),
            TrialOutcome::Machine => lossy(0, 40, [3, 0, 0, 0, 0]),
            TrialOutcome::Own => lossy(0, 40, [0, 0, 3, 0, 0]),
            TrialOutcome::Slow => lossy(0, 40, [0; 5]),
        };
        assert_eq!(metrics.outcome(period_ms), outcome);
        let observed = Observed {
            metrics,
            responses: histogram().unwrap(),
            begin_ns: 1,
        };
        Trial {
            case: Case::DEFAULT,
            period_ms,
            spin_us: None,
            found: Ok(observed),
        }
    }

    /// Searches where `outcome` says what the trial of a period ends like, the how many-th of that period.
    fn find(guess: usize, outcome: impl Fn(usize, usize) -> TrialOutcome) -> Shortest {
        let mut counts = [0; PERIODS_MS.len()];
        let found = search(Case::DEFAULT, &PERIODS_MS, guess, |period_ms| {
            let index = PERIODS_MS.iter().position(|ms| *ms == period_ms).unwrap();
            counts[index] += 1;
            Ok(trial(period_ms, outcome(index, counts[index])))
        });
        found.unwrap().1
    }

    /// The period of some trials, how many held, and how many there are.
    fn tally(trials: &[Trial]) -> Option<(f64, usize, usize)> {
        let held = trials.iter().filter(|trial| trial.holds()).count();
        Some((trials.first()?.period_ms, held, trials.len()))
    }

    #[test]
    fn the_border_lies_between_what_held_and_what_failed() {
        for failing in [TrialOutcome::Machine, TrialOutcome::Own, TrialOutcome::Slow] {
            let all = (0..=7).flat_map(|holding| (0..9).map(move |first| (holding, first)));
            for (holding, guess) in all {
                let holds = |index| {
                    if index < holding {
                        TrialOutcome::Holds
                    } else {
                        failing
                    }
                };
                let found = find(guess, |index, _| holds(index));
                let period_ms = |index: usize| PERIODS_MS.get(index).copied();
                let held_ms = holding.checked_sub(1).and_then(period_ms);
                assert_eq!(tally(&found.held), held_ms.map(|ms| (ms, 1, 1)));
                let failed = period_ms(holding).map(|ms| (ms, 0, failing.trials()));
                assert_eq!(tally(&found.failed), failed);
                let mut trials = found.trials.iter();
                assert!(trials.all(|trial| trial.holds() || !trial.remarks().is_empty()));
                if guess + 1 == holding && holding < 7 {
                    assert_eq!(found.trials.len(), 1 + failing.trials(), "a good guess");
                }
            }
        }
        assert!(search(Case::DEFAULT, &PERIODS_MS, 3, |_| anyhow::bail!("no")).is_err());
    }

    #[test]
    fn a_period_that_the_machine_spoilt_holds_when_it_is_tried_again() {
        use TrialOutcome::{Holds, Machine};
        for spoilt in 0..Machine.trials() {
            let found = find(2, |_, count| if count > spoilt { Holds } else { Machine });
            assert_eq!(tally(&found.held), Some((0.1, 1, spoilt + 1)));
            assert!(found.failed.is_empty());
            assert_eq!(found.trials.len(), (PERIODS_MS.len() - 2) * (spoilt + 1));
        }
    }
}
