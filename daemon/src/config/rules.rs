//! Validation: the declared range of each number, and rules between keys.

use cdcr_controller::parameters::UserParameter;

use super::{Config, ConfigError, Origins, keys};

/// Rejects the first number outside its range, and the first contradiction between values.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let numbers = numbers(config);
    // NaN is outside every range.
    for (key, parameter, value) in &numbers {
        if let Some(refusal) = parameter.refusal(*value) {
            let message = format!("{value} is out of range: {refusal}");
            return Err(origins.error(&[key], &message));
        }
    }
    check_times(config, &numbers, origins)?;
    let (realtime, safety) = (&config.realtime, &config.safety);
    let (exchange, cycle) = (realtime.exchange_priority, realtime.cycle_priority);
    let (warning_rad, fault_rad) = (safety.following_warning_rad, safety.following_fault_rad);
    let timeout_ms = config.obstacles.source_timeout_ms;
    let rules: [(bool, &[&str], String); 3] = [
        (
            exchange < cycle,
            &["realtime.exchange_priority", "realtime.cycle_priority"],
            format!(
                "exchange_priority = {exchange} must be below cycle_priority = {cycle}, so that the cycle pre-empts the \
                 exchange"
            ),
        ),
        (
            warning_rad <= fault_rad,
            &["safety.following_fault_rad", "safety.following_warning_rad"],
            format!(
                "following_fault_rad = {fault_rad} must be at least following_warning_rad = {warning_rad}, so that the \
                 warning comes first"
            ),
        ),
        (
            timeout_ms >= 0.0 || timeout_ms == -1.0,
            &["obstacles.source_timeout_ms"],
            format!(
                "source_timeout_ms = {timeout_ms} is out of range: allowed is -1, or at least 0"
            ),
        ),
    ];
    if let Some((_, keys, message)) = rules.iter().find(|(is_kept, ..)| !is_kept) {
        return Err(origins.error(keys, message));
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
        origins.error(keys, &error.to_string())
    })
}

/// Checks the times that depend on the period.
fn check_times(
    config: &Config,
    numbers: &[(String, &UserParameter, f64)],
    origins: &Origins,
) -> Result<(), ConfigError> {
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
        // The estimator remembers 128 periods, and measurements have an age.
        ("actuator.delay_ms", 0.0, 64.0 * period_ms),
        ("link.tip_age_max_ms", 0.0, 100.0 * period_ms),
    ] {
        let number = numbers.iter().find(|(known, ..)| known == key);
        let (_, _, value) = *number.expect("a number of the configuration");
        let limit = match value {
            value if value < low => format!("at least {low}"),
            value if value > high => format!("at most {high}"),
            _ => continue,
        };
        let (_, name) = key.split_once('.').unwrap_or_default();
        let message = format!(
            "{name} = {value} is out of range: with cycle.period_ms = {period_ms}, allowed is {limit}"
        );
        return Err(origins.error_of_first(&[key, "cycle.period_ms"], &message));
    }
    Ok(())
}

/// Every number with its key and declaration.
pub(crate) fn numbers(config: &Config) -> Vec<(String, &'static UserParameter, f64)> {
    let sections = config.robot.sections.iter().enumerate();
    let sections = sections.map(|(index, section)| {
        let numbers = section.numbers().to_vec();
        (format!("robot.sections[{index}]"), numbers)
    });
    let mut all = Vec::new();
    for (table, numbers) in config.numbers_by_table().into_iter().chain(sections) {
        let parameters = keys::below(&keys::without_indices(&table)).iter();
        let numbers = parameters.zip(numbers).filter_map(|(parameter, number)| {
            Some((format!("{table}.{}", parameter.name), parameter, number?))
        });
        all.extend(numbers);
    }
    all
}
