//! A driver that took no command for a time and goes on.

use super::*;

/// The rate of the motion that is missed \[rad/s\].
const RATE_RAD_S: f64 = 0.4;
const STEP_RAD: f64 = RATE_RAD_S * 1e-9 * PERIOD_NS as f64;

/// Target of cycle `cycle` of a motion that is at 0.2 rad in cycle 10 and ends in cycle `last`.
fn moved_rad(cycle: u64, last: u64) -> f64 {
    0.2 + STEP_RAD * (cycle.min(last) - 10) as f64
}

/// A follower without the limit of the cable speed, after cycles 10 to 20 of the motion.
fn moving() -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    follower.robot.cable_speed_max_m_s = 1.0;
    for cycle in 10..=20 {
        take(
            &mut follower,
            &in_mode(Mode::Tracking, cycle, moved_rad(cycle, 99)),
        )
        .unwrap();
    }
    follower
}

// A driver process that hung while the robot was stopped or faulted: the set point went on meanwhile.
#[test]
fn motors_that_missed_commands_stay_in_stopped_and_faulted() {
    for mode in [Mode::Stopped, Mode::Faulted] {
        let mut follower = moving();
        let (stands_rad, stands_m) = sampled_at(&follower, 99.0);
        let far_rad = stands_rad + 0.5;
        for cycle in 100..120 {
            take(&mut follower, &in_mode(mode, cycle, far_rad)).unwrap();
            let (bend_rad, length_m) = sampled_at(&follower, cycle as f64 + 1.0);
            assert!((bend_rad - stands_rad).abs() < 1e-12, "{bend_rad}");
            assert!((length_m - stands_m).abs() < 1e-12, "{length_m}");
        }
        // The reset moves the commanded position to the motors, which stay.
        for cycle in 120..=220 {
            let back_rad = far_rad - 0.005 * (cycle - 120) as f64;
            take(&mut follower, &in_mode(Mode::Holding, cycle, back_rad)).unwrap();
            let (bend_rad, _) = sampled_at(&follower, cycle as f64 + 1.0);
            assert!((bend_rad - stands_rad).abs() < 1e-12, "{bend_rad}");
        }
        // From there they move as the position does.
        take(
            &mut follower,
            &in_mode(Mode::Tracking, 221, stands_rad + STEP_RAD),
        )
        .unwrap();
        let (bend_rad, _) = sampled_at(&follower, 222.0);
        assert!((bend_rad - stands_rad - STEP_RAD).abs() < 1e-12);
    }
}

#[test]
fn a_gap_without_motion_keeps_the_bits_of_the_position() {
    for mode in [Mode::Holding, Mode::Stopped] {
        let first = in_mode(Mode::Holding, 5, 0.1 + 0.2);
        let mut follower = follower(Interface::Position, &[first]);
        for cycle in [10, 30, 60, 61, 90] {
            take(&mut follower, &in_mode(mode, cycle, 0.1 + 0.2)).unwrap();
            assert_eq!(sampled_at(&follower, cycle as f64 + 1.0).0, 0.1 + 0.2);
            assert_eq!(follower.offset(), None);
        }
    }
}

/// Largest speed after a gap of `gap` periods during a motion that ends in cycle `last` \[rad/s\], and the cycle in
/// which the motors have caught up.
fn catch_up(gap: u64, last: u64, follower: &mut CommandFollower) -> (f64, u64) {
    let (mut before, mut fastest) = (sampled_at(follower, 999.0).0, 0.0_f64);
    for cycle in 20 + gap.. {
        let u_rad = moved_rad(cycle, last);
        take(follower, &in_mode(Mode::Tracking, cycle, u_rad)).unwrap();
        for part in 3..=12 {
            let (bend_rad, _) = sampled_at(follower, cycle as f64 + 0.1 * f64::from(part));
            let turn_s = 1e-10 * PERIOD_NS as f64;
            fastest = fastest.max((bend_rad - before).abs() / turn_s);
            before = bend_rad;
        }
        if (sampled_at(follower, cycle as f64 + 1.0).0 - u_rad).abs() < 1e-12 {
            return (fastest, cycle);
        }
        assert!(cycle < 900, "the motors never catch up");
    }
    unreachable!()
}

#[test]
fn motors_catch_up_after_a_gap_at_about_twice_the_commanded_speed() {
    for gap in [4, 6, 10, 50] {
        for last in [999, 20 + gap] {
            let (fastest_rad_s, cycle) = catch_up(gap, last, &mut moving());
            assert!(
                fastest_rad_s < 2.3 * RATE_RAD_S,
                "{gap}: {fastest_rad_s} rad/s"
            );
            assert!(
                cycle <= 20 + 2 * gap + 2,
                "{gap}: caught up in cycle {cycle}"
            );
        }
    }
}

#[test]
fn a_stop_ends_the_catching_up() {
    let mut follower = moving();
    for cycle in 70..75 {
        take(
            &mut follower,
            &in_mode(Mode::Tracking, cycle, moved_rad(cycle, 99)),
        )
        .unwrap();
    }
    let stopped_rad = moved_rad(75, 99);
    take(&mut follower, &in_mode(Mode::Stopped, 75, stopped_rad)).unwrap();
    let stands_rad = sampled_at(&follower, 75.2).0;
    assert!(stopped_rad - stands_rad > 20.0 * STEP_RAD);
    for cycle in 76..200 {
        take(&mut follower, &in_mode(Mode::Stopped, cycle, stopped_rad)).unwrap();
        assert!((sampled_at(&follower, cycle as f64 + 1.0).0 - stands_rad).abs() < 1e-12);
    }
}

/// A bus at 50 Hz: each command comes after the last one has expired.
#[test]
fn a_slow_driver_does_not_fall_behind() {
    let mut follower = moving();
    for cycle in (24..400).step_by(4) {
        let u_rad = moved_rad(cycle, 999);
        take(&mut follower, &in_mode(Mode::Tracking, cycle, u_rad)).unwrap();
        let behind_rad = u_rad - sampled_at(&follower, cycle as f64 + 3.9).0;
        assert!(behind_rad.abs() < 1e-12, "cycle {cycle}: {behind_rad} rad");
    }
}
