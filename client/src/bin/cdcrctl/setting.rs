//! The solver settings, each with its key, range and field: from the fields of the message, and the declared
//! table `[controller]` of the configuration.
//!
//! Ranges are checked here, so that a typing error is reported at once; the daemon checks them again.

use std::ops::RangeInclusive;

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::parameters::UserParameter;
use cdcr_shared_types::codes::Codes;
use cdcr_shared_types::limits::PERIOD_MS_MAX;
use cdcr_shared_types::message::{Meaning, Struct as _, Value as FieldValue, ValueMut};
use cdcr_shared_types::{SolverSettings, Status};
use serde_json::{Value, json};

/// A setting that can be shown and changed.
#[derive(Debug, PartialEq, Eq, Clone, Copy)]
pub(crate) struct Setting {
    pub(crate) key: &'static str,
    field: &'static str,
}

/// The budget is a key of the table `[cycle]`, in ms there and in ns in the message.
const BUDGET: Setting = Setting {
    key: "budget_ms",
    field: "budget_ns",
};
/// Budgets \[ms\]. The daemon's own period limits them further.
const BUDGET_MS: RangeInclusive<f64> = 0.0..=PERIOD_MS_MAX as f64;
/// A value of the configuration that a daemon replaces by the number for its robot.
pub(crate) const AUTO: &str = "auto";
const BUDGET_NOTE: &str = "; 0: all the remaining period";

impl From<&'static UserParameter> for Setting {
    fn from(parameter: &'static UserParameter) -> Self {
        Self {
            key: parameter.name,
            field: parameter.name,
        }
    }
}

impl Setting {
    /// All settings, in the order of the configuration.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let (seed, others) = NmpcSettings::PARAMETERS.split_last().unzip();
        let others = others.into_iter().flatten().map(Self::from);
        others.chain([BUDGET]).chain(seed.map(Self::from))
    }

    /// Its value as command-line text.
    pub(crate) fn text(self, settings: SolverSettings) -> String {
        match self.json(settings) {
            Value::String(word) => word,
            number if number.is_f64() => number.as_f64().map_or_else(String::new, number_text),
            number => number.to_string(),
        }
    }

    /// Its value: a word or a number.
    pub(crate) fn json(self, settings: SolverSettings) -> Value {
        let mut value = Value::Null;
        settings.visit(&mut |field, part| {
            if field.name == self.field {
                value = match (part, field.meaning) {
                    (FieldValue::U32(code), Meaning::Code(codes)) => json!(codes.text(code)),
                    (FieldValue::U32(count), _) => json!(count),
                    (FieldValue::U64(ns), _) if self == BUDGET => json!(ns as f64 / 1e6),
                    (FieldValue::U64(whole), _) => json!(whole),
                    (FieldValue::F64(number), _) => json!(number),
                    _ => Value::Null,
                };
            }
        });
        value
    }

    /// The words that it accepts.
    pub(crate) fn words(self) -> Vec<String> {
        let codes = self.codes().into_iter().flat_map(|codes| codes.values);
        let auto = self.has_auto().then(|| AUTO.to_owned());
        codes
            .map(|(_, _, text)| (*text).to_owned())
            .chain(auto)
            .collect()
    }

    fn has_auto(self) -> bool {
        self.key == "rate_weight"
    }

    fn codes(self) -> Option<&'static Codes> {
        let mut fields = SolverSettings::LAYOUT.fields.iter();
        match fields.find(|field| field.name == self.field)?.meaning {
            Meaning::Code(codes) => Some(codes),
            _ => None,
        }
    }

    fn range(self) -> Option<RangeInclusive<f64>> {
        if self == BUDGET {
            return Some(BUDGET_MS);
        }
        self.declared()?.range.clone()
    }

    fn declared(self) -> Option<&'static UserParameter> {
        let mut declared = NmpcSettings::PARAMETERS.iter();
        declared.find(|parameter| parameter.name == self.key)
    }

    /// Question about a value that is probably unintended.
    pub(crate) fn warning(self, settings: SolverSettings) -> Option<String> {
        let value = self.json(settings).as_f64()?;
        let warning = self.declared()?.warning(value)?;
        Some(format!("{} = {}: {warning}", self.key, self.text(settings)))
    }

    /// Text of the accepted values for this daemon.
    pub(crate) fn allowed_by(self, status: &Status) -> String {
        match self.range() {
            Some(range) if self.key == "safe_distance_m" => format!(
                "{} to {}; no less than in the configuration",
                number_text(status.safe_distance_min_m),
                number_text(*range.end())
            ),
            Some(_) if self == BUDGET => {
                let period_ms = number_text(status.period_ns as f64 / 1e6);
                format!("0 to {period_ms}{BUDGET_NOTE}")
            }
            _ => self.allowed(),
        }
    }

    /// Text of the accepted values.
    pub(crate) fn allowed(self) -> String {
        let words = self.words();
        let range = match (words.split_last(), self.range()) {
            (Some((last, others)), None) => format!("{} or {last}", others.join(", ")),
            (Some((word, _)), Some(range)) => {
                format!(
                    "{} to {} or {word}",
                    number_text(*range.start()),
                    number_text(*range.end())
                )
            }
            (None, Some(_)) if self == BUDGET => "0 to the period of the daemon".to_owned(),
            (None, Some(range)) => {
                format!(
                    "{} to {}",
                    number_text(*range.start()),
                    number_text(*range.end())
                )
            }
            (None, None) => format!("0 to {}", u64::MAX),
        };
        let note = match self.key {
            "control_blocks" => "; at most horizon_steps; 0: as many",
            "regenerate_after" => "; 0: never",
            "budget_ms" => BUDGET_NOTE,
            _ => "",
        };
        range + note
    }
}

/// Uses an exponent instead of many zeros.
fn number_text(number: f64) -> String {
    if number == 0.0 || (1e-3..1e6).contains(&number.abs()) {
        number.to_string()
    } else {
        format!("{number:e}")
    }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct SettingChange {
    setting: Setting,
    value: Wanted,
}

#[derive(Debug, Clone, Copy)]
enum Wanted {
    Count(u32),
    Number(f64),
    Whole(u64),
    /// The number that the status names.
    Auto,
}

impl SettingChange {
    /// Parses `KEY=VALUE`, with a known key and a value in its range.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=');
        let (key, value) = parts
            .filter(|(key, _)| !key.trim().is_empty())
            .ok_or_else(|| {
                format!("invalid setting {text:?}: use KEY=VALUE, for example horizon_steps=5")
            })?;
        let (key, value) = (key.trim(), value.trim());
        let known = Setting::all().find(|setting| setting.key == key);
        let setting = known.ok_or_else(|| unknown(key))?;
        let value = wanted(setting, value).ok_or_else(|| {
            format!(
                "invalid value {value:?} for {key}: use {}",
                setting.allowed()
            )
        })?;
        Ok(Self { setting, value })
    }

    /// Key of the setting.
    pub(crate) fn key(&self) -> &'static str {
        self.setting.key
    }

    /// True if the value is the one that the daemon chooses for its robot.
    pub(crate) fn is_auto(&self) -> bool {
        matches!(self.value, Wanted::Auto)
    }

    /// Changes `settings`; `auto` is the number for [`is_auto`](Self::is_auto).
    pub(crate) fn apply(&self, settings: &mut SolverSettings, auto: f64) {
        settings.visit_mut(&mut |field, part| {
            if field.name == self.setting.field {
                match (part, self.value) {
                    (ValueMut::U32(count), Wanted::Count(wanted)) => *count = wanted,
                    (ValueMut::U64(whole), Wanted::Whole(wanted)) => *whole = wanted,
                    (ValueMut::F64(number), Wanted::Number(wanted)) => *number = wanted,
                    (ValueMut::F64(number), Wanted::Auto) => *number = auto,
                    // `wanted` returns no other pairs.
                    _ => {}
                }
            }
        });
    }
}

/// The value of a setting, if it is valid.
fn wanted(setting: Setting, text: &str) -> Option<Wanted> {
    if let Some(codes) = setting.codes() {
        let mut values = codes.values.iter();
        let (code, ..) = values.find(|(_, _, word)| *word == text)?;
        return Some(Wanted::Count(*code));
    }
    let Some(range) = setting.range() else {
        return text.parse().ok().map(Wanted::Whole);
    };
    if setting.has_auto() && text == AUTO {
        return Some(Wanted::Auto);
    }
    let number: f64 = text.parse().ok()?;
    if !range.contains(&number) {
        return None;
    }
    if setting == BUDGET {
        return Some(Wanted::Whole((number * 1e6).round() as u64));
    }
    let is_count =
        matches!(setting.json(SolverSettings::default()), Value::Number(zero) if zero.is_u64());
    if is_count {
        return text.parse().ok().map(Wanted::Count);
    }
    Some(Wanted::Number(number))
}

/// The error for an unknown key: the most similar key, and all keys.
fn unknown(key: &str) -> String {
    let likeness = |setting: &Setting| strsim::jaro_winkler(setting.key, key);
    let nearest = Setting::all()
        .max_by(|a, b| likeness(a).total_cmp(&likeness(b)))
        .filter(|setting| likeness(setting) > 0.8)
        .map(|setting| format!("; did you mean {}?", setting.key));
    let all: Vec<_> = Setting::all().map(|setting| setting.key).collect();
    format!(
        "unknown setting {key:?}{} All settings: {}",
        nearest.unwrap_or_else(|| ".".to_owned()),
        all.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_are_those_of_the_configuration_and_the_defaults_are_legal() {
        let text = include_str!("../../../../configs/default.toml");
        let lines = text
            .lines()
            .skip_while(|line| *line != "[controller]")
            .skip(1)
            .take_while(|line| !line.starts_with('['))
            .filter(|line| line.contains(" = ") && !line.starts_with('#'));
        let mut keys = vec!["budget_ms"];
        for line in lines {
            let (key, value) = line.split_once(" = ").expect("filtered");
            let value = value.trim_matches('"');
            let change = SettingChange::parse(&format!("{key}={value}"));
            assert_eq!(change.expect(line).setting.key, key);
            keys.push(key);
        }
        let mut known: Vec<_> = Setting::all().map(|setting| setting.key).collect();
        keys.sort_unstable();
        known.sort_unstable();
        assert_eq!(known, keys);
    }

    #[test]
    fn an_invalid_setting_is_rejected_with_the_allowed_values() {
        for (text, part) in [
            ("horizon_steps", "KEY=VALUE"),
            ("horizon_step=3", "did you mean horizon_steps?"),
            ("zzz=3", "All settings: solver, horizon_steps"),
            ("horizon_steps=51", "1 to 50"),
            ("horizon_steps=2.5", "1 to 50"),
            ("solver=newton", "kpso, gauss-newton or kpso-refined"),
            ("position_weight=0", "1e-12 to 1e12"),
            ("inertia=NaN", "0 to 1"),
            ("budget_ms=-1", "0 to the period of the daemon;"),
            ("seed=-1", "0 to 18446744073709551615"),
        ] {
            let error = SettingChange::parse(text).expect_err(text);
            assert!(error.contains(part), "{part} in {error}");
        }
    }

    #[test]
    fn only_an_unusual_value_has_a_warning() {
        let mut settings = SolverSettings {
            position_weight: 1.0,
            ..SolverSettings::default()
        };
        let warnings =
            |settings| Setting::all().filter_map(move |setting| setting.warning(settings));
        assert_eq!(warnings(settings).collect::<Vec<_>>(), [""; 0]);
        SettingChange::parse("rate_weight=1e12")
            .expect("legal")
            .apply(&mut settings, 0.0);
        let warnings: Vec<_> = warnings(settings).collect();
        assert_eq!(warnings, ["rate_weight = 1e12: usual is 0 to 0.01"]);
    }

    #[test]
    fn auto_is_the_number_of_the_daemon() {
        let mut settings = SolverSettings::default();
        let change = SettingChange::parse("rate_weight=auto").expect("as in the configuration");
        assert!(change.is_auto());
        change.apply(&mut settings, 1e-10);
        assert_eq!(settings.rate_weight, 1e-10);
        let error = SettingChange::parse("damping=auto").expect_err("a number only");
        assert!(error.contains("1e-20 to 1"), "{error}");
    }

    #[test]
    fn a_budget_in_ms_is_ns_in_the_message() {
        let mut settings = SolverSettings::default();
        SettingChange::parse("budget_ms=2.5")
            .expect("legal")
            .apply(&mut settings, 0.0);
        assert_eq!(settings.budget_ns, 2_500_000);
    }
}
