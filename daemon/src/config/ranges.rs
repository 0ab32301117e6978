//! What is allowed for each number, whatever the other keys say.

use std::ops::RangeInclusive;

use cdcr_controller::{nmpc, robot};
use toml::Value;

use super::{Config, ConfigError, Origins};

/// The allowed values of a key.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    pub(super) key: &'static str,
    pub(super) low: f64,
    pub(super) high: f64,
    /// What other keys allow beyond that, in words; `rules` checks it.
    pub(super) also: Option<&'static str>,
}

const fn range(key: &'static str, low: f64, high: f64) -> Range {
    let also = None;
    Range {
        key,
        low,
        high,
        also,
    }
}

/// A range that the controller or the robot gives.
const fn given(key: &'static str, range: &RangeInclusive<f64>) -> Range {
    let (low, high, also) = (*range.start(), *range.end(), None);
    Range {
        key,
        low,
        high,
        also,
    }
}

impl Range {
    const fn also(mut self, words: &'static str) -> Self {
        self.also = Some(words);
        self
    }
}

const AT_MOST_PERIOD: &str = "at most cycle.period_ms";
const NOT_FLAT: &str =
    "slope and square together at least a millionth of the step at a depth of 1 mm";
const AT_MOST_HALF: &str = "at most half of cycle.period_ms";

/// Every key that is a number and has constant limits. The unit ends the key.
pub(super) const RANGES: [Range; 59] = [
    given(
        "robot.cable_speed_max_m_s",
        &robot::ranges::CABLE_SPEED_MAX_M_S,
    ),
    given(
        "robot.cable_stroke_max_m",
        &robot::ranges::CABLE_STROKE_MAX_M,
    ),
    given("robot.sections.length_m", &robot::ranges::LENGTH_M).also("above cable_radius_m"),
    given(
        "robot.sections.cable_radius_m",
        &robot::ranges::CABLE_RADIUS_M,
    )
    .also("below length_m"),
    given(
        "robot.sections.cable_offset_rad",
        &robot::ranges::CABLE_OFFSET_RAD,
    ),
    given("robot.sections.bend_max_rad", &robot::ranges::BEND_MAX_RAD),
    given(
        "robot.sections.rate_max_rad_s",
        &robot::ranges::RATE_MAX_RAD_S,
    ),
    given(
        "robot.sections.body_radius_m",
        &robot::ranges::BODY_RADIUS_M,
    ),
    range("link.simulated_seed", 0.0, 4_294_967_295.0),
    range("link.measurement_timeout_ms", 1.0, 10_000.0),
    range("link.command_valid_ms", 0.0, 10_000.0),
    range("actuator.delay_ms", 0.0, 300.0),
    range("actuator.time_constant_ms", 0.0, 300.0),
    range("estimator.time_constant_ms", 0.0, 10_000.0),
    range("cycle.period_ms", 0.1, 100.0).also("at least twice cycle.gather_lead_ms"),
    range("cycle.deadline_ms", 0.0, 100.0).also(AT_MOST_PERIOD),
    range("cycle.late_start_ms", 0.001, 100.0),
    range("cycle.budget_ms", 0.0, 100.0).also(AT_MOST_PERIOD),
    range("cycle.budget_margin_ms", 0.0, 50.0).also(AT_MOST_HALF),
    range("cycle.gather_lead_ms", 0.02, 50.0).also(AT_MOST_HALF),
    range("cycle.miss_limit", 0.0, 1e6),
    range("cycle.watchdog_ms", 50.0, 60_000.0).also("at least ten times cycle.period_ms"),
    range("motion.deceleration_rad_s2", 0.01, 1e6),
    range("motion.acceleration_rad_s2", 0.0, 1e6),
    range("motion.home_rate_rad_s", 1e-3, 100.0),
    range("motion.home_tolerance_rad", 1e-6, 1.0),
    range("safety.clearance_fault_m", -10.0, 10.0),
    range("safety.measurement_jump_rad", 1e-6, 1e3),
    range("safety.measurement_jump_limit", 1.0, 1e6),
    range("safety.measurement_frozen_rad", 1e-6, 1e3),
    range("safety.following_warning_rad", 1e-6, 1e3).also("at most safety.following_fault_rad"),
    range("safety.following_fault_rad", 1e-6, 1e3).also("at least safety.following_warning_rad"),
    range("safety.following_lag_ms", 0.0, 10_000.0),
    range("obstacles.source_timeout_ms", 0.0, 60_000.0),
    range("reference.lease_ms", 20.0, 60_000.0),
    given("controller.horizon_steps", &nmpc::ranges::HORIZON_STEPS),
    given("controller.control_blocks", &nmpc::ranges::CONTROL_BLOCKS)
        .also("at most controller.horizon_steps"),
    given("controller.swarm_size", &nmpc::ranges::SWARM_SIZE),
    given("controller.swarm_iterations", &nmpc::ranges::ITERATIONS),
    given("controller.regenerate_after", &nmpc::ranges::ITERATIONS),
    given("controller.inertia", &nmpc::ranges::INERTIA),
    given("controller.cognitive", &nmpc::ranges::COEFFICIENT),
    given("controller.social", &nmpc::ranges::COEFFICIENT),
    given(
        "controller.refinement_steps",
        &nmpc::ranges::REFINEMENT_STEPS,
    ),
    given("controller.damping", &nmpc::ranges::DAMPING),
    given("controller.position_weight", &nmpc::ranges::POSITION_WEIGHT),
    given("controller.orientation_weight", &nmpc::ranges::WEIGHT),
    given(
        "controller.orientation_tolerance_rad",
        &nmpc::ranges::ORIENTATION_TOLERANCE_RAD,
    ),
    given("controller.rate_weight", &nmpc::ranges::WEIGHT),
    given("controller.rate_change_weight", &nmpc::ranges::WEIGHT),
    given("controller.terminal_weight", &nmpc::ranges::WEIGHT)
        .also("above 0 where controller.horizon_steps is 1"),
    given("controller.safe_distance_m", &nmpc::ranges::SAFE_DISTANCE_M),
    given("controller.obstacle_step_penalty", &nmpc::ranges::WEIGHT).also(NOT_FLAT),
    given("controller.obstacle_slope_penalty", &nmpc::ranges::WEIGHT).also(NOT_FLAT),
    given("controller.obstacle_square_penalty", &nmpc::ranges::WEIGHT),
    range("realtime.core", -1.0, 1023.0),
    range("realtime.cycle_priority", 2.0, 99.0).also("above realtime.exchange_priority"),
    range("realtime.exchange_priority", 1.0, 98.0).also("below realtime.cycle_priority"),
    range("realtime.spin_us", 0.0, 1000.0).also(AT_MOST_HALF),
];

/// The range of a key.
pub(super) fn of(key: &str) -> Option<&'static Range> {
    RANGES.iter().find(|range| range.key == key)
}

/// Refuses the first number outside its range, NaN included.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    // Not by way of JSON, which has neither NaN nor infinity.
    let values = Value::try_from(config)
        .map_err(|error| origins.error(&["the configuration"], &error.to_string()))?;
    for range in &RANGES {
        for (key, value) in found(&values, range.key) {
            if !(range.low..=range.high).contains(&value) {
                let allowed = format!("{} to {}", number(range.low), number(range.high));
                let message = format!("{value} is out of range: allowed is {allowed}");
                return Err(origins.error(&[&key], &message));
            }
        }
    }
    Ok(())
}

/// The numbers of a key, one for each table of a list.
fn found(values: &Value, key: &str) -> Vec<(String, f64)> {
    let mut at = vec![(String::new(), values)];
    for part in key.split('.') {
        let below = at.into_iter().filter_map(|(path, value)| {
            let dot = if path.is_empty() { "" } else { "." };
            Some((format!("{path}{dot}{part}"), value.get(part)?))
        });
        at = below.flat_map(each).collect();
    }
    at.into_iter()
        .map(|(key, value)| {
            let whole = value.as_integer().map(|value| value as f64);
            (key, value.as_float().or(whole).unwrap_or(f64::NAN))
        })
        .collect()
}

/// The elements of a list; anything else as it is.
fn each((path, value): (String, &Value)) -> Vec<(String, &Value)> {
    match value.as_array() {
        Some(list) => {
            let elements = list.iter().enumerate();
            elements
                .map(|(index, value)| (format!("{path}[{index}]"), value))
                .collect()
        }
        None => vec![(path, value)],
    }
}

/// A limit as people write it.
pub(super) fn number(value: f64) -> String {
    use std::f64::consts::{PI, TAU};
    let size = value.abs();
    if size == PI || size == TAU {
        let sign = if value < 0.0 { "-" } else { "" };
        let name = if size == PI { "π" } else { "2π" };
        return format!("{sign}{name}");
    }
    if size != 0.0 && !(1e-6..1e7).contains(&size) {
        return format!("{value:e}");
    }
    value.to_string()
}
