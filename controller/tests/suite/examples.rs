//! The examples run and reach the results that they state.

#![allow(
    unreachable_pub,
    reason = "an example is a program, and its main is called from here"
)]

#[path = "../../examples/avoid_an_obstacle.rs"]
mod avoid_an_obstacle;
#[allow(dead_code, reason = "its table is tested, and its main writes that")]
#[path = "../../programs/closed_loop_csv.rs"]
mod closed_loop_csv;
#[path = "../../examples/one_solve.rs"]
mod one_solve;
#[path = "../../examples/track_a_spiral.rs"]
mod track_a_spiral;
#[path = "../../examples/your_own_robot.rs"]
mod your_own_robot;

use cdcr_controller::plant::RobotPreset;

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

#[test]
fn one_solve_converges() {
    one_solve::main().unwrap();
}

/// Runs are bit-identical. The ideal robot is on the reference, the laboratory robot within some millimetres.
#[test]
fn a_closed_loop_is_written_to_the_bit() {
    for (preset, error_m) in [(RobotPreset::Ideal, 1e-9), (RobotPreset::Laboratory, 5e-3)] {
        let csv = closed_loop_csv::csv(preset).unwrap();
        assert_eq!(csv, closed_loop_csv::csv(preset).unwrap());
        let last = csv.lines().last().unwrap();
        let numbers: Vec<f64> = last
            .split(',')
            .map(|number| number.parse().unwrap())
            .collect();
        assert_eq!((csv.lines().count(), numbers.len()), (401, 20));
        assert!(numbers[19] < error_m, "{preset:?}: {:e} m", numbers[19]);
    }
}
