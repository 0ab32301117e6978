//! Every setting with its key, its range and its place in the message.
//!
//! The ranges are those of `configs/default.toml`. They are checked here so that a typing error is told
//! at once; the daemon has the last word.

use cdcr_shared_types::codes::{Coordinates, SolverKind, VelocityRule};
use cdcr_shared_types::limits::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, ITERATIONS_MAX, SWARM_MAX};
use cdcr_shared_types::{SolverSettings, Status};
use serde_json::{Value, json};

/// A setting that can be shown and changed.
#[derive(Debug)]
pub(crate) struct Setting {
    pub(crate) key: &'static str,
    field: Field,
    /// What else to know about its range.
    note: &'static str,
}

/// Where a setting is in the message, and what it may be.
#[derive(Debug)]
enum Field {
    /// One of some words; their codes count from 0.
    Word(
        fn() -> Vec<&'static str>,
        fn(&mut SolverSettings) -> &mut u32,
    ),
    /// A count within a range.
    Count(u32, usize, fn(&mut SolverSettings) -> &mut u32),
    /// A number within a range.
    Number(f64, f64, fn(&mut SolverSettings) -> &mut f64),
    /// A time up to a limit, in ms here and in ns in the message.
    Milliseconds(f64, fn(&mut SolverSettings) -> &mut u64),
    /// Any whole number.
    Seed(fn(&mut SolverSettings) -> &mut u64),
}

const fn word(
    key: &'static str,
    words: fn() -> Vec<&'static str>,
    of: fn(&mut SolverSettings) -> &mut u32,
) -> Setting {
    let field = Field::Word(words, of);
    let note = "";
    Setting { key, field, note }
}

const fn count(
    key: &'static str,
    least: u32,
    most: usize,
    of: fn(&mut SolverSettings) -> &mut u32,
) -> Setting {
    let field = Field::Count(least, most, of);
    let note = "";
    Setting { key, field, note }
}

const fn number(
    key: &'static str,
    least: f64,
    most: f64,
    of: fn(&mut SolverSettings) -> &mut f64,
) -> Setting {
    let field = Field::Number(least, most, of);
    let note = "";
    Setting { key, field, note }
}

impl Setting {
    const fn with_note(mut self, note: &'static str) -> Self {
        self.note = note;
        self
    }
}

/// Largest weight or penalty.
const WEIGHT_MAX: f64 = 1e12;

/// All of them, in the order of the configuration.
pub(crate) const SETTINGS: &[Setting] = &[
    word(
        "solver",
        || SolverKind::ALL.iter().map(|kind| kind.text()).collect(),
        |s| &mut s.solver,
    ),
    count("horizon_steps", 1, HORIZON_STEPS_MAX, |s| {
        &mut s.horizon_steps
    }),
    word(
        "coordinates",
        || Coordinates::ALL.iter().map(|kind| kind.text()).collect(),
        |s| &mut s.coordinates,
    ),
    count("control_blocks", 0, CONTROL_BLOCKS_MAX, |s| {
        &mut s.control_blocks
    })
    .with_note("; at most horizon_steps; 0: as many"),
    count("swarm_size", 1, SWARM_MAX, |s| &mut s.swarm_size),
    count("swarm_iterations", 0, ITERATIONS_MAX, |s| {
        &mut s.swarm_iterations
    }),
    count("regenerate_after", 0, ITERATIONS_MAX, |s| {
        &mut s.regenerate_after
    })
    .with_note("; 0: never"),
    word(
        "velocity_rule",
        || VelocityRule::ALL.iter().map(|rule| rule.text()).collect(),
        |s| &mut s.velocity_rule,
    ),
    number("inertia", 0.0, 1.0, |s| &mut s.inertia),
    number("cognitive", 0.0, 4.0, |s| &mut s.cognitive),
    number("social", 0.0, 4.0, |s| &mut s.social),
    count("refinement_steps", 0, 50, |s| &mut s.refinement_steps),
    number("damping", 1e-20, 1.0, |s| &mut s.damping),
    number("position_weight", 1e-12, WEIGHT_MAX, |s| {
        &mut s.position_weight
    }),
    number("orientation_weight", 0.0, WEIGHT_MAX, |s| {
        &mut s.orientation_weight
    }),
    number("orientation_tolerance_rad", 0.0, 1.0, |s| {
        &mut s.orientation_tolerance_rad
    }),
    number("rate_weight", 0.0, WEIGHT_MAX, |s| &mut s.rate_weight),
    number("rate_change_weight", 0.0, WEIGHT_MAX, |s| {
        &mut s.rate_change_weight
    }),
    number("terminal_weight", 0.0, WEIGHT_MAX, |s| {
        &mut s.terminal_weight
    }),
    number("safe_distance_m", 0.0, 10.0, |s| &mut s.safe_distance_m),
    number("obstacle_step_penalty", 0.0, WEIGHT_MAX, |s| {
        &mut s.obstacle_step_penalty
    }),
    number("obstacle_slope_penalty", 0.0, WEIGHT_MAX, |s| {
        &mut s.obstacle_slope_penalty
    }),
    number("obstacle_square_penalty", 0.0, WEIGHT_MAX, |s| {
        &mut s.obstacle_square_penalty
    }),
    Setting {
        key: "budget_ms",
        field: Field::Milliseconds(100.0, |s| &mut s.budget_ns),
        note: "; 0: all that is left of the period",
    },
    Setting {
        key: "seed",
        field: Field::Seed(|s| &mut s.seed),
        note: "",
    },
];

impl Setting {
    /// Its value, as it is typed.
    pub(crate) fn text(&self, settings: SolverSettings) -> String {
        match (self.json(settings), &self.field) {
            (Value::String(word), _) => word,
            (number, Field::Number(..) | Field::Milliseconds(..)) => {
                number.as_f64().map_or("?".to_owned(), number_text)
            }
            (number, _) => number.to_string(),
        }
    }

    /// Its value: a word or a number.
    pub(crate) fn json(&self, mut settings: SolverSettings) -> Value {
        let settings = &mut settings;
        match &self.field {
            Field::Word(words, of) => {
                let word = words().get(*of(settings) as usize).copied();
                json!(word.unwrap_or("unknown code"))
            }
            Field::Count(_, _, of) => json!(of(settings)),
            Field::Number(_, _, of) => json!(of(settings)),
            Field::Milliseconds(_, of) => json!(*of(settings) as f64 * 1e-6),
            Field::Seed(of) => json!(of(settings)),
        }
    }

    /// The words that it may be, if it is no number.
    pub(crate) fn words(&self) -> Vec<String> {
        match &self.field {
            Field::Word(words, _) => words().into_iter().map(str::to_owned).collect(),
            _ => Vec::new(),
        }
    }

    /// What it may be for this daemon, in words.
    pub(crate) fn allowed_by(&self, status: &Status) -> String {
        match self.field {
            Field::Number(_, most, _) if self.key == "safe_distance_m" => format!(
                "{} to {}; no less than in the configuration",
                number_text(status.safe_distance_min_m),
                number_text(most)
            ),
            _ => self.allowed(),
        }
    }

    /// What it may be, in words.
    pub(crate) fn allowed(&self) -> String {
        let range = match &self.field {
            Field::Word(words, _) => {
                let words = words();
                let (last, others) = words.split_last().unwrap_or((&"", &[]));
                format!("{} or {last}", others.join(", "))
            }
            Field::Count(least, most, _) => format!("{least} to {most}"),
            Field::Number(least, most, _) => {
                format!("{} to {}", number_text(*least), number_text(*most))
            }
            Field::Milliseconds(most, _) => format!("0 to {most}"),
            Field::Seed(_) => format!("0 to {}", u64::MAX),
        };
        range + self.note
    }
}

/// With a power of ten where the zeros would be many.
fn number_text(number: f64) -> String {
    if number == 0.0 || (1e-3..1e6).contains(&number.abs()) {
        number.to_string()
    } else {
        format!("{number:e}")
    }
}

/// What one setting shall be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Change {
    setting: &'static Setting,
    value: Wanted,
}

#[derive(Debug, Clone, Copy)]
enum Wanted {
    Code(u32),
    Number(f64),
    Whole(u64),
}

impl Change {
    /// `KEY=VALUE`, with a key that exists and a value in its range.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text
            .split_once('=')
            .ok_or_else(|| format!("{text:?} is no KEY=VALUE, for example horizon_steps=5"))?;
        let (key, value) = (key.trim(), value.trim());
        let known = SETTINGS.iter().find(|setting| setting.key == key);
        let setting = known.ok_or_else(|| unknown(key))?;
        let value = wanted(&setting.field, value)
            .ok_or_else(|| format!("{key} cannot be {value:?}; it may be {}", setting.allowed()))?;
        Ok(Self { setting, value })
    }

    /// Writes it into `settings`.
    pub(crate) fn apply(&self, settings: &mut SolverSettings) {
        match (&self.setting.field, self.value) {
            (Field::Word(_, of) | Field::Count(_, _, of), Wanted::Code(code)) => {
                *of(settings) = code;
            }
            (Field::Number(_, _, of), Wanted::Number(number)) => *of(settings) = number,
            (Field::Milliseconds(_, of) | Field::Seed(of), Wanted::Whole(whole)) => {
                *of(settings) = whole;
            }
            // `wanted` makes no other pairs.
            _ => {}
        }
    }
}

/// The value for a field, when it may be that.
fn wanted(field: &Field, text: &str) -> Option<Wanted> {
    match field {
        Field::Word(words, _) => {
            let at = words().iter().position(|word| *word == text)?;
            Some(Wanted::Code(at as u32))
        }
        Field::Count(least, most, _) => {
            let count: u32 = text.parse().ok()?;
            let is_legal = count >= *least && count as usize <= *most;
            is_legal.then_some(Wanted::Code(count))
        }
        Field::Number(least, most, _) => {
            let number: f64 = text.parse().ok()?;
            (*least..=*most)
                .contains(&number)
                .then_some(Wanted::Number(number))
        }
        Field::Milliseconds(most, _) => {
            let number: f64 = text.parse().ok()?;
            let whole_ns = (number * 1e6).round();
            (0.0..=*most)
                .contains(&number)
                .then_some(Wanted::Whole(whole_ns as u64))
        }
        Field::Seed(_) => text.parse().ok().map(Wanted::Whole),
    }
}

/// The error for a key that does not exist: the nearest one that does, and all.
fn unknown(key: &str) -> String {
    let likeness = |setting: &Setting| strsim::jaro_winkler(setting.key, key);
    let nearest = SETTINGS
        .iter()
        .max_by(|a, b| likeness(a).total_cmp(&likeness(b)))
        .filter(|setting| likeness(setting) > 0.8)
        .map(|setting| format!("; do you mean {}?", setting.key));
    let all: Vec<_> = SETTINGS.iter().map(|setting| setting.key).collect();
    format!(
        "there is no setting {key:?}{} All settings: {}",
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
            let change = Change::parse(&format!("{key}={}", value.trim_matches('"')));
            assert_eq!(change.expect(line).setting.key, key);
            keys.push(key);
        }
        let mut known: Vec<_> = SETTINGS.iter().map(|setting| setting.key).collect();
        keys.sort_unstable();
        known.sort_unstable();
        assert_eq!(known, keys);
    }

    #[test]
    fn what_is_wrong_is_told_with_what_is_right() {
        for (text, part) in [
            ("horizon_steps", "KEY=VALUE"),
            ("horizon_step=3", "do you mean horizon_steps?"),
            ("zzz=3", "All settings: solver, horizon_steps"),
            ("horizon_steps=51", "1 to 50"),
            ("horizon_steps=2.5", "1 to 50"),
            ("solver=newton", "kpso, gauss-newton or kpso-refined"),
            ("position_weight=0", "1e-12 to 1e12"),
            ("inertia=NaN", "0 to 1"),
            ("budget_ms=-1", "0 to 100"),
            ("seed=-1", "0 to 18446744073709551615"),
        ] {
            let error = Change::parse(text).expect_err(text);
            assert!(error.contains(part), "{part} in {error}");
        }
    }

    #[test]
    fn a_budget_in_ms_is_ns_in_the_message() {
        let mut settings = SolverSettings::default();
        Change::parse("budget_ms=2.5")
            .expect("legal")
            .apply(&mut settings);
        assert_eq!(settings.budget_ns, 2_500_000);
    }
}
