//! How many iterations of a swarm fit into a time on this machine.

use std::time::Instant;

use anyhow::Result;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::optimizer::Budget;

use super::course::Course;
use super::variant::BUDGET_SWARM;
use crate::closed_loop::ClosedLoop;
use crate::experiment::Solver;
use crate::metric::median;

const ITERATIONS: u32 = 8;
const EVERY: u64 = 8;
const ITERATIONS_MAX: f64 = 1000.0;

/// What an iteration of [`BUDGET_SWARM`] particles takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sizing {
    pub iteration_us: f64,
}

impl Sizing {
    /// Drives the course with Gauss-Newton and times the swarm on the way.
    pub fn measure(course: Course) -> Result<Self> {
        let scene = course.scene()?;
        let driving = Solver::GaussNewton.of(course.settings());
        let timed = NmpcSettings {
            swarm_size: BUDGET_SWARM,
            swarm_iterations: ITERATIONS,
            ..Solver::Kpso.of(course.settings())
        };
        let mut driver = Nmpc::new(scene.robot.clone(), scene.period_s, driving)?;
        let mut swarm = Nmpc::new(scene.robot.clone(), scene.period_s, timed)?;
        let mut closed = ClosedLoop::new(&scene, driving)?;
        let mut times_us = Vec::new();
        for cycle in 0.. {
            if closed.is_over() {
                break;
            }
            if cycle % EVERY == 0 {
                // From rest there is an error left, and no iteration is saved.
                swarm.forget_plan();
                let begin = Instant::now();
                let (_, report) = swarm.solve(&closed.input(), &mut Budget::unlimited());
                let us = begin.elapsed().as_secs_f64() * 1e6;
                times_us.push(us / f64::from(report.iterations.max(1)));
            }
            let (desired_rates, _) = driver.solve(&closed.input(), &mut Budget::unlimited());
            closed.advance(&desired_rates);
        }
        Ok(Self {
            iteration_us: median(times_us).unwrap_or(1.0),
        })
    }

    /// Iterations that take about so long, at least one.
    pub(super) fn iterations(&self, time_us: f64) -> u32 {
        (time_us / self.iteration_us).clamp(1.0, ITERATIONS_MAX) as u32
    }
}
