//! Wire → domain: validates every message of a client or driver.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::reference::{Interpolation, Orientation, ReferencePoint, TrajectoryError};
use cdcr_controller::robot::{CABLES_MAX, Configuration, Obstacle, Robot, Shape};
use cdcr_controller::safety::Request;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{self, Outcome, RequestKind, UnknownCode};
use cdcr_shared_types::limits::{
    OBSTACLE_AGE_MS_MAX, OBSTACLE_SPEED_M_S_MAX, REFERENCE_AHEAD_S_MAX,
};
use cdcr_shared_types::model;
use nalgebra::{Vector3, Vector4};

use crate::handover::TimedMeasurement;
use crate::obstacles::{KnownObstacle, ObstacleSet};

/// The outcome of a refused message, and the point or obstacle that caused it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    pub outcome: Outcome,
    /// Index of the point, obstacle or value; 0 without one.
    pub detail: u32,
}

impl Refused {
    /// A refusal of the message as a whole.
    pub fn whole(outcome: Outcome) -> Self {
        Self { outcome, detail: 0 }
    }

    pub fn at_index(outcome: Outcome, index: usize) -> Self {
        Self {
            outcome,
            detail: index as u32,
        }
    }
}

/// Tolerance for the length of unit vectors and quaternions.
const UNIT_TOLERANCE: f64 = 1e-6;
/// Distance by which positions may be outside the reachable ball \[m\]: rounding of the straight robot.
const REACH_TOLERANCE_M: f64 = 1e-6;
/// Time by which the clock of a driver or obstacle source may be ahead \[ns\].
const CLOCK_TOLERANCE_NS: u64 = 1_000_000;

/// Largest age of an obstacle that moves \[ns\].
const OBSTACLE_AGE_MAX_NS: u64 = 1_000_000 * OBSTACLE_AGE_MS_MAX as u64;
/// References are at most this far ahead \[ns\].
const AHEAD_MAX_NS: u64 = 1_000_000_000 * REFERENCE_AHEAD_S_MAX as u64;
/// Larger bends \[rad\], lengths or positions \[m\] are not valid measurements.
const MEASURED_MAX: f64 = 1e3;

/// The points of a chunk, all validated: finite, ahead of `now_ns` by at most [`REFERENCE_AHEAD_S_MAX`], inside the reachable
/// ball, with unit orientations. The trajectory checks that their times increase.
pub fn reference_points<'a>(
    chunk: &'a wire::ReferenceChunk,
    robot: &Robot,
    now_ns: u64,
) -> Result<impl Iterator<Item = ReferencePoint> + Clone + 'a, Refused> {
    let interpolation = codes::Interpolation::try_from(chunk.interpolation);
    let interpolation = interpolation
        .map_err(|_| Refused::whole(Outcome::UnknownCode))?
        .into();
    let points = (1..=wire::limits::CHUNK_POINTS_MAX)
        .contains(&(chunk.count as usize))
        .then(|| &chunk.points[..chunk.count as usize])
        .ok_or(Refused::whole(Outcome::CountOutOfRange))?;
    for (index, point) in points.iter().enumerate() {
        reference_point(point, interpolation, robot.reach_m(), now_ns)
            .map_err(|outcome| Refused::at_index(outcome, index))?;
    }
    let reach_m = robot.reach_m();
    Ok(points
        .iter()
        .filter_map(move |point| reference_point(point, interpolation, reach_m, now_ns).ok()))
}

fn reference_point(
    point: &wire::ReferencePoint,
    interpolation: Interpolation,
    reach_m: f64,
    now_ns: u64,
) -> Result<ReferencePoint, Outcome> {
    if point.reserved != 0 {
        return Err(Outcome::UnknownCode);
    }
    let position_m = Vector3::from(point.position_m);
    if !position_m
        .iter()
        .chain(&point.orientation)
        .all(|value| value.is_finite())
    {
        return Err(Outcome::NotFinite);
    }
    if point.time_ns <= now_ns {
        return Err(Outcome::InThePast);
    }
    if point.time_ns - now_ns > AHEAD_MAX_NS {
        return Err(Outcome::OutOfRange);
    }
    if position_m.norm() > reach_m + REACH_TOLERANCE_M {
        return Err(Outcome::OutOfReach);
    }
    Ok(ReferencePoint {
        time_ns: point.time_ns,
        position_m,
        orientation: orientation(point)?,
        interpolation,
    })
}

fn orientation(point: &wire::ReferencePoint) -> Result<Orientation, Outcome> {
    let [x, y, z, w] = point.orientation;
    let kind = codes::OrientationKind::try_from(point.orientation_kind).map_err(unknown_code)?;
    let orientation = model::orientation_of(kind, point.orientation);
    let norm = match orientation {
        Orientation::Free => 1.0,
        Orientation::Axis(_) | Orientation::Preferred(_) => Vector3::new(x, y, z).norm(),
        Orientation::Full(_) => Vector4::new(x, y, z, w).norm(),
    };
    let is_unit = (norm - 1.0).abs() <= UNIT_TOLERANCE;
    is_unit.then_some(orientation).ok_or(Outcome::NotUnit)
}

fn unknown_code(_: UnknownCode) -> Outcome {
    Outcome::UnknownCode
}

/// Converts the reason for which the trajectory rejected points.
pub fn trajectory_refusal(error: &TrajectoryError) -> Refused {
    match error {
        TrajectoryError::TimeNotIncreasing { index } => {
            Refused::at_index(Outcome::TimeNotIncreasing, *index)
        }
        TrajectoryError::Full { .. } => Refused::whole(Outcome::BufferFull),
    }
}

/// Validates a driver's measurement against the robot and the clock.
pub fn measurement(
    message: &wire::Measurement,
    robot: &Robot,
    interface: codes::Interface,
    now_ns: u64,
) -> Result<TimedMeasurement, Refused> {
    if message.reserved != 0 {
        return Err(Refused::whole(Outcome::UnknownCode));
    }
    if message.sections as usize != robot.section_count() {
        return Err(Refused::whole(Outcome::WrongRobot));
    }
    match codes::Interface::try_from(message.interface) {
        Ok(reported) if reported == interface => {}
        Ok(_) => return Err(Refused::whole(Outcome::WrongInterface)),
        Err(_) => return Err(Refused::whole(Outcome::UnknownCode)),
    }
    if message.measured_ns > now_ns + CLOCK_TOLERANCE_NS {
        return Err(Refused::whole(Outcome::InTheFuture));
    }
    let rested_ns = match interface {
        codes::Interface::Velocity => [message.rested_from_ns, message.rested_until_ns],
        // Motors that follow positions make up for a rest.
        _ => [0; 2],
    };
    if rested_ns[1] > now_ns + CLOCK_TOLERANCE_NS {
        return Err(Refused::whole(Outcome::InTheFuture));
    }
    if !rested_ns.is_sorted() {
        return Err(Refused::whole(Outcome::OutOfRange));
    }
    let sane = |values: &[f64]| {
        let refused = |outcome| move |index| Err(Refused::at_index(outcome, index));
        let odd = values.iter().position(|value| !value.is_finite());
        odd.map_or(Ok(()), refused(Outcome::NotFinite))?;
        let far = values.iter().position(|value| value.abs() > MEASURED_MAX);
        far.map_or(Ok(()), refused(Outcome::OutOfRange))
    };
    let measurement = match codes::MeasurementKind::try_from(message.kind) {
        Ok(codes::MeasurementKind::Configuration) => {
            let bends = &message.bend_rad[..robot.coordinate_count()];
            sane(bends)?;
            let configuration = Configuration::from_slice(bends);
            configuration
                .map(Measurement::Configuration)
                .ok_or(Refused::whole(Outcome::WrongRobot))?
        }
        Ok(codes::MeasurementKind::CableLengths) => {
            sane(&message.cable_length_m[..robot.cable_count()])?;
            let mut lengths = [0.0; CABLES_MAX];
            lengths[..robot.cable_count()]
                .copy_from_slice(&message.cable_length_m[..robot.cable_count()]);
            Measurement::CableLengths(lengths)
        }
        Ok(codes::MeasurementKind::TipPose) => {
            sane(&message.tip_position_m)?;
            sane(&message.tip_orientation)?;
            Measurement::TipPosition(Vector3::from(message.tip_position_m))
        }
        Ok(codes::MeasurementKind::None) | Err(_) => {
            return Err(Refused::whole(Outcome::UnknownCode));
        }
    };
    Ok(TimedMeasurement {
        measurement,
        measured_ns: message.measured_ns,
        rested_ns,
    })
}

/// The obstacles known after `update`. If one of them is invalid or does not fit, the whole update is
/// refused.
pub fn updated_obstacles(
    update: &wire::ObstacleUpdate,
    known: &ObstacleSet,
    now_ns: u64,
) -> Result<ObstacleSet, Refused> {
    let action = codes::ObstacleAction::try_from(update.action)
        .map_err(|_| Refused::whole(Outcome::UnknownCode))?;
    let count = update.count as usize;
    let given = update.obstacles.get(..count);
    let given = given.ok_or(Refused::whole(Outcome::CountOutOfRange))?;
    let mut set = *known;
    match action {
        codes::ObstacleAction::Upsert => {
            for (index, message) in given.iter().enumerate() {
                let refused = |outcome| Refused::at_index(outcome, index);
                let obstacle = obstacle(message, now_ns).map_err(refused)?;
                let source = update.header.sender_id;
                set.upsert(KnownObstacle { source, ..obstacle })
                    .map_err(|_| refused(Outcome::BufferFull))?;
            }
        }
        codes::ObstacleAction::Remove => given.iter().for_each(|message| set.remove(message.id)),
        codes::ObstacleAction::Clear => set = ObstacleSet::default(),
    }
    Ok(set)
}

/// One obstacle without its source: finite numbers in range, not measured in the future, not yet expired. One that
/// moves was measured a short time ago: the prediction from an old stamp, or from 0, would place it elsewhere.
pub fn obstacle(message: &wire::Obstacle, now_ns: u64) -> Result<KnownObstacle, Outcome> {
    let velocity_m_s = Vector3::from(message.velocity_m_s);
    let shape = model::shape_of(message).map_err(unknown_code)?;
    let ends = match shape {
        Shape::Sphere { centre_m } => [centre_m; 2],
        Shape::Capsule { start_m, end_m } => [start_m, end_m],
    };
    let finite = ends.iter().flatten().chain(&velocity_m_s);
    if !finite.chain([&message.radius_m]).all(|x| x.is_finite()) {
        return Err(Outcome::NotFinite);
    }
    let is_too_fast = velocity_m_s.norm() > OBSTACLE_SPEED_M_S_MAX as f64;
    if is_too_fast {
        return Err(Outcome::OutOfRange);
    }
    if message.measured_ns > now_ns + CLOCK_TOLERANCE_NS {
        return Err(Outcome::InTheFuture);
    }
    let is_old = now_ns.saturating_sub(message.measured_ns) > OBSTACLE_AGE_MAX_NS;
    if is_old && velocity_m_s != Vector3::zeros() {
        return Err(Outcome::InThePast);
    }
    let expires_ns = message.measured_ns.saturating_add(message.lifetime_ns);
    let known = KnownObstacle {
        id: message.id,
        source: 0,
        obstacle: Obstacle::new(shape, message.radius_m, velocity_m_s)
            .map_err(|_| Outcome::OutOfRange)?,
        measured_ns: message.measured_ns,
        expires_ns: (message.lifetime_ns > 0).then_some(expires_ns),
    };
    if !known.is_known_at(now_ns) {
        return Err(Outcome::InThePast);
    }
    // Its speed may have moved it out of range since its measurement.
    let is_near = known.advanced_to(now_ns).is_some();
    is_near.then_some(known).ok_or(Outcome::OutOfRange)
}

/// [`model::mode_request`] of a client, which accepts the pose by another field than the kind.
pub fn mode_request(kind: RequestKind, accepts_pose: bool, lease_number: u32) -> Option<Request> {
    match kind {
        RequestKind::Reset if accepts_pose => Some(Request::ResetAcceptingPose),
        RequestKind::ResetAcceptingPose => None,
        _ => model::mode_request(kind, lease_number),
    }
}
