//! The examples do what they say: each fails where it does not.

#![allow(
    unreachable_pub,
    reason = "an example is a program, and its main is called from here"
)]

#[path = "../../examples/avoid_an_obstacle.rs"]
mod avoid_an_obstacle;
#[path = "../../examples/track_a_spiral.rs"]
mod track_a_spiral;
#[path = "../../examples/your_own_robot.rs"]
mod your_own_robot;

#[test]
fn the_spiral_is_tracked() {
    track_a_spiral::main().unwrap();
}

#[test]
fn the_obstacle_is_avoided() {
    avoid_an_obstacle::main().unwrap();
}

#[test]
fn another_robot_reaches_its_point() {
    your_own_robot::main().unwrap();
}
