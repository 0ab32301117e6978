//! Whose shortest period is looked for.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use cdcr_client::PAPER_SECTION_M;
use serde::Serialize;
use tempfile::TempDir;

use crate::experiment::Solver;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;

/// Longest time before a release at which the inputs are gathered \[ms\]: the daemon's default.
const GATHER_LEAD_MAX_MS: f64 = 0.2;
/// The same as a share of the period: the gather must fit between two cycles.
const GATHER_LEAD_SHARE: f64 = 0.35;
/// A later start than this counts as late \[ms\]: the daemon's default, where the period is not shorter.
const LATE_START_MAX_MS: f64 = 1.0;
/// Share of the period that may be spent spinning.
const SPIN_SHARE: f64 = 0.25;

/// A robot, and how its control problem is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Case {
    pub sections: usize,
    pub solver: Solver,
    pub horizon_steps: u32,
}

impl Case {
    pub const DEFAULT: Self = Self {
        sections: 3,
        solver: Solver::KpsoRefined,
        horizon_steps: 2,
    };

    /// One to three sections with every solver and both horizons, so that neighbours are alike.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for solver in [Solver::GaussNewton, Solver::Kpso, Solver::KpsoRefined] {
            for horizon_steps in [2, 10] {
                all.extend((1..=3).map(|sections| Self {
                    sections,
                    solver,
                    horizon_steps,
                }));
            }
        }
        all
    }

    pub fn name(&self) -> String {
        let plural = if self.sections == 1 { "" } else { "s" };
        format!(
            "{} section{plural}, {}, N = {}",
            self.sections,
            self.solver.name(),
            self.horizon_steps
        )
    }

    pub fn key(&self) -> String {
        format!(
            "{}-sections/{}/n{}",
            self.sections,
            self.solver.name(),
            self.horizon_steps
        )
    }
}

/// What all daemons of a run have in common.
#[derive(Debug)]
pub struct Stage {
    pub cores: Cores,
    pub realtime: bool,
    /// How long before a release they wake up to spin \[µs\]; at most a quarter of the period.
    pub spin_us: f64,
    folder: TempDir,
}

impl Stage {
    pub fn new(cores: Cores, realtime: bool, spin_us: f64) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix("cdcr-bench-").tempdir();
        let folder = folder.context("a folder for temporary files")?;
        for sections in 1..=3 {
            let file = folder.path().join(file_name(sections));
            fs::write(&file, robot(sections))
                .with_context(|| format!("cannot write {}", file.display()))?;
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
        Launch::patient(Some(self.config(case.sections)))
            .placed(&self.cores, self.realtime)
            .with("cycle.period_ms", period_ms)
            .with("cycle.gather_lead_ms", gather_lead_ms(period_ms))
            .with("cycle.late_start_ms", period_ms.min(LATE_START_MAX_MS))
            .with("realtime.spin_us", self.spin_within_us(period_ms))
            .with("controller.solver", case.solver.name())
            .with("controller.horizon_steps", case.horizon_steps)
    }

    /// How long a daemon with this period spins before a release \[µs\].
    pub fn spin_within_us(&self, period_ms: f64) -> f64 {
        self.spin_us.min(SPIN_SHARE * period_ms * 1e3)
    }

    fn config(&self, sections: usize) -> PathBuf {
        self.folder.path().join(file_name(sections))
    }
}

/// How long before a release the inputs are gathered \[ms\].
fn gather_lead_ms(period_ms: f64) -> f64 {
    GATHER_LEAD_MAX_MS.min(GATHER_LEAD_SHARE * period_ms)
}

fn file_name(sections: usize) -> String {
    format!("robot-{sections}.toml")
}

fn robot(sections: usize) -> String {
    let section = |index: usize| {
        let offset_rad = (40.0 * index as f64).to_radians();
        format!(
            "[[robot.sections]]\n\
             length_m = {PAPER_SECTION_M:?}\n\
             cable_radius_m = 0.0125\n\
             cable_offset_rad = {offset_rad:?}\n\
             bend_max_rad = 2.8\n\
             rate_max_rad_s = 2.0\n\
             body_radius_m = 0.015\n"
        )
    };
    (0..sections).map(section).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_daemon_accepts_every_robot_with_every_period() {
        let stage = Stage::new(Cores::find().unwrap(), false, 0.0).unwrap();
        for sections in 1..=3 {
            let case = Case {
                sections,
                ..Case::DEFAULT
            };
            let launch = stage.launch(&case, 0.5);
            let program = crate::subject::daemon::program("cdcrd").unwrap();
            let mut command = std::process::Command::new(program);
            command.arg("check").arg("--config");
            command.arg(launch.config.as_ref().unwrap());
            for (key, value) in &launch.settings {
                command.arg("--set").arg(format!("{key}={value}"));
            }
            let output = command.output().unwrap();
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{stderr}");
        }
    }
}
