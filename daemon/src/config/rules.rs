//! Rules between keys.

use super::{Config, ConfigError, Origins};

/// Refuses the first pair of values that contradict each other.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    check_times(config, origins)?;
    check_priorities(config, origins)?;
    check_following(config, origins)?;
    check_source_timeout(config, origins)?;
    config.controller.validate().map_err(|error| {
        let key = format!("controller.{}", error.key);
        let others: &[&str] = match error.key {
            "control_blocks" | "terminal_weight" => &["controller.horizon_steps"],
            "obstacle_slope_penalty" => &[
                "controller.obstacle_step_penalty",
                "controller.obstacle_square_penalty",
            ],
            _ => &[],
        };
        let keys = [&[key.as_str()], others].concat();
        origins.error(&keys, &error.to_string())
    })
}

/// Times that the period bounds.
fn check_times(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let (cycle, realtime) = (&config.cycle, &config.realtime);
    let period_ms = cycle.period_ms;
    let (half_ms, endless) = (0.5 * period_ms, f64::INFINITY);
    let rules = [
        ("cycle.deadline_ms", cycle.deadline_ms, 0.0, period_ms),
        ("cycle.budget_ms", cycle.budget_ms, 0.0, period_ms),
        (
            "cycle.budget_margin_ms",
            cycle.budget_margin_ms,
            0.0,
            half_ms,
        ),
        ("cycle.gather_lead_ms", cycle.gather_lead_ms, 0.0, half_ms),
        (
            "cycle.watchdog_ms",
            cycle.watchdog_ms,
            10.0 * period_ms,
            endless,
        ),
        (
            "realtime.spin_us",
            realtime.spin_us,
            if realtime.spin_us == -1.0 { -1.0 } else { 0.0 },
            1e3 * half_ms,
        ),
        // The estimator remembers 128 periods, and measurements have an age.
        (
            "actuator.delay_ms",
            config.actuator.delay_ms,
            0.0,
            64.0 * period_ms,
        ),
    ];
    for (key, value, low, high) in rules {
        if (low..=high).contains(&value) {
            continue;
        }
        let limit = if value < low {
            format!("at least {low}")
        } else {
            format!("at most {high}")
        };
        let name = key.rsplit('.').next().unwrap_or(key);
        let message = format!(
            "{name} = {value} is out of range: with cycle.period_ms = {period_ms}, allowed is {limit}"
        );
        return Err(origins.error(&[key, "cycle.period_ms"], &message));
    }
    Ok(())
}

fn check_following(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let warning_rad = config.safety.following_warning_rad;
    let fault_rad = config.safety.following_fault_rad;
    if warning_rad <= fault_rad {
        return Ok(());
    }
    Err(origins.error(
        &["safety.following_fault_rad", "safety.following_warning_rad"],
        &format!(
            "following_fault_rad = {fault_rad} must be at least following_warning_rad = {warning_rad}, so that the \
             warning comes first"
        ),
    ))
}

/// Below 0, -1 alone has a meaning.
fn check_source_timeout(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let timeout_ms = config.obstacles.source_timeout_ms;
    if timeout_ms >= 0.0 || timeout_ms == -1.0 {
        return Ok(());
    }
    Err(origins.error(
        &["obstacles.source_timeout_ms"],
        &format!("source_timeout_ms = {timeout_ms} is out of range: allowed is -1, or at least 0"),
    ))
}

fn check_priorities(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let exchange = config.realtime.exchange_priority;
    let cycle = config.realtime.cycle_priority;
    if exchange < cycle {
        return Ok(());
    }
    Err(origins.error(
        &["realtime.exchange_priority", "realtime.cycle_priority"],
        &format!(
            "exchange_priority = {exchange} must be below cycle_priority = {cycle}, so that the cycle \
             pre-empts the exchange"
        ),
    ))
}
