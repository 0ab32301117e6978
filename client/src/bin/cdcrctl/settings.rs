//! The settings of the solver by their keys, as in the table `[controller]` of the configuration.

mod keys;

use std::fmt::Write as _;
use std::io::Write;

use anyhow::bail;
use cdcr_client::{Connection, RequestError};
use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::codes::Outcome;
use serde_json::Value;

use crate::Done;
use crate::args::{Format, SettingsAction, SettingsOptions, Target};
pub(crate) use keys::Change;
use keys::SETTINGS;

/// `cdcrctl settings …`
pub(crate) fn run(target: &Target, options: &SettingsOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let format = match &options.action {
        Some(SettingsAction::Set { changes }) => return set(&connection, changes),
        Some(SettingsAction::Show(show)) => show.format,
        None => options.show.format,
    };
    let settings = connection.settings()?;
    let shown = match format {
        Format::Text => table(settings)?,
        Format::Json => serde_json::to_string_pretty(&object(settings))? + "\n",
    };
    std::io::stdout().write_all(shown.as_bytes())?;
    Ok(Done::Good)
}

fn table(settings: SolverSettings) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    writeln!(out, "{:<26}{:<15}allowed", "setting", "value")?;
    for setting in SETTINGS {
        let (value, allowed) = (setting.text(settings), setting.allowed());
        writeln!(out, "{:<26}{value:<15}{allowed}", setting.key)?;
    }
    Ok(out)
}

/// With the keys and values that `set` understands.
fn object(settings: SolverSettings) -> Value {
    let fields = SETTINGS
        .iter()
        .map(|setting| (setting.key.to_owned(), setting.json(settings)));
    Value::Object(fields.collect())
}

fn set(connection: &Connection, changes: &[Change]) -> anyhow::Result<Done> {
    let before = connection.settings()?;
    let mut after = before;
    for change in changes {
        change.apply(&mut after);
    }
    let response = match connection.change_settings(after) {
        Err(
            error @ RequestError::Refused {
                outcome: Outcome::OutOfRange | Outcome::UnknownCode | Outcome::Unsupported,
                ..
            },
        ) => bail!("{error}\nallowed:\n{}", allowed(changes)),
        answer => answer?,
    };
    let mut out = std::io::stdout().lock();
    for setting in changed(before, after) {
        let (old, new) = (setting.text(before), setting.text(after));
        writeln!(out, "{}: {old} -> {new}", setting.key)?;
    }
    if changed(before, after).next().is_none() {
        writeln!(out, "nothing changes: the settings were so already")?;
    }
    writeln!(
        out,
        "settings: accepted, in effect after cycle {}",
        response.cycle
    )?;
    Ok(Done::Good)
}

fn changed(
    before: SolverSettings,
    after: SolverSettings,
) -> impl Iterator<Item = &'static keys::Setting> {
    let is_changed = move |setting: &&keys::Setting| setting.text(before) != setting.text(after);
    SETTINGS.iter().filter(is_changed)
}

/// What the daemon allows for the settings that were to change.
fn allowed(changes: &[Change]) -> String {
    let lines = changes
        .iter()
        .map(|change| format!("  {} {}", change.setting().key, change.setting().allowed()));
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_can_be_set() {
        let mut settings = SolverSettings {
            solver: 1,
            damping: 1e-14,
            budget_ns: 2_500_000,
            seed: u64::MAX,
            horizon_steps: 3,
            position_weight: 1.0,
            swarm_size: 1,
            ..SolverSettings::default()
        };
        let shown = object(settings);
        for (key, value) in shown.as_object().expect("an object") {
            let value = value.as_str().map_or(value.to_string(), str::to_owned);
            let change = Change::parse(&format!("{key}={value}")).expect("legal");
            change.apply(&mut settings);
        }
        assert_eq!(object(settings), shown);
        assert_eq!((settings.seed, settings.budget_ns), (u64::MAX, 2_500_000));
        let table = table(settings).expect("formatted");
        for line in [
            "solver                    gauss-newton   kpso, gauss-newton or kpso-refined\n",
            "damping                   1e-14          1e-20 to 1\n",
            "budget_ms                 2.5            0 to 100; 0: all that is left of the period\n",
        ] {
            assert!(table.contains(line), "{line} in\n{table}");
        }
    }

    #[test]
    fn only_what_changes_is_named() {
        let before = SolverSettings::default();
        let mut after = before;
        for text in ["rate_weight=1e-6", "inertia=0"] {
            Change::parse(text).expect("legal").apply(&mut after);
        }
        let keys: Vec<_> = changed(before, after).map(|setting| setting.key).collect();
        assert_eq!(keys, ["rate_weight"]);
    }
}
