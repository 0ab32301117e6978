//! Results of `cdcr-bench quality`, from a small part of it.

use std::collections::BTreeSet;

use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::progress::Progress;
use cdcr_bench::quality::course::Course;
use cdcr_bench::quality::{CONTENDERS, Field, QualityOptions};
use serde_json::Value;

use crate::{dataset_is_sound, number};

/// Two courses, one with an obstacle, for an eighth of a second each.
fn small() -> QualityOptions {
    QualityOptions {
        rounds: 2,
        courses: vec![Course::Line, Course::Crossing],
        cycles_max: 25,
        budgets_us: vec![0, 500],
        swarms: vec![(6, 10)],
        horizons: vec![2, 5],
        restarts: 1,
    }
}

#[test]
fn the_result_holds_every_variant() {
    let report = small().run(&mut Progress::silent()).expect("it runs");
    // For each course: 2 budgets and 2 horizons with three solvers, and a swarm with two.
    let rows = 2 * (2 * 3 + 2 * 3 + 2);
    let fields = Field::ALL.len() * CONTENDERS.len();
    let counts = ["restarts", "cases", "problems"].map(|key| report.rows(key).len());
    assert_eq!(counts, [fields, rows, 2 * fields]);
    for case in report.rows("cases") {
        assert_eq!(case["rounds"], 2, "{case}");
        let (is_timed, share) = (case["axis"] == "budget", number(case, "cut_short_share"));
        // Only a budget shortens a solve.
        assert!(is_timed || share == 0.0, "{case}");
        assert_eq!(case["budget_us"].is_u64(), is_timed, "{case}");
        // The plan is evaluated even where the solver had no time for it.
        let is_cut = share == 1.0 && number(case, "mean_cost") > 0.0;
        assert!(is_cut || case["budget_us"] != 0, "{case}");
        for key in ["min_clearance_mm", "below_safe_ms"] {
            assert_eq!(case[key].is_f64(), case["course"] == "crossing", "{case}");
        }
    }
    let plots = ["error", "clearance", "stuck"].map(|name| format!("quality-{name}"));
    assert!(report.plots().map(|plot| &plot.name).eq(&plots));
    dataset_is_sound(&report, &[2]);
    let names: BTreeSet<&str> = report.metrics.iter().map(|metric| &*metric.name).collect();
    for name in [
        "quality/budget/line/kpso/0-us/mean_error",
        "quality/budget/crossing/kpso-refined/500-us/least_clearance",
        "quality/swarm/line/kpso/6x10/mean_error",
        "quality/horizon/line/gauss-newton/n5/mean_error",
        "quality/restarts/ball/kpso-refined/stuck",
    ] {
        assert!(names.contains(name), "{name} in {names:?}");
    }
}

#[test]
fn what_no_clock_ends_comes_out_the_same_again() {
    let mut options = small();
    (options.rounds, options.budgets_us) = (1, Vec::new());
    let [first, second] = [(); 2].map(|()| {
        let report = options.run(&mut Progress::silent()).expect("it runs");
        let problems = report.rows("problems").iter();
        let costs: Vec<Value> = problems.map(|row| row["cost"].clone()).collect();
        (costs, report.metrics)
    });
    assert!(!first.0.is_empty() && !first.1.is_empty());
    assert_eq!(first, second);
}
