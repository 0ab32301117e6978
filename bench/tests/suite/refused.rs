//! Invalid arguments are rejected with a reason before any measurement.

use crate::{program, stderr};

/// Arguments, and words of the error.
const REFUSED: &str = "\
deadline --duration=2s --rounds=9 --setup=ordinary => less than a second
deadline --load=nonsense => nonsense
deadline --setup=ordinary --config=/no/such/file.toml => /no/such/file.toml
deadline --setup=ordinary --period=1ns => cycle.period_ms
deadline --rounds=0 => 1..=1000
latency --samples 1 => 5..=10000
latency --quick --rounds 3 => cannot be used with
latency --period soon => --period
latency --rounds 1 --samples 5 --config /no/such/file.toml => /no/such/file.toml
rate --spin 2000 => 0 to 1000
rate --spin NaN => 0 to 1000
rate --rounds 0 => 1..=100
rate --quick --rounds 2 => cannot be used with
footprint --duration 1ms => must be 0.1 s to 3600 s
footprint --rounds 0 => 1..=100
footprint --quick --rounds 2 => cannot be used with
all --quick --only budget --out /dev/null/inside => cannot create the folder /dev/null/inside
all --quick --out nowhere --config nowhere.toml => no file nowhere.toml
robustness --only nonsense => see docs/robustness.md for the names
robustness --sweep --only nonsense => see docs/tuning.md for the keys
";

#[test]
fn what_cannot_be_measured_is_refused_with_a_reason() {
    for line in REFUSED.lines() {
        let (arguments, reason) = line.split_once(" => ").unwrap();
        let output = program(arguments).output().unwrap();
        let errors = stderr(&output);
        assert!(!output.status.success(), "{arguments}");
        assert!(errors.contains(reason), "{arguments}: {errors}");
    }
}
