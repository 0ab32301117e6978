//! The shortest period that *holds*: `bench/README.md` defines it, and how often a trial is repeated.

mod report;
mod trial;

use std::time::Instant;

use anyhow::Result;
use cdcr_client::counted;
use cdcr_controller::nmpc::SolverKind;
use cdcr_controller::robot::RobotParameters;
use serde::Serialize;

pub use report::picture;

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use trial::{Trial, TrialOutcome};

/// Tried periods, longest first \[ms\]: 200 Hz to 10 kHz.
const PERIODS_MS: [f64; 7] = [5.0, 2.0, 1.0, 0.5, 0.25, 0.2, 0.1];
/// Periods of the table of the default case \[ms\]: the required 200 Hz, and 1, 2, 5 and 10 kHz.
const STEPS_MS: [f64; 5] = [5.0, 1.0, 0.5, 0.2, 0.1];
const FIRST_GUESS: usize = 4;
/// Expected number of trials in a search: both sides of the border, and a repetition.
const TRIALS: f64 = 3.2;
/// Approximate time for start, begin of tracking, warm-up and end of a trial \[s\].
const AROUND_S: f64 = 1.0;
const SPIN_SHARE: f64 = 0.25;

#[derive(Debug, Clone, clap::Args)]
pub struct RateOptions {
    /// Measurements of the default at each of its periods, 1 to 100. The search for the shortest periods
    /// runs once.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Let the daemon wake up this long before each release and spin, 0 (no rehearsal) to 1000 µs; at most a quarter
    /// of the period [default: that of the daemon].
    #[arg(long = "spin", value_name = "US", value_parser = spin_us)]
    pub spin_us: Option<f64>,
    /// How long a trial measures at least: seconds, and periods.
    #[arg(skip = (2.0, 4000.0))]
    pub length: (f64, f64),
    #[arg(skip = RateCase::all())]
    pub cases: Vec<RateCase>,
    /// The periods that are tried, longest first \[ms\].
    #[arg(skip = PERIODS_MS)]
    pub periods_ms: Vec<f64>,
    /// The periods that the default is shown with \[ms\].
    #[arg(skip = STEPS_MS)]
    pub steps_ms: Vec<f64>,
}

fn spin_us(text: &str) -> Result<f64, &'static str> {
    let value = text.parse().ok();
    let value = value.filter(|us| (0.0..=1000.0).contains(us));
    value.ok_or("must be 0 to 1000")
}

impl RateOptions {
    fn measured_s(&self, period_ms: f64) -> f64 {
        let (least_s, least_periods) = self.length;
        least_s.max(least_periods * period_ms * 1e-3)
    }

    fn trial_s(&self, period_ms: f64) -> f64 {
        self.measured_s(period_ms) + AROUND_S
    }

    fn search_s(&self) -> f64 {
        let shortest_ms = self.periods_ms.last();
        shortest_ms.map_or(0.0, |period_ms| TRIALS * self.trial_s(*period_ms))
    }
}

impl Benchmark for RateOptions {
    fn quicken(&mut self) {
        (self.rounds, self.length) = (1, (0.5, 400.0));
        let is_default = |case: &RateCase| (case.sections, case.horizon_steps) == (3, 2);
        self.cases.retain(is_default);
    }

    fn expected_s(&self) -> f64 {
        let round_s: f64 = self.steps_ms.iter().map(|ms| self.trial_s(*ms)).sum();
        f64::from(self.rounds) * round_s + self.cases.len() as f64 * self.search_s()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let stage = Stage::new(self.spin_us)?;
        let mut trial = |case: RateCase, period_ms: f64, more_s: f64| {
            interrupt::check()?;
            progress.expect(more_s);
            progress.begin(&format!("{} every {period_ms} ms", case.name()));
            let trial = Trial::run(&stage, case, period_ms, self.measured_s(period_ms))?;
            progress.advance(self.trial_s(period_ms));
            anyhow::Ok(trial)
        };
        let mut steps: Vec<Vec<Trial>> = self.steps_ms.iter().map(|_| Vec::new()).collect();
        for _ in 0..self.rounds {
            for (step, period_ms) in steps.iter_mut().zip(&self.steps_ms) {
                step.push(trial(RateCase::DEFAULT, *period_ms, 0.0)?);
            }
        }
        // Each search begins at the result of the previous one.
        let (mut shortest, mut guess) = (Vec::new(), FIRST_GUESS);
        for case in &self.cases {
            // The number and duration of the trials is only known now.
            let mut known_s = self.search_s();
            let found = search(*case, &self.periods_ms, guess, |period_ms| {
                let more_s = self.trial_s(period_ms) - std::mem::take(&mut known_s);
                trial(*case, period_ms, more_s)
            })?;
            let mut periods_ms = self.periods_ms.iter();
            let held = periods_ms.position(|period_ms| Some(*period_ms) == found.held_ms);
            guess = held.unwrap_or(0);
            shortest.push(found);
        }
        report::dataset(stage.realtime, self.spin_us, steps, &shortest)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RateCase {
    pub sections: usize,
    pub solver: SolverKind,
    pub horizon_steps: u32,
}

impl RateCase {
    pub const DEFAULT: Self = Self {
        sections: 3,
        solver: SolverKind::KpsoRefined,
        horizon_steps: 2,
    };

    /// One to three sections with every solver and both horizons, ordered so that neighbours are similar.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for solver in [
            SolverKind::GaussNewton,
            SolverKind::Kpso,
            SolverKind::KpsoRefined,
        ] {
            for horizon_steps in [2, 10] {
                all.extend((1..=3).map(|sections| Self {
                    sections,
                    solver,
                    horizon_steps,
                }));
            }
        }
        all
    }

    fn name(&self) -> String {
        let (solver, steps) = (self.solver.name(), self.horizon_steps);
        let sections = counted(self.sections, "section");
        format!("{sections}, {solver}, N = {steps}")
    }

    fn robot(&self) -> toml::Value {
        let sections = RobotParameters::paper(self.sections).sections;
        toml::Value::try_from(sections).expect("numbers")
    }
}

#[derive(Debug)]
struct Stage {
    cores: Cores,
    realtime: bool,
    /// Time before a release at which the cycle thread begins to spin \[µs\]; `None`: the daemon's default.
    spin_us: Option<f64>,
    begun: Instant,
}

impl Stage {
    fn new(spin_us: Option<f64>) -> Result<Self> {
        let cores = Cores::find()?;
        cores.stay_off();
        Ok(Self {
            cores,
            realtime: may_be_realtime(),
            spin_us,
            begun: Instant::now(),
        })
    }

    fn launch(&self, case: &RateCase, period_ms: f64) -> Launch {
        Launch::stall_tolerant(None)
            .placed(&self.cores, self.realtime)
            .with_period(period_ms)
            .with("robot.sections", case.robot())
            .with("controller.solver", case.solver.name())
            .with("controller.horizon_steps", case.horizon_steps)
            .with_some("realtime.spin_us", self.spin_within_us(period_ms))
    }

    fn spin_within_us(&self, period_ms: f64) -> Option<f64> {
        let most_us = SPIN_SHARE * period_ms * 1e3;
        self.spin_us.map(|spin_us| spin_us.min(most_us))
    }
}

#[derive(Debug)]
struct Shortest {
    case: RateCase,
    /// In the order of execution; the last trial of a period decides.
    trials: Vec<Trial>,
    /// The shortest period that held; `None` if not even the longest did.
    held_ms: Option<f64>,
    /// The next shorter period; `None` if there is none.
    failed_ms: Option<f64>,
}

impl Shortest {
    fn trials_with(&self, period_ms: Option<f64>) -> Vec<&Trial> {
        let is_it = |trial: &&Trial| Some(trial.period_ms) == period_ms;
        self.trials.iter().filter(is_it).collect()
    }
}

/// Moves step by step from the guess towards the border, so a good guess costs two trials. Assumes that a longer
/// period holds whenever a shorter one does.
fn search(
    case: RateCase,
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
        let (mut outcome, mut count) = (TrialOutcome::Machine, 0);
        while count < outcome.trials() {
            let tried = trial(*period_ms)?;
            (outcome, count) = (tried.outcome, count + 1);
            trials.push(tried);
        }
        index = match outcome {
            TrialOutcome::Holds => index + 1,
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
    use serde_json::{Value, json};

    use super::{trial::Observed, *};
    use TrialOutcome::{Holds, Machine, NotFollowed, Own, Slow};

    pub(super) fn trial(period_ms: f64, outcome: TrialOutcome) -> Trial {
        let mut held = Observed::default().row();
        held["response_us"] = json!({ "p50": 30.0, "p99": 40.0, "p999": null });
        held["core_share"] = json!(0.2);
        let (remarks, row) = match outcome {
            Holds => ("", held),
            _ => ("too short", Value::Null),
        };
        Trial::new(RateCase::DEFAULT, period_ms, None, outcome, remarks, row)
    }

    /// `outcome` gets the index of the period and the number of its trial.
    fn find(guess: usize, outcome: impl Fn(usize, usize) -> TrialOutcome) -> Shortest {
        let mut counts = [0; PERIODS_MS.len()];
        let found = search(RateCase::DEFAULT, &PERIODS_MS, guess, |period_ms| {
            let index = PERIODS_MS.iter().position(|ms| *ms == period_ms).unwrap();
            counts[index] += 1;
            Ok(trial(period_ms, outcome(index, counts[index])))
        });
        found.unwrap()
    }

    #[test]
    fn the_border_lies_between_what_held_and_what_failed() {
        for failing in [Machine, Own, Slow, NotFollowed] {
            let all = (0..=7).flat_map(|holding| (0..9).map(move |first| (holding, first)));
            for (holding, guess) in all {
                let outcome = |index, _| if index < holding { Holds } else { failing };
                let found = find(guess, outcome);
                let period_ms = |index: usize| PERIODS_MS.get(index).copied();
                assert_eq!(found.held_ms, holding.checked_sub(1).and_then(period_ms));
                assert_eq!(found.failed_ms, period_ms(holding));
                let counts = [found.held_ms, found.failed_ms].map(|ms| found.trials_with(ms).len());
                assert!(counts[0] == 1 || holding == 0);
                assert!(counts[1] == failing.trials() || holding == 7);
                if guess + 1 == holding && holding < 7 {
                    assert_eq!(found.trials.len(), 1 + failing.trials(), "a good guess");
                }
            }
        }
        assert!(search(RateCase::DEFAULT, &PERIODS_MS, 3, |_| anyhow::bail!("no")).is_err());
        // A period whose trials failed because of the machine holds when a repetition does.
        for spoilt in 0..Machine.trials() {
            let found = find(2, |_, count| if count > spoilt { Holds } else { Machine });
            assert_eq!((found.held_ms, found.failed_ms), (Some(0.1), None));
            assert_eq!(found.trials.len(), (PERIODS_MS.len() - 2) * (spoilt + 1));
        }
    }

    #[test]
    fn the_daemon_accepts_every_robot_with_every_period() {
        // `None`: the default spin time.
        for (case, ms, spin_us) in [(0, 5.0, Some(1e3)), (1, 0.5, Some(0.0)), (2, 0.1, None)] {
            let stage = Stage::new(spin_us).unwrap();
            let launch = stage.launch(&RateCase::all()[case], ms);
            let output = launch.command("check").unwrap().output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{errors}");
        }
    }
}
