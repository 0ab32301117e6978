//! Wire ↔ domain. Converting validates: what comes out of here is finite, in range and of known kind.
//!
//! The only module that knows both a wire type and its domain twin.

mod incoming;
mod outgoing;
mod settings;

pub use incoming::{Refused, measurement, mode_request, reference_points, trajectory_refusal};
pub use outgoing::{command, mode, reason, refusal, robot, telemetry, text};
pub use settings::{settings_from_wire, settings_to_wire};

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use cdcr_controller::estimator::Measurement;
    use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
    use cdcr_controller::robot::{Configuration, Robot};
    use cdcr_shared_types as wire;
    use cdcr_shared_types::codes::{self, Outcome};
    use nalgebra::Vector3;

    use super::outgoing::measurement_to_wire;
    use super::*;
    use crate::ports::TimedMeasurement;

    fn trunk() -> Robot {
        Robot::new(&RobotParameters::paper(1)).unwrap()
    }

    fn chunk(points: &[wire::ReferencePoint]) -> wire::ReferenceChunk {
        let mut chunk = wire::ReferenceChunk {
            count: points.len() as u32,
            ..Default::default()
        };
        chunk.points[..points.len()].copy_from_slice(points);
        chunk
    }

    fn point(time_ns: u64, position_m: [f64; 3]) -> wire::ReferencePoint {
        wire::ReferencePoint {
            time_ns,
            position_m,
            ..Default::default()
        }
    }

    fn refusal_of(chunk: &wire::ReferenceChunk) -> (Outcome, u32) {
        let refused = reference_points(chunk, &trunk(), 100)
            .err()
            .expect("it is wrong");
        (refused.outcome, refused.detail)
    }

    #[test]
    fn every_kind_of_bad_point_is_refused_with_its_place() {
        let good = point(200, [0.0, 0.0, 0.3]);
        assert_eq!(
            reference_points(&chunk(&[good]), &trunk(), 100)
                .ok()
                .map(Iterator::count),
            Some(1)
        );
        let nan = point(300, [f64::NAN, 0.0, 0.0]);
        assert_eq!(refusal_of(&chunk(&[good, nan])), (Outcome::NotFinite, 1));
        assert_eq!(
            refusal_of(&chunk(&[point(100, [0.0; 3])])),
            (Outcome::InThePast, 0)
        );
        assert_eq!(
            refusal_of(&chunk(&[good, point(300, [0.0, 0.2, 0.3])])),
            (Outcome::OutOfReach, 1)
        );
        assert_eq!(
            refusal_of(&chunk(&[good, good])),
            (Outcome::TimeNotIncreasing, 1)
        );
        assert_eq!(refusal_of(&chunk(&[])), (Outcome::CountOutOfRange, 0));
        let many = wire::ReferenceChunk {
            count: 129,
            ..Default::default()
        };
        assert_eq!(refusal_of(&many), (Outcome::CountOutOfRange, 0));
        let odd = wire::ReferenceChunk {
            interpolation: 9,
            ..chunk(&[good])
        };
        assert_eq!(refusal_of(&odd), (Outcome::UnknownCode, 0));
        let axis = wire::ReferencePoint {
            orientation_kind: codes::OrientationKind::Axis.code(),
            orientation: [0.0, 0.0, 0.5, 0.0],
            ..good
        };
        assert_eq!(refusal_of(&chunk(&[axis])), (Outcome::NotUnit, 0));
        let unknown = wire::ReferencePoint {
            orientation_kind: 7,
            ..good
        };
        assert_eq!(refusal_of(&chunk(&[unknown])), (Outcome::UnknownCode, 0));
    }

    #[test]
    fn settings_round_trip_and_unsupported_ones_are_refused() {
        let settings = NmpcSettings {
            solver: SolverKind::Kpso,
            seed: 99,
            ..Default::default()
        };
        assert_eq!(
            settings_from_wire(&settings_to_wire(&settings)),
            Ok(settings)
        );
        let with = |change: fn(&mut wire::SolverSettings)| {
            let mut message = settings_to_wire(&NmpcSettings::default());
            change(&mut message);
            settings_from_wire(&message)
        };
        assert_eq!(
            with(|m| m.orientation_weight = 1.0),
            Err(Outcome::Unsupported)
        );
        assert_eq!(
            with(|m| m.safe_distance_m = f64::NAN),
            Err(Outcome::Unsupported)
        );
        assert_eq!(with(|m| m.solver = 77), Err(Outcome::UnknownCode));
        assert_eq!(with(|m| m.swarm_size = 0), Err(Outcome::OutOfRange));
        assert_eq!(with(|m| m.inertia = f64::NAN), Err(Outcome::OutOfRange));
    }

    #[test]
    fn measurements_are_checked_against_robot_and_clock() {
        let good = wire::Measurement {
            kind: codes::MeasurementKind::Configuration.code(),
            sections: 1,
            measured_ns: 90,
            ..Default::default()
        };
        let outcome =
            |message| measurement(&message, &trunk(), 100).map_err(|refused| refused.outcome);
        assert!(outcome(good).is_ok());
        assert_eq!(
            outcome(wire::Measurement {
                sections: 2,
                ..good
            }),
            Err(Outcome::WrongRobot)
        );
        let future = wire::Measurement {
            measured_ns: 10_000_000,
            ..good
        };
        assert_eq!(outcome(future), Err(Outcome::OutOfRange));
        let mut nan = good;
        nan.bend_rad[1] = f64::INFINITY;
        assert_eq!(outcome(nan), Err(Outcome::NotFinite));
        assert_eq!(
            outcome(wire::Measurement { kind: 0, ..good }),
            Err(Outcome::UnknownCode)
        );
    }

    #[test]
    fn measurements_round_trip() {
        let configuration = Configuration::from_slice(&[0.1, -0.2]).unwrap();
        let lengths = trunk().cable_lengths(configuration.as_slice());
        for measurement_in in [
            Measurement::Configuration(configuration),
            Measurement::CableLengths(lengths),
            Measurement::TipPosition(Vector3::new(0.1, 0.2, 0.3)),
        ] {
            let timed = TimedMeasurement {
                measurement: measurement_in,
                measured_ns: 90,
            };
            let message = measurement_to_wire(&timed, &trunk());
            assert_eq!(measurement(&message, &trunk(), 100), Ok(timed));
        }
    }

    #[test]
    fn text_is_cut_at_a_character() {
        let long = "ä".repeat(40);
        let cut = text(&long);
        assert_eq!(std::str::from_utf8(&cut[..48]), Ok("ä".repeat(24).as_str()));
        assert_eq!(&text("abc")[..4], b"abc\0");
    }
}
