//! Validation: the declared range of each number, and rules between keys.

use cdcr_controller::parameters::UserParameter;

use super::error::Result;
use super::{Config, Origins, keys};

/// Rejects the first number outside its range, and the first contradiction between values.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<()> {
    let numbers = numbers(config);
    for (key, parameter, value) in &numbers {
        // NaN is outside every range.
        if let Some(refusal) = parameter.refusal(*value) {
            let message = format_args!("{value} is out of range: {refusal}");
            return Err(origins.error(&[key], message));
        }
    }
    let named = |key: &str| {
        let number = numbers.iter().find(|(known, ..)| known == key);
        let (_, parameter, value) = number.expect("a number of the configuration");
        (parameter.name, *value)
    };
    let period_ms = config.cycle.period_ms;
    let (half_ms, endless) = (0.5 * period_ms, f64::INFINITY);
    let is_automatic = config.realtime.spin_us == -1.0;
    let spin_min_us = if is_automatic { -1.0 } else { 0.0 };
    for (key, low, high) in [
        ("cycle.deadline_ms", 0.0, period_ms),
        ("cycle.budget_ms", 0.0, period_ms),
        ("cycle.budget_margin_ms", 0.0, half_ms),
        ("cycle.gather_lead_ms", 0.0, half_ms),
        ("cycle.watchdog_ms", 10.0 * period_ms, endless),
        ("realtime.spin_us", spin_min_us, 1e3 * half_ms),
        // The estimator remembers 128 periods of commands: the delay, and the age of a measurement.
        ("actuator.delay_ms", 0.0, 64.0 * period_ms),
        (
            "link.tip_age_max_ms",
            0.0,
            120.0 * period_ms - config.actuator.delay_ms,
        ),
    ] {
        let limit = match named(key) {
            (_, value) if value < low => format!("at least {low}"),
            (_, value) if value > high => format!("at most {high}"),
            _ => continue,
        };
        let (name, value) = named(key);
        let message = format_args!(
            "{name} = {value} is out of range: with cycle.period_ms = {period_ms}, allowed is {limit}"
        );
        return Err(origins.error_of(key, &[key, "cycle.period_ms"], message));
    }
    let [exchange, cycle] = ["realtime.exchange_priority", "realtime.cycle_priority"];
    let [warning, fault] = ["safety.following_warning_rad", "safety.following_fault_rad"];
    for (key, relation, other, reason) in [
        (exchange, "below", cycle, "the cycle pre-empts the exchange"),
        (fault, "at least", warning, "the warning comes first"),
    ] {
        let [(name, value), (limit, bound)] = [key, other].map(named);
        if (value < bound) != (relation == "below") {
            let message = format_args!(
                "{name} = {value} must be {relation} {limit} = {bound}, so that {reason}"
            );
            return Err(origins.error(&[key, other], message));
        }
    }
    let (name, timeout_ms) = named("obstacles.source_timeout_ms");
    if timeout_ms < 0.0 && timeout_ms != -1.0 {
        let message =
            format_args!("{name} = {timeout_ms} is out of range: allowed is -1, or at least 0");
        return Err(origins.error(&["obstacles.source_timeout_ms"], message));
    }
    config.controller.validate().map_err(|error| {
        let key = format!("controller.{}", error.key);
        let keys: &[&str] = match error.key {
            "control_blocks" | "terminal_weight" => &[&key, "controller.horizon_steps"],
            "obstacle_slope_penalty" => &[
                &key,
                "controller.obstacle_step_penalty",
                "controller.obstacle_square_penalty",
            ],
            _ => &[&key],
        };
        origins.error(keys, error)
    })
}

/// Every number with its key and declaration.
pub(crate) fn numbers(config: &Config) -> Vec<(String, &'static UserParameter, f64)> {
    let values = keys::values(config);
    let mut numbers = Vec::new();
    for key in keys::ALL.iter().filter(|key| key.parameter.range.is_some()) {
        for (name, value) in keys::each(&values, &key.name) {
            let whole = || value.as_integer().map(|whole| whole as f64);
            let number = value.as_float().or_else(whole);
            numbers.extend(number.map(|number| (name, key.parameter, number)));
        }
    }
    numbers
}
