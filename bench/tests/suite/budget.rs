//! What `cdcr-bench budget` hands over, from a few solves.

use cdcr_bench::budget::BUDGETS_US;
use serde_json::Value;

use crate::{list, number, printed, program};

const CASES: [&str; 3] = ["default", "tip-axis", "obstacles"];

fn run(format: &str) -> String {
    printed(&mut program(&format!(
        "budget --solves 5 --format {format}"
    )))
}

#[test]
fn every_case_has_every_budget_and_no_plan_is_worse_than_the_warm_start() {
    let document: Value = serde_json::from_str(&run("json")).expect("one object");
    let rows = list(&document, "cases");
    let all = CASES
        .iter()
        .flat_map(|case| BUDGETS_US.map(|us| (*case, us)));
    assert_eq!(rows.len(), all.clone().count());
    for (row, (case, budget_us)) in rows.iter().zip(all) {
        assert_eq!(row["case"], case);
        assert_eq!(row["budget_us"], budget_us);
        assert_eq!(row["solves"], 5);
        assert_eq!(row["worse_than_warm_start"], 0);
        for key in ["over_us", "bare_over_us"] {
            let [p50, p99, max] = ["p50", "p99", "max"].map(|q| number(&row[key], q));
            assert!(0.0 <= p50 && p50 <= p99 && p99 <= max, "{row}");
        }
        let share = number(row, "ended_by_budget_share");
        assert!((0.0..=1.0).contains(&share), "{row}");
        // Without any time there is always work left.
        assert!(budget_us > 0 || share == 1.0, "{row}");
    }
    // A line for each, below its heads.
    let csv = run("csv");
    assert!(csv.starts_with("case,budget_us,solves,"), "{csv}");
    assert_eq!(csv.lines().count(), 1 + CASES.len() * BUDGETS_US.len());
    assert!(run("text").starts_with("How much later"));
}
