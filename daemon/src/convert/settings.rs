//! Settings of the solver, both ways.

use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
use cdcr_controller::optimizer::VelocityRule;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{self, Outcome};

use crate::handover::Settings;

/// Longest budget of a solve that can be asked for \[ns\]: the longest period.
const BUDGET_MAX_NS: u64 = 100_000_000;

/// Settings on the wire. Fields of functions that this build does not have are zero.
pub fn settings_to_wire(settings: &Settings) -> wire::SolverSettings {
    let Settings {
        nmpc: settings,
        budget_ns,
    } = settings;
    wire::SolverSettings {
        solver: match settings.solver {
            SolverKind::Kpso => codes::SolverKind::Kpso,
            SolverKind::GaussNewton => codes::SolverKind::GaussNewton,
            SolverKind::KpsoRefined => codes::SolverKind::KpsoRefined,
        }
        .code(),
        coordinates: match settings.coordinates {
            Coordinates::BendVector => codes::Coordinates::BendVector,
            Coordinates::BendAngles => codes::Coordinates::BendAngles,
        }
        .code(),
        horizon_steps: settings.horizon_steps,
        control_blocks: settings.control_blocks,
        swarm_size: settings.swarm_size,
        swarm_iterations: settings.swarm_iterations,
        regenerate_after: settings.regenerate_after,
        velocity_rule: match settings.velocity_rule {
            VelocityRule::Inertia => codes::VelocityRule::Inertia,
            VelocityRule::Constriction => codes::VelocityRule::Constriction,
            VelocityRule::Verbatim => codes::VelocityRule::Verbatim,
        }
        .code(),
        refinement_steps: settings.refinement_steps,
        inertia: settings.inertia,
        cognitive: settings.cognitive,
        social: settings.social,
        damping: settings.damping,
        position_weight: settings.position_weight,
        orientation_weight: settings.orientation_weight,
        orientation_tolerance_rad: settings.orientation_tolerance_rad,
        rate_weight: settings.rate_weight,
        rate_change_weight: settings.rate_change_weight,
        terminal_weight: settings.terminal_weight,
        safe_distance_m: settings.safe_distance_m,
        obstacle_step_penalty: settings.obstacle_step_penalty,
        obstacle_slope_penalty: settings.obstacle_slope_penalty,
        obstacle_square_penalty: settings.obstacle_square_penalty,
        budget_ns: *budget_ns,
        seed: settings.seed,
        ..wire::SolverSettings::default()
    }
}

/// Settings from the wire, checked. What this build does not have is refused, never ignored.
///
/// # Errors
/// `UnknownCode` or `OutOfRange`.
pub fn settings_from_wire(message: &wire::SolverSettings) -> Result<Settings, Outcome> {
    if message.reserved != 0 {
        return Err(Outcome::UnknownCode);
    }
    if message.budget_ns > BUDGET_MAX_NS {
        return Err(Outcome::OutOfRange);
    }
    let unknown = |_| Outcome::UnknownCode;
    let settings = NmpcSettings {
        solver: match codes::SolverKind::try_from(message.solver).map_err(unknown)? {
            codes::SolverKind::Kpso => SolverKind::Kpso,
            codes::SolverKind::GaussNewton => SolverKind::GaussNewton,
            codes::SolverKind::KpsoRefined => SolverKind::KpsoRefined,
        },
        coordinates: match codes::Coordinates::try_from(message.coordinates).map_err(unknown)? {
            codes::Coordinates::BendVector => Coordinates::BendVector,
            codes::Coordinates::BendAngles => Coordinates::BendAngles,
        },
        horizon_steps: message.horizon_steps,
        control_blocks: message.control_blocks,
        swarm_size: message.swarm_size,
        swarm_iterations: message.swarm_iterations,
        regenerate_after: message.regenerate_after,
        velocity_rule: match codes::VelocityRule::try_from(message.velocity_rule)
            .map_err(unknown)?
        {
            codes::VelocityRule::Inertia => VelocityRule::Inertia,
            codes::VelocityRule::Constriction => VelocityRule::Constriction,
            codes::VelocityRule::Verbatim => VelocityRule::Verbatim,
        },
        inertia: message.inertia,
        cognitive: message.cognitive,
        social: message.social,
        refinement_steps: message.refinement_steps,
        damping: message.damping,
        position_weight: message.position_weight,
        orientation_weight: message.orientation_weight,
        orientation_tolerance_rad: message.orientation_tolerance_rad,
        rate_weight: message.rate_weight,
        rate_change_weight: message.rate_change_weight,
        terminal_weight: message.terminal_weight,
        safe_distance_m: message.safe_distance_m,
        obstacle_step_penalty: message.obstacle_step_penalty,
        obstacle_slope_penalty: message.obstacle_slope_penalty,
        obstacle_square_penalty: message.obstacle_square_penalty,
        seed: message.seed,
    };
    settings.validate().map_err(|_| Outcome::OutOfRange)?;
    Ok(Settings {
        nmpc: settings,
        budget_ns: message.budget_ns,
    })
}
