//! The known keys, as the default configuration has them, and which of them is nearest to a misspelt one.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::parameters::Parameter;
use cdcr_controller::robot::SectionParameters;
use toml::{Table, Value};
use toml_edit::{Item, TableLike};

use super::{
    ActuatorConfig, Config, CycleConfig, EstimatorConfig, LinkConfig, MotionConfig,
    ObstaclesConfig, RealtimeConfig, ReferenceConfig, RobotConfig, SafetyConfig, TransportConfig,
};

/// How alike two names must be for one to be called a misspelling of the other.
const ALIKE: f64 = 0.8;
/// How much a key of the same table comes before one of another table.
const SAME_TABLE: f64 = 0.05;

/// Length from which on a part of a name says which one is meant.
const PART: usize = 5;

static SETTABLE: LazyLock<BTreeMap<String, Value>> = LazyLock::new(|| {
    let tables = values(&Config::default()).into_iter();
    let keys = tables.flat_map(|(table, keys)| {
        let keys = keys.as_table().cloned().unwrap_or_default();
        keys.into_iter()
            .map(move |(key, value)| (format!("{table}.{key}"), value))
    });
    keys.collect()
});

/// Every table and every key with what is declared of it, in the order of the default file.
static DECLARED: LazyLock<Vec<(String, &'static Parameter)>> = LazyLock::new(|| {
    let mut declared = Vec::new();
    for table in Config::PARAMETERS {
        declared.push((table.name.to_owned(), table));
        for parameter in below(table.name) {
            let key = format!("{}.{}", table.name, parameter.name);
            let inner = below(&key)
                .iter()
                .map(|inner| (format!("{key}.{}", inner.name), inner));
            let inner: Vec<_> = inner.collect();
            declared.push((key, parameter));
            declared.extend(inner);
        }
    }
    declared
});

/// The parameters of a table, or of a list of tables.
fn below(key: &str) -> &'static [Parameter] {
    match key {
        "robot" => RobotConfig::PARAMETERS,
        "robot.sections" => SectionParameters::PARAMETERS,
        "link" => LinkConfig::PARAMETERS,
        "actuator" => ActuatorConfig::PARAMETERS,
        "estimator" => EstimatorConfig::PARAMETERS,
        "cycle" => CycleConfig::PARAMETERS,
        "motion" => MotionConfig::PARAMETERS,
        "safety" => SafetyConfig::PARAMETERS,
        "obstacles" => ObstaclesConfig::PARAMETERS,
        "reference" => ReferenceConfig::PARAMETERS,
        "controller" => NmpcSettings::PARAMETERS,
        "realtime" => RealtimeConfig::PARAMETERS,
        "transport" => TransportConfig::PARAMETERS,
        _ => &[],
    }
}

/// Every key that has a value of its own, like `cycle.period_ms`, with its default.
pub(super) fn settable() -> &'static BTreeMap<String, Value> {
    &SETTABLE
}

/// Every table, every key that has a value of its own, and every key inside a list of tables, like
/// `robot.sections.length_m`, with what is declared of it.
pub(super) fn all() -> &'static [(String, &'static Parameter)] {
    &DECLARED
}

/// What is declared of a key or a table.
pub(super) fn declared(key: &str) -> Option<&'static Parameter> {
    let mut all = all().iter();
    all.find(|(known, _)| known == key)
        .map(|(_, parameter)| *parameter)
}

/// The values of a configuration, table by table.
pub(super) fn values(config: &Config) -> Table {
    Table::try_from(config).unwrap_or_default()
}

/// The value of a key that has one of its own.
pub(super) fn value<'a>(values: &'a Table, key: &str) -> Option<&'a Value> {
    let (table, name) = key.split_once('.')?;
    values.get(table)?.get(name)
}

/// The keys that have other values in one configuration than in the other.
pub(crate) fn changed(one: &Config, other: &Config) -> Vec<String> {
    let (one, other) = (values(one), values(other));
    let keys = settable().keys();
    keys.filter(|key| value(&one, key) != value(&other, key))
        .cloned()
        .collect()
}

/// The environment variable that sets `key`.
pub(super) fn variable(key: &str) -> String {
    format!("CDCR_{}", key.replace('.', "_").to_uppercase())
}

/// `robot.sections[1].length_m` as `robot.sections.length_m`.
pub(super) fn without_indices(key: &str) -> String {
    let parts = key.split('.').map(|part| match part.split_once('[') {
        Some((name, _)) => name,
        None => part,
    });
    parts.collect::<Vec<_>>().join(".")
}

/// Longest name that may be a misspelling \[bytes\]: the likeness of long ones takes long to tell.
const MISSPELT_MAX: usize = 100;

/// The known key that `unknown` most likely means.
pub(super) fn nearest(unknown: &str) -> Option<&'static str> {
    if unknown.len() > MISSPELT_MAX {
        return None;
    }
    let unknown = without_indices(&unknown.to_lowercase());
    let scored = all()
        .iter()
        .map(|(known, _)| (likeness(&unknown, known), known));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(a.1)));
    best.filter(|(score, _)| *score >= ALIKE)
        .map(|(_, known)| known.as_str())
}

/// How alike a misspelt key and a known one are, 0 to a little more than 1.
fn likeness(unknown: &str, known: &str) -> f64 {
    let (table, name) = split(unknown);
    let (known_table, known_name) = split(known);
    let bonus = if table == known_table {
        SAME_TABLE
    } else {
        0.0
    };
    let is_part = name.len() >= PART && known_name.contains(name);
    let part = if is_part { ALIKE } else { 0.0 };
    let of_names = strsim::jaro_winkler(name, known_name).max(part) + bonus;
    let (flat, known_flat) = (unknown.replace('.', "_"), known.replace('.', "_"));
    let of_paths = strsim::normalized_damerau_levenshtein(&flat, &known_flat);
    of_names.max(of_paths)
}

fn split(key: &str) -> (&str, &str) {
    key.rsplit_once('.').unwrap_or(("", key))
}

/// The variable of a known key that a variable of another name most likely means.
pub(super) fn nearest_variable(unknown: &str) -> Option<String> {
    if unknown.len() > MISSPELT_MAX {
        return None;
    }
    let name = |variable: &str| variable.trim_start_matches("CDCR_").to_owned();
    let known = settable().keys().map(|key| variable(key));
    let scored = known.map(|known| {
        let score = strsim::normalized_damerau_levenshtein(&name(unknown), &name(&known));
        (score, known)
    });
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(score, _)| *score >= ALIKE)
        .map(|(_, known)| known)
}

/// The first key of a document that is not known, and at which byte it stands.
pub(super) fn first_unknown(root: &dyn TableLike) -> Option<(String, Option<usize>)> {
    let mut unknown = Vec::new();
    for (table, item) in root.iter() {
        let is_known = declared(table).is_some();
        match item.as_table_like() {
            _ if !is_known => unknown.push((table.to_owned(), offset(root, table))),
            Some(keys) => collect_unknown(keys, table, &mut unknown),
            None => {}
        }
    }
    unknown
        .into_iter()
        .min_by_key(|(_, offset)| offset.unwrap_or(usize::MAX))
}

fn collect_unknown(keys: &dyn TableLike, table: &str, unknown: &mut Vec<(String, Option<usize>)>) {
    for (name, item) in keys.iter() {
        let key = format!("{table}.{name}");
        if declared(&key).is_none() {
            unknown.push((key, offset(keys, name)));
            continue;
        }
        if below(&key).is_empty() {
            continue;
        }
        for (index, element) in elements(item).enumerate() {
            for (name, _) in element.iter() {
                if declared(&format!("{key}.{name}")).is_none() {
                    let key = format!("{key}[{index}].{name}");
                    unknown.push((key, offset(element, name)));
                }
            }
        }
    }
}

/// The tables of a list, however it is written.
fn elements(item: &Item) -> impl Iterator<Item = &dyn TableLike> {
    let as_tables = item.as_array_of_tables().into_iter().flatten();
    let as_values = item.as_array().into_iter().flatten();
    as_tables.map(|table| table as &dyn TableLike).chain(
        as_values.filter_map(|value| value.as_inline_table().map(|table| table as &dyn TableLike)),
    )
}

/// At which byte a key of a table stands.
fn offset(table: &dyn TableLike, name: &str) -> Option<usize> {
    let (key, item) = table.get_key_value(name)?;
    let span = key.span().or_else(|| item.span())?;
    Some(span.start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_the_one_that_was_meant() {
        for (unknown, meant) in [
            ("cycle.periodms", "cycle.period_ms"),
            ("cycle.period", "cycle.period_ms"),
            ("cycle.perriod_ms", "cycle.period_ms"),
            ("cycle.PERIOD_MS", "cycle.period_ms"),
            ("cycle_period_ms", "cycle.period_ms"),
            ("period_ms", "cycle.period_ms"),
            ("robot.period_ms", "cycle.period_ms"),
            ("cycl", "cycle"),
            ("cycles.period_ms", "cycle.period_ms"),
            ("controler", "controller"),
            ("nmpc.swarm_size", "controller.swarm_size"),
            ("cycle.swarm_size", "controller.swarm_size"),
            ("controller.swarmsize", "controller.swarm_size"),
            ("controller.horizon", "controller.horizon_steps"),
            ("robot.section", "robot.sections"),
            ("robot.sections[1].lenght_m", "robot.sections.length_m"),
            ("robot.length_m", "robot.sections.length_m"),
            ("realtime.priority", "realtime.cycle_priority"),
            ("safety.clearance_m", "safety.clearance_fault_m"),
            ("link.timeout_ms", "link.measurement_timeout_ms"),
        ] {
            assert_eq!(nearest(unknown), Some(meant), "{unknown}");
        }
        for foreign in ["", ".", "xyz", "cycle.colour", "π.ß[", "logging.verbose"] {
            assert_eq!(nearest(foreign), None, "{foreign}");
        }
    }

    #[test]
    fn every_key_has_a_variable_of_its_own() {
        let mut variables: Vec<String> = settable().keys().map(|key| variable(key)).collect();
        variables
            .extend(["CDCR_CONFIG", "CDCR_ROBOT", "CDCR_PREFIX", "CDCR_ROOT"].map(String::from));
        let count = variables.len();
        variables.sort();
        variables.dedup();
        assert_eq!(variables.len(), count);
        assert!(variables.contains(&"CDCR_CYCLE_PERIOD_MS".to_owned()));
    }

    #[test]
    fn variables_of_other_programs_are_not_near() {
        assert_eq!(
            nearest_variable("CDCR_CYCLE_PERIOD").as_deref(),
            Some("CDCR_CYCLE_PERIOD_MS")
        );
        for foreign in [
            "CDCR_TEST_SECONDS",
            "CDCR_SOAK_MINUTES",
            "CDCR_KEEP_PICTURES",
            "CDCR_",
        ] {
            assert_eq!(nearest_variable(foreign), None, "{foreign}");
        }
    }
}
