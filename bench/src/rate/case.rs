//! Cases of the search for the shortest period, and the launch of their daemons.

use std::time::Instant;

use cdcr_client::{PAPER_SECTION_M, counted};
use serde::Serialize;

use crate::benchmark::with_period;
use crate::experiment::Solver;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;

/// Largest share of the period for spinning.
const SPIN_SHARE: f64 = 0.25;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Case {
    pub sections: usize,
    pub solver: Solver,
    pub horizon_steps: u32,
}

impl Case {
    pub const DEFAULT: Self = Self::new(3, Solver::KpsoRefined, 2);

    pub const fn new(sections: usize, solver: Solver, horizon_steps: u32) -> Self {
        Self {
            sections,
            solver,
            horizon_steps,
        }
    }

    /// One to three sections with every solver and both horizons, ordered so that neighbours are similar.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for solver in [Solver::GaussNewton, Solver::Kpso, Solver::KpsoRefined] {
            for steps in [2, 10] {
                all.extend([1, 2, 3].map(|sections| Self::new(sections, solver, steps)));
            }
        }
        all
    }

    pub fn name(&self) -> String {
        let (solver, steps) = (self.solver.name(), self.horizon_steps);
        let sections = counted(self.sections, "section");
        format!("{sections}, {solver}, N = {steps}")
    }

    pub fn key(&self) -> String {
        let (sections, solver, steps) = (self.sections, self.solver.name(), self.horizon_steps);
        format!("{sections}-sections/{solver}/n{steps}")
    }

    /// The sections of the robot as a configuration value.
    fn robot(&self) -> String {
        let section = |index: usize| {
            let offset_rad = (40.0 * index as f64).to_radians();
            format!(
                "{{ length_m = {PAPER_SECTION_M:?}, cable_radius_m = 0.0125, cable_offset_rad = {offset_rad:?}, \
                 bend_max_rad = 2.8, rate_max_rad_s = 2.0, body_radius_m = 0.015 }}"
            )
        };
        let sections: Vec<String> = (0..self.sections).map(section).collect();
        format!("[{}]", sections.join(", "))
    }
}

#[derive(Debug)]
pub struct Stage {
    pub cores: Cores,
    pub realtime: bool,
    /// Time before a release at which the cycle thread begins to spin \[µs\], at most a quarter of the
    /// period; `None`: the daemon's default.
    pub spin_us: Option<f64>,
    pub begun: Instant,
}

impl Stage {
    /// Launch of a daemon with this case and this period.
    pub fn launch(&self, case: &Case, period_ms: f64) -> Launch {
        let launch = Launch::patient(None).placed(&self.cores, self.realtime);
        let launch = with_period(launch, period_ms)
            .with("robot.sections", case.robot())
            .with("controller.solver", case.solver.name())
            .with("controller.horizon_steps", case.horizon_steps);
        match self.spin_within_us(period_ms) {
            Some(spin_us) => launch.with("realtime.spin_us", spin_us),
            None => launch,
        }
    }

    /// Requested spin time before a release with this period \[µs\].
    pub fn spin_within_us(&self, period_ms: f64) -> Option<f64> {
        let most_us = SPIN_SHARE * period_ms * 1e3;
        self.spin_us.map(|spin_us| spin_us.min(most_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_daemon_accepts_every_robot_with_every_period() {
        // `None`: the default spin time.
        for (sections, period_ms, spin_us) in
            [(1, 5.0, Some(1e3)), (2, 0.5, Some(0.0)), (3, 0.1, None)]
        {
            let stage = Stage {
                cores: Cores::find().unwrap(),
                realtime: false,
                spin_us,
                begun: Instant::now(),
            };
            let launch = stage.launch(&Case::new(sections, Solver::Kpso, 10), period_ms);
            let output = launch.command("check").unwrap().output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{errors}");
        }
    }
}
