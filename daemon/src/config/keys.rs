//! The known keys, as in the default configuration, and the nearest one to a misspelt key.

use std::sync::LazyLock;

use cdcr_controller::parameters::UserParameter;
use cdcr_controller::robot::SectionParameters;
use toml::{Table, Value};

use super::Config;

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

static KEYS: LazyLock<Vec<Key>> = LazyLock::new(|| {
    let mut keys = Vec::new();
    collect("", &values(&Config::default()), &mut keys);
    keys
});

fn collect(above: &str, defaults: &Table, keys: &mut Vec<Key>) {
    for parameter in below(above) {
        let dot = if above.is_empty() { "" } else { "." };
        let name = format!("{above}{dot}{}", parameter.name);
        keys.push(Key {
            name: name.clone(),
            parameter,
            default: value(defaults, &name).cloned(),
        });
        collect(&name, defaults, keys);
    }
}

/// The declarations at the top level (`""`), in a table, or in a list of tables.
pub(super) fn below(key: &str) -> &'static [UserParameter] {
    match key {
        "" => Config::PARAMETERS,
        "robot.sections" => SectionParameters::PARAMETERS,
        table => Config::parameters_of(table),
    }
}

/// Every key, in the order of the default file.
pub(super) fn all() -> &'static [Key] {
    &KEYS
}

/// A key or a table by its name.
pub(super) fn get(name: &str) -> Option<&'static Key> {
    all().iter().find(|key| key.name == name)
}

/// The names and defaults of the settable keys.
pub(super) fn settable() -> impl Iterator<Item = (&'static str, &'static Value)> {
    let keys = all().iter();
    keys.filter_map(|key| Some((&*key.name, key.default.as_ref()?)))
}

/// The values of a configuration, table by table.
pub(super) fn values(config: &Config) -> Table {
    Table::try_from(config).unwrap_or_default()
}

/// The value of a settable key.
pub(super) fn value<'a>(values: &'a Table, key: &str) -> Option<&'a Value> {
    let (table, name) = key.split_once('.')?;
    values.get(table)?.get(name)
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
    let parts = key.split('.').map(|part| part.split('['));
    let names = parts.filter_map(|mut part| part.next());
    names.collect::<Vec<_>>().join(".")
}

/// The most similar of the known names, if it is similar enough. Long names are skipped: their similarity
/// takes long to compute.
fn best<T: Ord>(
    unknown: &str,
    known: impl Iterator<Item = T>,
    likeness: impl Fn(&T) -> f64,
) -> Option<T> {
    let scored = known
        .take_while(|_| unknown.len() <= MISSPELT_MAX)
        .map(|known| (likeness(&known), known));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(&a.1)));
    best.filter(|(score, _)| *score >= ALIKE)
        .map(|(_, known)| known)
}

/// The known key most similar to `unknown`.
pub(super) fn nearest(unknown: &str) -> Option<&'static str> {
    let plain = without_indices(&unknown.to_lowercase());
    let known = all().iter().map(|key| &*key.name);
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
    let [flat, known_flat] = [unknown, known].map(|key| key.replace('.', "_"));
    of_names.max(strsim::normalized_damerau_levenshtein(&flat, &known_flat))
}

/// The variable of a known key most similar to the variable `unknown`.
pub(super) fn nearest_variable(unknown: &str) -> Option<String> {
    let name = |variable: &str| variable.trim_start_matches("CDCR_").to_owned();
    best(unknown, settable().map(|(key, _)| variable(key)), |known| {
        strsim::normalized_damerau_levenshtein(&name(unknown), &name(known))
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_nearest_key_is_the_one_that_was_meant() {
        for (meant, misspelt) in [
            (
                "cycle.period_ms",
                "cycle.periodms cycle.period cycle.perriod_ms cycle.PERIOD_MS cycle_period_ms period_ms robot.period_ms \
                 cycles.period_ms",
            ),
            ("cycle", "cycl"),
            ("controller", "controler"),
            (
                "controller.swarm_size",
                "nmpc.swarm_size cycle.swarm_size controller.swarmsize",
            ),
            ("controller.horizon_steps", "controller.horizon"),
            ("robot.sections", "robot.section"),
            (
                "robot.sections.length_m",
                "robot.sections[1].lenght_m robot.length_m",
            ),
            ("realtime.cycle_priority", "realtime.priority"),
            ("safety.clearance_fault_m", "safety.clearance_m"),
            ("link.measurement_timeout_ms", "link.timeout_ms"),
        ] {
            for unknown in misspelt.split(' ') {
                assert_eq!(nearest(unknown), Some(meant), "{unknown}");
            }
        }
        for foreign in ["", ".", "xyz", "cycle.colour", "π.ß[", "logging.verbose"] {
            assert_eq!(nearest(foreign), None, "{foreign}");
        }
    }

    #[test]
    fn every_key_has_a_variable_of_its_own_and_those_of_other_programs_are_not_near() {
        let short = ["CDCR_CONFIG", "CDCR_ROBOT", "CDCR_PREFIX", "CDCR_ROOT"].map(str::to_owned);
        let mut all = settable().map(|(key, _)| variable(key)).chain(short);
        let mut known = BTreeSet::new();
        assert!(all.all(|variable| known.insert(variable)));
        let near = nearest_variable("CDCR_CYCLE_PERIOD");
        assert_eq!(near.as_deref(), Some("CDCR_CYCLE_PERIOD_MS"));
        for foreign in "CDCR_TEST_SECONDS CDCR_SOAK_MINUTES CDCR_KEEP_PICTURES CDCR_".split(' ') {
            assert_eq!(nearest_variable(foreign), None, "{foreign}");
        }
    }
}
