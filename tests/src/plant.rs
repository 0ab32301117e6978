//! A robot as it is built: motors that lag and stand a little beside, encoders that count from elsewhere, noise.

use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::RobotDescription;
use cdcr_shared_types::limits::{CABLES_MAX, COORDINATES_MAX};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::record::robot_of;

/// In what a robot differs from the one that the daemon computes with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flaws {
    /// Time constant of the motors, of first order \[s\].
    pub lag_s: f64,
    /// The encoder of the first cable of each section counts from so far beside its zero \[m\].
    pub offset_m: f64,
    /// The motor of the second cable of each section stands so far beside where it was sent, as under a load \[m\]. A
    /// speed has none.
    pub droop_m: f64,
    /// A measured cable length is off by at most this, evenly spread \[m\].
    pub noise_m: f64,
}

impl Flaws {
    /// Those of a robot that is built well: the noise is three counts of an encoder with 4096 on a 10 mm spool.
    pub const USUAL: Self = Self {
        lag_s: 0.02,
        offset_m: 1e-4,
        droop_m: 1e-4,
        noise_m: 3e-5,
    };
    /// None: for a test that compares measurements exactly. Such a test says why.
    pub const NONE: Self = Self {
        lag_s: 0.0,
        offset_m: 0.0,
        droop_m: 0.0,
        noise_m: 0.0,
    };
}

/// What the motors are told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotorOrder {
    /// To stand where they are.
    Stand,
    /// To run at these speeds, one for each cable \[m/s\].
    Speeds([f64; CABLES_MAX]),
    /// To go to these lengths, one for each cable \[m\].
    Lengths([f64; CABLES_MAX]),
}

/// The motors and encoders of a robot. The same seed and the same orders give the same bits.
#[derive(Debug, Clone)]
pub struct Plant {
    robot: Robot,
    flaws: Flaws,
    /// Where the cables are.
    length_m: [f64; CABLES_MAX],
    speed_m_s: [f64; CABLES_MAX],
    noise: Xoshiro256PlusPlus,
}

impl Plant {
    /// A robot at rest, bent by `bend_rad`.
    pub fn new(
        robot: &RobotDescription,
        bend_rad: &[f64; COORDINATES_MAX],
        flaws: Flaws,
        seed: u64,
    ) -> Self {
        let robot = robot_of(robot);
        let length_m = robot.cable_lengths(&bent(&bend_rad[..robot.coordinate_count()]));
        Self {
            robot,
            flaws,
            length_m,
            speed_m_s: [0.0; CABLES_MAX],
            noise: Xoshiro256PlusPlus::seed_from_u64(seed),
        }
    }

    /// Sections that it has.
    pub fn sections(&self) -> u32 {
        self.robot.section_count() as u32
    }

    /// Lets `dt_s` pass with the motors at `order`, as far as the sections bend: they have mechanical ends.
    pub fn advance(&mut self, order: &MotorOrder, dt_s: f64) {
        // Of the way to its goal a motor has this part left.
        let left = if self.flaws.lag_s > 0.0 {
            (-dt_s / self.flaws.lag_s).exp()
        } else {
            0.0
        };
        let goals_m_s = match order {
            MotorOrder::Lengths(goals_m) => return self.approach(goals_m, left),
            MotorOrder::Speeds(goals_m_s) => goals_m_s,
            MotorOrder::Stand => &[0.0; CABLES_MAX],
        };
        for (cable, goal_m_s) in goals_m_s.iter().enumerate() {
            let speed_m_s = &mut self.speed_m_s[cable];
            // What a motor of first order runs in this time.
            let behind_m_s = *speed_m_s - goal_m_s;
            self.length_m[cable] += goal_m_s * dt_s + behind_m_s * self.flaws.lag_s * (1.0 - left);
            *speed_m_s = goal_m_s + behind_m_s * left;
        }
        self.keep_ends();
    }

    fn approach(&mut self, goals_m: &[f64; CABLES_MAX], left: f64) {
        for (cable, goal_m) in goals_m.iter().enumerate() {
            let droop_m = if cable % 3 == 1 {
                self.flaws.droop_m
            } else {
                0.0
            };
            let goal_m = goal_m + droop_m;
            self.length_m[cable] = goal_m + (self.length_m[cable] - goal_m) * left;
        }
        self.keep_ends();
    }

    fn keep_ends(&mut self) {
        let mut bends = self.robot.bend_from_cable_lengths(&self.length_m);
        let mut is_beyond = false;
        let (pairs, _) = bends.as_mut_slice().as_chunks_mut::<2>();
        for ([u, v], section) in pairs.iter_mut().zip(self.robot.sections()) {
            let beyond = u.hypot(*v) / section.bend_max_rad;
            if beyond > 1.0 {
                (*u, *v) = (*u / beyond, *v / beyond);
                is_beyond = true;
            }
        }
        if is_beyond {
            self.length_m = self.robot.cable_lengths(&bends);
        }
    }

    /// What the encoders say \[m\].
    pub fn measure_cables(&mut self) -> [f64; CABLES_MAX] {
        let mut lengths_m = self.length_m;
        for (cable, length_m) in lengths_m[..self.robot.cable_count()].iter_mut().enumerate() {
            if cable % 3 == 0 {
                *length_m += self.flaws.offset_m;
            }
            *length_m += self.flaws.noise_m * self.noise.random_range(-1.0..=1.0);
        }
        lengths_m
    }

    /// The bends that a driver computes from them \[rad\].
    pub fn measure_bends(&mut self) -> [f64; COORDINATES_MAX] {
        let lengths_m = self.measure_cables();
        let bends = self.robot.bend_from_cable_lengths(&lengths_m);
        padded(bends.as_slice())
    }

    /// How it is bent in truth \[rad\].
    pub fn bend_rad(&self) -> [f64; COORDINATES_MAX] {
        padded(
            self.robot
                .bend_from_cable_lengths(&self.length_m)
                .as_slice(),
        )
    }
}

fn bent(bend_rad: &[f64]) -> Configuration {
    Configuration::from_slice(bend_rad).expect("a pair for each section")
}

fn padded(bends: &[f64]) -> [f64; COORDINATES_MAX] {
    core::array::from_fn(|i| bends.get(i).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_controller::robot::BendRates;
    use cdcr_shared_types::SectionDescription;

    const STEP_S: f64 = 0.001;

    fn plant(flaws: Flaws) -> Plant {
        let section = SectionDescription {
            length_m: 0.3,
            cable_radius_m: 0.0125,
            cable_offset_rad: 0.4,
            bend_max_rad: 2.0,
            rate_max_rad_s: 2.0,
            body_radius_m: 0.015,
        };
        let mut robot = RobotDescription {
            sections: 2,
            cable_speed_max_m_s: 0.5,
            cable_stroke_max_m: 0.25,
            ..RobotDescription::default()
        };
        robot.section[..2].fill(section);
        Plant::new(&robot, &padded(&[0.5, -0.2, 0.1]), flaws, 7)
    }

    fn near(found: &[f64], expected: &[f64], within: f64) {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= within, "{found}, {expected}");
        }
    }

    fn rates(rad_s: [f64; 4]) -> BendRates {
        BendRates::from_slice(&rad_s).unwrap()
    }

    #[test]
    fn the_ideal_robot_goes_where_it_is_sent_at_once() {
        let mut plant = plant(Flaws::NONE);
        near(&plant.measure_bends(), &[0.5, -0.2, 0.1, 0.0], 1e-12);
        let goal = plant.robot.cable_lengths(&bent(&[0.1, 0.2, 0.3, 0.4]));
        plant.advance(&MotorOrder::Lengths(goal), STEP_S);
        near(&plant.measure_bends(), &[0.1, 0.2, 0.3, 0.4], 1e-12);
        let speeds = plant.robot.cable_speeds(&rates([1.0, 0.0, -2.0, 0.0]));
        plant.advance(&MotorOrder::Speeds(speeds), 0.1);
        near(&plant.measure_bends(), &[0.2, 0.2, 0.1, 0.4], 1e-12);
        let before = plant.clone().measure_cables();
        plant.advance(&MotorOrder::Stand, 1.0);
        assert_eq!(plant.measure_cables(), before);
    }

    #[test]
    fn motors_lag_by_their_time_constant_whatever_the_step() {
        let lag_s = 0.02;
        for steps in [1, 7, 100] {
            let mut plant = plant(Flaws {
                lag_s,
                ..Flaws::NONE
            });
            let speeds = plant.robot.cable_speeds(&rates([1.0, 0.0, 0.0, 0.0]));
            let step_s = 0.1 / f64::from(steps);
            for _ in 0..steps {
                plant.advance(&MotorOrder::Speeds(speeds), step_s);
            }
            let behind = lag_s * (1.0 - (-0.1 / lag_s).exp());
            near(&plant.bend_rad(), &[0.5 + 0.1 - behind, -0.2, 0.1], 1e-12);
            // It runs on for a while when it is told to stand.
            plant.advance(&MotorOrder::Stand, 10.0);
            near(&plant.bend_rad(), &[0.5 + 0.1, -0.2, 0.1], 1e-12);
            let goal = plant.robot.cable_lengths(&bent(&[0.0; 4]));
            plant.advance(&MotorOrder::Lengths(goal), lag_s);
            near(&plant.bend_rad()[..1], &[0.6 * (-1.0_f64).exp()], 1e-12);
        }
    }

    #[test]
    fn flaws_are_where_they_are_said_and_repeat() {
        let mut built = plant(Flaws {
            noise_m: 0.0,
            ..Flaws::USUAL
        });
        let goal = built.robot.cable_lengths(&bent(&[0.1, 0.2, 0.3, 0.4]));
        for _ in 0..1000 {
            built.advance(&MotorOrder::Lengths(goal), STEP_S);
        }
        let measured = built.measure_cables();
        for cable in 0..6 {
            let expected = goal[cable] + [1e-4, 1e-4, 0.0][cable % 3];
            assert!((measured[cable] - expected).abs() < 1e-12, "{cable}");
        }
        let (mut one, mut other) = (plant(Flaws::USUAL), plant(Flaws::USUAL));
        let first = one.measure_cables();
        assert_eq!(first, other.measure_cables());
        assert_ne!(first, one.measure_cables());
        let far = |lengths: [f64; CABLES_MAX]| (lengths[2] - one.length_m[2]).abs();
        let most = (0..1000)
            .map(|_| far(other.measure_cables()))
            .fold(0.0, f64::max);
        assert!((2.9e-5..=3e-5).contains(&most), "{most}");
    }

    #[test]
    fn sections_have_mechanical_ends() {
        for order in [
            |plant: &Plant| {
                MotorOrder::Speeds(plant.robot.cable_speeds(&rates([3.0, 4.0, 0.0, 0.0])))
            },
            |plant: &Plant| {
                MotorOrder::Lengths(plant.robot.cable_lengths(&bent(&[3.0, 4.0, 0.1, 0.0])))
            },
        ] {
            let mut plant = plant(Flaws {
                droop_m: 0.0,
                ..Flaws::USUAL
            });
            let order = order(&plant);
            for _ in 0..10_000 {
                plant.advance(&order, STEP_S);
            }
            let [u, v, w, ..] = plant.bend_rad();
            assert!((u.hypot(v) - 2.0).abs() < 1e-9);
            assert!((w - 0.1).abs() < 1e-9 && v > u);
        }
    }
}
