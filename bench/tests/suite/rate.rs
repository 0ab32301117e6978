//! Results of `cdcr-bench rate`, from short trials with real daemons.
use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::experiment::Solver;
use cdcr_bench::progress::Progress;
use cdcr_bench::rate::{self, Case, Measured, RateOptions, Trial};

use crate::{machine, number};

fn short(cases: Vec<Case>, periods_ms: &[f64], steps_ms: &[f64]) -> Measured {
    let options = RateOptions {
        rounds: 1,
        length: (0.2, 60.0),
        cases,
        periods_ms: periods_ms.to_vec(),
        steps_ms: steps_ms.to_vec(),
        ..RateOptions::of_report(true)
    };
    rate::measure(&options, &mut Progress::silent()).unwrap()
}

/// The numbers of a trial are consistent, independent of the machine.
fn assert_consistent(trial: &Trial) {
    let row = &trial.row;
    assert_eq!(row["holds"], trial.holds());
    assert!(
        number(row, "cycles") > 0.0 && number(row, "duration_s") >= 0.2,
        "{row}"
    );
    assert!(!trial.holds() || number(row, "lost_share") <= 1e-3, "{row}");
    assert!(trial.holds() || !trial.remarks().is_empty(), "{row}");
    let (wake, response) = (&row["wake_us"], &row["response_us"]);
    assert!(number(wake, "p50") <= number(response, "p50"), "{row}");
    assert!(number(response, "p999") <= number(response, "max"), "{row}");
    assert!(!trial.responses.as_ref().unwrap().histogram_ns.is_empty());
    for key in ["budget_hit_share", "stale_input_share"] {
        assert!((0.0..=1.0).contains(&number(row, key)), "{row}");
    }
    let share = number(row, "tracking_share");
    assert!(share > 0.0 && share <= 1.0, "{row}");
}

#[test]
fn the_border_lies_between_what_held_and_what_failed() {
    let _machine = machine();
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
    assert!(shortest.held_ms.is_some() || shortest.failed_ms.is_some());
    // Two periods with up to three trials each; only the last one decides.
    assert!((1..=6).contains(&shortest.trials.len()));
    let held = shortest.trials_with(shortest.held_ms);
    assert!(held.last().is_none_or(|trial| trial.holds()));
    let mut failed = shortest.trials_with(shortest.failed_ms).into_iter();
    assert!(failed.all(|trial| !trial.holds()));
    for trial in shortest.trials.iter().chain(step) {
        assert_consistent(trial);
    }
}
