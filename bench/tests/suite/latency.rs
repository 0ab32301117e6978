//! Results of `cdcr-bench latency` from a few samples.

use cdcr_bench::latency::declared;

use crate::{is_sound, list, machine, number, printed_json, program, row};

/// Two rounds with another period: each leg has its samples, and no effect precedes its cause.
#[test]
fn every_way_is_measured_in_every_round() {
    let _machine = machine();
    let line = "latency --rounds 2 --samples 10 --period 10ms --format json";
    let json = printed_json(&mut program(line));
    assert_eq!(json["setting"]["period_us"], 10_000.0);
    assert_eq!(json["targets"][0]["limit_us"], 10_100.0);
    let legs = list(&json, "legs");
    let names: Vec<_> = legs.iter().filter_map(|row| row["leg"].as_str()).collect();
    let declared: Vec<_> = declared().legs.into_iter().map(|[leg, ..]| leg).collect();
    assert_eq!(names, declared);
    let row = |leg| row(&json, "legs", "leg", leg);
    for (leg, least, most) in [
        ("reference.command", 20.0, f64::MAX),
        ("obstacle.grid", 20.0, f64::MAX),
        ("measurement.machinery", 20.0, f64::MAX),
        ("lease.answer", 20.0, f64::MAX),
        ("stop.zero_command", 8.0, 8.0),
        ("stop.grid", 8.0, 8.0),
        ("ipc.one_way", 160.0, 160.0),
    ] {
        let row = row(leg);
        assert!((least..=most).contains(&number(row, "samples")), "{row}");
    }
    let least = |leg| number(&row(leg)["latency_us"], "min");
    assert!(least("ipc.round_trip") >= least("ipc.one_way"));
    assert!(least("command.release") >= least("command.handover"));
    assert!(least("command.handover") >= least("command.hop"));
    assert!(least("command.hop") > 0.0);
    let looks = &json["setting"]["looks"];
    assert!(number(looks, "all") > 0.0 && number(looks, "late") <= number(looks, "all"));
    is_sound(&json, &[2]);
    for count in ["spoilt_stops", "without_command"] {
        assert!(json["unmeasured"][count].is_u64(), "{count}");
    }
}
