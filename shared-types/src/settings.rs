use crate::message::message;

message! {
    /// Settings of the optimal control problem and its solver.
    ///
    /// They travel in a settings request, in the status, and in every telemetry record, so that a record is complete.
    /// Meaning and range of each are those of the key of the same name in `configs/default.toml`; a request outside the ranges
    /// is rejected.
    pub struct SolverSettings "cdcr.SolverSettings.v2" {
        /// [`codes::SolverKind`](crate::codes::SolverKind).
        solver: u32 [code SolverKind],
        /// [`codes::Coordinates`](crate::codes::Coordinates) of the controls.
        coordinates: u32 [code Coordinates],
        /// Prediction steps N.
        horizon_steps: u32,
        /// Control blocks M, and at most N; 0: one per step.
        control_blocks: u32,
        /// Particles of the swarm.
        swarm_size: u32,
        /// Iterations of the swarm.
        swarm_iterations: u32,
        /// Iterations without improvement before the swarm is regenerated; 0: never.
        regenerate_after: u32,
        /// [`codes::VelocityRule`](crate::codes::VelocityRule).
        velocity_rule: u32 [code VelocityRule],
        /// Gauss-Newton steps.
        refinement_steps: u32,
        /// Zero.
        reserved: u32 [reserved],
        /// Inertia weight w.
        inertia: f64,
        /// Coefficient c1 of Eq. 6, the weight of a particle's own best.
        cognitive: f64,
        /// Coefficient c2 of Eq. 6, the weight of the swarm's best.
        social: f64,
        /// Damping of the Gauss-Newton steps \[m²\].
        damping: f64 [unit "m²"],
        /// Weight of the squared position error in the cost (Eq. 5), per m².
        position_weight: f64 [unit "1/m²"],
        /// Weight of the squared orientation error, per rad².
        orientation_weight: f64 [unit "1/rad²"],
        /// Orientation error without cost \[rad\].
        orientation_tolerance_rad: f64,
        /// Weight of the squared rates, per (rad/s)².
        rate_weight: f64 [unit "s²/rad²"],
        /// Weight of the squared changes of rates, per (rad/s)².
        rate_change_weight: f64 [unit "s²/rad²"],
        /// Gain by which bends that the tip does not need return towards straight while it travels.
        posture_gain: f64,
        /// Factor on the error cost of the last step.
        terminal_weight: f64,
        /// Safe distance between body and obstacles \[m\].
        safe_distance_m: f64,
        /// Penalty in the solver's cost for each step inside the safe distance.
        obstacle_step_penalty: f64,
        /// Penalty in the solver's cost per m of depth inside the safe distance.
        obstacle_slope_penalty: f64 [unit "1/m"],
        /// Penalty in the solver's cost per m² of squared depth inside the safe distance.
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
            rate_weight, rate_change_weight, posture_gain, terminal_weight, safe_distance_m, obstacle_step_penalty,
            obstacle_slope_penalty, obstacle_square_penalty, seed,
        }
    };
}
