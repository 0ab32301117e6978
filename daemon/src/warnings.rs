//! Valid configurations that are probably unintended.

use cdcr_controller::nmpc::{
    RateWeight, budget_warning, posture_gain_warning, rate_change_weight_warning,
    rate_weight_warning, safe_distance_warning,
};
use cdcr_controller::robot::SectionParameters;

use crate::config::{Config, Interface, LinkKind, REST_MAX_S, TipSensor, ns, numbers};
use crate::core_budget::{CoreBudget, Costs};
use crate::handover::approach_limits;

/// Largest stroke of a cable that is taken to be meant \[m\].
const STROKE_M_MAX: f64 = 2.0;
/// Largest play that is taken to be meant, as a share of a section's stroke.
const PLAY_SHARE_MAX: f64 = 0.1;
/// Smallest speed limit of a cable that is taken to be meant, as a share of what the largest rates need.
const CABLE_SPEED_SHARE_MIN: f64 = 0.02;
/// Largest tolerance of home that is taken to be meant \[rad\].
const HOME_RAD_MAX: f64 = 0.1;
/// Fastest tip while homing that is taken to be meant \[m/s\].
const HOME_M_S_MAX: f64 = 1.0;
/// Smallest stroke that is taken to be meant, as a share of what full bends need.
const STROKE_SHARE_MIN: f64 = 0.7;
/// Longest validity of a command that is taken to be meant \[ms\].
const VALID_MS_MAX: f64 = 1000.0;
/// Motion at a usual speed, 0.25 m/s, is 25 mm in this time \[ms\].
const HANG_MS_MAX: f64 = 100.0;

/// Adds the texts whose conditions hold.
macro_rules! warn_where {
    ($warnings:ident: $($condition:expr => $text:literal $(, $argument:expr)*;)+) => {
        $(if $condition { $warnings.push(format!($text $(, $argument)*)); })+
    };
}

/// Warnings about valid but probably unintended settings, each with its keys.
pub(crate) fn warnings(config: &Config) -> Vec<String> {
    let Config {
        link,
        cycle,
        motion,
        safety,
        reference,
        controller,
        ..
    } = config;
    let deadline_ms = cycle.deadline_ns() as f64 / 1e6;
    let left_ns = cycle.deadline_ns().saturating_sub(cycle.budget_margin_ns());
    let left_ms = left_ns as f64 / 1e6;
    let period_ms = cycle.period_ms;
    let length_m = config.robot.length_m();
    let ramp_s = config.robot.fastest_rad_s() / motion.deceleration_rad_s2;
    let mut all = Vec::new();
    warn_where! { all:
        left_ms <= 0.0 => "cycle.deadline_ms leaves the solver no time: cycle.budget_margin_ms uses up the deadline of {deadline_ms} ms";
        left_ms > 0.0 && cycle.budget_ms > left_ms =>
            "cycle.budget_ms = {} has no effect: deadline minus margin is {left_ms} ms", cycle.budget_ms;
        ramp_s > REST_MAX_S =>
            "motion.deceleration_rad_s2 = {}: braking from the largest rate takes {ramp_s:.0} s, but an ending daemon waits only {REST_MAX_S} s",
            motion.deceleration_rad_s2;
        ns(cycle.late_start_ms) > ns(deadline_ms) =>
            "cycle.late_start_ms = {} is longer than the deadline of {deadline_ms} ms: a late start is always a deadline miss too",
            cycle.late_start_ms;
        link.command_valid_ms > 0.0 && link.command_valid_ms < period_ms =>
            "link.command_valid_ms = {} is shorter than cycle.period_ms = {period_ms}: the robot holds before the next command arrives",
            link.command_valid_ms;
        link.kind == LinkKind::Simulated && link.tip_sensor == TipSensor::Separate =>
            "link.tip_sensor = \"separate\" has no effect: the simulated robot accepts no measurements";
    }
    all.extend(of_rate_weight(config));
    all.extend(of_weights_beside_the_rates(config));
    home_speed(config, &mut all);
    source_timeout(config, &mut all);
    warn_where! { all:
        reference.lease_ms < period_ms =>
            "reference.lease_ms = {} is shorter than cycle.period_ms = {period_ms}: a lease expires before it can be renewed",
            reference.lease_ms;
        safety.clearance_fault_m > controller.safe_distance_m =>
            "safety.clearance_fault_m = {} is above controller.safe_distance_m = {}: the robot faults at clearances that the clearance guard allows",
            safety.clearance_fault_m, controller.safe_distance_m;
    }
    let safe_distance = safe_distance_warning(controller.safe_distance_m, length_m);
    all.extend(safe_distance.map(|warning| format!("controller.{warning}")));
    all.extend(budget_warning(cycle.budget_ms).map(|warning| format!("cycle.{warning}")));
    cut(config, &mut all);
    tip_speed(config, &mut all);
    for (j, section) in config.robot.sections.iter().enumerate() {
        of_section(j, section, &mut all);
    }
    all.extend(unusual(config));
    of_units(config, &mut all);
    of_reach(config, &mut all);
    of_checks(config, &mut all);
    all
}

/// Values beyond what their declarations call usual.
fn unusual(config: &Config) -> Vec<String> {
    let numbers = numbers(config).into_iter();
    let unusual = numbers.filter_map(|(key, parameter, value)| {
        let warning = parameter.warning(value)?;
        Some(format!("{key} = {value}: {warning}"))
    });
    unusual.collect()
}

/// Values that are probably in another unit.
fn of_units(config: &Config, all: &mut Vec<String>) {
    let actuator = &config.actuator;
    let is_short = |ms: f64| ms > 0.0 && ms < 0.5_f64.min(0.1 * config.cycle.period_ms);
    let full_m = config.robot.full_stroke_m();
    let stroke_m = config.robot.cable_stroke_max_m;
    let overlap_m = config.robot.self_overlap_max_m;
    let radii_m = config.robot.sections.iter().map(|it| it.body_radius_m);
    let thinnest_m = 2.0 * radii_m.fold(f64::INFINITY, f64::min);
    let bend_m = config.robot.least_stroke_m();
    // Upper bound: all components at their largest rates, in the direction of one cable.
    let sections = config.robot.sections.iter();
    let speeds_m_s = sections.map(|section| section.cable_radius_m * section.rate_max_rad_s);
    let fastest_m_s = core::f64::consts::SQRT_2 * speeds_m_s.sum::<f64>();
    let cable_m_s = config.robot.cable_speed_max_m_s;
    warn_where! { all:
        actuator.play_m > PLAY_SHARE_MAX * bend_m =>
            "actuator.play_m = {}: the cables of a section move by {bend_m:.4} m at its full bend; check the unit (m). A robot swings where this \
             is more than its play (docs/robustness.md)", actuator.play_m;
        cable_m_s < CABLE_SPEED_SHARE_MIN * fastest_m_s =>
            "robot.cable_speed_max_m_s = {cable_m_s}: the rates of this robot need up to {fastest_m_s:.3} m/s, and all are scaled down to it; check \
             the unit (m/s)";
        is_short(actuator.delay_ms) => "actuator.delay_ms = {}: check the unit (ms)", actuator.delay_ms;
        is_short(actuator.time_constant_ms) => "actuator.time_constant_ms = {}: check the unit (ms)", actuator.time_constant_ms;
        thinnest_m > 0.0 && (thinnest_m..1.0).contains(&overlap_m) =>
            "robot.self_overlap_max_m = {overlap_m}: parts of the body, {thinnest_m} m thick, may pass through each other; lower it, or set it to 1.0 for a \
             body that is not checked";
        stroke_m > STROKE_M_MAX.max(full_m) =>
            "robot.cable_stroke_max_m = {stroke_m}: at full bend no cable moves by more than {full_m:.3} m; check the unit (m)";
    }
}

/// Limits with which the robot hardly moves, or not where it is asked to.
fn of_reach(config: &Config, all: &mut Vec<String>) {
    let motion = &config.motion;
    let grows_s = config.robot.fastest_rad_s() / motion.acceleration_rad_s2;
    let full_m = config.robot.full_stroke_m();
    let stroke_m = config.robot.cable_stroke_max_m;
    warn_where! { all:
        motion.home_tolerance_rad > HOME_RAD_MAX =>
            "motion.home_tolerance_rad = {}: a robot that is bent by up to that counts as straight, and home does not move it; \
             check the unit (rad)",
            motion.home_tolerance_rad;
        motion.acceleration_rad_s2 > 0.0 && grows_s > REST_MAX_S =>
            "motion.acceleration_rad_s2 = {}: a rate takes {grows_s:.0} s to grow to its limit, so that the robot hardly moves; \
             check the unit (rad/s²)",
            motion.acceleration_rad_s2;
        stroke_m < STROKE_SHARE_MIN * full_m =>
            "robot.cable_stroke_max_m = {stroke_m}: at full bend of all sections to one side a cable moves by {full_m:.3} m, so the strokes \
             keep the robot from most of its reach; check the unit (m)";
    }
}

/// Checks of a robot behind a driver that these values switch off, or that act too early.
fn of_checks(config: &Config, all: &mut Vec<String>) {
    let (safety, link, period_ms) = (&config.safety, &config.link, config.cycle.period_ms);
    if link.kind != LinkKind::Driver {
        return;
    }
    let bends_rad = config.robot.sections.iter().map(|s| s.bend_max_rad);
    let most_rad = 2.0 * bends_rad.fold(0.0, f64::max);
    let bend_m = config.robot.least_stroke_m();
    let unmeasured_rad = config.robot.fastest_rad_s() * link.measurement_timeout_ms * 1e-3;
    for (key, value) in [
        ("following_fault_rad", safety.following_fault_rad),
        ("measurement_jump_rad", safety.measurement_jump_rad),
        ("measurement_frozen_rad", safety.measurement_frozen_rad),
    ] {
        warn_where! { all:
            value > most_rad =>
                "safety.{key} = {value} is more than a section of this robot can change its bend ({most_rad} rad): the check of bends \
                 does not act; check the unit (rad)";
        }
    }
    warn_where! { all:
        link.measurement_timeout_ms < period_ms =>
            "link.measurement_timeout_ms = {} is shorter than cycle.period_ms = {period_ms}: a driver that measures once \
             per period times out at once",
            link.measurement_timeout_ms;
        safety.measurement_frozen_rad < unmeasured_rad =>
            "safety.measurement_frozen_rad = {}: a bend can be commanded by {unmeasured_rad:.3} rad within link.measurement_timeout_ms = {}, \
             so that a late measurement counts as frozen", safety.measurement_frozen_rad, link.measurement_timeout_ms;
        safety.clearance_fault_m < 0.0 =>
            "safety.clearance_fault_m = {}: a body up to {} m inside an obstacle is not a fault", safety.clearance_fault_m, -safety.clearance_fault_m;
        safety.cable_common_m == 0.0 =>
            "safety.cable_common_m = 0: where cable lengths are measured, a broken or slack cable is not detected";
        safety.cable_common_m > bend_m =>
            "safety.cable_common_m = {}: a cable of a section moves by {bend_m:.4} m at its full bend, so where cable lengths are measured, \
             a broken or slack cable is not detected; check the unit (m)", safety.cable_common_m;
        link.interface == Interface::Position && link.measurement_timeout_ms > HANG_MS_MAX =>
            "link.measurement_timeout_ms = {}: a position driver that hangs is detected only after this time; until then the commanded \
             position moves by up to {unmeasured_rad:.3} rad of a bend, and the displayed pose is wrong (docs/drivers.md, After a hang)",
            link.measurement_timeout_ms;
        link.command_valid_ms > VALID_MS_MAX =>
            "link.command_valid_ms = {}: the robot may keep moving this long after its daemon has died", link.command_valid_ms;
    }
}

/// Of one section. Lists of a configuration count from 0.
fn of_section(j: usize, section: &SectionParameters, all: &mut Vec<String>) {
    let (cable_m, body_m) = (section.cable_radius_m, section.body_radius_m);
    let is_other = cable_m > 3.0 * body_m && body_m > 0.0;
    let check = if is_other {
        "; check the unit of both (m)"
    } else {
        ""
    };
    warn_where! { all:
        cable_m > body_m =>
            "robot.sections[{j}].body_radius_m = {body_m} is below cable_radius_m = {cable_m}: cables and discs lie outside the \
             body that the clearance guard protects{check}";
        cable_m < 0.2 * body_m =>
            "robot.sections[{j}].cable_radius_m = {cable_m} is far inside the body of {body_m} m; check the unit (m). A wrong \
             radius bends the robot by a wrong factor";
    }
}

/// Upper bound of the speed of the tip where every component of a section has at most this rate \[m/s\]: a
/// section moves its own end by half its length for each rad, and turns everything beyond.
fn tip_speed_max_m_s(
    sections: &[SectionParameters],
    rate_rad_s: impl Fn(&SectionParameters) -> f64,
) -> f64 {
    let (mut most_m_s, mut beyond_m) = (0.0, 0.0);
    for section in sections.iter().rev() {
        let lever_m = 0.5 * section.length_m + beyond_m;
        most_m_s += core::f64::consts::SQRT_2 * rate_rad_s(section) * lever_m;
        beyond_m += section.length_m;
    }
    most_m_s
}

/// A tip that homes faster than people expect of a motion home.
fn home_speed(config: &Config, all: &mut Vec<String>) {
    let rate_rad_s = config.motion.home_rate_rad_s;
    let limit_m_s = config.robot.tip_speed_max_m_s;
    let sections = &config.robot.sections;
    let most_m_s = tip_speed_max_m_s(sections, |section| rate_rad_s.min(section.rate_max_rad_s));
    let is_limited = limit_m_s > 0.0 && limit_m_s <= HOME_M_S_MAX;
    // An unusual rate has a warning of its own.
    let key = "motion.home_rate_rad_s";
    let is_usual = !unusual(config).iter().any(|text| text.starts_with(key));
    warn_where! { all:
        most_m_s > HOME_M_S_MAX && is_usual && !is_limited =>
            "{key} = {rate_rad_s}: home moves the tip of this robot at up to {most_m_s:.1} m/s; lower it, or set robot.tip_speed_max_m_s";
    }
}

/// A speed limit of the section ends that never acts, or always.
fn tip_speed(config: &Config, all: &mut Vec<String>) {
    let (motion, limit_m_s) = (&config.motion, config.robot.tip_speed_max_m_s);
    if limit_m_s == 0.0 {
        return;
    }
    let sections = &config.robot.sections;
    let most_m_s = tip_speed_max_m_s(sections, |section| section.rate_max_rad_s);
    let last = config.robot.sections.last();
    let homing_m_s = last.map_or(0.0, |last| 0.5 * last.length_m * motion.home_rate_rad_s);
    let approach = approach_limits(config);
    let key = "robot.tip_speed_max_m_s";
    warn_where! { all:
        limit_m_s > most_m_s =>
            "{key} = {limit_m_s} has no effect: the largest rates move the tip at {most_m_s:.2} m/s at most; check the unit (m/s)";
        limit_m_s < 0.1 * homing_m_s =>
            "{key} = {limit_m_s}: the last section alone moves the tip at {homing_m_s:.3} m/s at motion.home_rate_rad_s = \
             {}, so that homing takes more than ten times as long; check the unit (m/s)", motion.home_rate_rad_s;
        approach.is_some_and(|approach| approach.speed_m_s > limit_m_s) =>
            "motion.approach_speed_m_s = {} is above {key} = {limit_m_s}: the tip falls behind its approach to a \
             reference; lower it, too", motion.approach_speed_m_s;
    }
}

fn of_rate_weight(config: &Config) -> Option<String> {
    let RateWeight::Of(weight) = config.controller.rate_weight else {
        return None;
    };
    let sections = config.robot.sections.len();
    let warning = rate_weight_warning(weight, sections, config.link.is_ideal())?;
    Some(format!(
        "controller.{warning}; set \"auto\", or remove the key"
    ))
}

fn of_weights_beside_the_rates(config: &Config) -> impl Iterator<Item = String> {
    let controller = &config.controller;
    let rate_weight = match controller.rate_weight {
        RateWeight::Auto => RateWeight::auto(config.link.is_ideal()),
        weight @ RateWeight::Of(_) => weight,
    };
    let change = rate_change_weight_warning(
        rate_weight.into(),
        controller.rate_change_weight,
        1e-3 * config.cycle.period_ms,
        config.robot.sections.len(),
    );
    let posture = posture_gain_warning(
        controller.posture_gain,
        rate_weight.into(),
        controller.horizon_steps,
    );
    let warnings = [change, posture].into_iter().flatten();
    warnings.map(|warning| format!("controller.{warning}"))
}

/// A probably unintended timeout of the obstacle sources.
fn source_timeout(config: &Config, all: &mut Vec<String>) {
    let (timeout_ms, period_ms) = (config.obstacles.source_timeout_ms, config.cycle.period_ms);
    warn_where! { all:
        config.link.kind == LinkKind::Driver && timeout_ms == 0.0 =>
            "obstacles.source_timeout_ms = 0: when a source of obstacles fails, its obstacles expire and the robot \
             can collide with them; remove the key, or set a few times the send interval of the source";
        timeout_ms > 0.0 && timeout_ms < period_ms =>
            "obstacles.source_timeout_ms = {timeout_ms} is shorter than cycle.period_ms = {period_ms}: a source that \
             sends once per period times out at once";
    }
}

/// The configured time of the solver exceeds the real-time threads' share of the core.
fn cut(config: &Config, all: &mut Vec<String>) {
    let cycle = &config.cycle;
    let is_asked_for = cycle.budget_ms > 0.0 || cycle.budget_margin_ms > 0.0;
    let until_ns = cycle.deadline_ns().saturating_sub(cycle.budget_margin_ns());
    let asked_ns = match ns(cycle.budget_ms) {
        0 => until_ns,
        budget_ns => budget_ns.min(until_ns),
    };
    let (budget, costs) = (CoreBudget::new(config), Costs::default());
    warn_where! { all:
        is_asked_for && asked_ns > budget.solve_ns(costs) =>
            "the solver budget is cut below the {} ms of cycle.budget_ms and cycle.budget_margin_ms: {}; Linux halts \
             real-time threads above 95 % of a core (realtime.spin_us included)", asked_ns as f64 / 1e6, budget.describe(costs);
    }
}
