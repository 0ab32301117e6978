//! Writes a closed loop as CSV with all digits of every number: for plots, and for programs in other languages that
//! must reproduce it.
//!
//! ```sh
//! cargo run --release -p cdcr-controller -- laboratory > loop.csv
//! ```

use std::error::Error;
use std::fmt::Write as _;
use std::io::{self, Write as _};

use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, RateWeight};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::reference::{Interpolation, Orientation, ReferencePoint, Trajectory};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};

const PERIOD_NS: u64 = 5_000_000;
const PERIOD_S: f64 = 0.005;
const CYCLES: u64 = 400;

/// Prints the closed loop of the robot named by the first argument; without one, of the ideal robot.
fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1).unwrap_or("ideal".to_owned());
    let preset = RobotPreset::ALL
        .into_iter()
        .find(|preset| preset.name() == name);
    let csv = csv(preset.ok_or_else(|| format!("there is no robot {name:?}"))?)?;
    Ok(io::stdout().write_all(csv.as_bytes())?)
}

/// One row for each period: the reference, then bends, rates, tip and error of the robot after it.
///
/// # Errors
/// None for the paper's robot and the default settings.
pub fn csv(preset: RobotPreset) -> Result<String, Box<dyn Error>> {
    let robot = Robot::new(&RobotParameters::paper(3))?;
    let is_ideal = preset.flaws() == Flaws::default();
    let settings = NmpcSettings {
        rate_weight: RateWeight::auto(is_ideal),
        ..NmpcSettings::default()
    };
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;
    let start = Configuration::from_bend_angles(&[[0.0; 2], [0.3, 0.0], [0.4, 0.0]]);
    // Points as from a client; the daemon interpolates between them.
    let points: Vec<_> = (0..=CYCLES + 2).map(|cycle| point(&robot, cycle)).collect();
    let mut trajectory = Trajectory::with_capacity(points.len(), f64::INFINITY);
    trajectory.replace(points.iter().copied())?;
    let reference_at = |time_s: f64| trajectory.sample((time_s * 1e9).round() as u64);
    let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &[], reference_at)?;
    if !is_ideal {
        closed = closed.with_acceleration(40.0).with_driven(driven(preset))?;
    }

    let mut csv = String::from("time_s,x_m,y_m,z_m,");
    for quantity in ["bend_rad", "rate_rad_s"] {
        (0..6).try_for_each(|i| write!(csv, "{quantity}_{i},"))?;
    }
    csv.push_str("tip_x_m,tip_y_m,tip_z_m,error_m\n");
    for point in points.iter().skip(1).take(CYCLES as usize) {
        closed.step(&mut nmpc);
        let tip_m = closed.tip_m();
        let numbers = [&[closed.time_s()], point.position_m.as_slice()].concat();
        let state = [
            closed.configuration().as_slice(),
            closed.command().rates.as_slice(),
        ]
        .concat();
        let outcome = [tip_m.as_slice(), &[closed.error_m()]].concat();
        let row: Vec<_> = [numbers, state, outcome].concat();
        let row: Vec<_> = row.iter().map(|number| format!("{number:e}")).collect();
        writeln!(csv, "{}", row.join(","))?;
    }
    Ok(csv)
}

/// A curve within reach of the last two sections.
fn point(robot: &Robot, cycle: u64) -> ReferencePoint {
    let turn_rad = 0.5 * cycle as f64 * PERIOD_S;
    let bends = Configuration::from_bend_angles(&[[0.0; 2], [0.3, turn_rad], [0.4, -turn_rad]]);
    ReferencePoint {
        time_ns: cycle * PERIOD_NS,
        position_m: robot.tip_position(&bends),
        orientation: Orientation::Free,
        interpolation: Interpolation::Cubic,
    }
}

/// As in a daemon whose configuration does not set the motors.
fn driven(preset: RobotPreset) -> Driven {
    Driven {
        flaws: preset.flaws(),
        actuator: Actuator::IDEAL,
        time_constant_s: 0.18,
        obeys_positions: false,
        sensor: if preset.measures_tip() {
            Sensor::Tip { every: 1 }
        } else {
            Sensor::Cables
        },
        without: None,
        seed: 1,
    }
}
