//! A tip sensor whose axes are not those of the base: swapped, mirrored or turned; and one that is late.

use core::iter;

use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::safety::Mode;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::DIRECT;
use super::trial::{PERIOD_S, TRACK, Trial};
use crate::config::Interface;
use crate::handover::{CycleRecord, MeasurementUse, TipCause};

const BEGIN_M: [f64; 3] = [-0.15, 0.02, 0.68];
const ACROSS_M_S: [f64; 3] = [0.1, 0.0, 0.0];

/// A robot of the laboratory at rest at the beginning of the line, with a tip sensor with these axes.
fn at_begin(interface: Interface, axes: Matrix3<f64>) -> Trial {
    let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.measures_tip = true;
    trial.tip_axes = axes;
    trial.turns(300);
    trial.feed_line(BEGIN_M, [0.0; 3], 0.0);
    trial.ask(TRACK);
    trial.turns(400);
    trial
}

/// Largest speed of the tip over 50 ms \[m/s\], and how often three measurements in a row were not used, in so many cycles.
fn observed(trial: &mut Trial, cycles: u32) -> (f64, usize) {
    const STRIDE: usize = 10;
    let (mut tips_m, mut records) = (Vec::new(), Vec::new());
    for _ in 0..cycles {
        let record = trial.turn();
        assert!(matches!(record.mode, Mode::Tracking { .. }));
        records.push(record);
        tips_m.push(trial.tip_m);
    }
    let pairs = iter::zip(&tips_m, &tips_m[STRIDE..]);
    let speeds_m_s = pairs.map(|(from, to)| (to - from).norm() / (STRIDE as f64 * PERIOD_S));
    let is_used = |record: &CycleRecord| record.tip_use == MeasurementUse::Used;
    let given_up = |four: &&[CycleRecord]| is_used(&four[0]) && !four[1..].iter().any(is_used);
    (
        speeds_m_s.fold(0.0, f64::max),
        records.windows(4).filter(given_up).count(),
    )
}

/// The tip is asked to move at 0.1 m/s. Each motion of a tip that is measured along other axes changes its offset, and the
/// offset moves the tip.
#[test]
fn a_tip_that_is_measured_along_other_axes_is_moved_slowly_and_given_up() {
    let turned = |degrees: f64| Rotation3::new(Vector3::z() * degrees.to_radians()).into_inner();
    let frames = [
        (
            "swapped",
            Matrix3::from_columns(&[Vector3::y(), Vector3::x(), Vector3::z()]),
        ),
        (
            "mirrored",
            Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0)),
        ),
        ("turned by 90 degrees", turned(90.0)),
        ("turned by 120 degrees", turned(120.0)),
        ("turned by 180 degrees", turned(180.0)),
    ];
    for interface in [Interface::Position, Interface::Velocity] {
        for (name, axes) in frames {
            for way in ["line", "circle"] {
                let mut trial = at_begin(interface, axes);
                if way == "line" {
                    trial.feed_line(BEGIN_M, ACROSS_M_S, 0.1);
                } else {
                    trial.feed_circle(0.067, 20.0);
                    trial.turns(500);
                }
                let (speed_m_s, lost) = observed(&mut trial, 2000);
                println!("{interface:?}, {name}, {way}: {speed_m_s} m/s, lost {lost} times");
                assert!(speed_m_s < 0.3 && lost < 8, "{name}, {way}: {speed_m_s}");
            }
        }
    }
}

/// A tip with right axes is lost while something holds it too far aside, and is followed again by itself; by another sensor at once.
#[test]
fn a_tip_that_was_lost_is_followed_again_after_a_while() {
    let axes = Matrix3::identity();
    let lost = || {
        let mut trial = at_begin(Interface::Position, axes);
        trial.feed_line(BEGIN_M, ACROSS_M_S, 0.1);
        trial.turns(100);
        trial.tip_error_m = Vector3::new(0.0, 0.12, 0.0);
        assert_eq!(trial.turns(10).tip_unused, Some(TipCause::Far));
        trial.tip_error_m = Vector3::zeros();
        trial
    };
    let mut trial = lost();
    let waits = trial.turns(60);
    assert_eq!(waits.tip_unused, Some(TipCause::WasFar));
    assert!(waits.tip_margin_m < 0.01, "{}", waits.tip_margin_m);
    assert_eq!(trial.turns(10).tip_unused, None);
    let mut other = lost();
    other.inputs.tip_sensors += 1;
    assert_eq!(other.turn().tip_use, MeasurementUse::Used);
}

/// A sensor that publishes each picture twice: the second one changes neither the trust in it nor the cause.
#[test]
fn the_same_bits_again_leave_the_cause_as_it_is() {
    for (aside_m, cause) in [(0.0, None), (0.12, Some(TipCause::Far))] {
        let mut trial = at_begin(Interface::Position, Matrix3::identity());
        trial.feed_line(BEGIN_M, ACROSS_M_S, 0.1);
        trial.turns(100);
        trial.tip_error_m = Vector3::new(0.0, aside_m, 0.0);
        assert_eq!(trial.turns(10).tip_unused, cause);
        let picture_m = trial.plant.tip_m() + trial.tip_error_m;
        trial.frozen_tip_m = Some(picture_m);
        assert_eq!(trial.turn().tip_unused, cause);
        let again = trial.turn();
        assert_eq!(again.tip_use, MeasurementUse::Implausible);
        assert_eq!(again.tip_unused, cause);
    }
}

/// Speed of the tip beside a camera that takes its time to evaluate a picture.
const SPEED_M_S: f64 = 0.15;

/// Largest distance of the true tip from a circle at [`SPEED_M_S`], once the tip offset is learnt \[m\].
fn error_m(interface: Interface, age_cycles: usize) -> f64 {
    let flaws = Flaws {
        length_error: 0.03,
        tip_noise_m: 3e-4,
        ..RobotPreset::Laboratory.flaws()
    };
    let mut trial = Trial::with(interface, flaws, DIRECT);
    trial.measures_tip = true;
    trial.tip_age_cycles = age_cycles;
    trial.turns(300);
    trial.feed_circle(SPEED_M_S / 1.5, 20.0);
    trial.ask(TRACK);
    trial.turns(1500);
    let mut largest_m = 0.0_f64;
    for _ in 0..2000 {
        let record = trial.turn();
        assert_eq!(record.tip_use, MeasurementUse::Used);
        let goal_m = record.reference.position_m;
        largest_m = largest_m.max((trial.tip_m - goal_m).norm());
    }
    println!("{interface:?}, {} ms: {largest_m} m", 5 * age_cycles);
    largest_m
}

#[test]
fn the_age_of_a_tip_is_compensated() {
    for interface in [Interface::Velocity, Interface::Position] {
        let fresh_m = error_m(interface, 0);
        for age_cycles in [12, 30, 60, 100] {
            let old_m = error_m(interface, age_cycles);
            // Of the way of the tip in this time.
            let way_m = SPEED_M_S * PERIOD_S * age_cycles as f64;
            assert!(old_m < fresh_m + 0.06 * way_m, "{old_m}, {fresh_m}");
        }
    }
}
