//! The driver of a run, and what goes wrong with it.

use std::collections::VecDeque;

use cdcr_controller::robot::Configuration;
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_shared_types::{Command, Measurement, RobotDescription};
use cdcr_tests::plant::{Flaws, MotorOrder, Plant};
use cdcr_tests::record::robot_of;

use crate::chaos::dice::Dice;

/// What goes wrong for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    None,
    Silent,
    /// What it measures is on its way for so long \[ns\].
    Late(u64),
    Frozen,
    /// A bend seems to be so far beside \[rad\].
    Jumps(f64),
    NotFinite,
    /// The motors do not move.
    Stuck,
}

/// The robot behind it is that of all tests.
#[derive(Debug)]
pub(super) struct Driver {
    robot: RobotDescription,
    interface: Interface,
    kind: MeasurementKind,
    flaws: Flaws,
    plant: Plant,
    order: Option<Command>,
    trouble: Trouble,
    trouble_ends_ns: u64,
    moved_ns: u64,
    under_way: VecDeque<(u64, Measurement)>,
    last: Measurement,
}

impl Driver {
    pub(super) fn new(
        dice: &mut Dice,
        robot: &RobotDescription,
        interface: Interface,
        now_ns: u64,
    ) -> Self {
        let scale = dice.pick(&[0.0, 1.0, 1.0, 3.0]);
        let usual = Flaws::USUAL;
        let flaws = Flaws {
            lag_s: scale * usual.lag_s,
            offset_m: scale * usual.offset_m,
            droop_m: scale * usual.droop_m,
            noise_m: scale * usual.noise_m,
        };
        Self {
            plant: Plant::new(robot, &bend(dice, robot), flaws, 1),
            kind: dice.pick(&[
                MeasurementKind::Configuration,
                MeasurementKind::CableLengths,
                MeasurementKind::TipPose,
            ]),
            robot: *robot,
            interface,
            flaws,
            order: None,
            // Some come late.
            trouble: Trouble::Silent,
            trouble_ends_ns: now_ns + dice.duration_ms(0, 100).as_nanos() as u64,
            moved_ns: now_ns,
            under_way: VecDeque::new(),
            last: Measurement::default(),
        }
    }

    /// A command arrives.
    pub(super) fn take(&mut self, command: &Command) {
        self.order = Some(*command);
    }

    /// Somebody bends the robot by hand.
    pub(super) fn push(&mut self, dice: &mut Dice) {
        self.plant = Plant::new(&self.robot, &bend(dice, &self.robot), self.flaws, 2);
    }

    /// Lets the time pass until `now_ns`, and measures then.
    pub(super) fn turn(&mut self, dice: &mut Dice, now_ns: u64) {
        self.move_to(now_ns);
        if now_ns >= self.trouble_ends_ns {
            self.trouble = Trouble::None;
            if dice.chance(1) {
                self.trouble = draw(dice);
                self.trouble_ends_ns = now_ns + dice.duration_ms(5, 800).as_nanos() as u64;
            }
        }
        let delay_ns = match self.trouble {
            Trouble::Silent => return,
            Trouble::Late(delay_ns) => delay_ns,
            _ => 0,
        };
        self.last = self.measure(now_ns);
        self.under_way.push_back((now_ns + delay_ns, self.last));
    }

    fn measure(&mut self, now_ns: u64) -> Measurement {
        let mut measurement = Measurement {
            measured_ns: now_ns,
            sections: self.robot.sections,
            interface: self.interface.code(),
            kind: self.kind.code(),
            bend_rad: self.plant.measure_bends(),
            cable_length_m: self.plant.measure_cables(),
            ..Measurement::default()
        };
        match self.trouble {
            Trouble::Frozen => {
                measurement.bend_rad = self.last.bend_rad;
                measurement.cable_length_m = self.last.cable_length_m;
            }
            Trouble::Jumps(beside_rad) => {
                measurement.bend_rad[0] += beside_rad;
                measurement.cable_length_m[0] += beside_rad * 0.01;
            }
            Trouble::NotFinite => {
                measurement.bend_rad[0] = f64::NAN;
                measurement.cable_length_m[0] = f64::NAN;
            }
            _ => {}
        }
        let bends = &measurement.bend_rad[..2 * self.robot.sections as usize];
        let bends = Configuration::from_slice(bends).unwrap();
        measurement.tip_position_m = robot_of(&self.robot).tip_position(&bends).into();
        measurement
    }

    /// The measurements that have arrived.
    pub(super) fn arrived(&mut self, now_ns: u64) -> impl Iterator<Item = Measurement> {
        let is_here = |(at_ns, _): &(u64, Measurement)| *at_ns <= now_ns;
        let (here, under_way): (VecDeque<_>, _) = self.under_way.drain(..).partition(is_here);
        self.under_way = under_way;
        here.into_iter().map(|(_, measurement)| measurement)
    }

    /// The motors obey the command for as long as it is valid; motors for positions keep theirs.
    fn move_to(&mut self, now_ns: u64) {
        let order = self.order.filter(|_| self.trouble != Trouble::Stuck);
        let until_ns = order.map_or(self.moved_ns, |command| command.valid_until_ns);
        let obeys_ns = now_ns.min(until_ns).saturating_sub(self.moved_ns);
        let rests_ns = now_ns - self.moved_ns - obeys_ns;
        self.moved_ns = now_ns;
        let [obeying, resting] = match order {
            None => [MotorOrder::Stand; 2],
            Some(command) if self.interface == Interface::Position => {
                [MotorOrder::Lengths(command.cable_length_m); 2]
            }
            Some(command) => [
                MotorOrder::Speeds(command.cable_speed_m_s),
                MotorOrder::Stand,
            ],
        };
        self.plant.advance(&obeying, obeys_ns as f64 * 1e-9);
        self.plant.advance(&resting, rests_ns as f64 * 1e-9);
    }
}

fn draw(dice: &mut Dice) -> Trouble {
    let delay_ns = dice.duration_ms(1, 60).as_nanos() as u64;
    let beside_rad = dice.between(-2.0, 2.0);
    dice.pick(&[
        Trouble::Silent,
        Trouble::Late(delay_ns),
        Trouble::Frozen,
        Trouble::Jumps(beside_rad),
        Trouble::NotFinite,
        Trouble::Stuck,
    ])
}

/// Any shape, now and then one beyond the limits.
fn bend(dice: &mut Dice, robot: &RobotDescription) -> [f64; COORDINATES_MAX] {
    let most_rad = dice.pick(&[0.0, 0.3, 1.0, 2.2]);
    let width = 2 * robot.sections as usize;
    core::array::from_fn(|i| {
        if i < width && most_rad > 0.0 {
            dice.between(-most_rad, most_rad)
        } else {
            0.0
        }
    })
}
