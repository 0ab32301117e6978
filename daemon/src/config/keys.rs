//! The known keys, as in the default configuration, and the nearest one to a misspelt key.

use std::sync::LazyLock;

use cdcr_controller::parameters::UserParameter;
use cdcr_controller::robot::SectionParameters;
use toml::{Table, Value};

use super::{Config, TABLES};

/// Smallest similarity of a misspelt name to a known one.
const ALIKE: f64 = 0.8;
/// Bonus for a key of the same table.
const SAME_TABLE: f64 = 0.05;
/// Smallest length of a part that identifies a name.
const PART: usize = 5;
/// Longest name that may be a misspelling \[bytes\].
const MISSPELT_MAX: usize = 100;

/// A table, a settable key, or a key inside a list of tables.
#[derive(Debug)]
pub(super) struct Key {
    /// Like `cycle.period_ms` or `robot.sections.length_m`.
    pub(super) name: String,
    /// The declaration of the key.
    pub(super) parameter: &'static UserParameter,
    /// `None`: not settable by itself.
    pub(super) default: Option<Value>,
}

/// Every key, in the order of the default file.
pub(super) static ALL: LazyLock<Vec<Key>> = LazyLock::new(|| {
    let mut keys = Vec::new();
    collect("", &values(&Config::default()), &mut keys);
    keys
});

fn collect(above: &str, defaults: &Table, keys: &mut Vec<Key>) {
    for parameter in below(above) {
        let name = join(above, parameter.name);
        keys.push(Key {
            name: name.clone(),
            parameter,
            default: value(defaults, &name).cloned(),
        });
        collect(&name, defaults, keys);
    }
}

/// The name of a key in a table, or of a table at the top level (`""`).
pub(super) fn join(above: &str, name: &str) -> String {
    let dot = if above.is_empty() { "" } else { "." };
    format!("{above}{dot}{name}")
}

/// The declarations at the top level (`""`), in a table, or in a list of tables.
pub(super) fn below(key: &str) -> &'static [UserParameter] {
    match key {
        "" => Config::PARAMETERS,
        "robot.sections" => SectionParameters::PARAMETERS,
        name => {
            let table = TABLES.iter().find(|table| table.0 == name);
            table.map_or(&[], |table| table.1)
        }
    }
}

/// A key or a table by its name.
pub(super) fn get(name: &str) -> Option<&'static Key> {
    ALL.iter().find(|key| key.name == name)
}

/// The names and defaults of the settable keys.
pub(super) fn settable() -> impl Iterator<Item = (&'static str, &'static Value)> {
    let keys = ALL.iter();
    keys.filter_map(|key| Some((&*key.name, key.default.as_ref()?)))
}

/// The values of a configuration, table by table.
pub(super) fn values(config: &Config) -> Table {
    Table::try_from(config).expect("values from TOML can be written as TOML")
}

/// The value of a settable key.
pub(super) fn value<'a>(values: &'a Table, key: &str) -> Option<&'a Value> {
    let (table, name) = key.split_once('.')?;
    values.get(table)?.get(name)
}

/// The values of a key with their keys: one, or that of each table of a list.
pub(super) fn each<'a>(values: &'a Table, key: &str) -> Vec<(String, &'a Value)> {
    if let Some(value) = value(values, key) {
        return vec![(key.to_owned(), value)];
    }
    let (list, name) = key.rsplit_once('.').unwrap_or_default();
    let tables = value(values, list).and_then(Value::as_array);
    let each = tables.into_iter().flatten().enumerate();
    let each = each.map(|(index, table)| (format!("{list}[{index}].{name}"), &table[name]));
    each.collect()
}

/// A value as TOML, a small number with an exponent: TOML's own text of 1e-20 has all its zeros.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{number:?}"),
        other => other.to_string(),
    }
}

/// The keys whose values differ between two configurations.
pub(crate) fn changed(one: &Config, other: &Config) -> Vec<String> {
    let (one, other) = (values(one), values(other));
    let names = settable().map(|(name, _)| name);
    let changed = names.filter(|name| value(&one, name) != value(&other, name));
    changed.map(str::to_owned).collect()
}

/// The environment variable that sets `key`.
pub(super) fn variable(key: &str) -> String {
    format!("CDCR_{}", key.replace('.', "_").to_uppercase())
}

/// `robot.sections[1].length_m` as `robot.sections.length_m`.
pub(super) fn without_indices(key: &str) -> String {
    let names = key.split('.').filter_map(|part| part.split('[').next());
    names.collect::<Vec<_>>().join(".")
}

/// The most similar of the known names, if it is similar enough. Long names are skipped: their similarity
/// takes long to compute.
fn best<'a>(
    unknown: &str,
    known: impl Iterator<Item = &'a str>,
    likeness: impl Fn(&str) -> f64,
) -> Option<&'a str> {
    let known = known.take_while(|_| unknown.len() <= MISSPELT_MAX);
    let scored = known.map(|known| (likeness(known), known));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(a.1)))?;
    (best.0 >= ALIKE).then_some(best.1)
}

/// The known key most similar to `unknown`.
pub(super) fn nearest(unknown: &str) -> Option<&'static str> {
    let plain = without_indices(&unknown.to_lowercase());
    let known = ALL.iter().map(|key| &*key.name);
    best(unknown, known, |known| likeness(&plain, known))
}

/// Similarity of a misspelt key and a known one, 0 to a little more than 1.
fn likeness(unknown: &str, known: &str) -> f64 {
    let [(table, name), (known_table, known_name)] =
        [unknown, known].map(|key| key.rsplit_once('.').unwrap_or(("", key)));
    let is_part = name.len() >= PART && known_name.contains(name);
    let part = if is_part { ALIKE } else { 0.0 };
    let bonus = SAME_TABLE * f64::from(u8::from(table == known_table));
    let of_names = strsim::jaro_winkler(name, known_name).max(part) + bonus;
    of_names.max(flat_likeness(&unknown.replace('.', "_"), known))
}

fn flat_likeness(unknown: &str, known: &str) -> f64 {
    strsim::normalized_damerau_levenshtein(unknown, &known.replace('.', "_"))
}

/// The variable of a known key most similar to the variable `unknown`.
pub(super) fn nearest_variable(unknown: &str) -> Option<String> {
    let name = unknown.trim_start_matches("CDCR_").to_lowercase();
    let known = settable().map(|(key, _)| key);
    best(unknown, known, |known| flat_likeness(&name, known)).map(variable)
}

#[test]
fn every_key_has_a_variable_of_its_own() {
    let short = ["CDCR_CONFIG", "CDCR_ROBOT", "CDCR_PREFIX", "CDCR_ROOT"].map(str::to_owned);
    let mut all = settable().map(|(key, _)| variable(key)).chain(short);
    let mut known = std::collections::BTreeSet::new();
    assert!(all.all(|variable| known.insert(variable)));
}
