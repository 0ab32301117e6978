//! Settings of the solver: a Python dictionary whose keys are the names of `NmpcSettings`.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use cdcr_client::model::settings_of;
use cdcr_controller::nmpc::{NmpcSettings, RateWeight};
use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::limits::PERIOD_MS_MAX;
use cdcr_shared_types::message::{Meaning, Struct, ValueMut};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::type_hint_identifier;
use pyo3::types::{PyBool, PyDict};
use serde::Deserialize;
use toml::{Table, Value};

use crate::errors::{Class, Failure, REPORT};
use crate::numbers::within;

/// The defaults with the changes of a dictionary, checked.
pub(crate) fn settings(given: Option<&Bound<'_, PyDict>>) -> PyResult<NmpcSettings> {
    let mut table = Table::new();
    for (key, value) in given.into_iter().flatten() {
        let key: String = key.extract().map_err(|_| {
            Failure::argument(
                format!("a key of the settings is {key}; needed is a name"),
                "Use the keys of cdcr.default_settings().",
            )
        })?;
        let value = scalar(&key, &value)?;
        table.insert(key, value);
    }
    Ok(from_table(table)?)
}

/// A number, a word or a truth value.
pub(crate) fn scalar(key: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(truth) = value.cast::<PyBool>() {
        return Ok(Value::Boolean(truth.is_true()));
    }
    if let Ok(word) = value.extract::<String>() {
        return Ok(Value::String(word));
    }
    if let Ok(whole) = value.extract::<i64>() {
        return Ok(Value::Integer(whole));
    }
    let number = value.extract::<f64>().map_err(|_| {
        let kind = value.get_type();
        Failure::argument(
            format!("{key} is {kind}; needed is a number or a word"),
            format!("Give {key} a value of its kind; cdcr.default_settings() shows one."),
        )
    })?;
    Ok(Value::Float(number))
}

fn from_table(table: Table) -> Result<NmpcSettings, Failure> {
    let settings = NmpcSettings::deserialize(Value::Table(table)).map_err(|error| {
        Failure::argument(
            format!("settings of the solver: {}", error.message()),
            "Use the keys and kinds of cdcr.default_settings().",
        )
    })?;
    settings.validate()?;
    Ok(settings)
}

/// Settings as a dictionary.
pub(crate) struct Settings(pub(crate) NmpcSettings);

impl<'py> IntoPyObject<'py> for Settings {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = PyErr;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_identifier!("builtins", "Settings");

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
        let table = Table::try_from(self.0);
        let table = table.map_err(|error| Failure::argument(error, REPORT))?;
        let dictionary = PyDict::new(py);
        for (key, value) in table {
            match value {
                Value::Integer(whole) => dictionary.set_item(key, whole)?,
                Value::Float(number) => dictionary.set_item(key, number)?,
                other => dictionary.set_item(key, other.as_str())?,
            }
        }
        Ok(dictionary)
    }
}

/// The settings of the solver that apply where none are given: key by key as in the table `[controller]` of a configuration.
#[pyfunction]
pub(crate) fn default_settings() -> Settings {
    Settings(NmpcSettings::default())
}

/// What each setting of the solver is, with its range: by its name.
#[pyfunction]
pub(crate) fn setting_texts() -> BTreeMap<&'static str, String> {
    let declared = NmpcSettings::PARAMETERS.iter();
    declared
        .map(|setting| (setting.name, setting.text().replace('\n', " ")))
        .collect()
}

/// The settings of the solver in the table `[controller]` of a configuration of cdcrd; the defaults for keys that are not there.
///
/// Raises ArgumentError for a file that is not a configuration, an unknown key, and a value outside its range.
#[pyfunction]
pub(crate) fn settings_from_toml(path: PathBuf) -> PyResult<Settings> {
    let mut file = read(&path)?;
    let settings = match file.remove("controller") {
        Some(Value::Table(table)) => from_table(table)?,
        _ => NmpcSettings::default(),
    };
    Ok(Settings(settings))
}

/// A configuration of cdcrd.
pub(crate) fn read(path: &PathBuf) -> Result<Table, Failure> {
    let name = path.display();
    let text = fs::read_to_string(path).map_err(|error| {
        Failure::argument(
            format!("cannot read {name}: {error}"),
            "Give the path of a configuration of cdcrd.",
        )
    })?;
    text.parse().map_err(|error| {
        Failure::argument(
            format!("{name} is not valid TOML: {error}"),
            format!("Check it with: cdcrd check --config {name}"),
        )
    })
}

/// The settings of a daemon.
pub(crate) fn known(wire: &SolverSettings) -> PyResult<Settings> {
    let settings = settings_of(wire).map_err(|code| {
        Failure::new(
            Class::Link,
            code,
            "Install daemon and package of one version.",
        )
    })?;
    Ok(Settings(settings))
}

/// The settings of a daemon with changes, checked. `rate_weight_auto` gives the number that it chose for its robot.
pub(crate) fn changed(
    mut wire: SolverSettings,
    budget_ms: Option<f64>,
    changes: Option<&Bound<'_, PyDict>>,
    rate_weight_auto: impl FnOnce() -> PyResult<f64>,
) -> PyResult<SolverSettings> {
    if let Some(changes) = changes {
        let all = known(&wire)?.into_pyobject(changes.py())?;
        all.update(changes.as_mapping())?;
        let mut settings = settings(Some(&all))?;
        if settings.rate_weight == RateWeight::Auto {
            settings.rate_weight = rate_weight_auto()?.into();
        }
        change(&mut wire, &settings)?;
    }
    if let Some(budget_ms) = budget_ms {
        let budget_ms = within("budget_ms", budget_ms, 0.0..=PERIOD_MS_MAX as f64)?;
        wire.budget_ns = (budget_ms * 1e6).round() as u64;
    }
    Ok(wire)
}

/// Writes settings into a message, by the common names. Other fields of the message are unchanged.
fn change(message: &mut SolverSettings, settings: &NmpcSettings) -> Result<(), Failure> {
    let table = Table::try_from(settings).map_err(|error| Failure::argument(error, REPORT))?;
    let mut unknown = None;
    message.visit_mut(&mut |field, place| {
        let Some(value) = table.get(field.name) else {
            return;
        };
        let number = match (value, field.meaning) {
            (Value::String(word), Meaning::Code(codes)) => codes
                .values
                .iter()
                .find(|(_, _, text)| text == word)
                .map(|(code, ..)| Value::Integer(i64::from(*code))),
            // "auto": the daemon's value is unchanged.
            (Value::String(_), _) => return,
            (value, _) => Some(value.clone()),
        };
        match (place, number) {
            (ValueMut::U32(place), Some(Value::Integer(number))) => *place = number as u32,
            (ValueMut::U64(place), Some(Value::Integer(number))) => *place = number as u64,
            (ValueMut::F64(place), Some(Value::Float(number))) => *place = number,
            _ => unknown = Some(field.name),
        }
    });
    match unknown {
        None => Ok(()),
        Some(name) => Err(Failure::argument(
            format!("the message of settings cannot hold {name}"),
            "Install daemon and package of one version.",
        )),
    }
}
