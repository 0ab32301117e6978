//! Real-time control of cable-driven continuum robots: the mathematics, and nothing else.
//!
//! A continuum robot of this class is a chain of 1 to 6 bending sections. Each bends into a circular
//! arc (constant curvature) under three cables. This crate models it, and finds in each period the
//! rates that make its tip follow a reference: nonlinear model predictive control (NMPC) solved by
//! knowledge-based particle swarm optimisation (KPSO) and by damped Gauss-Newton steps. It follows the
//! paper *Nonlinear Model Predictive Control for Trajectory Tracking of a Class of Continuum Robots*,
//! whose equation numbers stand in the documentation.
//!
//! # Layers
//!
//! Each module sees only those above it.
//!
//! | module | is | must not know |
//! |---|---|---|
//! | `wide` | numbers side by side, for the swarm | processors |
//! | [`robot`] | validated parameters, arc of one section, chain, Jacobian, orientation, cables | time |
//! | [`optimizer`] | minimisers over a box with a budget: KPSO (Eq. 6-7), Gauss-Newton; public is what a solve is given | robots |
//! | [`mod@reference`] | time-stamped trajectory, interpolation, window of one solve | who sends it |
//! | [`estimator`] | configuration from measurements | commands to come |
//! | [`nmpc`] | the optimal control problem (Eq. 4-5) and its solution | clocks, threads |
//! | [`safety`] | mode machine, limits, clearance guard: the safety checks before the cables | optimisation |
//! | [`calibration`] | the geometry that explains measured cables and tips | time, files |
//! | [`plant`] | simulated robots; of the modules here only `closed_loop` uses them | the controller |
//! | [`closed_loop`] | solver, safety checks and a robot, ideal or not, period by period: for simulations | clocks |
//!
//! Absent on purpose: clocks, threads, files, messages, logging, `unsafe`. Time comes in as numbers of
//! periods and as the closure of a [`Budget`](optimizer::Budget).
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
//! | q̇ | [`BendRates`](robot::BendRates): what is commanded | rad/s |
//! | x | tip pose in the base frame, [`Pose`](robot::Pose); base z along the straight robot | m |
//! | T | period | s |
//! | N, M | steps of the horizon (up to 50), blocks in which the rates are held (up to N and to 20) | |
//! | z | the plan: controls of all blocks, 2 n M unknowns: rates of bend vectors, or of (θ, φ) | rad/s |
//! | Φ, Θ, Ψ | angles of the tip, [`ZyxAngles`](robot::ZyxAngles) (Eq. 1) | rad |
//! | J | [`Jacobian`](robot::Jacobian) of the tip (Eq. 2-3) | m/rad, rad/rad |
//! | L | [cable lengths](robot::Robot::cable_lengths) | m |
//! | d, D | [clearance](robot::Body::clearance_m) of the body, and what is kept: `safe_distance_m` | m |
//! | ω | `terminal_weight`, factor on the error of the last step | |
//! | λ | `damping` of the Gauss-Newton step | |
//! | w, c₁, c₂ | inertia and coefficients of the swarm | |
//!
//! # What a solve promises
//!
//! Bounded work; an end when the budget says so, with the best solution so far; never worse than the
//! warm start; no allocation; a status that says what happened, and which constraint the plan breaks
//! if none that keeps it was found; the same bits again for the same inputs, plan, seed and work done.
//!
//! The budget is asked once for each microsecond or two of work, inside a single evaluation, too: fifty steps
//! against 64 obstacles are many quanta. Where it ends before even the warm start is evaluated, the warm start
//! leaves unevaluated.
//!
//! # Where the cost comes from
//!
//! Position, orientation of the tip beyond a tolerance, rates and their change, an extra weight on the last
//! step (Eq. 5); penalties on steps that come too near to an obstacle or go beyond a limit. Obstacles
//! move on at their velocity over the horizon; the whole body counts, by exact distances. See
//! [`NmpcSettings`](nmpc::NmpcSettings) for each weight, its unit and its range.
//!
//! # Example: a closed loop
//!
//! A robot with two sections draws a circle; the error stays far below a micrometre. There are more in `examples/`.
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

// The compiler puts all that is public into the program of the unit tests, called or not, and would compile the solver once more.
// `tests/suite` tests it in the library.
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
