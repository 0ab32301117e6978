//! Whose shortest period is looked for, and how a daemon is started for it.

use std::fs;

use anyhow::{Context, Result};
use cdcr_client::{PAPER_SECTION_M, counted};
use cdcr_scratch::Scratch;
use serde::Serialize;

use crate::benchmark::with_period;
use crate::experiment::Solver;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;

/// Share of the period that may be spent spinning.
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

    /// One to three sections with every solver and both horizons, so that neighbours are alike.
    pub fn all() -> Vec<Self> {
        let solvers = [Solver::GaussNewton, Solver::Kpso, Solver::KpsoRefined];
        let horizons = solvers
            .iter()
            .flat_map(|solver| [(*solver, 2), (*solver, 10)]);
        let all =
            horizons.flat_map(|(solver, steps)| [1, 2, 3].map(|n| Self::new(n, solver, steps)));
        all.collect()
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
}

#[derive(Debug)]
pub struct Stage {
    pub cores: Cores,
    pub realtime: bool,
    /// How long before a release they wake up to spin \[µs\], at most a quarter of the period; none: the daemon's default.
    pub spin_us: Option<f64>,
    folder: Scratch,
}

impl Stage {
    pub fn new(cores: Cores, realtime: bool, spin_us: Option<f64>) -> Result<Self> {
        let folder = Scratch::temporary();
        let folder = folder.context("a folder for temporary files")?;
        for sections in 1..=3 {
            fs::write(folder.path().join(file_name(sections)), robot(sections))
                .context("cannot write a robot")?;
        }
        Ok(Self {
            cores,
            realtime,
            spin_us,
            folder,
        })
    }

    /// How a daemon with this case and this period is started.
    pub fn launch(&self, case: &Case, period_ms: f64) -> Launch {
        let config = self.folder.path().join(file_name(case.sections));
        let launch = Launch::patient(Some(config)).placed(&self.cores, self.realtime);
        let launch = with_period(launch, period_ms)
            .with("controller.solver", case.solver.name())
            .with("controller.horizon_steps", case.horizon_steps);
        match self.spin_within_us(period_ms) {
            Some(spin_us) => launch.with("realtime.spin_us", spin_us),
            None => launch,
        }
    }

    /// How long a daemon with this period is asked to spin before a release \[µs\].
    pub fn spin_within_us(&self, period_ms: f64) -> Option<f64> {
        let most_us = SPIN_SHARE * period_ms * 1e3;
        self.spin_us.map(|spin_us| spin_us.min(most_us))
    }
}

fn file_name(sections: usize) -> String {
    format!("robot-{sections}.toml")
}

fn robot(sections: usize) -> String {
    let section = |index: usize| {
        let offset_rad = (40.0 * index as f64).to_radians();
        format!(
            "[[robot.sections]]\nlength_m = {PAPER_SECTION_M:?}\ncable_radius_m = 0.0125\n\
             cable_offset_rad = {offset_rad:?}\nbend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n"
        )
    };
    (0..sections).map(section).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_that_is_asked_nothing_spins_as_it_does_by_default() {
        let sets = |spin_us| {
            let stage = Stage::new(Cores::find().unwrap(), false, spin_us).unwrap();
            let mut settings = stage.launch(&Case::DEFAULT, 5.0).settings.into_iter();
            settings.any(|(key, _)| key == "realtime.spin_us")
        };
        assert_eq!([None, Some(0.0)].map(sets), [false, true]);
    }

    #[test]
    fn the_daemon_accepts_every_robot_and_what_the_period_bounds() {
        let stage = Stage::new(Cores::find().unwrap(), false, Some(1000.0)).unwrap();
        for (sections, period_ms, bounds) in [
            (1, 5.0, [0.2, 1.0, 1000.0]),
            (2, 0.5, [0.175, 0.5, 125.0]),
            (3, 0.1, [0.035, 0.1, 25.0]),
        ] {
            let launch = stage.launch(&Case::new(sections, Solver::Kpso, 10), period_ms);
            let keys = [
                "cycle.gather_lead_ms",
                "cycle.late_start_ms",
                "realtime.spin_us",
            ];
            for (key, bound) in keys.into_iter().zip(bounds) {
                let set = launch.settings.iter().rfind(|(name, _)| name == key);
                let value: f64 = set.unwrap().1.parse().unwrap();
                assert!((value - bound).abs() < 1e-9, "{key}: {value}");
            }
            let output = launch.command("check").unwrap().output().unwrap();
            assert!(
                output.status.success(),
                "{}",
                String::from_utf8_lossy(&output.stderr)
            );
        }
    }
}
