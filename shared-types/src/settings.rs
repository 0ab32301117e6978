use crate::message::message;

message! {
    /// Settings of the optimal control problem and its solver.
    ///
    /// They travel in a settings request, in the status, and in every telemetry record, so that a record is complete.
    /// Ranges are those of `configs/default.toml`; a request outside them is rejected.
    pub struct SolverSettings "cdcr.SolverSettings.v1" {
        /// [`codes::SolverKind`](crate::codes::SolverKind).
        solver: u32 [code SolverKind],
        /// [`codes::Coordinates`](crate::codes::Coordinates) of the controls.
        coordinates: u32 [code Coordinates],
        /// Prediction steps N.
        horizon_steps: u32,
        /// Control blocks M ≤ N, limited by the plan size; 0 means M = N.
        control_blocks: u32,
        /// Particles.
        swarm_size: u32,
        /// Iterations of the swarm.
        swarm_iterations: u32,
        /// Iterations without improvement after which the swarm is regenerated; 0: never.
        regenerate_after: u32,
        /// [`codes::VelocityRule`](crate::codes::VelocityRule).
        velocity_rule: u32 [code VelocityRule],
        /// Gauss-Newton steps.
        refinement_steps: u32,
        /// Zero.
        reserved: u32 [reserved],
        /// Inertia w of the swarm.
        inertia: f64,
        /// Cognitive coefficient c₁.
        cognitive: f64,
        /// Social coefficient c₂.
        social: f64,
        /// Damping λ of the Gauss-Newton step \[m²\] in the cost's own scale.
        damping: f64 [unit "m²"],
        /// Weight of the squared position error, per m².
        position_weight: f64 [unit "1/m²"],
        /// Weight of the squared orientation error, per rad².
        orientation_weight: f64 [unit "1/rad²"],
        /// Orientation error that costs nothing \[rad\].
        orientation_tolerance_rad: f64,
        /// Weight of the squared rates, per (rad/s)².
        rate_weight: f64 [unit "s²/rad²"],
        /// Weight of the squared change of rates between blocks, per (rad/s)².
        rate_change_weight: f64 [unit "s²/rad²"],
        /// Extra weight of the last step, ω of Eq. 5: 1 counts it once.
        terminal_weight: f64,
        /// Distance that the body keeps from obstacles \[m\].
        safe_distance_m: f64,
        /// Penalty on entering the safe distance, per violated step.
        obstacle_step_penalty: f64,
        /// Penalty on the depth inside the safe distance, per m.
        obstacle_slope_penalty: f64 [unit "1/m"],
        /// Penalty on the square of the depth, per m².
        obstacle_square_penalty: f64 [unit "1/m²"],
        /// Time that a solve may take \[ns\]; 0: what is left of the period less the margin.
        budget_ns: u64,
        /// Seed of the swarm.
        seed: u64,
    }
}

/// The solver settings that the controller has under the same names. Calls the macro `$with` with the choices, each with
/// its enumeration, and the numbers: the conversions are generated from this list.
#[macro_export]
macro_rules! solver_settings {
    ($with:ident) => {
        $with! {
            {
                solver: SolverKind,
                coordinates: Coordinates,
                velocity_rule: VelocityRule,
            }
            horizon_steps, control_blocks, swarm_size, swarm_iterations, regenerate_after, inertia, cognitive,
            social, refinement_steps, damping, position_weight, orientation_weight, orientation_tolerance_rad,
            rate_weight, rate_change_weight, terminal_weight, safe_distance_m, obstacle_step_penalty,
            obstacle_slope_penalty, obstacle_square_penalty, seed,
        }
    };
}
