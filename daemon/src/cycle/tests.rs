//! Cycles of a robot that is not its model, on a clock of the test.
#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::cell::Cell;
use std::path::Path;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::reference::{Interpolation, Orientation, ReferencePoint, Trajectory};
use cdcr_controller::robot::{CABLES_MAX, Configuration};
use cdcr_controller::safety::{LeaseState, Request};
use nalgebra::Vector3;

use super::*;
use crate::config::Config;
use crate::convert;
use crate::link::DriverLink;

const PERIOD_NS: u64 = 5_000_000;
const PERIOD_S: f64 = 0.005;
/// Release of cycle 0.
const BEGIN_NS: u64 = 1_000_000_000;

#[derive(Debug, Default)]
struct Watch(Cell<u64>);

impl Clock for Watch {
    fn now_ns(&self) -> u64 {
        self.0.set(self.0.get() + 100);
        self.0.get()
    }

    fn sleep_until(&self, _: u64) {}
}

/// What is wrong with a robot.
#[derive(Debug, Clone, Copy)]
struct Flaws {
    interface: Interface,
    /// Time constant of the motors \[s\].
    lag_s: f64,
    /// Each cable is measured so much longer than it is commanded \[m\].
    offset_m: [f64; 3],
    /// The motors stand still, whatever is commanded.
    stands: bool,
}

const SLOPPY: Flaws = Flaws {
    interface: Interface::Position,
    lag_s: 0.03,
    offset_m: [1e-4, 0.0, -0.5e-4],
    stands: false,
};

/// A daemon's cycle, and the robot behind its driver.
struct Trial {
    cycle: Cycle<DriverLink>,
    robot: Robot,
    flaws: Flaws,
    bend_rad: Vec<f64>,
    inputs: CycleInputs,
    trajectory: Trajectory,
    clock: Watch,
    next: u64,
    asked: Option<Request>,
    last: Option<CycleRecord>,
    /// The last commanded position.
    target_rad: Vec<f64>,
}

impl Trial {
    fn new(flaws: Flaws) -> Self {
        let interface = match flaws.interface {
            Interface::Position => "position",
            Interface::Velocity => "velocity",
        };
        let text = format!("[link]\nkind = \"driver\"\ninterface = \"{interface}\"\n");
        let validated = Config::parse(&text, Path::new("trial")).unwrap();
        let mut inputs = CycleInputs::new(Settings::new(&validated.config));
        inputs.lease = LeaseState::Held;
        Self {
            cycle: Cycle::new(&validated, DriverLink).unwrap(),
            bend_rad: vec![0.0; validated.robot.coordinate_count()],
            trajectory: Trajectory::with_capacity(4096, validated.robot.reach_m()),
            robot: validated.robot,
            flaws,
            inputs,
            clock: Watch::default(),
            next: 0,
            asked: None,
            last: None,
            target_rad: Vec::new(),
        }
    }

    fn ask(&mut self, request: Request) -> CycleRecord {
        self.asked = Some(request);
        self.turn()
    }

    fn shape(&self) -> Configuration {
        Configuration::from_slice(&self.bend_rad).unwrap()
    }

    /// What the sensors say: cable lengths with the offsets.
    fn measure(&mut self, release_ns: u64) {
        let mut lengths = self.robot.cable_lengths(&self.shape());
        for (cable, length_m) in lengths
            .iter_mut()
            .enumerate()
            .take(self.robot.cable_count())
        {
            *length_m += self.flaws.offset_m[cable % 3];
        }
        let all: [f64; CABLES_MAX] = lengths;
        self.inputs.measurement = Some(TimedMeasurement {
            measurement: Measurement::CableLengths(all),
            measured_ns: release_ns - 1_000_000,
        });
    }

    fn gather(&mut self, release_ns: u64) {
        self.inputs.gather += 1;
        self.inputs.gather_ns = release_ns - 200_000;
        let steps = self.inputs.settings.nmpc.horizon_steps as usize;
        let window = &mut self.inputs.window;
        window.fill(&self.trajectory, self.next, release_ns, PERIOD_NS, steps);
        self.measure(release_ns);
    }

    /// One cycle, and what the robot does until the next.
    fn turn(&mut self) -> CycleRecord {
        self.gather(BEGIN_NS + self.next * PERIOD_NS);
        self.cycle(0)
    }

    /// A cycle with whatever inputs there are, after `skipped` releases without one.
    fn cycle(&mut self, skipped: u32) -> CycleRecord {
        self.next += u64::from(skipped);
        let release_ns = BEGIN_NS + self.next * PERIOD_NS;
        let release = Release {
            cycle: self.next,
            release_ns,
            due_ns: release_ns,
            start_ns: release_ns + 20_000,
            skipped,
        };
        self.clock.0.set(release.start_ns);
        let mut asked = self.asked.take();
        let next_request = || {
            asked
                .take()
                .map(|request| CycleRequest { ticket: 1, request })
        };
        let record = self
            .cycle
            .run(release, &self.inputs, next_request, &self.clock);
        let command = convert::command(&record, &self.robot, PERIOD_NS);
        self.target_rad = command.bend_target_rad[..self.bend_rad.len()].to_vec();
        self.obey(&record);
        self.next += 1;
        self.last = Some(record);
        record
    }

    /// What follows the solver takes so long.
    fn rest_after(&mut self, took_ns: u64) {
        self.clock.0.set(self.cycle.solve_over_ns + took_ns);
        self.cycle.rest(&self.clock);
    }

    fn obey(&mut self, record: &CycleRecord) {
        let part = (PERIOD_S / self.flaws.lag_s).min(1.0);
        for (i, bend) in self.bend_rad.iter_mut().enumerate() {
            *bend += match self.flaws {
                Flaws { stands: true, .. } => 0.0,
                Flaws {
                    interface: Interface::Position,
                    ..
                } => part * (self.target_rad[i] - *bend),
                Flaws {
                    interface: Interface::Velocity,
                    ..
                } => PERIOD_S * record.rates.as_slice()[i],
            };
        }
    }

    fn turns(&mut self, count: u32) -> CycleRecord {
        for _ in 0..count {
            self.turn();
        }
        self.last.unwrap()
    }

    /// A reference on a circle of `radius_m` about the axis, from now on, `duration_s` long.
    fn feed_circle(&mut self, radius_m: f64, duration_s: f64) {
        let start_ns = BEGIN_NS + (self.next + 2) * PERIOD_NS;
        let count = (duration_s / 0.02) as u64;
        let reach_m = self.robot.reach_m();
        let points = (0..count).map(|k| {
            let time_s = k as f64 * 0.02;
            let (sin, cos) = (1.5 * time_s).sin_cos();
            // Beginning where the robot is, at rest.
            let radius_m = radius_m * (0.5 * time_s).min(1.0).powi(2);
            ReferencePoint {
                time_ns: start_ns + k * 20_000_000,
                position_m: Vector3::new(radius_m * cos, radius_m * sin, 0.93 * reach_m),
                orientation: Orientation::Free,
                interpolation: Interpolation::Cubic,
            }
        });
        self.trajectory.replace(points).unwrap();
    }

    fn begin_tracking(&mut self) {
        self.feed_circle(0.2, 20.0);
        let record = self.ask(Request::Track);
        assert!(
            matches!(record.mode, Mode::Tracking { .. }),
            "{:?}",
            record.answers[0]
        );
    }
}

fn is_at_rest(record: &CycleRecord) -> bool {
    record.rates.as_slice().iter().all(|rate| *rate == 0.0)
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// A driver that measures 0.1 mm beside its command, and motors that come to rest beside it: for a minute in each mode
/// of rest nothing is commanded to move, to the bit.
#[test]
fn a_resting_robot_with_offset_and_droop_does_not_creep() {
    for interface in [Interface::Position, Interface::Velocity] {
        for asked in [Request::Hold, Request::Stop] {
            let mut trial = Trial::new(Flaws {
                interface,
                ..SLOPPY
            });
            trial.turns(3);
            trial.begin_tracking();
            trial.turns(600);
            trial.ask(asked);
            assert!(is_at_rest(&trial.turns(100)));
            let target_rad = bits(&trial.target_rad);
            for _ in 0..12_000 {
                assert!(is_at_rest(&trial.turn()));
                assert_eq!(
                    bits(&trial.target_rad),
                    target_rad,
                    "{interface:?} {asked:?}"
                );
            }
            // It hangs through when the motors let go, and nothing answers: that is a fault.
            if interface == Interface::Position && asked == Request::Hold {
                trial.flaws.offset_m[1] += 0.01;
                let faulted = trial.turns(10);
                assert!(
                    matches!(faulted.mode, Mode::Faulted { .. }),
                    "{:?}",
                    faulted.mode
                );
                for _ in 0..12_000 {
                    assert!(is_at_rest(&trial.turn()));
                    assert_eq!(bits(&trial.target_rad), target_rad);
                }
            }
        }
    }
}

/// Motors with a lag of 30 ms behind a position interface: the loop is stable, and an offset is learnt.
#[test]
fn tracking_with_lagging_position_motors_does_not_oscillate() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(1000);
    let (mut reversals, mut before, mut largest_m) = (0, BendRates::zero(3), 0.0_f64);
    for _ in 0..2000 {
        let record = trial.turn();
        assert!(
            matches!(record.mode, Mode::Tracking { .. }),
            "{:?}",
            record.mode
        );
        let tip_m = trial.robot.tip_position(&trial.shape());
        largest_m = largest_m.max((tip_m - record.reference.position_m).norm());
        let pairs = record.rates.as_slice().iter().zip(before.as_slice());
        reversals += pairs.filter(|(now, before)| **now * **before < 0.0).count();
        before = record.rates;
    }
    println!("{reversals} reversals, {largest_m} m");
    // Six components, a circle of 4.2 s: five turns reverse each component about five times.
    assert!(reversals < 100, "{reversals} reversals");
    assert!(largest_m < 0.01, "{largest_m} m");
}

/// A robot that does not move: a fault with the cause, and after a reset control begins where the robot is.
#[test]
fn a_robot_that_does_not_follow_is_a_fault_and_a_reset_begins_where_it_is() {
    for interface in [Interface::Position, Interface::Velocity] {
        let mut trial = Trial::new(Flaws {
            interface,
            offset_m: [0.0; 3],
            stands: true,
            ..SLOPPY
        });
        trial.turns(3);
        trial.begin_tracking();
        let mut record = trial.turn();
        while !record.mode.is_latched() {
            // Bits of noise, or the measurement would be frozen.
            trial.flaws.offset_m =
                [1e-9, -1e-9, 1e-9].map(|m| m * f64::from(record.release.cycle as u32 % 7));
            record = trial.turn();
            assert!(record.release.cycle < 5000);
        }
        assert_eq!(
            record.mode.reason(),
            Reason::FollowingError,
            "{interface:?}"
        );
        assert!(record.following.largest_rad() > record.policy.following.fault_rad);
        assert!(is_at_rest(&trial.turns(100)));
        let record = trial.ask(Request::Reset);
        assert_eq!(record.answers[0].unwrap().outcome, Ok(()));
        assert_eq!(
            record.mode,
            Mode::Holding {
                reason: Reason::Request
            }
        );
        assert!(
            trial.target_rad.iter().all(|bend| bend.abs() < 1e-5),
            "{:?}",
            trial.target_rad
        );
        assert!(trial.turns(100).following.largest_rad() < 1e-3);
    }
}

/// A reset is granted while the robot is still on its ramp: the commanded position goes on along it, and control begins
/// where the robot is once it rests.
#[test]
fn a_reset_on_the_ramp_does_not_step_the_commanded_position() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(3);
    trial.begin_tracking();
    // On its way to the first point, which is far from the straight robot.
    let fastest = trial
        .turns(12)
        .rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |most, rate| most.max(rate.abs()));
    assert!(fastest > 0.5, "{fastest} rad/s");
    trial.ask(Request::Stop);
    let mut before = trial.target_rad.clone();
    let mut record = trial.ask(Request::Reset);
    assert_eq!(record.answers[0].unwrap().outcome, Ok(()));
    let mut ramp = 0;
    while !is_at_rest(&record) {
        for (i, before) in before.iter().enumerate() {
            let moved = before + PERIOD_S * record.rates.as_slice()[i];
            assert_eq!(trial.target_rad[i].to_bits(), moved.to_bits());
        }
        before.clone_from(&trial.target_rad);
        record = trial.turn();
        ramp += 1;
    }
    assert!(ramp > 1, "{ramp}");
    // What is left is the following error, taken over once.
    trial.turns(2);
    let target_rad = bits(&trial.target_rad);
    trial.turns(100);
    assert_eq!(bits(&trial.target_rad), target_rad);
    assert!(trial.turn().following.largest_rad() < 0.1);
}

/// In every message the position is that of the message before, moved on by the speeds.
#[test]
fn positions_are_the_integral_of_the_speeds() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(3);
    trial.begin_tracking();
    for turn in 0..500_u32 {
        let before = trial.target_rad.clone();
        let record = if turn % 50 == 49 {
            trial.cycle(3)
        } else {
            trial.turn()
        };
        for (i, before) in before.iter().enumerate() {
            let moved = before + PERIOD_S * record.rates.as_slice()[i];
            assert_eq!(trial.target_rad[i].to_bits(), moved.to_bits());
        }
    }
}

#[test]
fn no_rate_grows_faster_than_the_acceleration() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(3);
    // The first point is far from the straight robot: without the limit it would be at its largest rates at once.
    trial.begin_tracking();
    let mut cut = 0;
    for _ in 0..200 {
        let record = trial.turn();
        let most = MOST_RAD_S2 * PERIOD_S;
        for (rate, before) in record
            .rates
            .as_slice()
            .iter()
            .zip(record.previous_rates.as_slice())
        {
            let grown = if rate * before > 0.0 {
                rate.abs() - before.abs()
            } else {
                rate.abs()
            };
            assert!(grown <= most * (1.0 + 1e-12), "{before} → {rate}");
        }
        cut += u32::from(record.limits_hit.acceleration);
    }
    assert!(cut > 0);
}

/// What a robot behind a driver has without a limit of its own.
const MOST_RAD_S2: f64 = crate::config::MotionConfig::ACCELERATION_RAD_S2;

#[test]
fn what_the_inputs_say_makes_a_moving_robot_hold_or_stop() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(100);
    // No gather any more: for as long as a command is valid it goes on.
    let modes: Vec<_> = (0..4).map(|_| trial.cycle(0).mode).collect();
    assert!(
        modes[..3]
            .iter()
            .all(|mode| matches!(mode, Mode::Tracking { .. })),
        "{modes:?}"
    );
    assert_eq!(
        modes[3],
        Mode::Holding {
            reason: Reason::InputsStale
        }
    );
    trial.turn();
    trial.begin_tracking();
    trial.inputs.obstacle_source_silent = true;
    assert_eq!(
        trial.turn().mode,
        Mode::Holding {
            reason: Reason::ObstacleSourceSilent
        }
    );
    let refused = trial.ask(Request::Track).answers[0].unwrap().outcome;
    assert_eq!(refused, Err(Refusal::Waits));
    trial.inputs.obstacle_source_silent = false;
    trial.turn();
    trial.begin_tracking();
    trial.inputs.suspends += 1;
    assert_eq!(
        trial.turn().mode,
        Mode::Stopped {
            reason: Reason::Suspended
        }
    );
    assert_eq!(
        trial.ask(Request::Reset).mode,
        Mode::Holding {
            reason: Reason::Request
        }
    );
}

#[test]
fn the_solver_leaves_what_the_rest_of_the_period_was_measured_to_take() {
    let mut trial = Trial::new(SLOPPY);
    trial.turns(20);
    trial.begin_tracking();
    let until_ns = |record: &CycleRecord| record.solve_until_ns - record.release.release_ns;
    assert_eq!(until_ns(&trial.turn()), 4_500_000, "a tenth by default");
    // A few long ones are stalls.
    for _ in 0..3 {
        trial.turn();
        trial.rest_after(3_000_000);
    }
    assert_eq!(until_ns(&trial.turn()), 4_500_000);
    for _ in 0..4 {
        trial.turn();
        trial.rest_after(280_000);
    }
    trial.inputs.exchange_ns = 150_000;
    let record = trial.turn();
    assert_eq!(record.costs.after_solve_ns, 280_100, "a look takes 100 ns");
    // 92.5 % of the period from the start, which is 0.02 ms late.
    assert_eq!(until_ns(&record), 4_625_000 + 20_000 - 280_100 - 150_000);
    assert!(record.solve_end_ns <= record.solve_until_ns);
    // However many: in those the thread has lost its core.
    for turn in 1..200 {
        trial.turn();
        trial.rest_after(if turn % 3 == 0 { 9_000_000 } else { 280_000 });
        trial.inputs.interruptions += u64::from(turn % 3 == 0);
    }
    assert_eq!(trial.turn().costs.after_solve_ns, 280_100);
    // What is no stall counts in full, and half as much again is left.
    for _ in 0..200 {
        trial.turn();
        trial.rest_after(1_500_000);
    }
    assert_eq!(until_ns(&trial.turn()), 5_000_000 - 3 * 1_500_100 / 2);
}

#[test]
fn a_cycle_that_cannot_fit_is_refused_with_the_numbers() {
    let check = |text: &str| {
        let validated = Config::parse(text, Path::new("trial")).unwrap();
        let cycle = Cycle::new(&validated, DriverLink).unwrap();
        // Each look takes 100 ns, and so does a cycle.
        cycle
            .with_kernel_share(0.9)
            .check_that_it_fits(&Watch::default())
    };
    assert_eq!(check(""), Ok(()));
    let short = "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.05\n";
    assert_eq!(check(short), Ok(()));
    let error = check(&format!("{short}[realtime]\nspin_us = 50.0\n")).unwrap_err();
    for word in [
        "cycle.period_ms = 0.1",
        "3 sections",
        "0.050 ms of spinning",
        "0.040 ms of exchange",
    ] {
        assert!(error.contains(word), "{error}");
    }
}
