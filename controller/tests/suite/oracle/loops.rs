//! Random closed loops: the crate's own solver moves the tip from goal to goal among obstacles.

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters};
use nalgebra::Vector3;

use super::Account;
use super::body::{Ball, arcs};
use super::moment::{Draw, Moment};
use super::rule::{DIP_M, ROUNDING, Way, moved};

use crate::{input, inside};

const PERIOD_S: f64 = 0.005;
const CYCLES: u32 = 120;
/// Cycles from one goal to the next.
const GOAL_CYCLES: u32 = 40;

/// A random closed loop.
pub(super) struct Scene {
    name: String,
    parameters: RobotParameters,
    start: Vec<f64>,
    goals_m: Vec<Vector3<f64>>,
    balls: Vec<Ball>,
    safe_m: f64,
    acceleration_rad_s2: f64,
    link: Link,
    cycles: u32,
}

/// Path from the commands to the robot.
#[derive(Debug, Clone)]
enum Link {
    /// Ideal robot.
    Ideal,
    /// Position motors.
    Motors(Motors),
    /// The commands of some cycles are lost: the driver continues the last one, and then comes to rest.
    Loses(Vec<bool>),
}

/// Motors that follow the commanded position of the previous period with a lag, and encoders with offsets.
#[derive(Debug, Clone)]
struct Motors {
    lag_s: f64,
    offset_rad: Vec<f64>,
}

impl Scene {
    pub(super) fn random(seed: u64) -> Self {
        let mut draw = Draw::new(!seed);
        let (parameters, start) = draw.robot();
        let mut balls = draw.balls(&parameters, &start, 32);
        let goals = [0.9, 0.5, 0.9].map(|share| draw.bends(&parameters, share));
        balls.extend(draw.balls(&parameters, &goals[0], 32));
        let kind = draw.share();
        let link = if kind < 0.4 {
            Link::Motors(Motors {
                lag_s: draw.between(0.005, 0.04),
                offset_rad: start.iter().map(|_| draw.between(-5e-3, 5e-3)).collect(),
            })
        } else if kind < 0.6 {
            Link::Loses(losses(&mut draw))
        } else {
            Link::Ideal
        };
        Self {
            name: format!("loop {seed}"),
            goals_m: goals
                .iter()
                .map(|bends| tip_m(&parameters, bends))
                .collect(),
            safe_m: draw.one_of(&[0.003, 0.01, 0.03]),
            acceleration_rad_s2: draw.one_of(&[40.0, 200.0, f64::INFINITY]),
            parameters,
            start,
            balls,
            link,
            cycles: CYCLES,
        }
    }

    /// The first cycles only.
    pub(super) fn first(self, cycles: u32) -> Self {
        Self { cycles, ..self }
    }

    /// Runs the loop and checks each command.
    pub(super) fn run(&self, account: &mut Account) {
        match &self.link {
            Link::Ideal => self.run_ideal(account),
            Link::Motors(motors) => self.run_motors(motors, account),
            Link::Loses(lost) => self.run_losing(lost, account),
        }
    }

    fn nmpc(&self) -> (Robot, Nmpc) {
        let robot = Robot::new(&self.parameters).unwrap();
        let settings = NmpcSettings {
            safe_distance_m: self.safe_m,
            ..NmpcSettings::default()
        };
        let nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
        (robot, nmpc)
    }

    fn reference(&self, time_s: f64) -> ReferenceSample {
        let goal = (time_s / PERIOD_S) as usize / GOAL_CYCLES as usize;
        inside(self.goals_m[goal.min(self.goals_m.len() - 1)])
    }

    /// The moment of a cycle, for a robot that stops at once without a further command.
    fn moment(
        &self,
        time_s: f64,
        at: &[f64],
        previous: &[f64],
        desired_rates: &BendRates,
    ) -> Moment {
        Moment {
            parameters: self.parameters.clone(),
            tip_offset_m: 0.0,
            at: at.to_vec(),
            commanded: None,
            previous: previous.to_vec(),
            desired_rates: desired_rates.as_slice().to_vec(),
            balls: self.balls.iter().map(|ball| ball.after(time_s)).collect(),
            safe_m: self.safe_m,
            acceleration_rad_s2: self.acceleration_rad_s2,
            period_s: PERIOD_S,
            moving_s: PERIOD_S,
            deceleration_rad_s2: f64::INFINITY,
            comes_to_rest: false,
        }
    }

    /// The ideal robot in the crate's own loop.
    fn run_ideal(&self, account: &mut Account) {
        let (robot, mut nmpc) = self.nmpc();
        let obstacles: Vec<Obstacle> = self.balls.iter().map(Ball::obstacle).collect();
        let start = Configuration::from_slice(&self.start).unwrap();
        let reference = |time_s| self.reference(time_s);
        let settings = *nmpc.settings();
        let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &obstacles, reference)
            .unwrap()
            .with_acceleration(self.acceleration_rad_s2);
        for cycle in 0..self.cycles {
            let (desired_rates, _) = nmpc.solve(&closed.input(), &mut Budget::unlimited());
            let before = closed.configuration().as_slice();
            let previous = closed.command().rates.as_slice();
            let moment = self.moment(closed.time_s(), before, previous, &desired_rates);
            closed.advance(&desired_rates);
            let command = closed.command();
            let name = format!("{}, cycle {cycle}", self.name);
            account.take(&name, &moment, command);
            account.ask(&name, &moment, command);
            let drifted_m = self.came_nearer_m(closed.configuration().as_slice());
            assert!(
                drifted_m <= ROUNDING * f64::from(cycle + 1),
                "{name}: {drifted_m} m"
            );
        }
    }

    /// With motors, whose commands are executed for three periods before the ramp to rest.
    fn run_motors(&self, motors: &Motors, account: &mut Account) {
        let (_, mut nmpc) = self.nmpc();
        let mut robot = self.start.clone();
        let measured = |robot: &[f64]| moved(robot, &motors.offset_rad, 1.0);
        let mut commanded = measured(&robot);
        let mut goes_to = commanded.clone();
        let mut rates = BendRates::zero(self.parameters.sections.len());
        let followed = 1.0 - (-PERIOD_S / motors.lag_s).exp();
        for cycle in 0..self.cycles {
            let time_s = f64::from(cycle) * PERIOD_S;
            let at = measured(&robot);
            let steps = 1..=nmpc.settings().horizon_steps;
            let reference: Vec<_> = steps
                .map(|step| self.reference(f64::from(cycle + step) * PERIOD_S))
                .collect();
            let mut moment = self.moment(time_s, &at, rates.as_slice(), &rates);
            let obstacles: Vec<Obstacle> = moment.balls.iter().map(Ball::obstacle).collect();
            let bends = Configuration::from_slice(&at).unwrap();
            let input = SolveInput {
                obstacles: &obstacles,
                seed: cycle_seed(1, u64::from(cycle)),
                ..input(&bends, &rates, &reference)
            };
            let (desired_rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
            moment.desired_rates = desired_rates.as_slice().to_vec();
            moment.commanded = Some(commanded.clone());
            (moment.moving_s, moment.deceleration_rad_s2) = (3.0 * PERIOD_S, 40.0);
            let command = moment.command();
            let name = format!("{}, cycle {cycle}, motors", self.name);
            account.take(&name, &moment, &command);
            account.ask(&name, &moment, &command);
            rates = command.rates;
            for (robot, goes_to) in robot.iter_mut().zip(&goes_to) {
                *robot += followed * (goes_to - *robot);
            }
            goes_to.clone_from(&commanded);
            commanded = moved(&commanded, rates.as_slice(), PERIOD_S);
        }
    }

    /// A robot that executes the last command for three periods, and then ramps to rest. On the whole path
    /// each section keeps the clearance of the resting robot, except for the tolerance in between. A command
    /// that follows lost ones may start on this path, so it may come nearer by that tolerance, each time.
    fn run_losing(&self, lost: &[bool], account: &mut Account) {
        let (_, mut nmpc) = self.nmpc();
        let (mut at, mut rates) = (self.start.clone(), vec![0.0; self.start.len()]);
        let mut reported = (
            0,
            self.moment(0.0, &at, &rates, &BendRates::zero(at.len() / 2)),
        );
        let mut sent_rates = rates.clone();
        let (mut interruptions, mut nearer_m) = (0, 0.0_f64);
        for cycle in 0..self.cycles {
            let name = format!("{}, cycle {cycle}, commands are lost", self.name);
            if !lost[cycle as usize] {
                interruptions += u32::from(cycle > 0 && lost[cycle as usize - 1]);
                let previous = BendRates::from_slice(&rates).unwrap();
                let mut moment = self.moment(f64::from(cycle) * PERIOD_S, &at, &rates, &previous);
                (moment.moving_s, moment.deceleration_rad_s2) = (3.0 * PERIOD_S, 40.0);
                let obstacles: Vec<Obstacle> = moment.balls.iter().map(Ball::obstacle).collect();
                let bends = Configuration::from_slice(&at).unwrap();
                let reference = [self.reference(f64::from(cycle) * PERIOD_S); 2];
                let input = SolveInput {
                    obstacles: &obstacles,
                    seed: cycle_seed(1, u64::from(cycle)),
                    ..input(&bends, &previous, &reference)
                };
                let (desired_rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
                moment.desired_rates = desired_rates.as_slice().to_vec();
                let command = moment.command();
                account.take(&name, &moment, &command);
                account.ask(&name, &moment, &command);
                sent_rates = command.rates.as_slice().to_vec();
                reported = (cycle, moment);
            }
            let (since, moment) = &reported;
            let way = Way::new(moment, &moment.at, &sent_rates);
            let time_s = f64::from(cycle + 1 - since) * PERIOD_S;
            at = moved(&moment.at, &sent_rates, way.stopping.way_s(time_s));
            let share = way.stopping.share(time_s);
            rates = sent_rates.iter().map(|rate| share * rate).collect();
            // At rest the robot stays, so moving obstacles may run into it.
            let end_s = way.stopping.end_s();
            let left_m = way.left_m(time_s.min(end_s));
            assert!(
                left_m >= -ROUNDING,
                "{name}: {left_m} m after {time_s} s of {end_s} s"
            );
            nearer_m = nearer_m.max(self.came_nearer_m(&at));
        }
        let allowed_m = DIP_M * f64::from(interruptions + 1);
        assert!(nearer_m <= allowed_m, "{}: {nearer_m} m", self.name);
        if nearer_m > ROUNDING {
            println!(
                "{}: {:.3} mm nearer to what stands, {interruptions} times after lost commands",
                self.name,
                1e3 * nearer_m
            );
        }
    }

    /// Largest unallowed approach of a section to an obstacle at rest since the start (m).
    fn came_nearer_m(&self, at: &[f64]) -> f64 {
        let [start, now] = [self.start.as_slice(), at].map(|bends| arcs(&self.parameters, bends));
        let standing = self
            .balls
            .iter()
            .filter(|ball| ball.velocity_m_s == Vector3::zeros());
        let mut most_m = 0.0_f64;
        for ball in standing {
            for (start, now) in start.iter().zip(&now) {
                let [start_m, now_m] =
                    [start, now].map(|arc| arc.nearest_m(ball, self.safe_m, 1e-10).0);
                most_m = most_m.max(start_m.min(self.safe_m) - now_m);
            }
        }
        most_m
    }
}

/// Cycles with lost commands, one to thirty in a row.
fn losses(draw: &mut Draw) -> Vec<bool> {
    let mut lost = Vec::new();
    while lost.len() < CYCLES as usize {
        lost.extend((0..draw.count(15)).map(|_| false));
        lost.extend((0..draw.count(30)).map(|_| true));
    }
    lost
}

fn tip_m(parameters: &RobotParameters, bends: &[f64]) -> Vector3<f64> {
    let arcs = arcs(parameters, bends);
    arcs[arcs.len() - 1].end_m()
}
