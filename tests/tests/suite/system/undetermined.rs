//! Recordings that do not determine a robot.

use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use cdcr_tests::Place;

/// A short motion of one section, of motors whose play is not configured: the bounds are as large as the values, and none is
/// printed for the configuration.
#[test]
fn rows_that_determine_nothing_give_nothing_to_paste() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let mut seed = 1_u64;
    let mut noise = move |most_m: f64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        most_m * ((seed >> 33) as f64 / f64::from(1_u32 << 30) - 1.0)
    };
    let mut text = "t_s,".to_owned();
    text.extend((1..=9).map(|cable| format!("cable_{cable}_m,")));
    text.push_str("x_m,y_m,z_m\n");
    for row in 0..500 {
        let angle = 0.02 * f64::from(row);
        let bend_rad = 0.6 * angle.sin();
        let bends = [[bend_rad, 0.3], [0.2, 1.0], [0.4 * bend_rad.abs(), 2.0]];
        let bends = Configuration::from_bend_angles(&bends);
        let play_m = 3e-4 * angle.cos().signum();
        let lengths_m = robot.cable_lengths(&bends);
        let mut numbers = Vec::new();
        for (cable, length_m) in lengths_m[..9].iter().enumerate() {
            let share = if cable % 3 == 0 { 1.0 } else { -0.5 };
            numbers.push(length_m + share * play_m + noise(3e-5));
        }
        for axis_m in &robot.tip_position(&bends) {
            numbers.push(axis_m + noise(5e-4));
        }
        let numbers: Vec<_> = numbers.iter().map(|m| format!("{m:.7}")).collect();
        let row = [format!("{:.2}", 0.02 * f64::from(row)), numbers.join(",")];
        text.push_str(&(row.join(",") + "\n"));
    }
    let place = Place::new();
    place.write("short.csv", &text);
    place.write("robot.toml", "");
    let line = "cdcrctl calibrate geometry short.csv --config robot.toml";
    let parts = [
        "these rows determine no value of the robot",
        "; nothing to paste",
        "bend by up to 0.6",
        "calibrate excite",
        "actuator.play_m",
        "coordinates of the tip exchanged",
    ];
    // Held values do not make a wrong model right.
    for options in ["--format text", "--format json", "--hold base"] {
        let printed = place.checked(&format!("{line} {options}"), 1, &parts);
        for part in ["robot.sections", "--hold base,sensor"] {
            assert!(!printed.contains(part), "{printed}");
        }
    }
    let unknown = [
        "no daemon is running",
        "short.csv names no robot",
        "--config",
    ];
    place.checked("cdcrctl calibrate geometry short.csv", 1, &unknown);
}
