//! The project's targets for the real-time cases.

use serde_json::Value;

use super::Setup;
use super::report::{Cases, Key, SIGNIFICANCE, misses, misses_p_value};
use super::stretch::Subject;
use crate::dataset::Dataset;
use crate::load::Load;

pub(super) fn add_targets(dataset: &mut Dataset, ratios: &[Value], cases: &Cases, period_us: f64) {
    #[rustfmt::skip]
    let of_ratios = [
        (["wake-up p50, daemon / bare loop", "≤ 1.1 for every load", ""], "wake_p50", None, 1.1),
        (["wake-up p99, daemon / bare loop", "≤ 1.1 for every load", ""], "wake_p99", None, 1.1),
        (["release to command in the client, p50 less wake-up p50, no load", "≤ 40 µs", "µs"],
            "command_beyond_wake_p50_us", Some(Load::None), 40.0),
        (["response p99 under clients that connect, loaded / unloaded", "≤ 1.3", ""],
            "response_p99_to_unloaded", Some(Load::Clients), 1.3),
        (["response p99 under a flood, loaded / unloaded", "≤ 1.3", ""],
            "response_p99_to_unloaded", Some(Load::Flood), 1.3),
    ];
    for (words, key, load, most) in of_ratios {
        let is_it = |row: &&Value| {
            row["realtime"] == true && load.is_none_or(|load: Load| row["load"] == load.name())
        };
        let found = ratios.iter().filter(is_it).filter_map(|row| {
            let of = row["load"].as_str()?.to_owned();
            Some((row[key].as_f64()?, row[format!("{key}_range")].clone(), of))
        });
        let worst = found.max_by(|one, other| one.0.total_cmp(&other.0));
        dataset.target(words, worst, f64::MIN..=most);
    }
    let (mut own, mut due, mut ours, mut theirs) = (0.0, 0, (0, 0), (0, 0));
    for (key, case) in cases {
        let subject = Subject::Bare;
        if (key.setup, key.subject) == (Setup::Realtime, Subject::Daemon) {
            let of_case = misses(&case.rounds);
            own += case.sum("own_misses").unwrap_or(0.0);
            due += of_case.1;
            // Only loads that were measured with both subjects.
            if let Some(bare) = cases.get(&Key { subject, ..*key }) {
                let bare = misses(&bare.rounds);
                ours = (ours.0 + of_case.0, ours.1 + of_case.1);
                theirs = (theirs.0 + bare.0, theirs.1 + bare.1);
            }
        }
    }
    let minutes = format!("{:.1} min", due as f64 * period_us / 60e6);
    let own = (due > 0).then_some((own, Value::Null, minutes));
    dataset.target(
        ["misses with cause compute or fault, all loads", "0", ""],
        own,
        0.0..=0.0,
    );
    let of = format!(
        "{} of {} against {} of {}",
        ours.0, ours.1, theirs.0, theirs.1
    );
    let chance = (ours.1 > 0).then(|| (misses_p_value(ours, theirs), Value::Null, of));
    let what = "misses beyond the bare loop's, all loads: probability by chance";
    dataset.target([what, "not below 0.05", ""], chance, SIGNIFICANCE..=1.0);
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::report::{Case, ratio};
    use super::*;

    #[test]
    fn misses_are_judged_for_all_loads_together_and_ratios_by_the_worst_load() {
        use Subject::{Bare, Cyclictest, Daemon};
        let mut cases = Cases::new();
        for (load, subject, misses, own, wake_us) in [
            (Load::None, Daemon, 1, 0, 10.0),
            (Load::None, Bare, 2, 0, 10.0),
            (Load::Cpu, Daemon, 3, 2, 26.0),
            (Load::Cpu, Bare, 2, 0, 20.0),
            (Load::Cpu, Cyclictest, 9000, 0, 20.0),
            (Load::Io, Daemon, 0, 0, 90.0),
        ] {
            let (setup, mut case) = (Setup::Realtime, Case::new().unwrap());
            case.rounds = vec![json!({
                "cycles": 11_000, "skipped_periods": 1000, "deadline_misses": misses, "own_misses": own,
                "wake_us": { "p50": wake_us },
            })];
            cases.insert(
                Key {
                    setup,
                    load,
                    subject,
                },
                case,
            );
        }
        let mut dataset = Dataset::default();
        let ratios = [Load::None, Load::Cpu].map(|load| Key {
            setup: Setup::Realtime,
            load,
            subject: Daemon,
        });
        let ratios = ratios.map(|key| ratio(&mut dataset, key, &cases).unwrap());
        add_targets(&mut dataset, &ratios, &cases, 5000.0);
        let found = dataset.targets.iter();
        let found = found.map(|row| {
            [&row["found"], &row["of"], &row["reached"]]
                .map(Value::to_string)
                .join(" ")
        });
        let found: Vec<_> = found.collect();
        assert_eq!(found[0], "1.3 \"cpu\" false");
        assert_eq!(found[1], "2.0 \"3.0 min\" false");
        assert!(found[2].contains("4 of 24000 against 4 of 24000") && found[2].ends_with("true"));
        assert_eq!(found.len(), 3, "{found:?}");
    }
}
