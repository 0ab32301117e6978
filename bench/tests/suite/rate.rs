//! What `cdcr-bench rate` finds out, from short trials with real daemons.
use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::experiment::Solver;
use cdcr_bench::progress::Progress;
use cdcr_bench::rate::{self, Case, Length, Measured, RateOptions, Trial, TrialOutcome};

fn short(cases: Vec<Case>, periods_ms: &[f64], steps_ms: &[f64]) -> Measured {
    let options = RateOptions {
        rounds: 1,
        length: Length {
            least_s: 0.2,
            least_periods: 60,
        },
        cases,
        periods_ms: periods_ms.to_vec(),
        steps_ms: steps_ms.to_vec(),
        ..RateOptions::of_report(true)
    };
    rate::measure(&options, &mut Progress::silent()).unwrap()
}

/// Whatever the machine did meanwhile: the metrics belong together.
fn assert_consistent(trial: &Trial) {
    let observed = trial.found.as_ref().unwrap();
    let metrics = &observed.metrics;
    let counted = &metrics.counted;
    let (wake, response) = (&counted.wake, &counted.response);
    assert!(
        counted.cycles > 0 && metrics.duration_s >= 0.2,
        "{metrics:?}"
    );
    let outcome = metrics.outcome(trial.period_ms);
    assert_eq!(trial.holds(), outcome == TrialOutcome::Holds);
    assert!(!trial.holds() || metrics.lost_share() <= 1e-3);
    assert!(trial.holds() || !trial.remarks().is_empty());
    assert!(wake.p50_ns <= response.p50_ns, "{metrics:?}");
    assert!(response.p999_ns <= response.max_ns, "{metrics:?}");
    assert!(!observed.responses.is_empty());
    assert!(counted.budget_hits.max(counted.stale_inputs) <= counted.cycles);
    let share = metrics.tracking_share;
    assert!(share > 0.0 && share <= 1.0, "{metrics:?}");
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
    assert_eq!(step.len(), 1);
    assert_eq!(step[0].case, Case::DEFAULT);
    let [shortest] = &report.shortest[..] else {
        panic!("one case: {:?}", report.shortest);
    };
    assert_eq!(shortest.case, case);
    assert!(!shortest.held.is_empty() || !shortest.failed.is_empty());
    // Two periods with up to three trials each; only the last one decides.
    assert!((1..=6).contains(&shortest.trials.len()));
    assert!(shortest.held.last().is_none_or(Trial::holds));
    assert!(shortest.failed.iter().all(|trial| !trial.holds()));
    for trial in shortest.trials.iter().chain(step) {
        assert_consistent(trial);
    }
}
