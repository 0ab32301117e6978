//! Real-time control of cable-driven continuum robots: the mathematics, and nothing else.
//!
//! A continuum robot of this class is a chain of 1 to 6 bending sections. Three cables bend each section into a
//! circular arc (constant curvature). This crate models the robot and computes in each period the rates that make its
//! tip follow a reference. The method is nonlinear model predictive control (NMPC), solved by knowledge-based particle
//! swarm optimisation (KPSO) and by damped Gauss-Newton steps. It follows the paper *Nonlinear Model Predictive Control
//! for Trajectory Tracking of a Class of Continuum Robots*; its equation numbers are cited in the documentation.
//!
//! # Layers
//!
//! Each module uses only those above it.
//!
//! | module | contents | must not know |
//! |---|---|---|
//! | [`mod@parameters`] | declaration of settings with their defaults, ranges and texts | robots |
//! | `wide` | SIMD lanes of numbers, for the swarm | processors |
//! | [`robot`] | validated parameters, arc of one section, chain, Jacobian, orientation, cables | time |
//! | [`optimizer`] | minimisers over a box with a budget: KPSO (Eq. 6-7), Gauss-Newton; public are the arguments of a solve | robots |
//! | [`mod@reference`] | time-stamped trajectory, interpolation, window of one solve | the sender |
//! | [`estimator`] | configuration from measurements | future commands |
//! | [`nmpc`] | the optimal control problem (Eq. 4-5) and its solution | clocks, threads |
//! | [`safety`] | mode machine, limits, clearance guard: the safety checks before the cables | optimisation |
//! | [`calibration`] | geometry estimated from measured cables and tips | time, files |
//! | [`plant`] | simulated robots; within this crate, used only by `closed_loop` | the controller |
//! | [`closed_loop`] | simulation of solver, safety checks and a robot, ideal or not, period by period | clocks |
//!
//! Absent by design: clocks, threads, files, messages, logging, `unsafe`. Time is passed as numbers of periods and
//! through the closure of a [`Budget`](optimizer::Budget).
//!
//! # Symbols
//!
//! | symbol | here | unit |
//! |---|---|---|
//! | n | sections | |
//! | ℓ | length of a section, `length_m` | m |
//! | θ, φ | bend and direction of a section | rad |
//! | u, v | bend vector θ (cos φ, sin φ), smooth through the straight section | rad |
//! | q | [`Configuration`](robot::Configuration): (u₁, v₁, u₂, v₂, …) (the paper's k) | rad |
//! | q̇ | [`BendRates`](robot::BendRates), the command | rad/s |
//! | x | tip pose in the base frame, [`Pose`](robot::Pose); base z along the straight robot | m |
//! | T | period | s |
//! | N, M | steps of the horizon (up to 50), blocks of constant rates (up to N; up to 20 if changes of rates have a weight) | |
//! | z | the plan: controls of all blocks, 2 n M unknowns (up to 300): rates of bend vectors, or of (θ, φ) | rad/s |
//! | Φ, Θ, Ψ | angles of the tip, [`ZyxAngles`](robot::ZyxAngles) (Eq. 1) | rad |
//! | J | [`Jacobian`](robot::Jacobian) of the tip (Eq. 2-3) | m/rad, rad/rad |
//! | L | [cable lengths](robot::Robot::cable_lengths) | m |
//! | d, D | [clearance](robot::Body::clearance_m) of the body, and the safe distance `safe_distance_m` | m |
//! | ω | `terminal_weight`, factor on the error of the last step | |
//! | λ | `damping` of the Gauss-Newton step | |
//! | w, c₁, c₂ | inertia and coefficients of the swarm | |
//!
//! # Guarantees of a solve
//!
//! - Bounded work. When the budget ends, the solve returns the best solution so far.
//! - The result is never worse than the warm start.
//! - No allocation.
//! - A status, and the constraint that the plan breaks if no plan was found that satisfies all.
//! - Bit-exact replay for the same inputs, plan, seed and amount of work.
//!
//! The budget is checked after every microsecond or two of work, also within one evaluation: fifty steps against 64
//! obstacles take many such intervals. If it ends before the warm start is evaluated, the warm start is returned
//! unevaluated.
//!
//! # Terms of the cost
//!
//! Position, orientation of the tip beyond a tolerance, rates and their change, an extra weight on the last step (Eq. 5);
//! penalties on steps below the safe distance or beyond a limit. Obstacles move at their velocity over the horizon.
//! Clearances are exact and cover the whole body. See [`NmpcSettings`](nmpc::NmpcSettings) for each weight, its unit
//! and its range.
//!
//! # Example: a closed loop
//!
//! A robot with two sections draws a circle; the error stays far below a micrometre. Further examples are in
//! `examples/`.
//!
//! ```
//! use cdcr_controller::closed_loop::ClosedLoop;
//! use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
//! use cdcr_controller::reference::{ReferenceSample, ReferenceState};
//! use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
//! use nalgebra::Vector3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! const PERIOD_S: f64 = 0.005;
//! let robot = Robot::new(&RobotParameters::paper(2))?;
//! let settings = NmpcSettings::default();
//! let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;
//! let start = Configuration::from_bend_angles(&[[0.0, 0.0], [0.5, 0.0]]);
//! let tip_m = robot.tip_position(&start);
//! let circle = |time_s: f64| {
//!     let (sin, cos) = time_s.sin_cos();
//!     ReferenceSample {
//!         state: ReferenceState::Inside,
//!         position_m: Vector3::new(tip_m.x * cos, tip_m.x * sin, tip_m.z),
//!         ..ReferenceSample::default()
//!     }
//! };
//! let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &[], circle)?;
//! while closed.time_s() < 2.0 {
//!     closed.step(&mut nmpc);
//!     assert!(closed.error_m() < 1e-9);
//! }
//! # Ok(())
//! # }
//! ```
//!
#![forbid(unsafe_code)]

pub mod calibration;
pub mod estimator;
pub mod optimizer;
pub mod parameters;
pub mod plant;
pub mod reference;
pub mod robot;
pub mod safety;
mod wide;

// The unit tests would compile every public item into their program and the solver once more. `tests/suite` tests these
// modules in the library.
#[cfg(not(test))]
pub mod closed_loop;
#[cfg(test)]
#[allow(dead_code, unused_imports, unreachable_pub, reason = "not public here")]
mod closed_loop;
#[cfg(not(test))]
pub mod nmpc;
#[cfg(test)]
#[allow(dead_code, unused_imports, unreachable_pub, reason = "not public here")]
mod nmpc;
