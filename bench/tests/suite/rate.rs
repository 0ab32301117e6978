//! Results of `cdcr-bench rate`, from short trials with real daemons.

use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::progress::Progress;
use cdcr_bench::rate::{RateCase, RateOptions};
use serde_json::Value;

use crate::{list, machine, number, values_are_sound};

#[test]
fn the_border_lies_between_what_held_and_what_failed() {
    let _machine = machine();
    // One section, gauss-newton, two steps.
    let case = RateCase::all()[0];
    let mut options = RateOptions::of_report(true, &[]);
    (options.length, options.cases) = ((0.2, 60.0), vec![case]);
    (options.periods_ms, options.steps_ms) = (vec![5.0, 2.0], vec![5.0]);
    let found = options.run(&mut Progress::silent()).unwrap();
    assert!(!found.recordings[0].histogram_ns.is_empty());
    let json = Value::Object(found.json());
    values_are_sound(&json);
    let [trials, rounds] = ["trials", "default_rounds"].map(|key| list(&json, key));
    let shortest = &list(&json, "shortest")[0];
    assert_eq!((rounds.len(), &rounds[0]["sections"]), (1, &Value::from(3)));
    assert_eq!(shortest["solver"], "gauss-newton");
    let [held, failed] = ["shortest_period_ms", "failed_period_ms"].map(|key| &shortest[key]);
    assert!(held.is_number() || failed.is_number());
    // Two periods with up to three trials each; only the last one decides.
    assert!((1..=6).contains(&trials.len()));
    let mut from_last = trials.iter().rev();
    let last = from_last.find(|trial| trial["period_ms"] == *held);
    assert!(last.is_none_or(|trial| trial["holds"] == true));
    let mut failed = trials.iter().filter(|trial| trial["period_ms"] == *failed);
    assert!(failed.all(|trial| trial["holds"] == false));
    for trial in trials.iter().chain(rounds) {
        let holds = trial["holds"] == true;
        let is_measured = number(trial, "cycles") > 0.0 && number(trial, "duration_s") >= 0.2;
        assert!(is_measured, "{trial}");
        assert!(!holds || number(trial, "lost_share") <= 1e-3, "{trial}");
        assert!(holds || trial["remarks"] != "", "{trial}");
        assert!(number(trial, "tracking_share") > 0.0, "{trial}");
    }
}
