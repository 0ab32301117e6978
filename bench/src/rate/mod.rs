//! Fastest rate of the loop: the shortest period that holds.
//!
//! `bench/README.md` defines when a period *holds*, and how often a trial is repeated. The report contains
//! every trial.

mod case;
mod report;
mod trial;

use std::time::Instant;

use anyhow::Result;

pub use case::Case;
pub use report::picture;
pub use trial::{Trial, TrialOutcome};

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use case::Stage;

/// Tried periods, longest first \[ms\]: 200 Hz to 10 kHz.
const PERIODS_MS: [f64; 7] = [5.0, 2.0, 1.0, 0.5, 0.25, 0.2, 0.1];
/// Periods of the table of the default case \[ms\]: the required 200 Hz, and 1, 2, 5 and 10 kHz.
const STEPS_MS: [f64; 5] = [5.0, 1.0, 0.5, 0.2, 0.1];
const FIRST_GUESS: usize = 4;
/// Expected number of trials in a search: both sides of the border, and a repetition.
const TRIALS: f64 = 3.2;
/// Approximate time for start, begin of tracking, warm-up and end of a trial \[s\].
const AROUND_S: f64 = 1.0;

#[derive(Debug, Clone, clap::Args)]
pub struct RateOptions {
    /// Measurements of the default at each of its periods, 1 to 100. The search for the shortest periods
    /// runs once.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Run only the default and its solvers in short trials: half a minute instead of
    /// five minutes; not a measurement.
    #[arg(long, conflicts_with = "rounds")]
    pub quick: bool,
    /// Let the daemon wake up this long before each release and spin, 0 (no rehearsal) to 1000 µs; at most a quarter
    /// of the period [default: as the daemon].
    #[arg(long = "spin", value_name = "US", value_parser = spin_us)]
    pub spin_us: Option<f64>,
    /// How long a trial measures at least: seconds, and periods.
    #[arg(skip = (2.0, 4000.0))]
    pub length: (f64, f64),
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

impl RateOptions {
    fn measured_s(&self, period_ms: f64) -> f64 {
        let (least_s, least_periods) = self.length;
        least_s.max(least_periods * period_ms * 1e-3)
    }

    /// Expected duration of a trial \[s\].
    fn trial_s(&self, period_ms: f64) -> f64 {
        self.measured_s(period_ms) + AROUND_S
    }

    /// Expected duration of a search \[s\].
    fn search_s(&self) -> f64 {
        let shortest_ms = self.periods_ms.last();
        shortest_ms.map_or(0.0, |period_ms| TRIALS * self.trial_s(*period_ms))
    }
}

impl Benchmark for RateOptions {
    fn quicken(&mut self) {
        (self.rounds, self.length) = (1, (0.5, 400.0));
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
        let round_s: f64 = self.steps_ms.iter().map(|ms| self.trial_s(*ms)).sum();
        f64::from(self.rounds) * round_s + self.cases.len() as f64 * self.search_s()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        report::dataset(measure(self, progress)?)
    }
}

/// Results of the default case with each of its periods, and the shortest period of each case.
#[derive(Debug)]
pub struct Measured {
    pub realtime: bool,
    /// Requested spin time before each release \[µs\], at most a quarter of the period; `None`: the daemon's
    /// default.
    pub spin_us: Option<f64>,
    /// The rounds of the default case with each period.
    pub steps: Vec<Vec<Trial>>,
    pub shortest: Vec<Shortest>,
}

#[derive(Debug)]
pub struct Shortest {
    pub case: Case,
    /// In the order of execution; the last trial of a period decides.
    pub trials: Vec<Trial>,
    /// The shortest period that held; `None` if not even the longest did.
    pub held_ms: Option<f64>,
    /// The next shorter period; `None` if there is none.
    pub failed_ms: Option<f64>,
}

impl Shortest {
    pub fn trials_with(&self, period_ms: Option<f64>) -> Vec<&Trial> {
        let is_it = |trial: &&Trial| Some(trial.period_ms) == period_ms;
        self.trials.iter().filter(is_it).collect()
    }
}

/// Measures the default case with each of its periods in rounds, then searches for the shortest period of
/// each case.
pub fn measure(options: &RateOptions, progress: &mut Progress) -> Result<Measured> {
    let cores = Cores::find()?;
    cores.stay_off();
    let stage = Stage {
        cores,
        realtime: may_be_realtime(),
        spin_us: options.spin_us,
        begun: Instant::now(),
    };
    let mut measured = Measured {
        realtime: stage.realtime,
        spin_us: options.spin_us,
        steps: options.steps_ms.iter().map(|_| Vec::new()).collect(),
        shortest: Vec::new(),
    };
    let mut trial = |case: Case, period_ms: f64, more_s: f64| {
        interrupt::check()?;
        progress.expect(more_s);
        progress.begin(&format!("{} every {period_ms} ms", case.name()));
        let trial = Trial::run(&stage, case, period_ms, options.measured_s(period_ms))?;
        progress.advance(options.trial_s(period_ms));
        anyhow::Ok(trial)
    };
    for _ in 0..options.rounds {
        for (step, period_ms) in measured.steps.iter_mut().zip(&options.steps_ms) {
            step.push(trial(Case::DEFAULT, *period_ms, 0.0)?);
        }
    }
    // Each search begins at the result of the previous one.
    let mut guess = FIRST_GUESS;
    for case in &options.cases {
        // The number and duration of the trials is only known now.
        let mut known_s = options.search_s();
        let found = search(*case, &options.periods_ms, guess, |period_ms| {
            let more_s = options.trial_s(period_ms) - std::mem::take(&mut known_s);
            trial(*case, period_ms, more_s)
        })?;
        let mut periods_ms = options.periods_ms.iter();
        let held = periods_ms.position(|period_ms| Some(*period_ms) == found.held_ms);
        guess = held.unwrap_or(0);
        measured.shortest.push(found);
    }
    Ok(measured)
}

/// The shortest of these periods that holds; they are sorted, longest first. Moves step by step from the
/// guess towards the border, so a good guess costs two trials. Assumes that a longer period holds whenever a
/// shorter one does.
fn search(
    case: Case,
    periods_ms: &[f64],
    guess: usize,
    mut trial: impl FnMut(f64) -> Result<Trial>,
) -> Result<Shortest> {
    let mut trials: Vec<Trial> = Vec::new();
    let mut index = guess.min(periods_ms.len().saturating_sub(1));
    while let Some(period_ms) = periods_ms.get(index) {
        if trials.iter().any(|trial| trial.period_ms == *period_ms) {
            break;
        }
        let mut outcome = None;
        for count in 1.. {
            let tried = trial(*period_ms)?;
            let decides = count >= tried.outcome.trials();
            outcome = Some(tried.outcome);
            trials.push(tried);
            if decides {
                break;
            }
        }
        index = match outcome {
            Some(TrialOutcome::Holds) => index + 1,
            _ => index.saturating_sub(1),
        };
    }
    let holds = |period_ms: &f64| {
        let mut trials = trials.iter();
        trials.any(|trial| trial.period_ms == *period_ms && trial.holds())
    };
    let held = periods_ms.iter().rposition(holds);
    Ok(Shortest {
        case,
        held_ms: held.map(|index| periods_ms[index]),
        failed_ms: periods_ms.get(held.map_or(0, |index| index + 1)).copied(),
        trials,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use trial::tests::{lossy, observed};

    /// A trial that holds, or that lost releases because of the machine or the loop.
    pub(super) fn trial(period_ms: f64, outcome: TrialOutcome) -> Trial {
        let found = match outcome {
            TrialOutcome::Holds => Ok(observed()),
            TrialOutcome::Machine => Ok(lossy(0, 40, [3, 0, 0, 0, 0])),
            TrialOutcome::Own => Ok(lossy(0, 40, [0, 0, 3, 0, 0])),
            TrialOutcome::Slow => Ok(lossy(0, 40, [0; 5])),
            TrialOutcome::NotFollowed => Err("too short".to_owned()),
        };
        let trial = Trial::new(Case::DEFAULT, period_ms, None, found);
        assert_eq!(trial.outcome, outcome);
        trial
    }

    /// Searches with simulated trials: `outcome` gets the index of the period and the number of its trial.
    fn find(guess: usize, outcome: impl Fn(usize, usize) -> TrialOutcome) -> Shortest {
        let mut counts = [0; PERIODS_MS.len()];
        let found = search(Case::DEFAULT, &PERIODS_MS, guess, |period_ms| {
            let index = PERIODS_MS.iter().position(|ms| *ms == period_ms).unwrap();
            counts[index] += 1;
            Ok(trial(period_ms, outcome(index, counts[index])))
        });
        found.unwrap()
    }

    /// Number of trials that held, and of all trials.
    fn tally(trials: &[&Trial]) -> (usize, usize) {
        let held = trials.iter().filter(|trial| trial.holds()).count();
        (held, trials.len())
    }

    #[test]
    fn the_border_lies_between_what_held_and_what_failed() {
        use TrialOutcome::{Holds, Machine, NotFollowed, Own, Slow};
        for failing in [Machine, Own, Slow, NotFollowed] {
            let all = (0..=7).flat_map(|holding| (0..9).map(move |first| (holding, first)));
            for (holding, guess) in all {
                let found = find(
                    guess,
                    |index, _| if index < holding { Holds } else { failing },
                );
                let period_ms = |index: usize| PERIODS_MS.get(index).copied();
                assert_eq!(found.held_ms, holding.checked_sub(1).and_then(period_ms));
                assert_eq!(found.failed_ms, period_ms(holding));
                let [held, failed] = [found.held_ms, found.failed_ms]
                    .map(|period_ms| tally(&found.trials_with(period_ms)));
                assert!(held == (1, 1) || holding == 0);
                assert!(failed == (0, failing.trials()) || holding == 7);
                let mut trials = found.trials.iter();
                assert!(trials.all(|trial| trial.holds() || !trial.remarks().is_empty()));
                if guess + 1 == holding && holding < 7 {
                    assert_eq!(found.trials.len(), 1 + failing.trials(), "a good guess");
                }
            }
        }
        assert!(search(Case::DEFAULT, &PERIODS_MS, 3, |_| anyhow::bail!("no")).is_err());
        // A period whose trials failed because of the machine holds when a repetition does.
        for spoilt in 0..Machine.trials() {
            let found = find(2, |_, count| if count > spoilt { Holds } else { Machine });
            assert_eq!((found.held_ms, found.failed_ms), (Some(0.1), None));
            assert_eq!(tally(&found.trials_with(found.held_ms)), (1, spoilt + 1));
            assert_eq!(found.trials.len(), (PERIODS_MS.len() - 2) * (spoilt + 1));
        }
    }
}
