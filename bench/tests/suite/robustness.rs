//! What `cdcr-bench robustness` hands over, from one seed.

use std::process::Command;

use serde_json::Value;

#[test]
fn every_robot_has_every_part_of_the_controller_switched_off() {
    let output = Command::new(env!("CARGO_BIN_EXE_cdcr-bench"))
        .args(["robustness", "--seeds", "1", "--format", "json"])
        .output()
        .expect("the program runs");
    assert!(output.status.success());
    let document: Value = serde_json::from_slice(&output.stdout).expect("one object");
    let rows = document["scenarios"].as_array().expect("a list");
    let mean_mm = |name: &str, controller: &str, interface: &str| {
        let row = rows.iter().find(|row| {
            row["name"] == name && row["controller"] == controller && row["interface"] == interface
        });
        row.expect(name)["mean_error_mm"].as_f64().expect("a mean")
    };
    for interface in ["position", "velocity"] {
        let of = |name: &str, controller: &str| mean_mm(name, controller, interface);
        assert!(of("ideal", "full") < 1e-9);
        assert!(of("30 µm of noise", "full") < 0.3 * of("30 µm of noise", "no estimator"));
        let lag = "lag 30 ms, delay 15 ms";
        assert!(of(lag, "full") < of(lag, "no actuator model"));
        assert!(of("wrong model", "full") < 0.01 * of("wrong model", "no tip"));
        assert!(of("blind", "full") < 0.2 * of("blind", "open loop"));
    }
    let kept = rows.iter().filter(|row| row["reached"] == "yes").count();
    assert!(kept >= 12, "{kept} of the targets");
    let ball = rows.iter().find(|row| row["name"] == "laboratory, ball");
    assert!(ball.expect("a ball")["min_clearance_mm"].as_f64() > Some(5.0));
}
