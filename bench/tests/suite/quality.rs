//! Results of `cdcr-bench quality`, from a small part of it.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::dataset::Dataset;
use cdcr_bench::progress::Progress;
use cdcr_bench::quality::course::Course;
use cdcr_bench::quality::{CONTENDERS, Field, QualityOptions};
use serde_json::Value;

use crate::number;

/// Two courses, one with an obstacle, for an eighth of a second each.
fn small() -> QualityOptions {
    QualityOptions {
        rounds: 2,
        quick: true,
        courses: vec![Course::Line, Course::Crossing],
        cycles_max: 25,
        budgets_us: vec![20, 500],
        swarms: vec![(6, 10)],
        horizons: vec![2, 5],
        restarts: 1,
    }
}

/// One run for all tests.
fn report() -> &'static Dataset {
    static REPORT: OnceLock<Dataset> = OnceLock::new();
    REPORT.get_or_init(|| small().run(&mut Progress::silent()).expect("it runs"))
}

#[test]
fn the_result_holds_every_variant() {
    let report = report();
    // For each course: 2 budgets and 2 horizons with three solvers, and a swarm with two.
    let rows = 2 * (2 * 3 + 2 * 3 + 2);
    let fields = Field::ALL.len() * CONTENDERS.len();
    let expected = [
        ("restarts", fields),
        ("cases", rows),
        ("problems", 2 * fields),
    ];
    for (key, count) in expected {
        assert_eq!(report.rows(key).len(), count, "{key}");
    }
    for case in report.rows("cases") {
        assert_eq!(case["rounds"], 2, "{case}");
        let keys = "mean_error_mm max_error_mm mean_cost solve_p50_us solve_p99_us";
        for key in keys.split(' ') {
            assert!(number(case, key) >= 0.0, "{key}: {case}");
        }
        let (is_timed, share) = (case["axis"] == "budget", number(case, "cut_short_share"));
        assert!((0.0..=1.0).contains(&share), "{case}");
        // Only a budget shortens a solve.
        assert!(is_timed || share == 0.0, "{case}");
        assert_eq!(case["budget_us"].is_u64(), is_timed, "{case}");
        for key in ["min_clearance_mm", "below_safe_ms"] {
            assert_eq!(case[key].is_f64(), case["course"] == "crossing", "{case}");
        }
    }
    let text = report.text();
    for word in "crossing,500 µs,6 x 10,5 steps,posts,gauss-newton-restarted".split(',') {
        assert!(text.contains(word), "{word} in {text}");
    }
    let names: Vec<&str> = report.plots.iter().map(|plot| plot.name).collect();
    let expected = ["quality-error", "quality-clearance", "quality-stuck"];
    assert_eq!(names, expected);
}

#[test]
fn metrics_have_a_value_for_each_round_and_names_of_their_own() {
    let metrics = &report().metrics;
    let names: BTreeSet<&str> = metrics.iter().map(|metric| metric.name.as_str()).collect();
    assert_eq!(names.len(), metrics.len());
    assert!(metrics.iter().all(|metric| metric.rounds.len() == 2));
    for name in [
        "budget/line/kpso/20-us/mean_error",
        "budget/crossing/kpso-refined/500-us/least_clearance",
        "swarm/line/kpso/6x10/mean_error",
        "horizon/line/gauss-newton/n5/mean_error",
        "restarts/ball/kpso-refined/stuck",
    ] {
        assert!(
            names.contains(&*format!("quality/{name}")),
            "{name} in {names:?}"
        );
    }
}

#[test]
fn what_no_clock_ends_comes_out_the_same_again() {
    let options = QualityOptions {
        rounds: 1,
        budgets_us: Vec::new(),
        ..small()
    };
    let [first, second] = [(); 2].map(|()| {
        let report = options.run(&mut Progress::silent()).expect("it runs");
        let problems = report.rows("problems").iter();
        let costs: Vec<Value> = problems.map(|row| row["cost"].clone()).collect();
        (costs, report.metrics)
    });
    assert!(!first.0.is_empty() && !first.1.is_empty());
    assert_eq!(first, second);
}
