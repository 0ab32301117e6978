//! A robot whose section ends have a speed limit.

use cdcr_controller::robot::{BendRates, Configuration, Robot};

use super::*;
use crate::model::robot_of;

const LIMIT_M_S: f64 = 0.15;
const TURN_NS: u64 = PERIOD_NS / 20;

/// A motion in which all sections turn about the axis of the base: every end has a constant speed.
struct Motion {
    follower: CommandFollower,
    exact: Robot,
    /// Turn of each period \[rad\].
    step_rad: f64,
    /// Cycle in which the motion ends.
    last: u64,
    before: Option<[f64; 6]>,
}

impl Motion {
    /// At `share` of the limit.
    fn new(share: f64) -> Self {
        let mut robot = RobotDescription {
            sections: 3,
            cable_speed_max_m_s: 1.0,
            cable_stroke_max_m: 1.0,
            tip_speed_max_m_s: LIMIT_M_S,
            ..RobotDescription::default()
        };
        for (section, length_m) in robot.section.iter_mut().zip([0.12, 0.1, 0.08]) {
            *section = SectionDescription {
                length_m,
                cable_radius_m: 0.01,
                ..super::robot().section[0]
            };
        }
        let exact = robot_of(&robot).unwrap();
        let (at, quarter) = (bends_rad(0.0), bends_rad(core::f64::consts::FRAC_PI_2));
        let m_rad = fastest_m_s(&exact, &at, &quarter);
        Self {
            follower: CommandFollower::new(&robot, Interface::Position),
            exact,
            step_rad: share * LIMIT_M_S * 1e-9 * PERIOD_NS as f64 / m_rad,
            last: u64::MAX,
            before: None,
        }
    }

    fn commanded(&self, cycle: u64) -> [f64; 6] {
        bends_rad(self.step_rad * cycle.min(self.last) as f64)
    }

    fn take_in(&mut self, mode: Mode, cycle: u64, now_ns: u64) {
        let mut command = Command {
            mode: mode.code(),
            sections: 3,
            ..position(cycle, 0.0)
        };
        command.bend_target_rad[..6].copy_from_slice(&self.commanded(cycle));
        command.cable_length_m = Default::default();
        self.follower.take(&command, now_ns).unwrap();
    }

    fn bends_at(&self, now_ns: u64) -> [f64; 6] {
        let position = self.follower.position_at(now_ns).unwrap();
        core::array::from_fn(|i| position.bend_rad[i])
    }

    /// Cycles `first` to `last`, the commands of which are taken late, and the fastest speed of a section end meanwhile.
    fn run(&mut self, first: u64, last: u64, late_turns: impl Fn(u64) -> u64) -> f64 {
        let mut fastest = 0.0_f64;
        for cycle in first..=last {
            for turn in 0..20 {
                let now_ns = cycle * PERIOD_NS + turn * TURN_NS;
                if turn == late_turns(cycle) {
                    self.take_in(Mode::Tracking, cycle, now_ns);
                }
                if self.follower.sender_id().is_none() {
                    continue;
                }
                let bends = self.bends_at(now_ns);
                if let Some(before) = self.before.replace(bends) {
                    let rates =
                        core::array::from_fn(|i| (bends[i] - before[i]) * 1e9 / TURN_NS as f64);
                    fastest = fastest.max(fastest_m_s(&self.exact, &before, &rates));
                }
            }
        }
        fastest
    }

    /// A driver that takes nothing in `missed` periods after cycle 40, and the fastest speed after that.
    fn hang(&mut self, missed: u64, last: u64) -> f64 {
        self.run(10, 40, |_| 4);
        let goes_on = 41 + missed;
        // It stands by then, or soon: the motion until it goes on is not a speed.
        self.before = None;
        self.run(goes_on, last, |_| 4)
    }
}

fn fastest_m_s(robot: &Robot, bends: &[f64; 6], rates: &[f64; 6]) -> f64 {
    robot.fastest_section_end_m_s(
        &Configuration::from_slice(bends).unwrap(),
        &BendRates::from_slice(rates).unwrap(),
    )
}

fn bends_rad(turn_rad: f64) -> [f64; 6] {
    let vectors = [(0.8, 0.0), (0.5, 0.7), (0.4, -0.4)];
    core::array::from_fn(|i| {
        let (bend_rad, ahead_rad) = vectors[i / 2];
        let (sin, cos) = (turn_rad + ahead_rad).sin_cos();
        bend_rad * if i % 2 == 0 { cos } else { sin }
    })
}

fn distance_rad(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter()
        .zip(b)
        .fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

#[test]
fn no_section_end_exceeds_its_speed_after_a_hang() {
    // Lost commands without a gap, and hangs of 60, 100 and 150 ms.
    for missed in [1, 2, 12, 20, 30] {
        for share in [0.3, 0.5, 0.77, 1.0] {
            let mut motion = Motion::new(share);
            motion.last = 400;
            let fastest_m_s = motion.hang(missed, 600);
            assert!(
                fastest_m_s < 1.01 * LIMIT_M_S,
                "{missed} periods at {share}: {fastest_m_s} m/s"
            );
            assert_eq!(motion.bends_at(u64::MAX), motion.commanded(600));
        }
    }
}

#[test]
fn motors_have_caught_up_after_a_hang_where_the_limit_leaves_room() {
    for (share, cycle) in [(0.5, 41 + 30 + 32), (0.77, 41 + 30 + 105)] {
        let mut motion = Motion::new(share);
        motion.hang(30, cycle);
        let behind_rad = distance_rad(&motion.bends_at(u64::MAX), &motion.commanded(cycle));
        assert!(behind_rad < 1e-12, "{share}: {behind_rad} rad");
    }
}

/// The daemon limits the speed in the estimated shape, so that of the commanded one may be a little larger.
#[test]
fn no_command_at_the_limit_or_a_little_above_it_is_left_behind() {
    for share in [0.7, 0.99, 1.0, 1.05] {
        let mut motion = Motion::new(share);
        for cycle in 10..2000 {
            motion.take_in(Mode::Tracking, cycle, cycle * PERIOD_NS + PERIOD_NS / 5);
            // When the next one is taken; far from the limit at the target time.
            let late_ns = if share < 0.8 { 0 } else { PERIOD_NS / 5 };
            let bends = motion.bends_at((cycle + 1) * PERIOD_NS + late_ns);
            let behind_rad = distance_rad(&bends, &motion.commanded(cycle));
            assert!(
                behind_rad < 1e-5 * motion.step_rad,
                "{share}, cycle {cycle}: {behind_rad}"
            );
        }
        // With delays that change, it is behind by the longest of them at most.
        motion.run(2000, 3000, |cycle| 1 + 7 * cycle % 13);
        let behind_rad = distance_rad(&motion.bends_at(3001 * PERIOD_NS), &motion.commanded(3000));
        assert!(behind_rad < 0.8 * motion.step_rad, "{share}: {behind_rad}");
    }
}

#[test]
fn a_stop_ends_the_catching_up_at_the_limit() {
    let mut motion = Motion::new(0.77);
    motion.hang(30, 80);
    motion.last = 81;
    let now_ns = 81 * PERIOD_NS;
    let stood = motion.bends_at(now_ns);
    assert!(distance_rad(&stood, &motion.commanded(81)) > 10.0 * motion.step_rad);
    for cycle in 81..120 {
        motion.take_in(Mode::Stopped, cycle, cycle * PERIOD_NS);
        let moved_rad = distance_rad(&motion.bends_at((cycle + 1) * PERIOD_NS), &stood);
        assert!(moved_rad < 1e-12, "{moved_rad}");
    }
}

/// Of a daemon that was started again without the limit: `rates_at` and `position_at` keep it.
#[test]
fn commands_far_above_the_limit_are_held_to_it() {
    for (share, is_refused) in [(1.4, false), (1.6, true), (4.0, true)] {
        let mut motion = Motion::new(share);
        let fastest_m_s = motion.run(10, 40, |_| 4);
        let most_m_s = 1.01 * share.min(TIP_SPEED_MARGIN) * LIMIT_M_S;
        assert!(fastest_m_s < most_m_s, "{share}: {fastest_m_s}");
        let mut follower = CommandFollower::new(&motion.follower.robot, Interface::Velocity);
        let [before, after] = [40, 41].map(|cycle| motion.commanded(cycle));
        let mut command = Command {
            sections: 3,
            ..velocity(41, 0.0)
        };
        for i in 0..6 {
            command.bend_target_rad[i] = after[i];
            command.bend_rate_rad_s[i] = (after[i] - before[i]) * 1e9 / PERIOD_NS as f64;
        }
        let taken = follower.take(&command, 41 * PERIOD_NS + 1);
        let is_tip_speed = matches!(taken, Err(CommandRefusal::TipSpeed { .. }));
        assert_eq!(is_tip_speed, is_refused, "{share}: {taken:?}");
    }
}
