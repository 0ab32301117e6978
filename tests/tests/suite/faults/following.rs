//! A robot that does not follow its commands.

use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_shared_types::Command;
use cdcr_shared_types::codes::{Interface, Mode, Outcome, Reason, RequestKind};
use cdcr_tests::record::largest;
use cdcr_tests::{Daemon, ask_for, refused, reset_here, wait_until};

use crate::faults::robot::{Robot, behind_both, is_held_by_a_stall};
use crate::faults::trail::{Trail, assert_ramps_to_rest, is};

/// Speed limit of every motor: a hundredth of the commanded speed during homing.
const HELD_M_S: f64 = 1e-4;
/// Default of `safety.following_fault_rad` \[rad\].
const FAULT_RAD: f64 = 0.3;
/// A commanded position within this distance of the robot does not move to it \[rad\].
const BESIDE_RAD: f64 = 0.05;

#[test]
fn a_robot_that_does_not_follow_is_a_fault() {
    behind_both(|interface| {
        let daemon = Daemon::start(&format!(
            "[link]\nkind = \"driver\"\ninterface = \"{interface}\"\nmeasurement_timeout_ms = 5000.0\n\
             [motion]\ndeceleration_rad_s2 = 5.0\n[cycle]\nmiss_limit = 1000000\n"
        ));
        let connection = daemon.connect();
        let held = Flaws {
            motor_speed_max_m_s: HELD_M_S,
            ..RobotPreset::Laboratory.flaws()
        };
        let mut trail = Trail::new(&connection);
        let mut robot = Robot::with_flaws(&connection, 1.0, held);
        robot.until_held(&mut trail);
        ask_for(&connection, RequestKind::Home);
        let turn = || robot.turn();
        let (_, now) = trail.until_while("the fault", turn, |record| {
            record.mode == Mode::Faulted.code() || is_held_by_a_stall(record)
        });
        if is_held_by_a_stall(&now) {
            return None;
        }
        assert_eq!(now.reason, Reason::FollowingError.code());
        println!(
            "{interface}: faulted at a following error of {:.3} rad",
            largest(&now.following_error_rad)
        );
        let place = "rad from its command";
        wait_until("the log names it", || daemon.log().contains(place));
        assert_ramps_to_rest(&mut trail, &now, || robot.turn());
        // What its driver sees: position-controlled motors push on, by all of the error.
        let distance_rad = |command: &Command, bend_rad: &[f64; 12]| {
            largest(&core::array::from_fn::<_, 12, _>(|i| {
                command.bend_target_rad[i] - bend_rad[i]
            }))
        };
        let command = robot.last_command().expect("a command");
        assert_eq!(command.mode, Mode::Faulted.code());
        let pushed_rad = distance_rad(&command, &robot.sensed_rad());
        println!("{interface}: pushed on by {pushed_rad:.3} rad");
        assert!(
            interface == Interface::Velocity || pushed_rad > FAULT_RAD,
            "{pushed_rad}"
        );
        // Control begins at the present position, if a person accepts it.
        let outcome = refused(&connection, RequestKind::Reset);
        assert_eq!(outcome, Outcome::PoseDiffers);
        reset_here(&connection);
        trail.until_while("holding", || robot.turn(), is(Mode::Holding));
        trail.until_while(
            "led to the robot",
            || robot.turn(),
            |record| distance_rad(&record.command, &record.measurement.bend_rad) < BESIDE_RAD,
        );
        Some(())
    });
}
