//! Common mode of a section's three cables: length changes that no bend explains.

use cdcr_controller::plant::{MisbehavingRobot, MotorOrder, RobotPreset};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use cdcr_controller::safety::{CommonModeWatch, Mode, Reason, Request};

use super::trial::Trial;
use crate::config::{Config, Interface};

const COMMON: Mode = Mode::Faulted {
    reason: Reason::CommonMode,
};

/// Lets the measured lengths of `cables` drift by 0.1 mm per cycle, up to 20 mm. Returns the drift at the
/// fault \[mm\].
fn drift_mm(trial: &mut Trial, cables: &[usize]) -> Option<f64> {
    (1..=200)
        .map(f64::from)
        .map(|tenths| 0.1 * tenths)
        .find(|mm| {
            for cable in cables {
                trial.cable_error_m[*cable] = 1e-3 * mm;
            }
            trial.turn().mode == COMMON
        })
}

/// A drift of 9 mm of one cable with a limit of 3 mm, or of 10 mm of all three of a section, is a fault with
/// its own reason. A common drift moves no bend, so no other check finds it.
#[test]
fn cables_that_no_bend_explains_are_a_fault() {
    let lenient = "[safety]\nfollowing_fault_rad = 3.0\ncable_common_m = 0.003\n";
    for interface in [Interface::Position, Interface::Velocity] {
        for (cables, from_mm, more) in [
            (&[4][..], 9.0, lenient),
            (&[3, 4, 5], 10.0, ""),
            (&[0, 1, 2], 10.0, ""),
        ] {
            let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), more);
            trial.turns(5);
            trial.begin_tracking();
            assert!(matches!(trial.turns(200).mode, Mode::Tracking { .. }));
            let mm = drift_mm(&mut trial, cables).unwrap();
            assert!(
                (from_mm - 0.2..=from_mm + 0.4).contains(&mm),
                "{cables:?}: {mm} mm"
            );
            if cables.len() < 3 {
                continue; // Its bends are wrong, too.
            }
            // After a reset the drift counts from zero.
            trial.turns(20);
            let after = trial.ask(Request::Reset);
            assert!(matches!(after.mode, Mode::Holding { .. }));
            assert!(matches!(trial.turns(50).mode, Mode::Holding { .. }));
        }
        let mut off = Trial::with(
            interface,
            RobotPreset::Laboratory.flaws(),
            "[safety]\ncable_common_m = 0.0\n",
        );
        off.turns(5);
        assert_eq!(drift_mm(&mut off, &[3, 4, 5]), None);
    }
}

/// A cable that runs off its drum by 0.1 mm per cycle is a fault with the defaults, by whichever check finds
/// it first.
#[test]
fn a_broken_cable_is_a_fault_with_the_defaults() {
    for interface in [Interface::Position, Interface::Velocity] {
        let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), "");
        trial.turns(5);
        trial.begin_tracking();
        trial.turns(200);
        let is_fault = (1..=400).any(|tenths| {
            trial.cable_error_m[4] = 1e-4 * f64::from(tenths);
            matches!(trial.turn().mode, Mode::Faulted { .. })
        });
        assert!(is_fault, "{interface:?}");
    }
}

/// Every simulated robot, bent to its limits in every direction, with one of three cables placed 3° off.
#[test]
fn bends_are_no_broken_cable() {
    const OFF_RAD: f64 = 0.052;
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let most_m = Config::default().safety.cable_common_m;
    for preset in RobotPreset::ALL {
        let straight = Configuration::straight(3);
        let mut plant = MisbehavingRobot::new(&robot, &straight, preset.flaws(), 7).unwrap();
        let mut watch = CommonModeWatch::new(most_m);
        for step in 0..=2000 {
            let turn_rad = 0.05 * f64::from(step);
            let bend_rad = 2.8 * (f64::from(step) / 500.0).min(1.0);
            let bends = Configuration::from_bend_angles(&[[bend_rad, turn_rad]; 3]);
            plant.order(MotorOrder::Lengths(robot.cable_lengths(&bends)));
            plant.advance(0.005);
            let mut lengths_m = plant.measure_cables().unwrap();
            // Error: the sum of the bends of the sections that a cable passes, times its radius, times the
            // error of its cosine.
            for section in 0..3 {
                let radius_m = robot.sections()[section].cable_radius_m;
                let off = (turn_rad - OFF_RAD).cos() - turn_rad.cos();
                lengths_m[3 * section] -= radius_m * (section + 1) as f64 * bend_rad * off;
            }
            assert!(!watch.is_broken(&robot, &lengths_m), "{preset:?}, {step}");
        }
    }
}
