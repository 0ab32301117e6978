//! The explanation of a key.

use std::path::Path;

use crate::config::{CycleConfig, Layers, explain};

#[test]
fn an_explanation_says_what_a_key_is_and_where_its_value_comes_from() {
    let text = "[cycle]\nperiod_ms = 2.0\n";
    let layers = Layers::default()
        .text(text, Path::new("robot.toml"))
        .unwrap();
    let settings = layers.settings().unwrap();
    assert_eq!(
        explain("cycle.period_ms", &settings).unwrap(),
        "cycle.period_ms\n  Period of the loop, 0.1 to 100 ms, and at least twice gather_lead_ms.\n  type      number\n  \
         range     0.1 to 100 ms, at least twice cycle.gather_lead_ms\n  default   5.0\n  value     2.0\n  from      robot.toml, line 2\n  variable  \
         CDCR_CYCLE_PERIOD_MS\n"
    );
    let table = explain("cycle", &settings).unwrap();
    for (name, _) in toml::Table::try_from(CycleConfig::default()).unwrap() {
        assert!(
            table.contains(&format!("\ncycle.{name}\n")),
            "{name}: {table}"
        );
    }
    let section = explain("robot.sections[1].length_m", &settings).unwrap();
    assert!(
        section.contains("value     0.3, 0.3, 0.3 (base first)"),
        "{section}"
    );
    let kind = explain("link.kind", &settings).unwrap();
    assert!(kind.contains("\"driver\": A driver process"), "{kind}");
    let error = explain("cycle.perod_ms", &settings)
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "unknown key cycle.perod_ms: did you mean cycle.period_ms?"
    );
}
