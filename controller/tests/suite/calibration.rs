//! Calibration identifies the geometry of a simulated robot from its encoders and a tip sensor.

use std::collections::BTreeMap;

use cdcr_controller::calibration::{
    Calibration, CalibrationError, CalibrationRow, HeldReason, Parameter, ParameterGroup,
    behind_play, calibrate,
};
use cdcr_controller::plant::{Flaws, MisbehavingRobot, MotorOrder, RobotPreset};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::exciting_path::ExcitingPath;

/// Time between two rows (s).
const ROW_S: f64 = 0.02;

/// A robot that differs from its configuration.
struct Trial {
    configured: RobotParameters,
    truth: RobotParameters,
    /// Zero offset of the first cable of each section (m).
    offset_m: f64,
    /// Play between motors and cables (m).
    play_m: f64,
    base: Isometry3<f64>,
    sensor: Isometry3<f64>,
    measures_rotation: bool,
    rows: Vec<CalibrationRow>,
}

impl Trial {
    /// A trial with a recording of this duration (s).
    fn recorded(seed: u64, sections: usize, duration_s: f64) -> Self {
        let mut trial = Self::new(seed, sections);
        trial.record(seed, duration_s);
        trial
    }

    /// Lengths and cable radii differ by 5 %, angles by 3°, zeros by 2 mm; motors and noise of the
    /// `laboratory`.
    fn new(seed: u64, sections: usize) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let configured = RobotParameters::paper(sections);
        let mut truth = configured.clone();
        for section in &mut truth.sections {
            let mut off = |most: f64| {
                let sign = if random.random_range(0.0..1.0) < 0.5 {
                    -1.0
                } else {
                    1.0
                };
                sign * most
            };
            section.length_m *= 1.0 + off(0.05);
            section.cable_offset_rad += off(3_f64.to_radians());
            section.cable_radius_m *= 1.0 + off(0.05);
        }
        Self {
            configured,
            truth,
            offset_m: 2e-3,
            play_m: 0.0,
            base: Isometry3::identity(),
            sensor: Isometry3::identity(),
            measures_rotation: false,
            rows: Vec::new(),
        }
    }

    /// Records a motion along an exciting path with position motors.
    fn record(&mut self, seed: u64, duration_s: f64) {
        let model = Robot::new(&self.configured).unwrap();
        let mut flaws = Flaws {
            offset_m: self.offset_m,
            ..RobotPreset::Laboratory.flaws()
        };
        if self.play_m > 0.0 {
            flaws.actuator.play_m = self.play_m;
        }
        let straight = Configuration::straight(model.section_count());
        let mut plant = MisbehavingRobot::new(&model, &straight, flaws, seed)
            .unwrap()
            .with_truth(Robot::new(&self.truth).unwrap());
        let path = ExcitingPath::new(&model, 0.5, 0.3, duration_s);
        for row in 0..(duration_s / ROW_S) as u32 {
            let goal = path.bends(f64::from(row) * ROW_S);
            plant.order(MotorOrder::Lengths(model.cable_lengths(&goal)));
            plant.advance(ROW_S);
            let cable_length_m = plant.measure_cables().unwrap();
            let noise_m = plant.measure_tip().unwrap() - plant.tip_m();
            let seen = plant.truth().tip_pose(&plant.configuration());
            let turn = UnitQuaternion::from_matrix(&seen.rotation);
            let placed =
                self.base * Isometry3::from_parts(seen.position_m.into(), turn) * self.sensor;
            self.rows.push(CalibrationRow {
                cable_length_m,
                tip_position_m: placed.translation.vector + noise_m,
                tip_rotation: self.measures_rotation.then_some(placed.rotation),
            });
        }
    }

    fn calibrate(&self, hold: &[ParameterGroup]) -> Calibration {
        calibrate(&self.configured, &self.rows, hold).unwrap()
    }

    fn truth_of(&self, parameter: Parameter) -> f64 {
        let section = |j: usize| &self.truth.sections[j];
        match parameter {
            Parameter::Length(j) => section(j).length_m,
            Parameter::CableRadius(j) => section(j).cable_radius_m,
            Parameter::CableAngle(j) => section(j).cable_offset_rad,
            Parameter::BasePosition(axis) => self.base.translation.vector[axis],
            Parameter::BaseRotation(axis) => self.base.rotation.scaled_axis()[axis],
            Parameter::SensorPosition(axis) => self.sensor.translation.vector[axis],
            Parameter::SensorRotation(axis) => self.sensor.rotation.scaled_axis()[axis],
            Parameter::CableZero(..) => f64::NAN,
        }
    }
}

/// Accuracy: lengths and radii 0.2 %, zeros 0.05 mm, angles 0.2°; the true values lie inside the stated 95 %
/// intervals.
#[test]
fn lengths_radii_zeros_and_angles_are_found_and_the_bounds_are_honest() {
    let seeds = crate::number("CDCR_CALIBRATION_SEEDS", crate::repetitions(1, 4).into());
    let mut worst = [0.0_f64; 4];
    let mut inside = BTreeMap::<String, u64>::new();
    for seed in 1..=seeds {
        let trial = Trial::recorded(seed, 3, 60.0);
        let found = trial.calibrate(&[]);
        if seed == 1 {
            check_held(&found);
        }
        let mut count = |name: String, off: f64, within: f64| {
            *inside.entry(name).or_default() += u64::from(off <= within);
        };
        for estimate in &found.estimates {
            let truth = trial.truth_of(estimate.parameter);
            let off = (estimate.value - truth).abs();
            count(estimate.parameter.to_string(), off, estimate.within);
            match estimate.parameter {
                Parameter::Length(_) => worst[0] = worst[0].max(100.0 * off / truth),
                Parameter::CableRadius(_) => worst[3] = worst[3].max(100.0 * off / truth),
                Parameter::CableAngle(_) => worst[2] = worst[2].max(off.to_degrees()),
                _ => {}
            }
        }
        for (j, zeros) in found.cable_zeros.iter().enumerate() {
            for (cable, (zero_m, within_m)) in zeros.iter().enumerate() {
                // Relative to their mean.
                let truth_m = trial.offset_m * if cable == 0 { 2.0 / 3.0 } else { -1.0 / 3.0 };
                let off_m = (zero_m - truth_m).abs();
                worst[1] = worst[1].max(1e3 * off_m);
                count(format!("zero {j} {cable}"), off_m, *within_m);
            }
        }
    }
    println!(
        "lengths {:.4} %, zeros {:.4} mm, angles {:.4}°, radii {:.4} %",
        worst[0], worst[1], worst[2], worst[3]
    );
    println!("inside, of {seeds}: {inside:?}");
    assert!(worst[0] < 0.2, "lengths: {} %", worst[0]);
    assert!(worst[1] < 0.05, "zeros: {} mm", worst[1]);
    assert!(worst[2] < 0.2, "angles: {}°", worst[2]);
    assert!(worst[3] < 0.2, "radii: {} %", worst[3]);
    let (sum, count) = (inside.values().sum::<u64>(), inside.len() as u64);
    assert!(10 * sum >= 9 * seeds * count, "{sum} of {}", seeds * count);
    if seeds >= 100 {
        let worst = inside.values().min().copied().unwrap_or(0);
        assert!(10 * worst >= 9 * seeds, "{inside:?}");
    }
}

/// Encoders are on the motors: half a millimetre of play is as much of the cables' lengths. Known play costs little. With a wrong one
/// the rows determine nothing.
#[test]
fn play_that_is_known_is_taken_from_the_lengths() {
    let mut trial = Trial::new(1, 3);
    trial.play_m = 6e-4;
    trial.record(1, 60.0);
    let worst_mm = |play_m: f64| {
        let rows = behind_play(&trial.rows, play_m);
        assert!(rows.len() > trial.rows.len() - 200, "{}", rows.len());
        let found = calibrate(&trial.configured, &rows, &[]).unwrap();
        let lengths = found.estimates.iter().filter_map(|estimate| {
            let is_length = matches!(estimate.parameter, Parameter::Length(_));
            is_length.then(|| (estimate.value - trial.truth_of(estimate.parameter)).abs())
        });
        (
            1e3 * lengths.fold(0.0, f64::max),
            1e3 * found.after[1].rms_m,
        )
    };
    let right = worst_mm(6e-4);
    println!("length and held-out tip [mm]: {right:?}");
    assert!(right.0 < 0.6 && right.1 < 1.5, "{right:?}");
    for play_m in [0.0, 3e-4] {
        let rows = behind_play(&trial.rows, play_m);
        let wrong = calibrate(&trial.configured, &rows, &[]);
        let Err(CalibrationError::NothingLeft { correlation, .. }) = wrong else {
            panic!("{play_m}: {wrong:?}");
        };
        println!("play {play_m} m: bounds {correlation:.1} times as wide");
        assert!(correlation > 5.0, "{correlation}");
    }
    // Until each cable has moved by it, nobody knows where in its play it is.
    assert_eq!(behind_play(&trial.rows, 0.0), trial.rows);
    assert!(behind_play(&trial.rows, 6e-4).len() < trial.rows.len());
}

/// A motion that was ended early, of cables with a play that is not configured. The bounds include what the rows do not determine, so
/// the true values are inside them.
#[test]
fn no_value_is_offered_that_the_rows_do_not_determine() {
    let mut trial = Trial::new(6, 3);
    trial.play_m = 6e-4;
    trial.record(6, 60.0);
    for seconds in [8.0, 14.0, 60.0] {
        let rows = &trial.rows[..(seconds / ROW_S) as usize];
        for play_m in [0.0, 6e-4] {
            let found = calibrate(&trial.configured, &behind_play(rows, play_m), &[]);
            let is_nothing = matches!(found, Err(CalibrationError::NothingLeft { .. }));
            assert!(is_nothing || found.is_ok(), "{found:?}");
            let estimates = found.map_or_else(|_| Vec::new(), |found| found.estimates);
            println!("{seconds} s, play {play_m} m: {} values", estimates.len());
            for estimate in estimates {
                let truth = trial.truth_of(estimate.parameter);
                let off = (estimate.value - truth).abs();
                assert!(off < 3.0 * estimate.within, "{estimate:?}, truth {truth}");
                let plausible = match estimate.parameter {
                    Parameter::Length(_) | Parameter::CableRadius(_) => 0.1 * estimate.old,
                    Parameter::BasePosition(_) | Parameter::SensorPosition(_) => 0.03,
                    _ => 0.1,
                };
                assert!(estimate.within < 0.4 * plausible, "{estimate:?}");
            }
        }
    }
}

fn held(found: &Calibration) -> Vec<(Parameter, Vec<Parameter>)> {
    let held = found.held.iter().filter_map(|held| match &held.why {
        HeldReason::Undetermined(others) => Some((held.parameter, others.clone())),
        HeldReason::Requested => None,
    });
    held.collect()
}

/// Parameters that positions cannot identify are held and reported.
fn check_held(found: &Calibration) {
    let mut held = held(found);
    held.sort_by_key(|(parameter, _)| parameter.to_string());
    let names: Vec<_> = held.iter().map(|(parameter, _)| *parameter).collect();
    assert_eq!(
        names,
        [Parameter::BaseRotation(2), Parameter::SensorPosition(2)]
    );
    // A rotation of the base equals one of all cables; a sensor on the axis lengthens the last arc.
    assert_eq!(held[0].1, [0, 1, 2].map(Parameter::CableAngle));
    assert_eq!(held[1].1, [Parameter::Length(2), Parameter::CableRadius(2)]);
    // Held parameters stay as configured, except for the rotation about z that two small ones about x and y
    // imply.
    assert!(found.geometry.value(Parameter::BaseRotation(2)).abs() < 1e-6);
    assert_eq!(found.geometry.value(Parameter::SensorPosition(2)), 0.0);
}

#[test]
fn base_and_sensor_are_found_where_the_tip_is_measured_with_its_rotation() {
    let mut trial = Trial::new(2, 2);
    let pose = |position_m: [f64; 3], turn: [f64; 3]| {
        let position_m = Translation3::from(Vector3::from(position_m));
        Isometry3::from_parts(position_m, UnitQuaternion::new(Vector3::from(turn)))
    };
    trial.base = pose([0.01, -0.02, 0.015], [0.03, -0.05, 0.0]);
    trial.sensor = pose([0.004, 0.003, 0.025], [0.02, 0.04, 0.1]);
    trial.measures_rotation = true;
    trial.record(2, 32.0);
    let found = trial.calibrate(&[]);
    // The rotation of the base about z equals one of all cables and of the sensor.
    assert_eq!(held(&found).len(), 1, "{:?}", held(&found));
    for estimate in &found.estimates {
        let truth = trial.truth_of(estimate.parameter);
        let most = match estimate.parameter {
            Parameter::Length(_) => 2e-3 * truth,
            Parameter::CableRadius(_) => 5e-3 * truth,
            Parameter::BasePosition(_) | Parameter::SensorPosition(_) => 5e-4,
            _ => 3e-3,
        };
        let off = (estimate.value - truth).abs();
        assert!(off < most, "{}: {off} of {truth}", estimate.parameter);
    }
    assert!(found.before[1].rms_rad > 0.05 && found.after[1].rms_rad < 5e-3);
}

#[test]
fn rows_that_are_wrong_are_left_out_and_the_rest_is_held_out() {
    let mut trial = Trial::recorded(3, 2, 32.0);
    let clean = trial.calibrate(&[]);
    for row in trial.rows.iter_mut().step_by(40) {
        row.tip_position_m.x += 0.1;
    }
    let wrong = trial.rows.len() / 40;
    let found = trial.calibrate(&[]);
    // A fifth of them is held out, and left out there, too: they do not make a good calibration fail.
    assert!(found.outliers * 10 >= wrong * 7 && found.outliers <= wrong + 5);
    let all = found.outliers + found.outliers_held_out;
    assert!(found.outliers_held_out * 10 >= wrong && all <= wrong + 5);
    assert!(found.after[1].rms_m < 1.1 * clean.after[1].rms_m);
    assert_eq!(clean.outliers_held_out, 0);
    for (found, clean) in found.estimates.iter().zip(&clean.estimates) {
        let apart = (found.value - clean.value).abs();
        assert!(apart < clean.within, "{}: {apart}", found.parameter);
    }
    // The held-out rows are explained as well as the fitted ones.
    let [fitted, held_out] = clean.after;
    assert!(fitted.rows > 3 * held_out.rows && 6 * held_out.rows > trial.rows.len());
    assert!((held_out.rms_m / fitted.rms_m - 1.0).abs() < 0.1);
    assert!(clean.before[1].rms_m > 20.0 * held_out.rms_m);
}

#[test]
fn a_section_that_does_not_move_is_named() {
    let mut trial = Trial::recorded(4, 2, 32.0);
    // The second section's cables follow the bends of the first section.
    let model = Robot::new(&trial.configured).unwrap();
    for row in &mut trial.rows {
        let mut bends = model.bend_from_cable_lengths(&row.cable_length_m);
        bends.as_mut_slice()[2..].fill(0.0);
        row.cable_length_m = model.cable_lengths(&bends);
        row.tip_position_m = Robot::new(&trial.truth).unwrap().tip_position(&bends);
    }
    let found = trial.calibrate(&[]);
    let held: Vec<_> = held(&found).into_iter().map(|(held, _)| held).collect();
    assert!(held.contains(&Parameter::CableRadius(1)), "{held:?}");
}

#[test]
fn rows_without_information_are_refused() {
    let mut trial = Trial::recorded(5, 1, 26.0);
    let few = calibrate(&trial.configured, &trial.rows[..99], &[]);
    assert_eq!(few, Err(CalibrationError::TooFewRows { rows: 99 }));
    let mut rows = trial.rows.clone();
    rows[6].tip_position_m.y = f64::NAN;
    let not_finite = calibrate(&trial.configured, &rows, &[]);
    assert_eq!(not_finite, Err(CalibrationError::NotFinite { row: 7 }));
    rows[6].tip_position_m.y = 0.0;
    rows[3].tip_rotation = Some(UnitQuaternion::identity());
    let mixed = calibrate(&trial.configured, &rows, &[]);
    assert_eq!(mixed, Err(CalibrationError::MixedRotations { row: 4 }));
    let still = vec![trial.rows[0]; 500];
    let still = calibrate(&trial.configured, &still, &[]);
    assert!(matches!(still, Err(CalibrationError::NoMotion { .. })));
    let all = ParameterGroup::ALL;
    let nothing = calibrate(&trial.configured, &trial.rows, &all);
    assert!(matches!(nothing, Err(CalibrationError::NothingLeft { .. })));
    trial.configured.sections[0].length_m = -1.0;
    let none = calibrate(&trial.configured, &trial.rows, &[]);
    assert!(matches!(none, Err(CalibrationError::Robot(_))));
}
