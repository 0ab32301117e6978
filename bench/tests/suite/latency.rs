//! Results of `cdcr-bench latency` from a few samples.

use cdcr_bench::latency::Leg;

use crate::{is_sound, list, machine, number, printed_json, program};

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
    assert_eq!(names, Leg::ALL.map(Leg::name));
    for (leg, least, most) in [
        (Leg::ReferenceCommand, 20.0, f64::MAX),
        (Leg::ObstacleGrid, 20.0, f64::MAX),
        (Leg::MeasurementMachinery, 20.0, f64::MAX),
        (Leg::LeaseAnswer, 20.0, f64::MAX),
        (Leg::StopZeroCommand, 8.0, 8.0),
        (Leg::StopGrid, 8.0, 8.0),
        (Leg::BareOneWay, 160.0, 160.0),
    ] {
        let row = &legs[leg as usize];
        assert!((least..=most).contains(&number(row, "samples")), "{row}");
    }
    let least = |leg: Leg| number(&legs[leg as usize]["latency_us"], "min");
    assert!(least(Leg::BareRoundTrip) >= least(Leg::BareOneWay));
    assert!(least(Leg::CommandRelease) >= least(Leg::CommandHandover));
    assert!(least(Leg::CommandHandover) >= least(Leg::CommandHop));
    assert!(least(Leg::CommandHop) > 0.0);
    let looks = &json["setting"]["looks"];
    assert!(number(looks, "all") > 0.0 && number(looks, "late") <= number(looks, "all"));
    is_sound(&json, &[2]);
    for count in ["spoilt_stops", "without_command"] {
        assert!(json["unmeasured"][count].is_u64(), "{count}");
    }
}
