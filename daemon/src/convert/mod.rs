//! Wire ↔ domain. Conversion validates: its results are finite, in range and of a known kind.
//!
//! The pairs that say the same are declared in [`cdcr_shared_types::model`], those of the daemon's own types here. In the
//! daemon, the only module that converts between a wire type and its domain counterpart. What has no counterpart is filled
//! where it is sent: the status by the supervisor, counts and what belongs to the cycle by the reporter.

mod incoming;
mod outgoing;
mod settings;

pub use incoming::{
    Refused, measurement, mode_request, obstacle, reference_points, trajectory_refusal,
    updated_obstacles,
};
pub use outgoing::{
    command, fill_telemetry, position_error_m, reference_position_m, scheduling, telemetry, text,
};
pub use settings::{settings_from_wire, settings_to_wire, with_changes};

use cdcr_shared_types::{measurement_states, robot_links, to_code};

use crate::config::{Interface, LinkKind};
use crate::handover::{MeasurementUse, TipCause};

robot_links!(to_code LinkKind =>);
measurement_states!(to_code MeasurementUse =>);
to_code! {
    Interface => Interface { Velocity, Position }
    TipCause => TipCause { Far, WasFar, Jumps, Jumped, Frozen }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use cdcr_controller::estimator::Measurement;
    use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
    use cdcr_controller::robot::{Configuration, Robot, Shape};
    use cdcr_shared_types as wire;
    use cdcr_shared_types::codes::{self, Outcome};
    use cdcr_shared_types::limits::REFERENCE_AHEAD_S_MAX;
    use nalgebra::Vector3;

    use super::outgoing::{measurement_to_wire, obstacle_to_wire};
    use super::*;
    use crate::handover::{RuntimeSettings, TimedMeasurement};
    use crate::obstacles::ObstacleSet;

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
        let refusals = |points: &[wire::ReferencePoint]| refusal_of(&chunk(points));
        let nan = point(3000, [f64::NAN, 0.0, 0.0]);
        assert_eq!(refusals(&[good, nan]), (Outcome::NotFinite, 1));
        let past = point(100, [0.0; 3]);
        assert_eq!(refusals(&[past]), (Outcome::InThePast, 0));
        let outside = point(3000, [0.0, 0.2, 0.3]);
        assert_eq!(refusals(&[good, outside]), (Outcome::OutOfReach, 1));
        let far = point(
            101 + 1_000_000_000 * REFERENCE_AHEAD_S_MAX as u64,
            [0.0, 0.0, 0.3],
        );
        assert_eq!(refusals(&[far]), (Outcome::OutOfRange, 0));
        assert_eq!(refusals(&[]), (Outcome::CountOutOfRange, 0));
        let mut axis = good;
        axis.orientation_kind = codes::OrientationKind::Axis.code();
        axis.orientation = [0.0, 0.0, 0.5, 0.0];
        assert_eq!(refusals(&[axis]), (Outcome::NotUnit, 0));
        axis.orientation_kind = 7;
        assert_eq!(refusals(&[axis]), (Outcome::UnknownCode, 0));
        let mut whole = chunk(&[good]);
        whole.interpolation = 9;
        assert_eq!(refusal_of(&whole), (Outcome::UnknownCode, 0));
        (whole.interpolation, whole.count) = (0, 129);
        assert_eq!(refusal_of(&whole), (Outcome::CountOutOfRange, 0));
    }

    #[test]
    fn settings_round_trip_and_unsupported_ones_are_refused() {
        const PERIOD_NS: u64 = 5_000_000;
        let nmpc = NmpcSettings {
            solver: SolverKind::Kpso,
            seed: 99,
            rate_weight: 1e-6.into(),
            ..Default::default()
        };
        let settings = RuntimeSettings {
            nmpc,
            budget_ns: 400_000,
        };
        assert_eq!(
            settings_from_wire(&settings_to_wire(&settings), PERIOD_NS),
            Ok(settings)
        );
        let with = |change: fn(&mut wire::SolverSettings)| {
            let mut message = settings_to_wire(&settings);
            change(&mut message);
            settings_from_wire(&message, PERIOD_NS)
        };
        let refused = |change| with(change).expect_err("it is wrong");
        assert!(with(|m| m.budget_ns = PERIOD_NS).is_ok());
        let out_of_range = Outcome::OutOfRange;
        assert_eq!(refused(|m| m.budget_ns = PERIOD_NS + 1), out_of_range);
        assert_eq!(refused(|m| m.safe_distance_m = f64::NAN), out_of_range);
        assert_eq!(refused(|m| m.swarm_size = 0), out_of_range);
        assert_eq!(refused(|m| m.inertia = f64::NAN), out_of_range);
        assert_eq!(refused(|m| m.reserved = 1), Outcome::UnknownCode);
        assert_eq!(refused(|m| m.coordinates = 9), Outcome::UnknownCode);
        assert_eq!(refused(|m| m.solver = 77), Outcome::UnknownCode);
    }

    fn ball(id: u32) -> wire::Obstacle {
        wire::Obstacle {
            id,
            start_m: [0.1, 0.0, 0.3],
            end_m: [f64::NAN; 3],
            radius_m: 0.02,
            measured_ns: 1_000,
            ..Default::default()
        }
    }

    fn update(action: codes::ObstacleAction, given: &[wire::Obstacle]) -> wire::ObstacleUpdate {
        let mut update = wire::ObstacleUpdate {
            action: action.code(),
            count: given.len() as u32,
            ..Default::default()
        };
        update.obstacles[..given.len()].copy_from_slice(given);
        update
    }

    #[test]
    fn obstacles_come_and_go_by_their_ids() {
        use codes::ObstacleAction::{Clear, Remove, Upsert};
        let mut set = ObstacleSet::default();
        for (action, ids, count) in [
            (Upsert, &[1, 2, 3][..], 3),
            (Upsert, &[3, 4], 4),
            (Remove, &[1, 4, 99], 2),
            (Upsert, &[], 2),
            (Clear, &[], 0),
        ] {
            let given: Vec<_> = ids.iter().map(|id| ball(*id)).collect();
            set = updated_obstacles(&update(action, &given), &set, 2_000).unwrap();
            assert_eq!(set.count(), count, "{action}");
        }
    }

    #[test]
    fn every_kind_of_bad_obstacle_is_refused_with_its_place() {
        let upsert = codes::ObstacleAction::Upsert;
        let refusal = |update: &wire::ObstacleUpdate, known: &ObstacleSet| {
            let refused = updated_obstacles(update, known, 2_000).expect_err("it is wrong");
            (refused.outcome, refused.detail)
        };
        let none = ObstacleSet::default();
        let bad = |change: fn(&mut wire::Obstacle)| {
            let mut wrong = ball(2);
            change(&mut wrong);
            refusal(&update(upsert, &[ball(1), wrong]), &none)
        };
        let not_finite = (Outcome::NotFinite, 1);
        let capsule = |o: &mut wire::Obstacle| o.shape = codes::ObstacleShape::Capsule.code();
        assert_eq!(bad(capsule), not_finite);
        assert_eq!(bad(|o| o.radius_m = f64::NAN), not_finite);
        assert_eq!(bad(|o| o.start_m[2] = f64::INFINITY), not_finite);
        assert_eq!(bad(|o| o.velocity_m_s[0] = f64::NAN), not_finite);
        let out_of_range = (Outcome::OutOfRange, 1);
        let gone = |o: &mut wire::Obstacle| (o.start_m[0], o.velocity_m_s[0]) = (1e6, 50.0);
        assert_eq!(bad(gone), out_of_range);
        assert_eq!(bad(|o| o.velocity_m_s = [60.0, 0.0, 81.0]), out_of_range);
        assert_eq!(bad(|o| o.radius_m = -0.01), out_of_range);
        assert_eq!(bad(|o| o.start_m[0] = 1e7), out_of_range);
        let future = (Outcome::InTheFuture, 1);
        assert_eq!(bad(|o| o.measured_ns = 10_000_000), future);
        assert_eq!(bad(|o| o.measured_ns = u64::MAX), future);
        assert_eq!(bad(|o| o.lifetime_ns = 1_000), (Outcome::InThePast, 1));
        assert_eq!(bad(|o| o.shape = 2), (Outcome::UnknownCode, 1));
        let mut many = update(upsert, &[]);
        many.count = 65;
        assert_eq!(refusal(&many, &none), (Outcome::CountOutOfRange, 0));
        many.action = 3;
        assert_eq!(refusal(&many, &none), (Outcome::UnknownCode, 0));
        let all: Vec<_> = (0..64).map(ball).collect();
        let full = updated_obstacles(&update(upsert, &all), &none, 2_000).unwrap();
        let one_more = update(upsert, &[ball(5), ball(64)]);
        assert_eq!(refusal(&one_more, &full), (Outcome::BufferFull, 1));
    }

    /// The prediction to the present would move it by its velocity times its age.
    #[test]
    fn an_obstacle_that_moves_is_refused_with_an_old_or_unset_stamp() {
        const NOW_NS: u64 = 2_460_000_000_000;
        let taken = |velocity_m_s: f64, age_ns: u64, lifetime_ns: u64| {
            let moving = wire::Obstacle {
                velocity_m_s: [velocity_m_s, 0.0, 0.0],
                measured_ns: NOW_NS - age_ns,
                lifetime_ns,
                ..ball(1)
            };
            obstacle(&moving, NOW_NS).map(|known| known.advanced_to(NOW_NS).unwrap().obstacle)
        };
        for age_ns in [NOW_NS, 600_000_000_000, 1_000_000_001] {
            assert_eq!(taken(0.01, age_ns, 0), Err(Outcome::InThePast));
            assert_eq!(taken(0.01, age_ns, u64::MAX), Err(Outcome::InThePast));
            // One that stands is where it was measured.
            assert!(taken(0.0, age_ns, 0).is_ok());
        }
        let moved = taken(0.01, 1_000_000_000, 0).unwrap();
        let centre_m = Vector3::new(0.11, 0.0, 0.3);
        assert_eq!(*moved.shape(), Shape::Sphere { centre_m });
    }

    #[test]
    fn obstacles_round_trip() {
        let mut capsule = wire::Obstacle {
            shape: codes::ObstacleShape::Capsule.code(),
            end_m: [0.2, 0.1, 0.3],
            velocity_m_s: [0.1, 0.0, -0.2],
            lifetime_ns: 5_000,
            ..ball(7)
        };
        let known = obstacle(&capsule, 2_000).unwrap();
        assert_eq!(obstacle_to_wire(&known), capsule);
        capsule.lifetime_ns = 0;
        let known = obstacle(&capsule, 2_000).unwrap();
        assert_eq!(obstacle_to_wire(&known), capsule);
    }

    #[test]
    fn measurements_are_checked_against_robot_and_clock() {
        let good = wire::Measurement {
            kind: codes::MeasurementKind::Configuration.code(),
            sections: 1,
            interface: codes::Interface::Position.code(),
            measured_ns: 90,
            ..Default::default()
        };
        let with = |change: fn(&mut wire::Measurement)| {
            let mut message = good;
            change(&mut message);
            let taken = measurement(&message, &trunk(), codes::Interface::Position, 100);
            taken.map(drop).map_err(|refused| refused.outcome)
        };
        assert_eq!(with(|_| ()), Ok(()));
        let tip = |m: &mut wire::Measurement| m.kind = codes::MeasurementKind::TipPose.code();
        assert_eq!(with(tip), Ok(()));
        let turned = |m: &mut wire::Measurement| {
            m.kind = codes::MeasurementKind::TipPose.code();
            m.tip_orientation[3] = f64::NAN;
        };
        assert_eq!(with(turned), Err(Outcome::NotFinite));
        let infinite = with(|m| m.bend_rad[1] = f64::INFINITY);
        assert_eq!(infinite, Err(Outcome::NotFinite));
        assert_eq!(with(|m| m.sections = 2), Err(Outcome::WrongRobot));
        let future = with(|m| m.measured_ns = 10_000_000);
        assert_eq!(future, Err(Outcome::InTheFuture));
        assert_eq!(with(|m| m.reserved = 1), Err(Outcome::UnknownCode));
        assert_eq!(with(|m| m.kind = 0), Err(Outcome::UnknownCode));
        let speeds = with(|m| m.interface = codes::Interface::Velocity.code());
        assert_eq!(speeds, Err(Outcome::WrongInterface));
    }

    #[test]
    fn a_stated_rest_is_checked_where_speeds_are_obeyed_and_else_ignored() {
        let stated = |interface: codes::Interface, rested_ns: [u64; 2]| {
            let message = wire::Measurement {
                kind: codes::MeasurementKind::Configuration.code(),
                sections: 1,
                interface: interface.code(),
                measured_ns: 90,
                rested_from_ns: rested_ns[0],
                rested_until_ns: rested_ns[1],
                ..Default::default()
            };
            let taken = measurement(&message, &trunk(), interface, 100);
            taken
                .map(|timed| timed.rested_ns)
                .map_err(|refused| refused.outcome)
        };
        for (rested_ns, of_speeds) in [
            ([70, 80], Ok([70, 80])),
            ([80, 70], Err(Outcome::OutOfRange)),
            ([70, 10_000_000], Err(Outcome::InTheFuture)),
        ] {
            assert_eq!(stated(codes::Interface::Velocity, rested_ns), of_speeds);
            assert_eq!(stated(codes::Interface::Position, rested_ns), Ok([0; 2]));
        }
    }

    #[test]
    fn measurements_round_trip() {
        let configuration = Configuration::from_slice(&[0.1, -0.2]).unwrap();
        let lengths = trunk().cable_lengths(&configuration);
        for measurement_in in [
            Measurement::Configuration(configuration),
            Measurement::CableLengths(lengths),
            Measurement::TipPosition(Vector3::new(0.1, 0.2, 0.3)),
        ] {
            let timed = TimedMeasurement {
                measurement: measurement_in,
                measured_ns: 90,
                rested_ns: [70, 80],
            };
            let mut sent = measurement_to_wire(&timed, &trunk());
            let interface = codes::Interface::Velocity;
            sent.interface = interface.code();
            assert_eq!(measurement(&sent, &trunk(), interface, 100), Ok(timed));
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
