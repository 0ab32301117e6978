//! Messages and their counterparts in the controller, in both directions from one list (feature `model`).
//!
//! Only codes are checked here. The daemon validates in `daemon/src/convert/`; a client reads what a daemon sent.

use cdcr_controller::nmpc::{self, NmpcSettings, SolveStatus};
use cdcr_controller::optimizer::{self, Candidate};
use cdcr_controller::reference::{self, Orientation};
use cdcr_controller::robot::{self, Robot, RobotError, RobotParameters, SectionParameters, Shape};
use cdcr_controller::safety;
use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};

use crate::codes::{self, ObstacleShape, OrientationKind, RequestKind, UnknownCode};
use crate::{Approach, Obstacle, RobotDescription, SectionDescription, SolverSettings, limits};

/// The controller does not know the wire contract, and has the same limits.
const _: () = {
    assert!(robot::SECTIONS_MAX == limits::SECTIONS_MAX);
    assert!(nmpc::HORIZON_STEPS_MAX == limits::HORIZON_STEPS_MAX);
    assert!(*nmpc::ranges::ITERATIONS.end() == limits::ITERATIONS_MAX as f64);
    assert!(nmpc::CONTROL_BLOCKS_MAX == limits::CONTROL_BLOCKS_MAX);
    assert!(nmpc::PLAN_MAX == limits::PLAN_MAX);
    assert!(nmpc::SWARM_MAX == limits::SWARM_MAX);
    assert!(nmpc::OBSTACLES_MAX == limits::OBSTACLES_MAX);
    assert!(safety::BEND_TOLERANCE_RAD == limits::BEND_TOLERANCE_RAD);
};

/// Generates the code of each value of an enumeration with equal names. A missing variant does not compile.
#[macro_export]
macro_rules! to_code {
    ($($domain:path => $code:ident { $($variant:ident),+ $(,)? })+) => { $(
        impl From<$domain> for $crate::codes::$code {
            fn from(value: $domain) -> Self {
                type Domain = $domain;
                match value { $(Domain::$variant { .. } => Self::$variant,)+ }
            }
        }
    )+ };
}

/// The value of each code, too.
macro_rules! both_ways {
    ($($domain:path => $code:ident { $($variant:ident),+ $(,)? })+) => { $(
        to_code! { $domain => $code { $($variant),+ } }
        impl From<codes::$code> for $domain {
            fn from(code: codes::$code) -> Self {
                match code { $(codes::$code::$variant => Self::$variant,)+ }
            }
        }
    )+ };
}

modes!(to_code safety::Mode =>);
reasons!(both_ways safety::Reason =>);
lease_states!(both_ways safety::LeaseState =>);
reference_states!(both_ways reference::ReferenceState =>);
interpolations!(both_ways reference::Interpolation =>);
solver_kinds!(both_ways nmpc::SolverKind =>);
coordinate_kinds!(both_ways nmpc::Coordinates =>);
velocity_rules!(both_ways optimizer::VelocityRule =>);
solver_statuses!(to_code SolveStatus =>);
winners!(to_code Candidate =>);
to_code! {
    safety::Refusal => Outcome { WrongMode, NoLease, NoReference, TooFar, CauseStands, PoseDiffers, TipElsewhere, Waits, Overruled, Ending }
    nmpc::Constraint => Constraint { Clearance, Limit }
}

/// The mode of a record with its reason.
pub fn mode_of(mode: codes::Mode, reason: safety::Reason) -> safety::Mode {
    match mode {
        codes::Mode::Starting => safety::Mode::Starting,
        codes::Mode::Holding => safety::Mode::Holding { reason },
        codes::Mode::Tracking => safety::Mode::Tracking { begun: false },
        codes::Mode::Homing => safety::Mode::Homing,
        codes::Mode::Stopped => safety::Mode::Stopped { reason },
        codes::Mode::Faulted => safety::Mode::Faulted { reason },
    }
}

/// The request about the mode; `None` for those about lease, settings and statistics. `lease_number` is the
/// number of the reference lease at the time of the request.
pub fn mode_request(kind: RequestKind, lease_number: u32) -> Option<safety::Request> {
    Some(match kind {
        RequestKind::Track => safety::Request::Track { lease_number },
        RequestKind::Hold => safety::Request::Hold,
        RequestKind::Home => safety::Request::Home,
        RequestKind::Stop => safety::Request::Stop,
        RequestKind::Reset => safety::Request::Reset,
        RequestKind::ResetAcceptingPose => safety::Request::ResetAcceptingPose,
        RequestKind::AcquireLease
        | RequestKind::ReleaseLease
        | RequestKind::Settings
        | RequestKind::ResetStatistics => return None,
    })
}

/// [`guard`](codes::guard) bits of a command that limits and guard changed.
pub fn guard_flags(hit: &safety::LimitsHit, clearance_hit: bool) -> u32 {
    let bits = [
        (hit.rate, codes::guard::RATE),
        (hit.bend, codes::guard::BEND),
        (hit.cable_speed, codes::guard::CABLE_SPEED),
        (hit.tip_speed, codes::guard::TIP_SPEED),
        (hit.cable_stroke, codes::guard::CABLE_STROKE),
        (hit.acceleration, codes::guard::ACCELERATION),
        (hit.self_contact, codes::guard::SELF_CONTACT),
        (hit.non_finite, codes::guard::NON_FINITE),
        (clearance_hit, codes::guard::CLEARANCE),
    ];
    let set = bits.iter().filter(|(set, _)| *set);
    set.fold(0, |flags, (_, bit)| flags | bit)
}

/// Generates both conversions of structs with equal fields.
macro_rules! same_fields {
    ($($domain:path = $message:ident { $($field:ident),+ })+) => { $(
        impl From<&$domain> for $message {
            fn from(from: &$domain) -> Self { Self { $($field: from.$field.into()),+ } }
        }
        impl From<&$message> for $domain {
            fn from(from: &$message) -> Self { Self { $($field: from.$field.into()),+ } }
        }
    )+ };
}

same_fields! {
    SectionParameters = SectionDescription { length_m, cable_radius_m, cable_offset_rad, bend_max_rad, rate_max_rad_s, body_radius_m }
    reference::Approach = Approach { begin_ns, duration_ns, joining_ns, offset_m, velocity_m_s, turn_rad }
}

impl From<&Robot> for RobotDescription {
    fn from(robot: &Robot) -> Self {
        let mut description = Self {
            sections: robot.section_count() as u32,
            fingerprint: robot.fingerprint(),
            cable_speed_max_m_s: robot.cable_speed_max_m_s(),
            cable_stroke_max_m: robot.cable_stroke_max_m(),
            tip_speed_max_m_s: robot.tip_speed_max_m_s().unwrap_or(0.0),
            self_overlap_max_m: robot.self_overlap_max_m(),
            ..Self::default()
        };
        for (target, section) in description.section.iter_mut().zip(robot.sections()) {
            *target = section.into();
        }
        description
    }
}

/// The robot of a description.
///
/// # Errors
/// When the description is invalid; a daemon publishes only valid ones.
pub fn robot_of(description: &RobotDescription) -> Result<Robot, RobotError> {
    let sections = description.section.iter().map(Into::into);
    Robot::new(&RobotParameters {
        sections: sections.take(description.sections as usize).collect(),
        cable_speed_max_m_s: description.cable_speed_max_m_s,
        cable_stroke_max_m: description.cable_stroke_max_m,
        tip_speed_max_m_s: description.tip_speed_max_m_s,
        self_overlap_max_m: description.self_overlap_max_m,
    })
}

/// The fields of the controller; number, time and lifetime are zero.
impl From<&robot::Obstacle> for Obstacle {
    fn from(obstacle: &robot::Obstacle) -> Self {
        let (shape, start_m, end_m) = match *obstacle.shape() {
            Shape::Sphere { centre_m } => (ObstacleShape::Sphere, centre_m, centre_m),
            Shape::Capsule { start_m, end_m } => (ObstacleShape::Capsule, start_m, end_m),
        };
        Self {
            shape: shape.code(),
            start_m: start_m.into(),
            end_m: end_m.into(),
            radius_m: obstacle.radius_m(),
            velocity_m_s: obstacle.velocity_m_s().into(),
            ..Self::default()
        }
    }
}

/// The shape of an obstacle.
///
/// # Errors
/// When its code is unknown.
pub fn shape_of(obstacle: &Obstacle) -> Result<Shape, UnknownCode> {
    let [start_m, end_m] = [obstacle.start_m.into(), obstacle.end_m.into()];
    Ok(match obstacle.shape.try_into()? {
        ObstacleShape::Sphere => Shape::Sphere { centre_m: start_m },
        ObstacleShape::Capsule => Shape::Capsule { start_m, end_m },
    })
}

/// An obstacle of a record, at its position at the release. `None` for an obstacle that a daemon would
/// refuse.
pub fn obstacle_of(obstacle: &Obstacle) -> Option<robot::Obstacle> {
    let shape = shape_of(obstacle).ok()?;
    robot::Obstacle::new(shape, obstacle.radius_m, obstacle.velocity_m_s.into()).ok()
}

/// Kind and numbers of an orientation.
pub fn orientation_to_wire(orientation: &Orientation) -> (OrientationKind, [f64; 4]) {
    let padded = |axis: &Unit<Vector3<f64>>| axis.push(0.0).into();
    match orientation {
        Orientation::Free => (OrientationKind::None, [0.0; 4]),
        Orientation::Axis(axis) => (OrientationKind::Axis, padded(axis)),
        Orientation::Preferred(axis) => (OrientationKind::Preferred, padded(axis)),
        Orientation::Full(full) => (OrientationKind::Full, full.coords.into()),
    }
}

/// The orientation with this kind and these numbers, which are normalised.
pub fn orientation_of(kind: OrientationKind, [x, y, z, w]: [f64; 4]) -> Orientation {
    let axis = || Unit::new_normalize([x, y, z].into());
    match kind {
        OrientationKind::None => Orientation::Free,
        OrientationKind::Axis => Orientation::Axis(axis()),
        OrientationKind::Preferred => Orientation::Preferred(axis()),
        OrientationKind::Full => {
            Orientation::Full(UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
        }
    }
}

/// Generates both conversions of the solver settings from their list. A missing field does not compile.
macro_rules! settings {
    ({ $($choice:ident: $type:ident,)+ } $($number:ident),+ $(,)?) => {
        /// The settings with this budget.
        pub fn settings_to_wire(settings: &NmpcSettings, budget_ns: u64) -> SolverSettings {
            let NmpcSettings { $($choice,)+ $($number),+ } = *settings;
            SolverSettings {
                $($choice: codes::$type::from($choice).code(),)+
                $($number: $number.into(),)+
                budget_ns,
                reserved: 0,
            }
        }

        /// The solver settings without the budget.
        ///
        /// # Errors
        /// When a code is unknown; no daemon publishes such settings.
        pub fn settings_of(settings: &SolverSettings) -> Result<NmpcSettings, UnknownCode> {
            let SolverSettings { $($choice,)+ $($number,)+ budget_ns: _, reserved: _ } = *settings;
            Ok(NmpcSettings {
                $($choice: codes::$type::try_from($choice)?.into(),)+
                $($number: $number.into(),)+
            })
        }
    };
}

crate::solver_settings!(settings);
