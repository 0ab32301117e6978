use serde::{Deserialize, Serialize};

use super::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, SWARM_MAX};
use crate::optimizer::{KpsoSettings, VelocityRule};

/// How the optimal control problem is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SolverKind {
    /// Knowledge-based particle swarm, as in the paper.
    Kpso,
    /// Damped Gauss-Newton steps from the best candidate.
    GaussNewton,
    /// The swarm chooses the basin, Gauss-Newton finishes.
    #[default]
    KpsoRefined,
}

impl SolverKind {
    pub(super) fn searches(self) -> bool {
        self != Self::GaussNewton
    }

    pub(super) fn refines(self) -> bool {
        self != Self::Kpso
    }
}

/// In which rates the optimal control problem is posed. The command is always bend-vector rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Coordinates {
    /// Rates (u̇, v̇) of each section's bend vector: smooth everywhere.
    #[default]
    BendVector,
    /// The paper's (θ̇, φ̇), with signed θ. A rate φ̇ moves nothing where the section is straight.
    BendAngles,
}

/// Everything that tunes the optimal control problem and its solver.
///
/// The default is the paper's swarm (6 × 30, c₁ = c₂ = 1.2, N = 2) with the inertia weight that Eq. 6
/// lacks, refined by Gauss-Newton.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct NmpcSettings {
    /// The solver.
    pub solver: SolverKind,
    /// Coordinates of the controls.
    pub coordinates: Coordinates,
    /// Prediction steps N.
    pub horizon_steps: u32,
    /// Control blocks M ≤ N, at most [`CONTROL_BLOCKS_MAX`]; 0: one for each step, as far as that goes.
    pub control_blocks: u32,
    /// Particles.
    pub swarm_size: u32,
    /// Swarm iterations.
    pub swarm_iterations: u32,
    /// Iterations without improvement after which the swarm is regenerated; 0: never.
    pub regenerate_after: u32,
    /// Velocity rule of the swarm.
    pub velocity_rule: VelocityRule,
    /// Inertia w.
    pub inertia: f64,
    /// Cognitive coefficient c₁.
    pub cognitive: f64,
    /// Social coefficient c₂.
    pub social: f64,
    /// Gauss-Newton steps.
    pub refinement_steps: u32,
    /// Damping λ of the Gauss-Newton step.
    pub damping: f64,
    /// Weight of the squared position error, per m².
    pub position_weight: f64,
    /// Weight of the squared orientation error, per rad². It counts where the reference asks for an
    /// orientation, and is chord length: 2 sin(α/2) for an angle of α.
    pub orientation_weight: f64,
    /// Orientation error that costs nothing \[rad\], the paper's |Θ|, |Ψ| ≤ 10⁻²: only what is beyond
    /// it is squared.
    pub orientation_tolerance_rad: f64,
    /// Weight of the squared rates, per (rad/s)².
    pub rate_weight: f64,
    /// Weight of the squared change of rates from block to block, per (rad/s)².
    pub rate_change_weight: f64,
    /// Factor ω on the last step's error; 1 counts it like the others. Above zero where the last step is the only one.
    pub terminal_weight: f64,
    /// Distance D that the body keeps from every obstacle, surface to surface \[m\].
    pub safe_distance_m: f64,
    /// Penalty on a step whose clearance d is below D, for each obstacle. A step alone is known to
    /// collide (where every candidate violates, it cancels): it needs a slope or a square beside it.
    pub obstacle_step_penalty: f64,
    /// Penalty on D - d, per m.
    pub obstacle_slope_penalty: f64,
    /// Penalty on (D - d)², per m².
    pub obstacle_square_penalty: f64,
    /// Seed of the swarm.
    pub seed: u64,
}

impl Default for NmpcSettings {
    fn default() -> Self {
        Self {
            solver: SolverKind::KpsoRefined,
            coordinates: Coordinates::BendVector,
            horizon_steps: 2,
            control_blocks: 0,
            swarm_size: 6,
            swarm_iterations: 30,
            regenerate_after: 10,
            velocity_rule: VelocityRule::Inertia,
            inertia: 0.5,
            cognitive: 1.2,
            social: 1.2,
            refinement_steps: 3,
            damping: 1e-14,
            position_weight: 1.0,
            orientation_weight: 0.1,
            orientation_tolerance_rad: 0.0,
            rate_weight: 0.0,
            rate_change_weight: 0.0,
            terminal_weight: 1.0,
            safe_distance_m: 0.01,
            obstacle_step_penalty: 1e3,
            obstacle_slope_penalty: 1e4,
            obstacle_square_penalty: 0.0,
            seed: 1,
        }
    }
}

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value} is out of range: allowed is {low} to {high}")]
pub struct SettingsError {
    /// Name of the setting.
    pub key: &'static str,
    /// The value found.
    pub value: f64,
    /// Smallest allowed value.
    pub low: f64,
    /// Largest allowed value.
    pub high: f64,
}

/// Allowed ranges of the settings, key by key.
pub mod ranges {
    use super::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, SWARM_MAX};
    use std::ops::RangeInclusive;

    /// Prediction steps.
    pub const HORIZON_STEPS: RangeInclusive<f64> = 1.0..=HORIZON_STEPS_MAX as f64;
    /// Control blocks.
    pub const CONTROL_BLOCKS: RangeInclusive<f64> = 0.0..=CONTROL_BLOCKS_MAX as f64;
    /// Particles.
    pub const SWARM_SIZE: RangeInclusive<f64> = 1.0..=SWARM_MAX as f64;
    /// Swarm iterations, and iterations before a regeneration.
    pub const ITERATIONS: RangeInclusive<f64> = 0.0..=1000.0;
    /// Inertia.
    pub const INERTIA: RangeInclusive<f64> = 0.0..=1.0;
    /// Swarm coefficients.
    pub const COEFFICIENT: RangeInclusive<f64> = 0.0..=4.0;
    /// Gauss-Newton steps.
    pub const REFINEMENT_STEPS: RangeInclusive<f64> = 0.0..=50.0;
    /// Damping: above zero, because the matrix of a straight robot is singular.
    pub const DAMPING: RangeInclusive<f64> = 1e-20..=1.0;
    /// Weights.
    pub const WEIGHT: RangeInclusive<f64> = 0.0..=1e12;
    /// Orientation error that costs nothing \[rad\].
    pub const ORIENTATION_TOLERANCE_RAD: RangeInclusive<f64> = 0.0..=1.0;
    /// Distance kept from obstacles \[m\].
    pub const SAFE_DISTANCE_M: RangeInclusive<f64> = 0.0..=10.0;
    /// Period T \[s\].
    pub const PERIOD_S: RangeInclusive<f64> = 1e-6..=10.0;
    /// Position weight: above zero, or there is nothing to follow.
    pub const POSITION_WEIGHT: RangeInclusive<f64> = 1e-12..=1e12;
}

/// A Gauss-Newton step below this counts as converged: at 5 ms it moves a tip by 1e-15 m.
pub(super) const STEP_TOLERANCE_RAD_S: f64 = 1e-12;
/// A mean position error below this counts as none \[m\].
const POSITION_TOLERANCE_M: f64 = 1e-15;

impl NmpcSettings {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingsError`] for the first that is outside, NaN included.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let checks = [
            (
                "horizon_steps",
                f64::from(self.horizon_steps),
                ranges::HORIZON_STEPS,
            ),
            (
                "control_blocks",
                f64::from(self.control_blocks),
                ranges::CONTROL_BLOCKS,
            ),
            (
                "control_blocks",
                f64::from(self.control_blocks),
                0.0..=f64::from(self.horizon_steps),
            ),
            ("swarm_size", f64::from(self.swarm_size), ranges::SWARM_SIZE),
            (
                "swarm_iterations",
                f64::from(self.swarm_iterations),
                ranges::ITERATIONS,
            ),
            (
                "regenerate_after",
                f64::from(self.regenerate_after),
                ranges::ITERATIONS,
            ),
            ("inertia", self.inertia, ranges::INERTIA),
            ("cognitive", self.cognitive, ranges::COEFFICIENT),
            ("social", self.social, ranges::COEFFICIENT),
            (
                "refinement_steps",
                f64::from(self.refinement_steps),
                ranges::REFINEMENT_STEPS,
            ),
            ("damping", self.damping, ranges::DAMPING),
            (
                "position_weight",
                self.position_weight,
                ranges::POSITION_WEIGHT,
            ),
            (
                "orientation_weight",
                self.orientation_weight,
                ranges::WEIGHT,
            ),
            (
                "orientation_tolerance_rad",
                self.orientation_tolerance_rad,
                ranges::ORIENTATION_TOLERANCE_RAD,
            ),
            ("rate_weight", self.rate_weight, ranges::WEIGHT),
            (
                "rate_change_weight",
                self.rate_change_weight,
                ranges::WEIGHT,
            ),
            (
                "terminal_weight",
                self.terminal_weight,
                self.terminal_range(),
            ),
            (
                "safe_distance_m",
                self.safe_distance_m,
                ranges::SAFE_DISTANCE_M,
            ),
            (
                "obstacle_step_penalty",
                self.obstacle_step_penalty,
                ranges::WEIGHT,
            ),
            (
                "obstacle_slope_penalty",
                self.obstacle_slope_penalty,
                self.slope_range(),
            ),
            (
                "obstacle_square_penalty",
                self.obstacle_square_penalty,
                ranges::WEIGHT,
            ),
        ];
        checks
            .into_iter()
            .try_for_each(|(key, value, range)| check(key, value, range))
    }

    /// With a single step the weight of the last is that of all.
    fn terminal_range(&self) -> std::ops::RangeInclusive<f64> {
        if self.horizon_steps == 1 {
            ranges::POSITION_WEIGHT
        } else {
            ranges::WEIGHT
        }
    }

    /// A constant penalty alone collides, so it is not allowed: at a depth of a millimetre, slope and square
    /// together must be a millionth of the step at least.
    fn slope_range(&self) -> std::ops::RangeInclusive<f64> {
        const DEPTH_M: f64 = 1e-3;
        let square = self.obstacle_square_penalty * DEPTH_M * DEPTH_M;
        let least = (1e-6 * self.obstacle_step_penalty - square).max(0.0) / DEPTH_M;
        least..=*ranges::WEIGHT.end()
    }

    pub(super) fn kpso(&self) -> KpsoSettings {
        KpsoSettings {
            size: self.swarm_size as usize,
            iterations: self.swarm_iterations,
            rule: self.velocity_rule,
            inertia: self.inertia,
            cognitive: self.cognitive,
            social: self.social,
            regenerate_after: self.regenerate_after,
            cost_tolerance: self.cost_tolerance(),
        }
    }

    /// A cost at or below this is zero to working precision.
    pub(super) fn cost_tolerance(&self) -> f64 {
        let steps = f64::from(self.horizon_steps);
        steps * self.position_weight * POSITION_TOLERANCE_M * POSITION_TOLERANCE_M
    }
}

/// Refuses a value outside its range, NaN included.
pub(super) fn check(
    key: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
) -> Result<(), SettingsError> {
    let (low, high) = range.into_inner();
    let error = SettingsError {
        key,
        value,
        low,
        high,
    };
    (low..=high).contains(&value).then_some(()).ok_or(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_settings_are_legal_and_bad_ones_say_what_is_allowed() {
        assert_eq!(NmpcSettings::default().validate(), Ok(()));
        let bad = NmpcSettings {
            swarm_size: 1000,
            ..NmpcSettings::default()
        };
        let error = bad.validate().expect_err("too many particles");
        assert_eq!(
            error.to_string(),
            "swarm_size = 1000 is out of range: allowed is 1 to 512"
        );
        let bad = NmpcSettings {
            inertia: f64::NAN,
            ..NmpcSettings::default()
        };
        assert_eq!(bad.validate().expect_err("NaN").key, "inertia");
        let bad = NmpcSettings {
            control_blocks: 3,
            ..NmpcSettings::default()
        };
        assert_eq!(bad.validate().expect_err("M > N").high, 2.0);
        // With one step, the last is all there is to follow.
        let weightless = |horizon_steps| NmpcSettings {
            horizon_steps,
            terminal_weight: 0.0,
            ..NmpcSettings::default()
        };
        assert_eq!(weightless(2).validate(), Ok(()));
        let error = weightless(1).validate().expect_err("nothing to follow");
        assert_eq!((error.key, error.low), ("terminal_weight", 1e-12));
    }
}
