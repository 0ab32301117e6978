//! What `cdcr-bench robustness` hands over, from one seed, and what was committed of it.

use std::path::Path;

use serde_json::Value;

use crate::{list, number, printed_json, program};

/// A result in the documents.
fn committed(name: &str) -> Value {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/results");
    let text = std::fs::read_to_string(place.join(name)).expect("the result");
    serde_json::from_str(&text).expect("one object")
}

/// Each row of today has the numbers of the committed row with the same `keys`.
fn are_those(new: &[Value], committed: &[Value], keys: &[&str], numbers: &[&str]) {
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

/// The result of today's code, of the part named `only`, and of everything with `CDCR_WHOLE`.
fn of_today(line: &str, only: &str) -> Value {
    let part = format!("--only {only}");
    let part = if is_whole() { "" } else { &part };
    printed_json(&mut program(&format!(
        "robustness --format json {line} {part}"
    )))
}

fn is_whole() -> bool {
    std::env::var_os("CDCR_WHOLE").is_some()
}

#[test]
fn what_robots_do_that_are_not_their_model_is_what_was_committed() {
    is_what_was_committed(&of_today("--seeds 1", "laboratory"));
}

#[test]
fn every_robot_has_every_part_of_the_controller_switched_off() {
    let committed = committed("robustness.json");
    let rows = list(&committed, "scenarios");
    let mean_mm = |name: &str, controller: &str, interface: &str| {
        let row = rows.iter().find(|row| {
            row["name"] == name && row["controller"] == controller && row["interface"] == interface
        });
        number(row.expect(name), "mean_error_mm")
    };
    for interface in ["position", "velocity"] {
        let of = |name: &str, controller: &str| mean_mm(name, controller, interface);
        assert!(of("ideal", "full") < 1e-9);
        assert!(of("30 µm of noise", "full") < 0.3 * of("30 µm of noise", "first version"));
        let lag = "lag 30 ms, delay 15 ms";
        assert!(of(lag, "full") < of(lag, "no actuator model"));
        assert!(of("wrong model", "full") < 0.01 * of("wrong model", "no tip"));
        let play = "play of 0.5 mm";
        assert!(of(play, "full") < 0.2 * of(play, "no actuator model"));
        assert!(of("slow", "full") < 0.1 * of("slow", "first version"));
    }
    // What a part is for shows on a robot that needs it.
    let parts = [
        ("30 µm of noise", "no filter", "rate_change_rms", 50.0),
        ("tip alone, 0.5 mm", "no filter", "mean_error_mm", 2.0),
        (
            "wrong model, spiral",
            "no offset along the way",
            "settled_error_mm",
            2.0,
        ),
        ("laboratory", "no weight on rates", "rest_rate_rad_s", 5.0),
    ];
    for (name, controller, key, times) in parts {
        let of = |controller: &str| {
            let mut both = rows.iter().filter(|row| row["name"] == name);
            let row = both.find(|row| row["controller"] == controller);
            number(row.expect(name), key)
        };
        let [with, without] = ["full", controller].map(of);
        assert!(
            without > times * with,
            "{name}: {without} without, {with} with {controller}"
        );
    }
    let of = |name: &str, key: &str| {
        let row = rows
            .iter()
            .find(|row| row["name"] == name && row["controller"] == "full");
        number(row.expect(name), key)
    };
    // Shorter or longer, on either way.
    for name in [
        "wrong model",
        "wrong model, 5 % shorter",
        "wrong model, spiral",
        "wrong model, 5 % shorter, lower spiral",
    ] {
        assert!(of(name, "settled_error_mm") < 0.2, "{name}");
    }
    let full = rows.iter().filter(|row| row["controller"] == "full");
    assert!(full.clone().any(|row| row["plant"] == "laboratory"));
    for row in full {
        assert_eq!(row["ok"], true, "{row}");
    }
    for row in rows {
        assert!(row["limit_excess"].as_f64() <= Some(1e-9), "{row}");
    }
    let rms_mm = of("30 µm of noise, standard deviation", "rms_error_mm");
    assert!(rms_mm < 0.15, "{rms_mm}");
    // A known play makes a robot at rest swing no farther than noise does without play.
    let lagging = "lag 20 ms, tip at 100 Hz";
    let with_play = format!("{lagging}, play of 0.5 mm");
    assert!(of(&with_play, "rest_error_mm") < of(lagging, "rest_error_mm"));
    let margin = rows.iter().find(|row| row["controller"] == "no margin");
    assert!(margin.expect("a robot that is longer")["min_clearance_mm"].as_f64() < Some(0.0));
    let ball = rows.iter().find(|row| row["name"] == "laboratory, ball");
    assert!(ball.expect("a ball")["min_clearance_mm"].as_f64() > Some(5.0));
}

/// The committed result is that of today's code: the first seed of each robot with noise, and each robot that lags.
fn is_what_was_committed(document: &Value) {
    let committed = committed("robustness.json");
    let metrics = list(&committed, "metrics");
    for new in list(document, "metrics") {
        let old = metrics.iter().find(|old| old["name"] == new["name"]);
        let [new_mm, old_mm] = [new, old.expect("its metric")].map(|of| of["rounds"][0].as_f64());
        same(new_mm.unwrap(), old_mm.unwrap(), &new["name"]);
    }
    let [new, old] = [document, &committed].map(|document| list(document, "scenarios"));
    assert!(!is_whole() || list(document, "metrics").len() == metrics.len());
    assert!(!is_whole() || new.len() == old.len());
    let is_steady = |row: &&Value| {
        let name = row["name"].as_str().expect("a name");
        // What oscillates goes by the last bits, and what is noisy by the seeds.
        let is_noisy = name.contains("tip");
        name.starts_with("lag") && !is_noisy && row["controller"] != "first version"
    };
    let steady: Vec<Value> = new.iter().filter(is_steady).cloned().collect();
    let numbers = ["mean_error_mm", "settled_error_mm", "max_error_mm"];
    are_those(&steady, old, &["name", "controller", "interface"], &numbers);
}

#[test]
fn what_the_knobs_do_is_what_was_committed() {
    let (today, committed) = (of_today("--sweep", "preset"), committed("tuning.json"));
    let [new, old] = [&today, &committed].map(|document| list(document, "knobs"));
    assert!(!is_whole() || new.len() == old.len());
    let numbers = [
        "mean_error_mm",
        "max_error_mm",
        "rate_change_rms",
        "cables_rate_change_rms",
    ];
    are_those(new, old, &["knob", "turned_to", "value"], &numbers);
}
