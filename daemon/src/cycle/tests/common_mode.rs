//! A section's three cables together: what no bend explains.

use cdcr_controller::plant::{MisbehavingRobot, MotorOrder, Preset};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use cdcr_controller::safety::{CommonModeWatch, Mode, Reason, Request};

use super::trial::Trial;
use crate::config::{Config, Interface};

const COMMON: Mode = Mode::Faulted {
    reason: Reason::CommonMode,
};

/// How far these cables have drifted from what the encoders said when control began, at 0.1 mm a cycle, when the robot faulted \[mm\]; after 20 mm: none.
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

/// One cable by 9 mm where 3 mm are allowed, or all three of a section by 10: a fault with a reason of its own. All three move no bend, so nothing else sees them.
#[test]
fn cables_that_no_bend_explains_are_a_fault() {
    let lenient = "[safety]\nfollowing_fault_rad = 3.0\ncable_common_m = 0.003\n";
    for interface in [Interface::Position, Interface::Velocity] {
        for (cables, from_mm, more) in [
            (&[4][..], 9.0, lenient),
            (&[3, 4, 5], 10.0, ""),
            (&[0, 1, 2], 10.0, ""),
        ] {
            let mut trial = Trial::with(interface, Preset::Laboratory.flaws(), more);
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
            // After a reset it counts from there.
            trial.turns(20);
            let after = trial.ask(Request::Reset);
            assert!(matches!(after.mode, Mode::Holding { .. }));
            assert!(matches!(trial.turns(50).mode, Mode::Holding { .. }));
        }
        let mut off = Trial::with(
            interface,
            Preset::Laboratory.flaws(),
            "[safety]\ncable_common_m = 0.0\n",
        );
        off.turns(5);
        assert_eq!(drift_mm(&mut off, &[3, 4, 5]), None);
    }
}

/// A cable that runs off its drum, 0.1 mm a cycle, is a fault with the defaults, too: whichever check sees it first.
#[test]
fn a_broken_cable_is_a_fault_with_the_defaults() {
    for interface in [Interface::Position, Interface::Velocity] {
        let mut trial = Trial::with(interface, Preset::Laboratory.flaws(), "");
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

/// Every simulated robot, bent to its limits in every direction, with one cable of three 3° beside where it should be.
#[test]
fn bends_are_no_broken_cable() {
    const OFF_RAD: f64 = 0.052;
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let most_m = Config::default().safety.cable_common_m;
    for preset in Preset::ALL {
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
            // The sum of the bends of the sections that a cable passes, times its radius, times how far its cosine is off.
            for section in 0..3 {
                let radius_m = robot.sections()[section].cable_radius_m;
                let off = (turn_rad - OFF_RAD).cos() - turn_rad.cos();
                lengths_m[3 * section] -= radius_m * (section + 1) as f64 * bend_rad * off;
            }
            assert!(!watch.is_broken(&robot, &lengths_m), "{preset:?}, {step}");
        }
    }
}
