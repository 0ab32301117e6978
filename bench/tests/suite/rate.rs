//! What `cdcr-bench rate` finds out, from short trials with real daemons.
use cdcr_bench::experiment::Solver;
use cdcr_bench::progress::Progress;
use cdcr_bench::rate::{self, Case, Length, Measured, Options, Trial, Verdict};

fn short(cases: Vec<Case>, periods_ms: &[f64], steps_ms: &[f64]) -> Measured {
    let options = Options {
        rounds: 1,
        length: Length {
            least_s: 0.2,
            least_periods: 60,
        },
        cases,
        periods_ms: periods_ms.to_vec(),
        steps_ms: steps_ms.to_vec(),
        ..Options::quick()
    };
    rate::measure(&options, &mut Progress::silent()).unwrap()
}

/// Whatever the machine did meanwhile: the figures belong together.
fn assert_consistent(trial: &Trial) {
    let figures = trial.figures.as_ref();
    let figures = figures.unwrap_or_else(|| panic!("{}", trial.remarks));
    assert!(
        figures.cycles > 0 && figures.duration_s >= 0.2,
        "{figures:?}"
    );
    let verdict = figures.verdict(trial.period_ms);
    assert_eq!(trial.holds, verdict == Verdict::Holds);
    assert!(!trial.holds || figures.lost_share() <= 1e-3);
    assert!(trial.holds || !trial.remarks.is_empty());
    assert!(
        figures.wake_us.p50 <= figures.response_us.p50,
        "{figures:?}"
    );
    assert!(
        figures.response_us.p999 <= figures.response_us.max,
        "{figures:?}"
    );
    assert!(!trial.responses.is_empty());
    for share in [
        figures.budget_hit_share,
        figures.stale_input_share,
        figures.tracking_share,
    ] {
        assert!((0.0..=1.0).contains(&share), "{figures:?}");
    }
    assert!(figures.tracking_share > 0.0, "{figures:?}");
}

#[test]
fn the_border_lies_between_what_held_and_what_failed() {
    let case = Case {
        sections: 1,
        solver: Solver::GaussNewton,
        horizon_steps: 2,
    };
    let report = short(vec![case], &[5.0, 2.0], &[5.0]);
    let [step] = &report.steps[..] else {
        panic!("one period: {:?}", report.steps);
    };
    assert_eq!(step.rounds.len(), 1);
    assert_eq!(step.rounds[0].case, Case::DEFAULT);
    let [shortest] = &report.shortest[..] else {
        panic!("one case: {:?}", report.shortest);
    };
    assert_eq!(shortest.case, case);
    assert!(shortest.held.is_some() || shortest.failed.is_some());
    assert!(shortest.held.as_ref().is_none_or(|trial| trial.holds));
    assert!(shortest.failed.as_ref().is_none_or(|trial| !trial.holds));
    // Two periods with up to three trials each.
    assert!((1..=6).contains(&report.trials.len()));
    let tallied = shortest.held_tally.trials + shortest.failed_tally.trials;
    assert!((1..=report.trials.len()).contains(&tallied));
    assert_eq!(
        shortest.held_tally.held,
        usize::from(shortest.held.is_some())
    );
    assert_eq!(shortest.failed_tally.held, 0);
    for trial in report.trials.iter().chain(&step.rounds) {
        assert_consistent(trial);
    }
}
