//! Results of `cdcr-bench robustness` from one seed, compared with the committed results.

use cdcr_bench::dataset::ShownTable;
use serde_json::Value;

use crate::results::result;
use crate::{list, number, printed_json, program};

/// Each new row has the numbers of the committed row with the same `keys`.
fn are_those(new: &[Value], committed: &[Value], keys: &[&str], numbers: &[&str]) {
    assert!(!is_whole() || new.len() == committed.len());
    for new in new {
        let is_it = |old: &&Value| keys.iter().all(|key| old[key] == new[key]);
        let old = committed.iter().find(is_it).expect("its row");
        for key in numbers {
            same(number(new, key), number(old, key), old);
        }
    }
}

fn same(found: f64, expected: f64, what: &Value) {
    let how = "see the command in bench/README.md";
    let is_same = (found / expected - 1.0).abs() < 1e-6;
    assert!(is_same, "{what}: {found}, committed {expected}; {how}");
}

/// Today's tables have the heads of the committed ones, and their lines of this name, which do not depend on seeds.
fn are_those_tables(today: &Value, committed: &Value, name: &str) {
    let tables = |document: &Value| serde_json::from_value(document["tables"].clone());
    let [new, old]: [Vec<ShownTable>; 2] = [today, committed].map(|it| tables(it).expect("tables"));
    let mut count = 0;
    for (new, old) in new.iter().zip(&old) {
        assert_eq!((&new.title, &new.heads), (&old.title, &old.heads));
        for line in new.lines.iter().filter(|line| line[0] == name) {
            assert!(old.lines.contains(line), "{line:?}");
            count += 1;
        }
    }
    assert!(count > 0, "no line {name}");
}

/// The present result of the part named `only`, or of everything with `CDCR_WHOLE`.
fn of_today(line: &str, only: &str) -> Value {
    let part = format!("--only {only}");
    let part = if is_whole() { "" } else { &part };
    let line = format!("robustness --format json {line} {part}");
    printed_json(&mut program(&line))
}

fn is_whole() -> bool {
    std::env::var_os("CDCR_WHOLE").is_some()
}

/// Without its part, a robot that needs it has at least this multiple of the number.
#[rustfmt::skip]
const PARTS: [(&str, &str, &str, f64); 9] = [
    ("30 µm of noise", "first version", "mean_error_mm", 1.0 / 0.3),
    ("lag 30 ms, delay 15 ms", "no actuator model", "mean_error_mm", 1.0),
    ("wrong model", "no tip", "mean_error_mm", 100.0),
    ("play of 0.5 mm", "no actuator model", "mean_error_mm", 5.0),
    ("slow", "first version", "mean_error_mm", 10.0),
    ("30 µm of noise", "no filter", "rate_change_rms", 50.0),
    ("tip alone, 0.5 mm", "no filter", "mean_error_mm", 2.0),
    ("wrong model, spiral", "no offset along the way", "settled_error_mm", 2.0),
    ("laboratory", "no weight on rates", "rest_rate_rad_s", 5.0),
];

#[test]
fn every_robot_has_every_part_of_the_controller_switched_off() {
    let committed = result("results/robustness.json");
    let rows = list(&committed, "scenarios");
    let of = |name: &str, controller: &str, interface: &str, key: &str| {
        let expected = [name, controller, interface];
        let is_it = |row: &&Value| ["name", "controller", "interface"].map(|k| &row[k]) == expected;
        let row = rows.iter().find(is_it);
        number(row.unwrap_or_else(|| panic!("{expected:?}")), key)
    };
    for (name, without, key, times) in PARTS {
        for interface in ["position", "velocity"] {
            let [with, without] = ["full", without].map(|it| of(name, it, interface, key));
            assert!(without > times * with, "{name}: {without}, {with} with it");
            assert!(of("ideal", "full", interface, "mean_error_mm") < 1e-9);
        }
    }
    let full = |name: &str, key: &str| of(name, "full", "position", key);
    // All targets are reached.
    for row in rows {
        assert!(row["controller"] != "full" || row["ok"] == true, "{row}");
        assert!(number(row, "limit_excess") <= 1e-9, "{row}");
    }
    assert!(rows.iter().any(|row| row["plant"] == "laboratory"));
    // A known play must not make a robot at rest oscillate more than noise does without play.
    let lagging = "lag 20 ms, tip at 100 Hz";
    let with_play = format!("{lagging}, play of 0.5 mm");
    assert!(full(&with_play, "rest_error_mm") < full(lagging, "rest_error_mm"));
    let near = |name, controller| of(name, controller, "position", "min_clearance_mm");
    assert!(near("5 % longer, ball", "no margin") < 0.0);
    assert!(near("laboratory, ball", "full") > 5.0);
}

/// The present code reproduces the committed first seed of each metric, and each robot with lag.
#[test]
fn what_robots_do_that_are_not_their_model_is_what_was_committed() {
    let today = of_today("--seeds 1", "laboratory");
    let committed = result("results/robustness.json");
    let [new, old] = [&today, &committed].map(|document| list(document, "metrics"));
    assert!(!is_whole() || new.len() == old.len());
    for new in new {
        let old = old.iter().find(|old| old["name"] == new["name"]);
        let [new_mm, old_mm] = [new, old.expect("its metric")].map(|of| of["rounds"][0].as_f64());
        same(new_mm.unwrap(), old_mm.unwrap(), &new["name"]);
    }
    let [new, old] = [&today, &committed].map(|document| list(document, "scenarios"));
    assert!(!is_whole() || new.len() == old.len());
    let is_steady = |row: &&Value| {
        let name = row["name"].as_str().expect("a name");
        // Oscillations depend on the last bits, and noise on the seeds.
        let is_noisy = name.contains("tip");
        name.starts_with("lag") && !is_noisy && row["controller"] != "first version"
    };
    let [new, old] = [new, old].map(|rows| rows.iter().filter(is_steady).cloned());
    let [new, old] = [new, old].map(Iterator::collect::<Vec<Value>>);
    let numbers = ["mean_error_mm", "settled_error_mm", "max_error_mm"];
    are_those(&new, &old, &["name", "controller", "interface"], &numbers);
    are_those_tables(&today, &committed, "ideal");
}

#[test]
fn what_the_knobs_do_is_what_was_committed() {
    let (today, committed) = (of_today("--sweep", "preset"), result("results/tuning.json"));
    let [new, old] = [&today, &committed].map(|document| list(document, "knobs"));
    let errors = ["mean_error_mm", "max_error_mm"];
    for numbers in [errors, ["rate_change_rms", "cables_rate_change_rms"]] {
        are_those(new, old, &["knob", "turned_to", "value"], &numbers);
    }
    are_those_tables(&today, &committed, "preset");
}
