//! The paper's simulations, each with a solver and its settings.

use anyhow::Result;
use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
use cdcr_controller::optimizer::VelocityRule;
use serde::Serialize;

use crate::named::named;
use crate::scene::Scene;

/// Limits on the rates of the line \[rad/s\]; not in the paper.
pub const LINE_RATES_RAD_S: [f64; 2] = [2.0, 8.0];
/// The paper's bound on |Θ| and |Ψ| \[rad\].
pub const LINE_TILT_MAX_RAD: f64 = 1e-2;
/// Safe distances of the circle \[m\]; not in the paper.
pub const CIRCLE_DISTANCES_M: [f64; 3] = [0.01, 0.02, 0.04];
/// Swarm of the line: particles and iterations, as in the paper.
const LINE_SWARM: (u32, u32) = (15, 70);
/// Weight of the tilt on the line \[per rad²\], beside 1 per m² of position.
const LINE_ORIENTATION_WEIGHT: f64 = 0.1;
/// Tilt without cost on the line \[rad\]. Zero, although the paper allows 10⁻²: a vertical tip is possible,
/// and a penalty that begins at the bound would allow the tip to exceed it.
const LINE_TOLERANCE_RAD: f64 = 0.0;
/// Steps of the circle: 0.1 s, enough to begin the detour before the obstacle.
const CIRCLE_HORIZON: u32 = 20;
/// Control blocks of the circle; 0: one for each step. Fewer cannot follow the circle between them, and leave
/// a larger error than its rounded constants.
const CIRCLE_BLOCKS: u32 = 0;

/// Gauss-Newton steps on the circle. With the default of 3, a cycle ends before convergence, and the detour
/// is up to a tenth wider.
const CIRCLE_REFINEMENTS: u32 = 6;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    Spiral { sections: usize },
    Line { rate_limit_rad_s: f64 },
    Circle { safe_distance_m: f64 },
}

impl Task {
    pub fn all() -> Vec<Self> {
        let spirals = (1..=3).map(|sections| Self::Spiral { sections });
        let lines = LINE_RATES_RAD_S.map(|rate_limit_rad_s| Self::Line { rate_limit_rad_s });
        let circles = CIRCLE_DISTANCES_M.map(|safe_distance_m| Self::Circle { safe_distance_m });
        spirals.chain(lines).chain(circles).collect()
    }

    pub fn name(&self) -> &'static str {
        match self {
            Self::Spiral { .. } => "spiral",
            Self::Line { .. } => "line",
            Self::Circle { .. } => "circle",
        }
    }

    pub fn scene(&self) -> Result<Scene> {
        match *self {
            Self::Spiral { sections } => Scene::spiral(sections),
            Self::Line { rate_limit_rad_s } => Scene::line(rate_limit_rad_s),
            Self::Circle { .. } => Scene::circle(),
        }
    }

    pub fn paper(&self) -> PaperMetrics {
        let (mean_error_mm, mean_solve_ms) = match self {
            Self::Spiral { sections: 1 } => (Some(5e-9), 4.0),
            Self::Spiral { sections: 2 } => (Some(7e-4), 5.0),
            Self::Spiral { .. } => (Some(5e-3), 23.0),
            Self::Line { .. } => (Some(0.016), 68.0),
            Self::Circle { .. } => (None, 2.6),
        };
        PaperMetrics {
            mean_error_mm,
            mean_solve_ms,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PaperMetrics {
    pub mean_error_mm: Option<f64>,
    pub mean_solve_ms: f64,
}

named! {
    pub enum Solver {
        Kpso = "kpso",
        KpsoVerbatim = "kpso-verbatim",
        GaussNewton = "gauss-newton",
        KpsoRefined = "kpso-refined",
    }
}

impl Solver {
    #[must_use]
    pub fn of(self, settings: NmpcSettings) -> NmpcSettings {
        let (solver, velocity_rule) = match self {
            Self::Kpso => (SolverKind::Kpso, settings.velocity_rule),
            Self::KpsoVerbatim => (SolverKind::Kpso, VelocityRule::Verbatim),
            Self::GaussNewton => (SolverKind::GaussNewton, settings.velocity_rule),
            Self::KpsoRefined => (SolverKind::KpsoRefined, settings.velocity_rule),
        };
        NmpcSettings {
            solver,
            velocity_rule,
            ..settings
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Experiment {
    pub task: Task,
    pub solver: Solver,
    pub coordinates: Coordinates,
}

impl Experiment {
    pub fn new(task: Task, solver: Solver) -> Self {
        Self {
            task,
            solver,
            coordinates: NmpcSettings::default().coordinates,
        }
    }

    /// All experiments. The circle only in bend vectors: it starts straight, where bend angles have no
    /// direction, and its twenty steps have many local minima in angles.
    pub fn all() -> Vec<Self> {
        let both = [Coordinates::BendVector, Coordinates::BendAngles];
        let mut all = Vec::new();
        for task in Task::all() {
            let count = if matches!(task, Task::Circle { .. }) {
                1
            } else {
                2
            };
            for &coordinates in &both[..count] {
                all.extend(Solver::ALL.map(|solver| Self {
                    task,
                    solver,
                    coordinates,
                }));
            }
        }
        all
    }

    /// The paper's parameters, completed by the project's defaults and the constants of this file.
    pub fn settings(&self) -> NmpcSettings {
        let base = self.solver.of(NmpcSettings {
            coordinates: self.coordinates,
            ..NmpcSettings::default()
        });
        match self.task {
            Task::Spiral { .. } => base,
            Task::Line { .. } => NmpcSettings {
                swarm_size: LINE_SWARM.0,
                swarm_iterations: LINE_SWARM.1,
                orientation_weight: LINE_ORIENTATION_WEIGHT,
                orientation_tolerance_rad: LINE_TOLERANCE_RAD,
                ..base
            },
            Task::Circle { safe_distance_m } => NmpcSettings {
                horizon_steps: CIRCLE_HORIZON,
                control_blocks: CIRCLE_BLOCKS,
                refinement_steps: CIRCLE_REFINEMENTS,
                safe_distance_m,
                ..base
            },
        }
    }
}
