mod first;
mod gap;
mod load;
mod rest;
mod takeover;
#[cfg(feature = "model")]
mod tip_speed;
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::{Header, SectionDescription};

use super::*;

const PERIOD_NS: u64 = 5_000_000;
const VALID_NS: u64 = 3 * PERIOD_NS;
const BEND_MAX_RAD: f64 = 2.8;
const RATE_MAX_RAD_S: f64 = 2.0;
const LENGTH_M: f64 = 0.3;
const DAEMON: u64 = 0xda1;
const OTHER: u64 = 0xda2;

/// One section with a cable radius of 12.5 mm.
fn robot() -> RobotDescription {
    let mut robot = RobotDescription {
        sections: 1,
        cable_speed_max_m_s: 0.02,
        cable_stroke_max_m: 0.03,
        ..RobotDescription::default()
    };
    robot.section[0] = SectionDescription {
        length_m: LENGTH_M,
        cable_radius_m: 0.0125,
        bend_max_rad: BEND_MAX_RAD,
        rate_max_rad_s: RATE_MAX_RAD_S,
        ..SectionDescription::default()
    };
    robot
}

/// Cycle `cycle` of a daemon, with the target bend `u_rad` at `rate_rad_s`.
fn command(interface: Interface, cycle: u64, u_rad: f64, rate_rad_s: f64) -> Command {
    let release_ns = cycle * PERIOD_NS;
    let mut command = Command {
        header: Header {
            sender_id: DAEMON,
            sequence: cycle,
            sent_ns: release_ns + 1_000_000,
        },
        cycle,
        release_ns,
        target_ns: release_ns + PERIOD_NS,
        valid_until_ns: release_ns + VALID_NS,
        sections: 1,
        interface: interface.code(),
        ..Command::default()
    };
    (command.bend_target_rad[0], command.bend_rate_rad_s[0]) = (u_rad, rate_rad_s);
    for (cable, part) in [1.0, -0.5, -0.5].into_iter().enumerate() {
        command.cable_length_m[cable] = LENGTH_M - 0.0125 * part * u_rad;
        command.cable_speed_m_s[cable] = -0.0125 * part * rate_rad_s;
    }
    command
}

fn position(cycle: u64, u_rad: f64) -> Command {
    command(Interface::Position, cycle, u_rad, 0.0)
}

fn in_mode(mode: Mode, cycle: u64, u_rad: f64) -> Command {
    Command {
        mode: mode.code(),
        ..position(cycle, u_rad)
    }
}

// A driver restarted while the robot was stopped, beside its commanded position.
#[test]
fn a_first_position_that_is_not_where_the_robot_was_measured_is_refused() {
    let mut of_bends = Measurement {
        kind: MeasurementKind::Configuration.code(),
        ..Measurement::default()
    };
    of_bends.bend_rad[0] = 0.5;
    let mut of_cables = Measurement {
        kind: MeasurementKind::CableLengths.code(),
        ..Measurement::default()
    };
    of_cables.cable_length_m = position(1, 0.5).cable_length_m;
    for measured in [of_bends, of_cables] {
        let mut follower = CommandFollower::new(&robot(), Interface::Position);
        follower.tell_measured(&measured);
        let refused = follower.take(&position(1, 0.0), PERIOD_NS + 1);
        let is_elsewhere = matches!(refused, Err(CommandRefusal::Elsewhere { at: 0, .. }));
        assert!(is_elsewhere, "{refused:?}");
        assert!(follower.position_at(PERIOD_NS).is_none(), "it holds");
        // After the reset, with a deviation due to droop and offset.
        follower
            .take(&position(2, 0.49), 2 * PERIOD_NS + 1)
            .unwrap();
        // Later positions are checked against the speed, not the measurement.
        follower.take(&position(3, 0.8), 3 * PERIOD_NS + 1).unwrap();
    }
}

fn velocity(cycle: u64, rate_rad_s: f64) -> Command {
    command(Interface::Velocity, cycle, 0.0, rate_rad_s)
}

fn sent_by(sender_id: u64, mut command: Command) -> Command {
    command.header.sender_id = sender_id;
    command
}

/// A follower that received `commands`, each one millisecond after its release.
fn follower(interface: Interface, commands: &[Command]) -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), interface);
    for command in commands {
        take(&mut follower, command).unwrap();
    }
    follower
}

fn take(follower: &mut CommandFollower, command: &Command) -> Result<(), CommandRefusal> {
    follower.take(command, command.release_ns + 1_000_000)
}

/// Bend and first cable at a time in periods.
fn sampled_at(follower: &CommandFollower, periods: f64) -> (f64, f64) {
    let now_ns = (periods * PERIOD_NS as f64) as u64;
    let position = follower.position_at(now_ns).unwrap();
    (position.bend_rad[0], position.cable_length_m[0])
}

#[test]
fn speeds_hold_until_they_run_out_and_rest_otherwise() {
    let mut follower = CommandFollower::new(&robot(), Interface::Velocity);
    assert_eq!(follower.rates_at(0), CommandedRates::default());
    assert_eq!(follower.position_at(0), None);
    let command = velocity(10, 1.5);
    take(&mut follower, &command).unwrap();
    let end_ns = 10 * PERIOD_NS + VALID_NS;
    for now_ns in [10 * PERIOD_NS, 11 * PERIOD_NS, end_ns - 1] {
        let rates = follower.rates_at(now_ns);
        assert_eq!(rates.bend_rate_rad_s[0], 1.5);
        assert_eq!(rates.cable_speed_m_s, command.cable_speed_m_s);
    }
    // The last ones are of another clock.
    for now_ns in [end_ns, end_ns + 1, u64::MAX, 0, 7 * PERIOD_NS] {
        assert_eq!(follower.rates_at(now_ns), CommandedRates::default());
    }
}

#[test]
fn a_position_is_reached_at_its_target_time_and_never_passed() {
    let follower = follower(
        Interface::Position,
        &[position(10, 0.2), position(11, 0.206)],
    );
    let (before, after) = (
        (0.2, LENGTH_M - 0.0125 * 0.2),
        (0.206, LENGTH_M - 0.0125 * 0.206),
    );
    assert_eq!(sampled_at(&follower, 11.0), before);
    // Taken at 11.2, 1 ms after its release.
    assert_eq!(sampled_at(&follower, 11.2), before);
    let half = sampled_at(&follower, 11.6);
    assert!((half.0 - 0.203).abs() < 1e-15 && (half.1 - (LENGTH_M - 0.0125 * 0.203)).abs() < 1e-15);
    for periods in [12.0, 13.0, 14.0, 1e6] {
        assert_eq!(sampled_at(&follower, periods), after);
    }
    // Before the release, the position is that of the previous command.
    assert_eq!(sampled_at(&follower, 3.0), before);
    let mut last = before.0;
    for step in 0..1000 {
        let (bend, _) = sampled_at(&follower, 11.0 + f64::from(step) * 1e-3);
        assert!((last..=after.0).contains(&bend));
        last = bend;
    }
}

#[test]
fn a_first_position_is_taken_as_it_is() {
    let follower = follower(Interface::Position, &[position(10, 0.2)]);
    for periods in [0.0, 10.0, 10.3, 11.0, 99.0] {
        assert_eq!(sampled_at(&follower, periods).0, 0.2);
    }
}

#[test]
fn a_resting_position_keeps_its_bits() {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    let mut rest = position(10, 0.1 + 0.2);
    rest.bend_target_rad[1] = -0.0;
    for cycle in 10..1000 {
        rest.header.sequence = cycle;
        rest.cycle = cycle;
        rest.release_ns = cycle * PERIOD_NS;
        rest.target_ns = rest.release_ns + PERIOD_NS;
        rest.valid_until_ns = rest.release_ns + VALID_NS;
        take(&mut follower, &rest).unwrap();
        let position = follower
            .position_at(rest.release_ns + cycle * 7919 % PERIOD_NS)
            .unwrap();
        assert_eq!(
            position.bend_rad.map(f64::to_bits),
            rest.bend_target_rad.map(f64::to_bits)
        );
        assert_eq!(position.cable_length_m, rest.cable_length_m);
    }
}

#[test]
fn a_position_that_runs_out_on_its_way_stays_where_it_is() {
    let mut short = position(11, 0.206);
    short.valid_until_ns = short.release_ns + PERIOD_NS * 3 / 5;
    let follower = follower(Interface::Position, &[position(10, 0.2), short]);
    let half = sampled_at(&follower, 11.6);
    assert!((half.0 - 0.203).abs() < 1e-15);
    for periods in [11.7, 12.0, 20.0] {
        assert_eq!(sampled_at(&follower, periods), half);
    }
}

#[test]
fn lost_commands_make_no_move_faster_than_the_robot() {
    // The bend rate limits one robot, the cable speed the other: 20 mm/s are 1.6 rad/s at 12.5 mm.
    for (cable_speed_max_m_s, fastest_rad_s) in [(1.0, RATE_MAX_RAD_S), (0.02, 1.6)] {
        let mut follower = CommandFollower::new(&robot(), Interface::Position);
        follower.robot.cable_speed_max_m_s = cable_speed_max_m_s;
        take(&mut follower, &position(10, 0.2)).unwrap();
        // Of ten commands at the largest rate, all but the last are lost.
        let end_rad = 0.2 + 0.05 * fastest_rad_s;
        take(&mut follower, &position(20, end_rad)).unwrap();
        let period_s = 1e-9 * PERIOD_NS as f64;
        let step_rad = 0.1 * period_s * fastest_rad_s;
        let mut last = 0.2;
        for step in 0..300 {
            let bend = sampled_at(&follower, 20.0 + 0.1 * f64::from(step)).0;
            assert!(bend >= last && bend - last <= step_rad * 1.000_01);
            last = bend;
        }
        // The command was taken at 20.2 and expired during the move; the next one continues from there.
        assert!((last - 0.2 - 2.8 * period_s * fastest_rad_s).abs() < 1e-6);
        take(&mut follower, &position(24, end_rad)).unwrap();
        assert_eq!(sampled_at(&follower, 24.0).0, last);
        for cycle in 25..36 {
            take(&mut follower, &position(cycle, end_rad)).unwrap();
        }
        assert_eq!(sampled_at(&follower, 40.0).0, end_rad);
    }
}

/// Of a daemon that stalls: each command arrives with another delay, and is partly over then.
#[test]
fn late_commands_make_no_move_faster_than_the_robot() {
    const TURN_NS: u64 = PERIOD_NS / 10;
    for rate_rad_s in [RATE_MAX_RAD_S, 0.7 * RATE_MAX_RAD_S] {
        let mut follower = CommandFollower::new(&robot(), Interface::Position);
        follower.robot.cable_speed_max_m_s = 1.0;
        let step_rad = rate_rad_s * 1e-9 * PERIOD_NS as f64;
        // The robot comes to rest in time to be caught up with.
        let goal = |cycle: u64| 0.2 + step_rad * (cycle.min(17) - 10) as f64;
        let most_rad = RATE_MAX_RAD_S * 1e-9 * TURN_NS as f64 * 1.001;
        let mut last: Option<f64> = None;
        // Turns of the driver from the release until the command arrives.
        let delays = (10..).zip([1, 3, 9, 2, 19, 7, 27, 12, 1, 1]);
        let mut waiting: Vec<_> = delays
            .map(|(cycle, turns)| (cycle * PERIOD_NS + turns * TURN_NS, cycle))
            .collect();
        for turn in 101..260 {
            let now_ns = turn * TURN_NS;
            let due = waiting.iter().position(|(at_ns, _)| *at_ns == now_ns);
            if let Some(due) = due {
                let (_, cycle) = waiting.remove(due);
                // One that was overtaken is refused.
                let _ = follower.take(&position(cycle, goal(cycle)), now_ns);
            }
            let bend = follower.position_at(now_ns).unwrap().bend_rad[0];
            let way = last.map_or(0.0, |last| bend - last);
            assert!((0.0..=most_rad).contains(&way), "turn {turn}: {way}");
            last = Some(bend);
        }
        assert!((last.unwrap() - goal(19)).abs() < 1e-12);
    }
}

#[test]
fn a_refused_command_changes_nothing_and_is_counted() {
    let good = velocity(10, 1.0);
    let mut follower = follower(Interface::Velocity, &[good]);
    let now_ns = 11 * PERIOD_NS;
    let refuse = |command: Command| {
        let mut follower = follower.clone();
        let refusal = follower.take(&command, now_ns).unwrap_err();
        assert_eq!(follower.refusals(), 1);
        assert_eq!(follower.rates_at(now_ns).bend_rate_rad_s[0], 1.0);
        refusal
    };
    let next = velocity(11, 0.5);
    let with = |change: fn(&mut Command)| {
        let mut command = next;
        change(&mut command);
        command
    };
    let not_finite = with(|next| next.bend_target_rad[3] = f64::NAN);
    assert_eq!(refuse(not_finite), CommandRefusal::NotFinite);
    let repeated_header = Command {
        header: good.header,
        ..next
    };
    for (bad, text) in [
        (
            with(|next| next.sections = 2),
            "for 2 sections, but this robot has 1",
        ),
        (
            with(|next| next.interface = 2),
            "commands by the interface position, but this driver follows the interface velocity",
        ),
        (with(|next| next.interface = 77), "77"),
        (
            with(|next| next.target_ns = next.release_ns - 7),
            "7 ns before its release",
        ),
        (with(|next| next.cycle = 10), "not newer"),
        (with(|next| next.release_ns = 10 * PERIOD_NS), "not newer"),
        (repeated_header, "not newer"),
        (good, "not newer"),
        (
            with(|next| next.valid_until_ns = 11 * PERIOD_NS),
            "0 ns after it had expired",
        ),
        (
            with(|next| next.valid_until_ns = 11 * PERIOD_NS - 9),
            "9 ns after it had expired",
        ),
        (sent_by(OTHER, next), "a second daemon"),
        (velocity(11, 2.1), "bend at 2.1 rad/s, the limit is 2"),
        (velocity(11, -2.1), "bend at -2.1 rad/s"),
        (
            velocity(11, 1.7),
            "cable 0 is commanded at -0.02125 m/s, the limit is 0.02",
        ),
    ] {
        let refusal = refuse(bad).to_string();
        assert!(refusal.contains(text), "{text}: {refusal}");
    }
    follower.take(&next, now_ns).unwrap();
    assert_eq!(
        (follower.refusals(), follower.sender_id()),
        (0, Some(DAEMON))
    );
    assert_eq!(follower.rates_at(now_ns).bend_rate_rad_s[0], 0.5);
}

#[test]
fn each_interface_is_held_to_its_own_limits() {
    // Rates that a position driver ignores, positions that a velocity driver ignores.
    let mut fast = position(10, 0.1);
    fast.bend_rate_rad_s[0] = 50.0;
    follower(Interface::Position, &[fast]);
    let mut far = velocity(10, 0.1);
    far.bend_target_rad[0] = 50.0;
    follower(Interface::Velocity, &[far]);
}

#[test]
fn a_position_beyond_a_limit_is_followed_only_on_its_way_back() {
    let mut bent = CommandFollower::new(&robot(), Interface::Position);
    bent.robot.cable_stroke_max_m = 1.0;
    let refusal = take(&mut bent, &position(10, 2.9)).unwrap_err();
    assert!(
        matches!(refusal, CommandRefusal::Bend { section: 0, .. }),
        "{refusal}"
    );
    assert_eq!(bent.position_at(u64::MAX), None);
    // The position at which the daemon holds a robot measured slightly beyond its limit.
    take(&mut bent, &position(11, 2.84)).unwrap();
    take(&mut bent, &position(12, 2.86)).unwrap_err();
    take(&mut bent, &position(13, 2.83)).unwrap();
    // From now on the robot is beyond its limits.
    bent.robot.section[0].bend_max_rad = 2.0;
    take(&mut bent, &position(14, 2.84)).unwrap_err();
    take(&mut bent, &position(15, 2.82)).unwrap();

    let mut pulled = CommandFollower::new(&robot(), Interface::Position);
    let refusal = take(&mut pulled, &position(10, -2.6)).unwrap_err();
    let (limit_m, cable) = (0.03, 0);
    assert!(
        matches!(refusal, CommandRefusal::Stroke { cable: c, limit_m: l, stroke_m } if c == cable && l == limit_m && stroke_m > limit_m),
        "{refusal}"
    );
    take(&mut pulled, &position(11, -2.4)).unwrap();
}

/// Of the motors, not of the positions from which they are distant.
#[test]
fn loaded_motors_stay_inside_their_limits() {
    let mut follower = takeover::taken_over(2.8);
    let outwards = |u_rad| sent_by(OTHER, position(30, u_rad));
    let refusal = take(&mut follower, &outwards(2.36)).unwrap_err();
    assert!(
        matches!(refusal, CommandRefusal::Bend { section: 0, bend_rad, .. } if bend_rad > 2.85),
        "{refusal}"
    );
    take(&mut follower, &outwards(2.34)).unwrap();
    // No daemon begins beyond a limit or at no number.
    for wrong in [3.5, 1e300, f64::NAN] {
        take(&mut follower, &sent_by(OTHER + 1, position(60, wrong))).unwrap_err();
    }
}

#[test]
fn a_forgotten_command_is_rest() {
    for interface in [Interface::Velocity, Interface::Position] {
        let mut follower = follower(interface, &[command(interface, 10, 0.1, 1.0)]);
        follower.forget();
        assert_eq!(follower.rates_at(10 * PERIOD_NS), CommandedRates::default());
        assert_eq!(follower.position_at(10 * PERIOD_NS), None);
        take(&mut follower, &command(interface, 11, 0.5, 1.0)).unwrap();
        assert_eq!(sampled_at(&follower, 11.0).0, 0.5);
    }
}
