//! The demo: one command, everything real.

use cdcr_tests::Place;
use serde_json::Value;

fn demo(place: &Place, arguments: &[&str]) -> (bool, String, String) {
    let output = place
        .command("cdcrctl")
        .arg("demo")
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.success(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

#[test]
fn the_demo_prints_one_json_object_with_every_field() {
    let place = Place::new();
    for sections in ["1", "3"] {
        let arguments = [
            "--sections",
            sections,
            "--duration",
            "1s",
            "--format",
            "json",
        ];
        let (good, out, err) = demo(&place, &arguments);
        assert!(good, "{err}");
        let report: Value = serde_json::from_str(&out).expect("one JSON object");
        assert_eq!(report["sections"].to_string(), sections);
        // The machine may stall; how exact the tracking is, is measured by the demo itself.
        assert!(report["mean_error_mm"].as_f64().unwrap() < 1.0, "{out}");
        assert!(
            report["max_error_mm"].as_f64().unwrap() >= report["mean_error_mm"].as_f64().unwrap()
        );
        assert!(report["cycles"].as_u64().unwrap() > 20, "{out}");
        let missing = report["realtime_missing"].as_array().unwrap();
        assert_eq!(report["realtime"].as_bool().unwrap(), missing.is_empty());
        for field in ["deadline_misses", "skipped_periods"] {
            assert!(report[field].is_u64(), "{field}: {out}");
        }
        for field in ["wake_us", "solve_us", "response_us"] {
            let [p50, p99, max] =
                ["p50", "p99", "max"].map(|key| report[field][key].as_f64().unwrap());
            assert!(0.0 < p50 && p50 <= p99 && p99 <= max, "{field}: {out}");
        }
    }
}

#[test]
fn the_demo_writes_telemetry_and_pictures() {
    let place = Place::new();
    let folder = place.folder().join("out");
    let folder_text = folder.to_str().unwrap();
    let (good, out, err) = demo(&place, &["--duration", "500ms", "--out", folder_text]);
    assert!(good, "{err}");
    assert!(out.contains("mm"), "{out}");
    let table = std::fs::read_to_string(folder.join("telemetry.csv")).unwrap();
    let head = table.lines().next().unwrap();
    assert!(head.contains("error_m") && head.contains("_us"), "{head}");
    assert!(
        table.lines().count() > 20,
        "{} lines",
        table.lines().count()
    );
    for picture in ["path.svg", "error.svg", "timing.svg"] {
        let text = std::fs::read_to_string(folder.join(picture)).unwrap();
        assert!(
            text.contains("<svg") && text.trim_end().ends_with("</svg>"),
            "{picture}"
        );
    }
}

#[test]
fn the_demo_refuses_what_it_cannot_show() {
    let place = Place::new();
    for arguments in [
        ["--sections", "4"],
        ["--duration", "0s"],
        ["--duration", "1h"],
    ] {
        let (good, _, err) = demo(&place, &arguments);
        assert!(!good && err.contains(arguments[0]), "{err}");
    }
}
