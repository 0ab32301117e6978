use core::fmt;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::robot::{Robot, RobotError, RobotParameters, SECTIONS_MAX, SectionParameters};

/// Parameters of one section: length, radius, angle and two zeros.
const PER_SECTION: usize = 5;
/// Number of parameters of the largest robot, with base and sensor: the length of every array here.
pub const PARAMETERS_MAX: usize = PER_SECTION * SECTIONS_MAX + 12;
/// Index of the first parameter of the base pose.
const BASE: usize = PER_SECTION * SECTIONS_MAX;
/// Index of the first parameter of the sensor pose.
const SENSOR: usize = BASE + 6;

/// Two orthonormal patterns of the zeros of a section's three cables that change its bend. The third pattern, their
/// mean, does not.
pub(super) const ZERO_PATTERNS: [[f64; 3]; 2] = [
    [
        0.816_496_580_927_726,
        -0.408_248_290_463_863,
        -0.408_248_290_463_863,
    ],
    [
        0.0,
        core::f64::consts::FRAC_1_SQRT_2,
        -core::f64::consts::FRAC_1_SQRT_2,
    ],
];

/// A parameter of calibration. Sections and axes count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Length of a section (m).
    Length(usize),
    /// Distance of a section's cables from the backbone (m).
    CableRadius(usize),
    /// Angle of a section's first cable (rad).
    CableAngle(usize),
    /// Zeros of a section's three cables relative to their mean (m), in one of two orthonormal patterns.
    /// [`Calibration`] lists them for each cable.
    ///
    /// [`Calibration`]: super::Calibration
    CableZero(usize, usize),
    /// Position of the robot's base in the frame of the tip measurements (m).
    BasePosition(usize),
    /// Rotation of the base about an axis of that frame (rad).
    BaseRotation(usize),
    /// Position of the sensor's target in the frame of the tip (m).
    SensorPosition(usize),
    /// Rotation of the sensor's target about an axis of the tip (rad).
    SensorRotation(usize),
}

/// Parameters that are calibrated together and can be held together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ParameterGroup {
    /// Pose of the base.
    Base,
    /// Pose of the sensor on the tip.
    Sensor,
    /// Zeros of the cables.
    Zeros,
    /// Angles of the cables.
    Angles,
    /// Distances of the cables from the backbone.
    Radii,
    /// Lengths of the sections.
    Lengths,
}

impl ParameterGroup {
    /// All groups.
    pub const ALL: [Self; 6] = [
        Self::Base,
        Self::Sensor,
        Self::Zeros,
        Self::Angles,
        Self::Radii,
        Self::Lengths,
    ];
}

impl Parameter {
    /// The parameter at an index of the arrays of this module.
    pub(super) fn from_index(index: usize) -> Self {
        let (section, part) = (index / PER_SECTION, index % PER_SECTION);
        match index {
            BASE.. => {
                let (axis, part) = ((index - BASE) % 3, (index - BASE) / 3);
                [
                    Self::BasePosition(axis),
                    Self::BaseRotation(axis),
                    Self::SensorPosition(axis),
                    Self::SensorRotation(axis),
                ][part]
            }
            _ => match part {
                0 => Self::Length(section),
                1 => Self::CableRadius(section),
                2 => Self::CableAngle(section),
                _ => Self::CableZero(section, part - 3),
            },
        }
    }

    /// Index in the arrays of this module.
    pub(super) fn index(self) -> usize {
        match self {
            Self::Length(section) => PER_SECTION * section,
            Self::CableRadius(section) => PER_SECTION * section + 1,
            Self::CableAngle(section) => PER_SECTION * section + 2,
            Self::CableZero(section, pattern) => PER_SECTION * section + 3 + pattern,
            Self::BasePosition(axis) => BASE + axis,
            Self::BaseRotation(axis) => BASE + 3 + axis,
            Self::SensorPosition(axis) => SENSOR + axis,
            Self::SensorRotation(axis) => SENSOR + 3 + axis,
        }
    }

    /// Group of the parameter.
    pub fn group(self) -> ParameterGroup {
        match self {
            Self::Length(_) => ParameterGroup::Lengths,
            Self::CableRadius(_) => ParameterGroup::Radii,
            Self::CableAngle(_) => ParameterGroup::Angles,
            Self::CableZero(..) => ParameterGroup::Zeros,
            Self::BasePosition(_) | Self::BaseRotation(_) => ParameterGroup::Base,
            Self::SensorPosition(_) | Self::SensorRotation(_) => ParameterGroup::Sensor,
        }
    }

    /// Plausible error (m or rad): the scale of excitation.
    pub(super) fn plausible_error(self, robot: &RobotParameters) -> f64 {
        match self {
            Self::Length(section) => 0.1 * robot.sections[section].length_m,
            // A zero as large as the motion of a cable by an angle of 0.1 rad.
            Self::CableRadius(section) | Self::CableZero(section, _) => {
                0.1 * robot.sections[section].cable_radius_m
            }
            Self::CableAngle(_) | Self::BaseRotation(_) | Self::SensorRotation(_) => 0.1,
            Self::BasePosition(_) | Self::SensorPosition(_) => {
                let lengths_m = robot.sections.iter().map(|section| section.length_m);
                0.1 * lengths_m.fold(0.0, f64::max)
            }
        }
    }

    /// True for an angle, false for a length.
    pub fn is_angle(self) -> bool {
        matches!(
            self,
            Self::CableAngle(_) | Self::BaseRotation(_) | Self::SensorRotation(_)
        )
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis = |axis: &usize| ["x", "y", "z"][*axis];
        match self {
            Self::Length(section) => write!(f, "length of section {}", section + 1),
            Self::CableRadius(section) => write!(f, "cable radius of section {}", section + 1),
            Self::CableAngle(section) => write!(f, "cable angle of section {}", section + 1),
            Self::CableZero(section, 0) => {
                write!(f, "zero of the first cable of section {}", section + 1)
            }
            Self::CableZero(section, _) => {
                write!(
                    f,
                    "zeros of the other two cables of section {}",
                    section + 1
                )
            }
            Self::BasePosition(a) => write!(f, "base position {}", axis(a)),
            Self::BaseRotation(a) => write!(f, "base rotation about {}", axis(a)),
            Self::SensorPosition(a) => write!(f, "sensor position {}", axis(a)),
            Self::SensorRotation(a) => write!(f, "sensor rotation about {}", axis(a)),
        }
    }
}

/// All estimated quantities.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// The robot: lengths, radii and angles of its sections are estimated, the rest is kept.
    pub robot: RobotParameters,
    /// Zeros of the cables of each section relative to their mean, by pattern (m).
    pub(super) zeros_m: [[f64; 2]; SECTIONS_MAX],
    /// Pose of the robot's base in the frame of the measured poses.
    pub base: Isometry3<f64>,
    /// Pose of the sensor's target in the frame of the tip.
    pub sensor: Isometry3<f64>,
}

impl Geometry {
    /// The configured geometry: zeros are 0, and poses are those of the tip in the base frame.
    pub fn configured(robot: &RobotParameters) -> Self {
        Self {
            robot: robot.clone(),
            zeros_m: [[0.0; 2]; SECTIONS_MAX],
            base: Isometry3::identity(),
            sensor: Isometry3::identity(),
        }
    }

    /// The validated robot.
    pub(super) fn checked(&self) -> Result<Robot, RobotError> {
        Robot::new(&self.robot)
    }

    /// Zeros of the three cables of a section relative to their mean (m).
    pub(super) fn section_zeros_m(&self, section: usize) -> [f64; 3] {
        let [a, b] = self.zeros_m[section];
        core::array::from_fn(|cable| a * ZERO_PATTERNS[0][cable] + b * ZERO_PATTERNS[1][cable])
    }

    /// Value of a parameter (m or rad); for a rotation, the component of its vector.
    pub fn value(&self, parameter: Parameter) -> f64 {
        let section = |j: usize| &self.robot.sections[j];
        match parameter {
            Parameter::Length(j) => section(j).length_m,
            Parameter::CableRadius(j) => section(j).cable_radius_m,
            Parameter::CableAngle(j) => section(j).cable_offset_rad,
            Parameter::CableZero(j, pattern) => self.zeros_m[j][pattern],
            Parameter::BasePosition(axis) => self.base.translation.vector[axis],
            Parameter::BaseRotation(axis) => self.base.rotation.scaled_axis()[axis],
            Parameter::SensorPosition(axis) => self.sensor.translation.vector[axis],
            Parameter::SensorRotation(axis) => self.sensor.rotation.scaled_axis()[axis],
        }
    }

    /// The geometry moved by a step in every parameter; rotations turn about the axes of their frame.
    #[must_use]
    pub(super) fn moved(&self, step: &[f64; PARAMETERS_MAX]) -> Self {
        let mut moved = self.clone();
        for (j, section) in moved.robot.sections.iter_mut().enumerate() {
            let SectionParameters {
                length_m,
                cable_radius_m,
                cable_offset_rad,
                ..
            } = section;
            let at = PER_SECTION * j;
            *length_m += step[at];
            *cable_radius_m += step[at + 1];
            *cable_offset_rad += step[at + 2];
            for (pattern, zero_m) in moved.zeros_m[j].iter_mut().enumerate() {
                *zero_m += step[at + 3 + pattern];
            }
        }
        for (pose, at) in [(&mut moved.base, BASE), (&mut moved.sensor, SENSOR)] {
            let vector = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
            pose.translation = Translation3::from(pose.translation.vector + vector(at));
            pose.rotation = UnitQuaternion::new(vector(at + 3)) * pose.rotation;
        }
        moved
    }
}
