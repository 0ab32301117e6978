//! The solver settings by their keys, as in the table `[controller]` of the configuration.

pub(crate) mod save;

use std::fmt::Write as _;
use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{bail, ensure};
use cdcr_client::model::{broken_bound, moves_away};
use cdcr_client::{Connection, LinkError, RequestError, STATUS_TIMEOUT, section_lengths_m};
use cdcr_controller::nmpc::{
    budget_warning, posture_gain_warning, rate_change_weight_warning, rate_weight_warning,
    safe_distance_warning,
};
use cdcr_shared_types::codes::Outcome;
use cdcr_shared_types::{SolverSettings, Status, Telemetry};
use serde_json::Value;

use crate::args::{Format, SettingsAction, SettingsOptions, Target};
use crate::done::Done;
use crate::setting::{Setting, SettingChange};

/// Time for which the solves are monitored for the new budget.
const MONITOR_TIME: Duration = Duration::from_millis(300);
/// Largest time by which an uncut solve may end before its budget \[ns\].
const CUT_NS: u64 = 50_000;

pub(crate) fn run(target: &Target, options: &SettingsOptions) -> anyhow::Result<Done> {
    if let Some(SettingsAction::Set { changes }) = &options.action {
        check_once(changes)?;
    }
    let connection = target.connect()?;
    let format = match &options.action {
        Some(SettingsAction::Set { changes }) => return set(&connection, changes),
        Some(SettingsAction::Save { file }) => return save::run(&connection, file.as_deref()),
        Some(SettingsAction::Show(show)) => show.format,
        None => options.show.format,
    };
    let settings = connection.settings()?;
    let shown = match format {
        Format::Text => table(settings, &connection.status(STATUS_TIMEOUT)?)?,
        Format::Json => serde_json::to_string_pretty(&object(settings))? + "\n",
    };
    std::io::stdout().write_all(shown.as_bytes())?;
    warn_of(&connection, Setting::all(), settings)?;
    Ok(Done::Good)
}

/// Warns of values that are probably unintended, as `cdcrd check` does.
fn warn_of(
    connection: &Connection,
    of: impl Iterator<Item = Setting>,
    settings: SolverSettings,
) -> anyhow::Result<()> {
    let of: Vec<_> = of.collect();
    let status = connection.status(STATUS_TIMEOUT)?;
    let unusual = of.iter().filter_map(|setting| setting.warning(settings));
    for warning in unusual.chain(unintended(&of, settings, &status)) {
        tell!("warning: {warning}");
    }
    Ok(())
}

/// Of those among `of`, values that do not fit the daemon's robot.
fn unintended(of: &[Setting], settings: SolverSettings, status: &Status) -> Vec<String> {
    let is_among = |key: &str| of.iter().any(|setting| setting.key == key);
    let lengths_m = section_lengths_m(&status.robot);
    let (sections, auto) = (lengths_m.len(), status.rate_weight_auto);
    let distance = safe_distance_warning(settings.safe_distance_m, lengths_m.iter().sum());
    let weight = rate_weight_warning(settings.rate_weight, sections, auto == 0.0);
    let weight = weight.map(|warning| format!("{warning}; without the key it is {auto}"));
    let change = rate_change_weight_warning(
        settings.rate_weight,
        settings.rate_change_weight,
        status.period_ns as f64 / 1e9,
        sections,
    );
    let posture = posture_gain_warning(
        settings.posture_gain,
        settings.rate_weight,
        settings.horizon_steps,
    );
    let budget = budget_warning(settings.budget_ns as f64 / 1e6);
    let all = [
        ("safe_distance_m", distance),
        ("rate_weight", weight),
        ("rate_change_weight", change),
        ("posture_gain", posture),
        ("budget_ms", budget),
    ];
    all.into_iter()
        .filter_map(|(key, warning)| warning.filter(|_| is_among(key)))
        .collect()
}

fn table(settings: SolverSettings, status: &Status) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    writeln!(out, "{:<26}{:<15}allowed", "setting", "value")?;
    for setting in Setting::all() {
        let (value, allowed) = (setting.text(settings), setting.allowed_by(status));
        writeln!(out, "{:<26}{value:<14} {allowed}", setting.key)?;
    }
    Ok(out)
}

/// With the keys and values that `set` accepts.
fn object(settings: SolverSettings) -> Value {
    let fields = Setting::all().map(|setting| (setting.key.to_owned(), setting.json(settings)));
    Value::Object(fields.collect())
}

/// Refuses two values for one setting.
fn check_once(changes: &[SettingChange]) -> anyhow::Result<()> {
    for (index, change) in changes.iter().enumerate() {
        let key = change.key();
        let is_new = changes[..index].iter().all(|earlier| earlier.key() != key);
        ensure!(is_new, "{key} is given twice: give each setting one value");
    }
    Ok(())
}

fn set(connection: &Connection, changes: &[SettingChange]) -> anyhow::Result<Done> {
    let before = connection.settings()?;
    let mut after = before;
    let is_auto = changes.iter().any(SettingChange::is_auto);
    let status = is_auto.then(|| connection.status(STATUS_TIMEOUT));
    let rate_weight_auto = status
        .transpose()?
        .map_or(0.0, |status| status.rate_weight_auto);
    for change in changes {
        change.apply(&mut after, rate_weight_auto);
    }
    if let Some(warning) = moves_away(&before, &after, &connection.status(STATUS_TIMEOUT)?) {
        tell!("warning: {warning}");
    }
    let response = match connection.change_settings(after) {
        Err(
            error @ RequestError::Refused {
                outcome: Outcome::OutOfRange,
                ..
            },
        ) => match broken_bound(&after, &connection.status(STATUS_TIMEOUT)?) {
            Some(bound) => bail!("cannot change settings: {bound}"),
            None => return Err(error.into()),
        },
        answer => answer?,
    };
    let mut out = std::io::stdout().lock();
    for setting in changed(before, after) {
        let (old, new) = (setting.text(before), setting.text(after));
        writeln!(out, "{}: {old} -> {new}", setting.key)?;
    }
    if changed(before, after).next().is_none() {
        writeln!(
            out,
            "nothing to change: these settings are already in effect"
        )?;
    }
    writeln!(
        out,
        "settings: accepted, in effect after cycle {}",
        response.cycle
    )?;
    warn_of(connection, changed(before, after), after)?;
    if after.budget_ns > 0
        && let Some(solve_ns) = longest_cut_solve_ns(connection, response.cycle)?
    {
        writeln!(
            out,
            "the solver budget is cut to {:.3} ms, because the other parts of the period need the rest \
             (docs/realtime.md)",
            solve_ns as f64 * 1e-6
        )?;
    }
    Ok(Done::Good)
}

/// The longest solve after `cycle` that was cut before its budget \[ns\]; `None` without one, or when the
/// robot does not track.
fn longest_cut_solve_ns(connection: &Connection, cycle: u64) -> Result<Option<u64>, LinkError> {
    let mut telemetry = connection.telemetry()?;
    let deadline = Instant::now() + MONITOR_TIME;
    let mut longest_ns = None;
    while let Some(record) =
        telemetry.next_within(deadline.saturating_duration_since(Instant::now()))?
    {
        if record.cycle > cycle {
            longest_ns = longest_ns.max(cut_solve_ns(&record));
        }
        if Instant::now() >= deadline {
            break;
        }
    }
    Ok(longest_ns)
}

/// Duration of a solve that was cut before its budget \[ns\].
fn cut_solve_ns(record: &Telemetry) -> Option<u64> {
    let solve_ns = record.solve_end_ns.saturating_sub(record.solve_start_ns);
    let is_cut = record.report.budget_spent == 1 && solve_ns + CUT_NS < record.settings.budget_ns;
    is_cut.then_some(solve_ns)
}

fn changed(before: SolverSettings, after: SolverSettings) -> impl Iterator<Item = Setting> {
    let is_changed = move |setting: &Setting| setting.text(before) != setting.text(after);
    Setting::all().filter(is_changed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solve_is_cut_that_ends_unfinished_and_before_its_budget() {
        let mut record = Telemetry::default();
        record.settings.budget_ns = 4_900_000;
        record.solve_start_ns = 1_000_000;
        record.solve_end_ns = 5_200_000;
        assert_eq!(cut_solve_ns(&record), None, "it was done");
        record.report.budget_spent = 1;
        assert_eq!(cut_solve_ns(&record), Some(4_200_000));
        record.solve_end_ns = 5_901_000;
        assert_eq!(cut_solve_ns(&record), None, "it had its time");
    }

    #[test]
    fn what_does_not_fit_the_robot_is_warned_of_where_it_is_set() {
        let mut status = Status {
            rate_weight_auto: 1e-10,
            ..Status::default()
        };
        status.robot.sections = 2;
        for section in &mut status.robot.section[..2] {
            section.length_m = 0.15;
        }
        let settings = SolverSettings {
            safe_distance_m: 10.0,
            ..SolverSettings::default()
        };
        let all: Vec<_> = Setting::all().collect();
        let [distance, weight] = unintended(&all, settings, &status).try_into().unwrap();
        assert!(
            distance.contains("longer than the robot of 0.300 m"),
            "{distance}"
        );
        assert!(
            weight.ends_with("without the key it is 0.0000000001"),
            "{weight}"
        );
        assert_eq!(unintended(&[], settings, &status), [""; 0]);
        status.rate_weight_auto = 0.0;
        assert_eq!(unintended(&all, settings, &status).len(), 1);
        let posture = SolverSettings {
            posture_gain: 2.0,
            ..SolverSettings::default()
        };
        let posture = unintended(&all, posture, &status).join("");
        assert!(
            posture.starts_with("posture_gain = 2 has no effect"),
            "{posture}"
        );
        let short = SolverSettings {
            budget_ns: 1_000,
            ..SolverSettings::default()
        };
        let budget = unintended(&all, short, &status).join("");
        assert!(
            budget.starts_with("budget_ms = 0.001 is too short"),
            "{budget}"
        );
    }

    #[test]
    fn what_is_shown_can_be_set() {
        let mut settings = SolverSettings {
            solver: 1,
            damping: 1e-14,
            budget_ns: 100,
            seed: u64::MAX,
            horizon_steps: 3,
            position_weight: 1.0,
            swarm_size: 1,
            ..SolverSettings::default()
        };
        let shown = object(settings);
        for (key, value) in shown.as_object().expect("an object") {
            let value = value.as_str().map_or(value.to_string(), str::to_owned);
            let change = SettingChange::parse(&format!("{key}={value}")).expect("legal");
            change.apply(&mut settings, 0.0);
        }
        assert_eq!(object(settings), shown);
        assert_eq!((settings.seed, settings.budget_ns), (u64::MAX, 100));
        let status = Status {
            safe_distance_min_m: 0.02,
            period_ns: 5_000_000,
            ..Status::default()
        };
        let table = table(settings, &status).expect("formatted");
        for line in [
            "solver                    gauss-newton   kpso, gauss-newton or kpso-refined\n",
            "damping                   1e-14          1e-20 to 1\n",
            "budget_ms                 1e-4           0 to 5; 0: all the remaining period\n",
            "safe_distance_m           0              0.02 to 10; no less than in the configuration\n",
        ] {
            assert!(table.contains(line), "{line} in\n{table}");
        }
    }

    #[test]
    fn a_refusal_names_the_bound_that_was_broken() {
        let status = Status {
            safe_distance_min_m: 0.01,
            period_ns: 5_000_000,
            ..Status::default()
        };
        let legal = SolverSettings {
            horizon_steps: 2,
            safe_distance_m: 0.01,
            obstacle_slope_penalty: 1e4,
            ..SolverSettings::default()
        };
        assert_eq!(broken_bound(&legal, &status), None);
        for (change, bound) in [
            ("safe_distance_m=0.005", "below the configured 0.01"),
            (
                "budget_ms=9",
                "budget_ms = 9 is longer than the period of the daemon: at most 5",
            ),
            (
                "control_blocks=3",
                "control_blocks = 3 is out of range: allowed is 0 to 2",
            ),
            (
                "obstacle_step_penalty=1e12",
                "obstacle_slope_penalty = 10000 is out of range",
            ),
        ] {
            let mut wanted = legal;
            SettingChange::parse(change)
                .expect("in its range")
                .apply(&mut wanted, 0.0);
            let reported = broken_bound(&wanted, &status).expect(change);
            assert!(reported.contains(bound), "{change}: {reported}");
        }
    }

    #[test]
    fn two_values_for_one_setting_are_refused() {
        let changes = |texts: &[&str]| -> Vec<_> {
            let parsed = texts.iter().map(|text| SettingChange::parse(text));
            parsed.collect::<Result<_, _>>().expect("legal")
        };
        assert!(check_once(&changes(&["inertia=0", "rate_weight=1e-6"])).is_ok());
        let twice = changes(&["inertia=0", "rate_weight=1e-6", "inertia=0.5"]);
        let error = check_once(&twice).expect_err("twice").to_string();
        assert!(error.starts_with("inertia is given twice"), "{error}");
    }

    #[test]
    fn only_what_changes_is_named() {
        let before = SolverSettings::default();
        let mut after = before;
        for text in ["rate_weight=1e-6", "inertia=0"] {
            SettingChange::parse(text)
                .expect("legal")
                .apply(&mut after, 0.0);
        }
        let keys: Vec<_> = changed(before, after).map(|setting| setting.key).collect();
        assert_eq!(keys, ["rate_weight"]);
    }
}
