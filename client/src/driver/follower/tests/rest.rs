//! The rest of motors that obey speeds, which the driver states.

use super::*;

const MS: u64 = 1_000_000;

/// Commands of the cycles 10 and 11, each taken 1 ms after its release: the last one runs out at 70 ms.
fn moving() -> CommandFollower {
    follower(
        Interface::Velocity,
        &[10, 11].map(|cycle| velocity(cycle, 1.0)),
    )
}

#[test]
fn nothing_is_stated_before_the_first_command_has_run_out() {
    let mut follower = CommandFollower::new(&robot(), Interface::Velocity);
    assert_eq!(follower.rest_ns(40 * MS), 0..0);
    take(&mut follower, &velocity(10, 1.0)).unwrap();
    assert_eq!(follower.rest_ns(60 * MS), 0..0);
}

#[test]
fn motors_rest_from_the_end_of_a_command_to_the_next_one() {
    let mut follower = moving();
    assert_eq!(follower.rest_ns(70 * MS), 0..0);
    // Times of the commands: each is obeyed 1 ms after its release.
    assert_eq!(follower.rest_ns(80 * MS), 69 * MS..79 * MS);
    // The daemon has sent commands all the time. The oldest valid one ends the rest.
    for cycle in [18, 19, 20] {
        follower.take(&velocity(cycle, 1.0), 101 * MS).unwrap();
        assert_eq!(follower.rest_ns(102 * MS), 69 * MS..100 * MS);
    }
    // It is stated until the next one.
    take(&mut follower, &velocity(21, 1.0)).unwrap();
    assert_eq!(follower.rest_ns(110 * MS), 69 * MS..100 * MS);
    assert_eq!(follower.rest_ns(130 * MS), 119 * MS..129 * MS);
}

#[test]
fn a_short_rest_soon_after_a_long_one_is_part_of_it() {
    let mut follower = moving();
    // It is valid until 105 ms, and obeyed 11 ms after its release.
    follower.take(&velocity(18, 1.0), 101 * MS).unwrap();
    assert_eq!(follower.rest_ns(106 * MS), 69 * MS..100 * MS);
    assert_eq!(follower.rest_ns(115 * MS), 69 * MS..104 * MS);
}

/// Each command is taken 12 ms after its release, and runs out 3 ms later.
#[test]
fn motors_that_always_obey_late_do_not_state_one_rest_without_end() {
    let mut follower = moving();
    for cycle in 12..40 {
        let taken_ns = (5 * cycle + 12) * MS;
        follower.take(&velocity(cycle, 1.0), taken_ns).unwrap();
        let rest_ns = follower.rest_ns(taken_ns + 4 * MS);
        assert!(rest_ns.end - rest_ns.start < 10 * MS, "{rest_ns:?}");
    }
}

#[test]
fn a_refused_command_ends_no_rest_and_its_reason_is_kept() {
    let mut follower = moving();
    assert_eq!(follower.last_refusal(), None);
    let refusal = follower.take(&velocity(15, 9.0), 80 * MS).unwrap_err();
    assert_eq!(follower.last_refusal(), Some(refusal));
    assert_eq!(follower.rest_ns(80 * MS), 69 * MS..79 * MS);
}

#[test]
fn a_driver_that_forgets_states_nothing() {
    let mut follower = moving();
    assert_eq!(follower.rest_ns(80 * MS), 69 * MS..79 * MS);
    follower.forget();
    assert_eq!(follower.rest_ns(85 * MS), 0..0);
    take(&mut follower, &velocity(20, 1.0)).unwrap();
    assert_eq!(follower.rest_ns(105 * MS), 0..0);
}
