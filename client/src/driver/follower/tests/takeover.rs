//! Another daemon, and another driver of the same robot.

use super::*;

/// Of two drivers of one robot the daemon follows the measurements of one; the other one's motors must rest.
#[test]
fn a_command_for_another_driver_is_refused_by_one_that_measures() {
    const OWN: u64 = 0xd1;
    for interface in [Interface::Velocity, Interface::Position] {
        let of = |cycle, driver_id| Command {
            driver_id,
            ..command(interface, cycle, 0.0, 0.1)
        };
        let mut follower = CommandFollower::new(&robot(), interface);
        let mut take = |command: Command| follower.take(&command, command.release_ns + 1);
        assert_eq!(
            take(of(1, OTHER)),
            Ok(()),
            "a process that measures nothing"
        );
        follower.tell_sender(OWN);
        assert_eq!(follower.rates_at(PERIOD_NS + 1), CommandedRates::default());
        let mut follower = CommandFollower::new(&robot(), interface);
        follower.tell_sender(OWN);
        let mut take = |command: Command| follower.take(&command, command.release_ns + 1);
        let refusal = CommandRefusal::OtherDriver { driver_id: OTHER };
        assert_eq!(take(of(1, OTHER)), Err(refusal));
        assert_eq!(take(of(2, 0)), Ok(()), "no driver is known yet");
        assert_eq!(take(of(3, OWN)), Ok(()));
        assert_eq!(take(of(4, OTHER)), Err(refusal));
        let rests_ns = 4 * PERIOD_NS + VALID_NS;
        assert_eq!(follower.rates_at(rests_ns), CommandedRates::default());
        assert_eq!(follower.refusals(), 2);
    }
}

#[test]
fn another_daemon_is_followed_when_the_old_one_has_run_out() {
    let mut follower = follower(Interface::Position, &[position(10, 0.2)]);
    // Two daemons at once: the second one is refused, whatever its sequence numbers.
    let refusal = take(&mut follower, &sent_by(OTHER, position(11, 0.3))).unwrap_err();
    assert!(matches!(
        refusal,
        CommandRefusal::OtherDaemon {
            sender: OTHER,
            present: DAEMON
        }
    ));
    // A restarted daemon starts its sequence numbers again.
    let mut first = sent_by(OTHER, position(14, 0.201));
    (first.cycle, first.header.sequence) = (0, 1);
    take(&mut follower, &first).unwrap();
    assert_eq!(follower.sender_id(), Some(OTHER));
    assert_eq!(sampled_at(&follower, 14.0).0, 0.2);
    assert!((sampled_at(&follower, 15.0).0 - 0.2).abs() < 1e-15);
    // Queued commands of the old daemon are late.
    let left = take(&mut follower, &position(13, 0.9)).unwrap_err();
    assert!(matches!(left, CommandRefusal::NotNewer { .. }));
}

/// Motors whose robot is bent by 0.5 rad by a load stand at `u_rad`; a restarted daemon sends the measured
/// position for ten periods.
pub(super) fn taken_over(u_rad: f64) -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    follower.robot.cable_speed_max_m_s = 1.0;
    follower.robot.cable_stroke_max_m = 1.0;
    take(&mut follower, &position(10, u_rad)).unwrap();
    for cycle in 20..30 {
        take(&mut follower, &sent_by(OTHER, position(cycle, u_rad - 0.5))).unwrap();
        for part in 0..10 {
            let (bend_rad, length_m) = sampled_at(&follower, cycle as f64 + 0.1 * f64::from(part));
            assert!((bend_rad - u_rad).abs() < 1e-12, "{bend_rad}");
            let first_m = position(cycle, u_rad).cable_length_m[0];
            assert!((length_m - first_m).abs() < 1e-12, "{length_m}");
        }
    }
    follower
}

#[test]
fn a_restarted_daemon_does_not_move_loaded_motors() {
    let mut follower = taken_over(1.2);
    // They move as its positions do, at their distance, and stand still to the bit when these do.
    let mut stood = None;
    for cycle in 30..40 {
        take(&mut follower, &sent_by(OTHER, position(cycle, 0.702))).unwrap();
        let (bend_rad, _) = sampled_at(&follower, cycle as f64 + 1.0);
        assert!((bend_rad - 1.202).abs() < 1e-12, "{bend_rad}");
        assert_eq!(*stood.get_or_insert(bend_rad), bend_rad);
    }
    assert!((follower.offset().unwrap().bend_rad[0] - 0.5).abs() < 1e-12);
    // A daemon that fails again and again, whatever it measures.
    for (number, u_rad) in [(1, 0.6), (2, 0.9), (3, 0.7)] {
        let cycle = 50 + 10 * number;
        take(
            &mut follower,
            &sent_by(OTHER + number, position(cycle, u_rad)),
        )
        .unwrap();
        assert!((sampled_at(&follower, cycle as f64 + 1.0).0 - 1.202).abs() < 1e-12);
    }
    // Motors that were without torque begin at the robot.
    follower.forget();
    assert_eq!(follower.offset(), None);
    take(&mut follower, &sent_by(OTHER + 3, position(90, 0.7))).unwrap();
    assert_eq!(sampled_at(&follower, 91.0).0, 0.7);
}

/// The robot was moved by hand while the daemon was away, and has sprung back to its motors since: after the
/// reset the commanded position moves to them.
#[test]
fn motors_stay_while_the_commanded_position_moves_to_them() {
    let mut follower = taken_over(1.2);
    let holding = |cycle, u_rad| Command {
        mode: Mode::Holding.code(),
        ..sent_by(OTHER, position(cycle, u_rad))
    };
    for step in 0..=100 {
        take(
            &mut follower,
            &holding(30 + step, 0.7 + 0.005 * step as f64),
        )
        .unwrap();
        let (bend_rad, _) = sampled_at(&follower, 31.0 + step as f64);
        assert!((bend_rad - 1.2).abs() < 1e-12, "{bend_rad}");
    }
    // Any other motion moves them, also back.
    for (cycle, u_rad) in [(131, 1.195), (132, 1.19)] {
        take(&mut follower, &sent_by(OTHER, position(cycle, u_rad))).unwrap();
        assert!((sampled_at(&follower, cycle as f64 + 1.0).0 - u_rad).abs() < 1e-12);
    }
}
