//! The driver of a run, and its faults.

use std::collections::VecDeque;

use cdcr_controller::plant::{Flaws, MisbehavingRobot, MotorOrder};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::{Command, Measurement};

use crate::chaos::dice::Dice;

/// A temporary fault.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    None,
    Silent,
    /// Delay of the measurements \[ns\].
    Late(u64),
    Frozen,
    /// Offset of a measured bend \[rad\].
    Jumps(f64),
    NotFinite,
    /// The motors do not move.
    Stuck,
}

/// A driver of one of the simulated robots.
#[derive(Debug)]
pub(super) struct Driver {
    robot: Robot,
    interface: Interface,
    kind: MeasurementKind,
    /// Whether it measures the tip, too.
    has_tip_sensor: bool,
    flaws: Flaws,
    is_mild: bool,
    plant: MisbehavingRobot,
    command: Option<Command>,
    trouble: Trouble,
    trouble_ends_ns: u64,
    moved_ns: u64,
    under_way: VecDeque<(u64, Measurement)>,
    last: Measurement,
}

impl Driver {
    pub(super) fn new(dice: &mut Dice, robot: &Robot, interface: Interface, now_ns: u64) -> Self {
        let is_mild = dice.chance(50);
        let flaws = dice.flaws(is_mild);
        let kinds = [
            MeasurementKind::Configuration,
            MeasurementKind::CableLengths,
            MeasurementKind::TipPose,
        ];
        Self {
            plant: bent(dice, robot, flaws),
            kind: dice.pick(&kinds),
            has_tip_sensor: dice.chance(50),
            robot: robot.clone(),
            interface,
            flaws,
            is_mild,
            command: None,
            // Some drivers start late.
            trouble: Trouble::Silent,
            trouble_ends_ns: now_ns + dice.duration_ms(0, 100).as_nanos() as u64,
            moved_ns: now_ns,
            under_way: VecDeque::new(),
            last: Measurement::default(),
        }
    }

    /// Whether its robot has only the flaws of a preset, so that it can be expected to follow.
    pub(super) fn is_mild(&self) -> bool {
        self.is_mild
    }

    /// Takes a received command.
    pub(super) fn take(&mut self, command: &Command, now_ns: u64) {
        self.move_to(now_ns);
        self.command = Some(*command);
    }

    /// Bends the robot by external force.
    pub(super) fn push(&mut self, dice: &mut Dice) {
        self.plant = bent(dice, &self.robot, self.flaws);
    }

    /// Advances to `now_ns` and measures.
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
        let tip = MeasurementKind::TipPose;
        let kinds = [Some(self.kind), self.has_tip_beside().then_some(tip)];
        for kind in kinds.into_iter().flatten() {
            if let Some(measurement) = self.measure(kind, now_ns) {
                self.under_way.push_back((now_ns + delay_ns, measurement));
            }
        }
    }

    /// Whether it measures the tip in addition to bends or cables.
    pub(super) fn has_tip_beside(&self) -> bool {
        self.has_tip_sensor && self.kind != MeasurementKind::TipPose
    }

    /// `None`: the sensor has no value now.
    fn measure(&mut self, kind: MeasurementKind, now_ns: u64) -> Option<Measurement> {
        // Fields without a value keep their defaults.
        let mut measurement = Measurement {
            measured_ns: now_ns,
            sections: self.robot.section_count() as u32,
            interface: self.interface.code(),
            kind: kind.code(),
            ..self.last
        };
        if kind == MeasurementKind::TipPose {
            measurement.tip_position_m = self.plant.measure_tip()?.into();
        } else {
            measurement.cable_length_m = self.plant.measure_cables()?;
            let bends = (self.robot).bend_from_cable_lengths(&measurement.cable_length_m);
            measurement.bend_rad[..bends.as_slice().len()].copy_from_slice(bends.as_slice());
        }
        match self.trouble {
            Trouble::Frozen => {
                measurement.bend_rad = self.last.bend_rad;
                measurement.cable_length_m = self.last.cable_length_m;
                measurement.tip_position_m = self.last.tip_position_m;
            }
            Trouble::Jumps(beside_rad) => {
                measurement.bend_rad[0] += beside_rad;
                measurement.cable_length_m[0] += beside_rad * 0.01;
                measurement.tip_position_m[0] += beside_rad * 0.1;
            }
            Trouble::NotFinite => {
                measurement.bend_rad[0] = f64::NAN;
                measurement.cable_length_m[0] = f64::NAN;
                measurement.tip_position_m[0] = f64::NAN;
            }
            _ => {}
        }
        self.last = measurement;
        Some(measurement)
    }

    /// The measurements that have arrived.
    pub(super) fn arrived(&mut self, now_ns: u64) -> impl Iterator<Item = Measurement> {
        let is_here = |(at_ns, _): &(u64, Measurement)| *at_ns <= now_ns;
        let (here, under_way): (VecDeque<_>, _) = self.under_way.drain(..).partition(is_here);
        self.under_way = under_way;
        here.into_iter().map(|(_, measurement)| measurement)
    }

    /// The motors obey the command while it is valid; position motors keep their positions.
    fn move_to(&mut self, now_ns: u64) {
        let command = self.command.filter(|_| self.trouble != Trouble::Stuck);
        let until_ns = command.map_or(self.moved_ns, |command| command.valid_until_ns);
        let obeys_ns = now_ns.min(until_ns).saturating_sub(self.moved_ns);
        let rests_ns = now_ns.saturating_sub(self.moved_ns) - obeys_ns;
        self.moved_ns = now_ns.max(self.moved_ns);
        let [obeying, resting] = match command {
            None => [MotorOrder::Stop; 2],
            Some(command) if self.interface == Interface::Position => {
                [MotorOrder::Lengths(command.cable_length_m); 2]
            }
            Some(command) => [
                MotorOrder::Speeds(command.cable_speed_m_s),
                MotorOrder::Stop,
            ],
        };
        for (order, time_ns) in [(obeying, obeys_ns), (resting, rests_ns)] {
            if time_ns > 0 {
                self.plant.order(order);
                self.plant.advance(time_ns as f64 * 1e-9);
            }
        }
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

/// The robot in any shape, sometimes beyond its limits.
fn bent(dice: &mut Dice, robot: &Robot, flaws: Flaws) -> MisbehavingRobot {
    let most_rad = dice.pick(&[1e-9, 0.3, 1.0, 2.2]);
    let bends = (0..robot.coordinate_count()).map(|_| dice.between(-most_rad, most_rad));
    let at = Configuration::from_slice(&bends.collect::<Vec<_>>()).unwrap();
    MisbehavingRobot::new(robot, &at, flaws, 1).unwrap()
}
