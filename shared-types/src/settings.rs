use iceoryx2::prelude::ZeroCopySend;

/// Everything that tunes the optimal control problem and its solver.
///
/// It travels in a settings request, in the status, and in every telemetry record, so that a record
/// is complete. Ranges are those of `configs/default.toml`; a request outside them is refused.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.SolverSettings.v1")]
pub struct SolverSettings {
    /// [`codes::SolverKind`](crate::codes::SolverKind).
    pub solver: u32,
    /// [`codes::Coordinates`](crate::codes::Coordinates) of the controls.
    pub coordinates: u32,
    /// Prediction steps N.
    pub horizon_steps: u32,
    /// Control blocks M ≤ N; 0 means M = N.
    pub control_blocks: u32,
    /// Particles.
    pub swarm_size: u32,
    /// Iterations of the swarm.
    pub swarm_iterations: u32,
    /// Iterations without improvement after which the swarm is regenerated; 0: never.
    pub regenerate_after: u32,
    /// [`codes::VelocityRule`](crate::codes::VelocityRule).
    pub velocity_rule: u32,
    /// Gauss-Newton steps.
    pub refinement_steps: u32,
    /// Zero.
    pub reserved: u32,
    /// Inertia w of the swarm.
    pub inertia: f64,
    /// Cognitive coefficient c₁.
    pub cognitive: f64,
    /// Social coefficient c₂.
    pub social: f64,
    /// Damping λ of the Gauss-Newton step \[m²\] in the cost's own scale.
    pub damping: f64,
    /// Weight of the squared position error, per m².
    pub position_weight: f64,
    /// Weight of the squared orientation error, per rad².
    pub orientation_weight: f64,
    /// Orientation error that costs nothing \[rad\].
    pub orientation_tolerance_rad: f64,
    /// Weight of the squared rates, per (rad/s)².
    pub rate_weight: f64,
    /// Weight of the squared change of rates between blocks, per (rad/s)².
    pub rate_change_weight: f64,
    /// Extra weight of the last step, ω of Eq. 5: 1 counts it once.
    pub terminal_weight: f64,
    /// Distance that the body keeps from obstacles \[m\].
    pub safe_distance_m: f64,
    /// Penalty on entering the safe distance, per violated step.
    pub obstacle_step_penalty: f64,
    /// Penalty on the depth inside the safe distance, per m.
    pub obstacle_slope_penalty: f64,
    /// Penalty on the square of the depth, per m².
    pub obstacle_square_penalty: f64,
    /// Time that a solve may take \[ns\]; 0: what is left of the period less the margin.
    pub budget_ns: u64,
    /// Seed of the swarm.
    pub seed: u64,
}
