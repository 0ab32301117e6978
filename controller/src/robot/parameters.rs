//! Parameters of a robot, their allowed ranges, and the checked [`Robot`].
//!
//! Invariant: every parameter of a [`Robot`] is inside [`ranges`], so no other file checks them again.

use core::ops::RangeInclusive;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::SECTIONS_MAX;

/// Allowed values of every parameter, inclusive at both ends. They exclude nonsense and unit mistakes (millimetres for
/// metres, degrees for radians), not unusual robots.
pub mod ranges {
    use core::ops::RangeInclusive;

    use super::SECTIONS_MAX;

    /// Number of sections.
    pub const SECTION_COUNT: RangeInclusive<usize> = 1..=SECTIONS_MAX;
    /// Length of a section (m): from a micro-catheter to a crane.
    pub const LENGTH_M: RangeInclusive<f64> = 0.001..=10.0;
    /// Distance of the cables from the backbone (m). It must also be below the section's length.
    pub const CABLE_RADIUS_M: RangeInclusive<f64> = 1e-4..=1.0;
    /// Angle of a section's first cable (rad): one turn in either direction.
    pub const CABLE_OFFSET_RAD: RangeInclusive<f64> =
        -core::f64::consts::TAU..=core::f64::consts::TAU;
    /// Largest bend of a section (rad): beyond π the section's end points back at its own base.
    pub const BEND_MAX_RAD: RangeInclusive<f64> = 0.01..=core::f64::consts::PI;
    /// Largest rate of a section's bend vector (rad/s).
    pub const RATE_MAX_RAD_S: RangeInclusive<f64> = 1e-3..=100.0;
    /// Radius of the body around the backbone (m); 0 is a line.
    pub const BODY_RADIUS_M: RangeInclusive<f64> = 0.0..=1.0;
    /// Largest change of a cable's length from that of the straight robot, in either direction (m).
    pub const CABLE_STROKE_MAX_M: RangeInclusive<f64> = 1e-4..=100.0;
    /// Largest speed of a cable (m/s).
    pub const CABLE_SPEED_MAX_M_S: RangeInclusive<f64> = 1e-4..=100.0;
    /// Largest speed of the end of a section (m/s), where it is limited.
    pub const TIP_SPEED_MAX_M_S: RangeInclusive<f64> = 1e-3..=100.0;
    /// Overlap of two parts of the body that a command may lead to (m).
    pub const SELF_OVERLAP_MAX_M: RangeInclusive<f64> = 0.0..=2.0;
}

crate::parameters! {
    /// One section as a configuration file gives it. Not yet checked: [`Robot::new`] does that.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[serde(deny_unknown_fields, expecting = "a table")]
    pub struct SectionParameters {
        /// Length of the backbone, {range}.
        length_m: f64, in ranges::LENGTH_M, "above cable_radius_m";
        /// Distance of the three cables from the backbone, {range}, and below the length.
        cable_radius_m: f64, in ranges::CABLE_RADIUS_M, "below length_m";
        /// Angle of the first cable about the backbone, {range}; the others follow at 120 and 240 degrees.
        cable_offset_rad: f64, in ranges::CABLE_OFFSET_RAD, usual -3.5..=3.5;
        /// Largest bend, {range}.
        bend_max_rad: f64, in ranges::BEND_MAX_RAD;
        /// Largest rate of each component of the bend vector, {range}.
        rate_max_rad_s: f64, in ranges::RATE_MAX_RAD_S, usual 0.0..=10.0;
        /// Radius of the body, {range}.
        body_radius_m: f64, in ranges::BODY_RADIUS_M;
    }
}

impl SectionParameters {
    /// Every parameter with its key and its allowed range, in the order in which the fingerprint hashes them.
    fn checked(&self) -> [(&'static str, f64, RangeInclusive<f64>); 6] {
        [
            ("length_m", self.length_m, ranges::LENGTH_M),
            (
                "cable_radius_m",
                self.cable_radius_m,
                ranges::CABLE_RADIUS_M,
            ),
            (
                "cable_offset_rad",
                self.cable_offset_rad,
                ranges::CABLE_OFFSET_RAD,
            ),
            ("bend_max_rad", self.bend_max_rad, ranges::BEND_MAX_RAD),
            (
                "rate_max_rad_s",
                self.rate_max_rad_s,
                ranges::RATE_MAX_RAD_S,
            ),
            ("body_radius_m", self.body_radius_m, ranges::BODY_RADIUS_M),
        ]
    }

    /// Rejects the first parameter outside its range. `section` counts from 1 for the user.
    fn check(&self, section: usize) -> Result<(), RobotError> {
        for (key, value, allowed) in self.checked() {
            if !allowed.contains(&value) {
                return Err(RobotError::Section {
                    section,
                    key,
                    value,
                    allowed,
                });
            }
        }
        if self.cable_radius_m >= self.length_m {
            return Err(RobotError::CableRadius {
                section,
                key: "cable_radius_m",
                value: self.cable_radius_m,
                allowed: *ranges::CABLE_RADIUS_M.start()..self.length_m,
            });
        }
        Ok(())
    }
}

/// Parameters of a robot as in a configuration file, base section first. [`Robot::new`] checks them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotParameters {
    /// The sections, base first; their number is in [`ranges::SECTION_COUNT`].
    pub sections: Vec<SectionParameters>,
    /// Largest speed of any cable (m/s), in [`ranges::CABLE_SPEED_MAX_M_S`].
    pub cable_speed_max_m_s: f64,
    /// Largest change of a cable's length from that of the straight robot, in either direction (m), in
    /// [`ranges::CABLE_STROKE_MAX_M`]. Set by winches and springs.
    pub cable_stroke_max_m: f64,
    /// Largest speed of the end of any section, seen from the base (m/s), in [`ranges::TIP_SPEED_MAX_M_S`]; 0: no limit.
    #[serde(default)]
    pub tip_speed_max_m_s: f64,
    /// Overlap of two parts of the body, by their `body_radius_m`, that a command may lead to (m), in
    /// [`ranges::SELF_OVERLAP_MAX_M`]. As much as the body is thick: no limit.
    #[serde(default = "usual_overlap_m")]
    pub self_overlap_max_m: f64,
}

/// Overlap of two parts of the body that is no contact (m), unless a robot says otherwise.
const fn usual_overlap_m() -> f64 {
    0.002
}

impl RobotParameters {
    /// The paper's robot with `section_count` sections: 0.3 m each, cables at 12.5 mm, and each section's first cable
    /// 40° further round than the previous one's. The lengths are from the paper, the cables from §2 of docs/model.md.
    /// The paper gives no limits; these are our own. Valid for [`Robot::new`] with 1 to 6 sections.
    pub fn paper(section_count: usize) -> Self {
        let section = |j: usize| SectionParameters {
            length_m: 0.3,
            cable_radius_m: 0.0125,
            cable_offset_rad: (40.0 * j as f64).to_radians(),
            bend_max_rad: 2.8,
            rate_max_rad_s: 2.0,
            body_radius_m: 0.015,
        };
        Self {
            sections: (0..section_count).map(section).collect(),
            cable_speed_max_m_s: 0.5,
            cable_stroke_max_m: 0.25,
            tip_speed_max_m_s: 0.0,
            self_overlap_max_m: usual_overlap_m(),
        }
    }
}

impl RobotParameters {
    /// Every parameter of the whole robot with its key and its allowed range, in the order in which the fingerprint
    /// hashes them. A speed of the tip that has no limit, and the usual overlap, are left out.
    fn checked(&self) -> impl Iterator<Item = (&'static str, f64, RangeInclusive<f64>)> {
        let tip_speed = (
            "tip_speed_max_m_s",
            self.tip_speed_max_m_s,
            ranges::TIP_SPEED_MAX_M_S,
        );
        let tip_speed = (self.tip_speed_max_m_s != 0.0).then_some(tip_speed);
        let overlap = (
            "self_overlap_max_m",
            self.self_overlap_max_m,
            ranges::SELF_OVERLAP_MAX_M,
        );
        let overlap = (self.self_overlap_max_m != usual_overlap_m()).then_some(overlap);
        let always = [
            (
                "cable_speed_max_m_s",
                self.cable_speed_max_m_s,
                ranges::CABLE_SPEED_MAX_M_S,
            ),
            (
                "cable_stroke_max_m",
                self.cable_stroke_max_m,
                ranges::CABLE_STROKE_MAX_M,
            ),
        ];
        always.into_iter().chain(tip_speed).chain(overlap)
    }
}

/// The parameter that makes a robot invalid: its place, its key, its value and the allowed values.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RobotError {
    /// Too few or too many sections.
    #[error("{value} sections; a robot has {} to {}, so add or remove some", allowed.start(), allowed.end())]
    SectionCount {
        /// Key of the list.
        key: &'static str,
        /// Number of sections given.
        value: usize,
        /// Allowed number of sections: [`ranges::SECTION_COUNT`].
        allowed: RangeInclusive<usize>,
    },
    /// A parameter of one section is out of range or not a number.
    #[error(
        "section {section}: {key} = {value} is outside {allowed:?} (SI units: m, rad, s); correct it"
    )]
    Section {
        /// Number of the section, 1 at the base.
        section: usize,
        /// Key of the parameter.
        key: &'static str,
        /// Value of the parameter, in the unit that ends the key.
        value: f64,
        /// Allowed range, one of [`ranges`].
        allowed: RangeInclusive<f64>,
    },
    /// A section's cables are at least as far from the backbone as the section is long.
    #[error(
        "section {section}: {key} = {value} is not below the length of the section, length_m = {}; correct either", allowed.end
    )]
    CableRadius {
        /// Number of the section, 1 at the base.
        section: usize,
        /// Key of the parameter.
        key: &'static str,
        /// Value of the parameter (m).
        value: f64,
        /// Allowed range (m), which ends before the section's length.
        allowed: core::ops::Range<f64>,
    },
    /// A parameter of the whole robot is out of range or not a number.
    #[error("robot: {key} = {value} is outside {allowed:?} (SI units: m, rad, s); correct it")]
    Whole {
        /// Key of the parameter.
        key: &'static str,
        /// Value of the parameter, in the unit that ends the key.
        value: f64,
        /// Allowed range, one of [`ranges`].
        allowed: RangeInclusive<f64>,
    },
}

/// A robot whose parameters are all valid. 624 bytes in fixed arrays, no heap: cheap to clone.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// The first `section_count` are used; the rest repeat the last.
    sections: [SectionParameters; SECTIONS_MAX],
    section_count: usize,
    cable_speed_max_m_s: f64,
    cable_stroke_max_m: f64,
    /// Infinite: no limit.
    tip_speed_max_m_s: f64,
    self_overlap_max_m: f64,
    /// (cos β, sin β) of each cable of each section, computed once, not in every cycle.
    cable_directions: [[[f64; 2]; 3]; SECTIONS_MAX],
    fingerprint: u64,
}

impl Robot {
    /// Checks the parameters. They cannot change afterwards.
    ///
    /// # Errors
    /// The first parameter outside [`ranges`] (a NaN is outside every range), base section first, as a [`RobotError`].
    pub fn new(parameters: &RobotParameters) -> Result<Self, RobotError> {
        let section_count = parameters.sections.len();
        let last = match parameters.sections.last() {
            Some(last) if ranges::SECTION_COUNT.contains(&section_count) => *last,
            _ => {
                return Err(RobotError::SectionCount {
                    key: "sections",
                    value: section_count,
                    allowed: ranges::SECTION_COUNT,
                });
            }
        };
        for (j, section) in parameters.sections.iter().enumerate() {
            section.check(j + 1)?;
        }
        for (key, value, allowed) in parameters.checked() {
            if !allowed.contains(&value) {
                return Err(RobotError::Whole {
                    key,
                    value,
                    allowed,
                });
            }
        }
        let sections = core::array::from_fn(|j| *parameters.sections.get(j).unwrap_or(&last));
        Ok(Self {
            sections,
            section_count,
            cable_speed_max_m_s: parameters.cable_speed_max_m_s,
            cable_stroke_max_m: parameters.cable_stroke_max_m,
            tip_speed_max_m_s: match parameters.tip_speed_max_m_s {
                0.0 => f64::INFINITY,
                limit_m_s => limit_m_s,
            },
            self_overlap_max_m: parameters.self_overlap_max_m,
            cable_directions: sections.map(|section| cable_directions(section.cable_offset_rad)),
            fingerprint: fingerprint(parameters),
        })
    }

    /// The sections, base first: 1 to 6 of them.
    pub fn sections(&self) -> &[SectionParameters] {
        &self.sections[..self.section_count]
    }

    pub(super) fn sections_mut(&mut self) -> &mut [SectionParameters] {
        &mut self.sections[..self.section_count]
    }

    /// Number of sections n, 1 to 6.
    pub fn section_count(&self) -> usize {
        self.section_count
    }

    /// Number of coordinates 2n: the length of every `bend_rad` and `rates` slice, 2 to 12.
    pub fn coordinate_count(&self) -> usize {
        2 * self.section_count
    }

    /// Number of cables 3n, 3 to 18.
    pub fn cable_count(&self) -> usize {
        3 * self.section_count
    }

    /// Upper bound on the distance of any point of the backbone from the base (m): the sum of the lengths.
    pub fn reach_m(&self) -> f64 {
        self.sections().iter().map(|section| section.length_m).sum()
    }

    /// Largest speed of any cable (m/s), in [`ranges::CABLE_SPEED_MAX_M_S`].
    pub fn cable_speed_max_m_s(&self) -> f64 {
        self.cable_speed_max_m_s
    }

    /// Largest change of a cable's length from that of the straight robot, in either direction (m), in
    /// [`ranges::CABLE_STROKE_MAX_M`].
    pub fn cable_stroke_max_m(&self) -> f64 {
        self.cable_stroke_max_m
    }

    /// Largest speed of the end of any section, seen from the base (m/s), in [`ranges::TIP_SPEED_MAX_M_S`]; `None`: no
    /// limit.
    pub fn tip_speed_max_m_s(&self) -> Option<f64> {
        Some(self.tip_speed_max_m_s).filter(|limit_m_s| limit_m_s.is_finite())
    }

    /// Overlap of two parts of the body that a command may lead to (m), in [`ranges::SELF_OVERLAP_MAX_M`].
    pub fn self_overlap_max_m(&self) -> f64 {
        self.self_overlap_max_m
    }

    /// The parameters of this robot.
    pub fn parameters(&self) -> RobotParameters {
        RobotParameters {
            sections: self.sections().to_vec(),
            cable_speed_max_m_s: self.cable_speed_max_m_s,
            cable_stroke_max_m: self.cable_stroke_max_m,
            tip_speed_max_m_s: self.tip_speed_max_m_s().unwrap_or(0.0),
            self_overlap_max_m: self.self_overlap_max_m,
        }
    }

    /// Hash of the parameters, by which two processes, or a recording and its replay, verify that they use the same
    /// robot.
    ///
    /// 64-bit FNV-1a over little-endian bytes: the section count (as u64), then the bits of each section's `length_m`,
    /// `cable_radius_m`, `cable_offset_rad`, `bend_max_rad`, `rate_max_rad_s`, `body_radius_m`, base first, then
    /// `cable_speed_max_m_s` and `cable_stroke_max_m`, `tip_speed_max_m_s` if it is a limit, and unless it is that of [`RobotParameters::paper`]
    /// the negative of `self_overlap_max_m`: a positive number there is a tip speed. The same on every platform. It depends on bits: 0.0 and -0.0
    /// differ.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// (cos β, sin β) of the three cables of each section, base first.
    pub(crate) fn cable_directions(&self) -> &[[[f64; 2]; 3]] {
        &self.cable_directions[..self.section_count]
    }
}

/// Directions of three cables 120° apart, β = 2πi/3 + offset (§2 of docs/model.md).
fn cable_directions(offset_rad: f64) -> [[f64; 2]; 3] {
    core::array::from_fn(|i| {
        let (sin, cos) = (core::f64::consts::TAU * i as f64 / 3.0 + offset_rad).sin_cos();
        [cos, sin]
    })
}

/// The hash documented at [`Robot::fingerprint`].
fn fingerprint(parameters: &RobotParameters) -> u64 {
    let count = parameters.sections.len() as u64;
    let of_sections = parameters
        .sections
        .iter()
        .flat_map(SectionParameters::checked);
    of_sections.chain(parameters.checked()).fold(
        fnv_1a(FNV_OFFSET_BASIS, count),
        |hash, (key, value, _)| {
            let sign = if key == "self_overlap_max_m" {
                -1.0
            } else {
                1.0
            };
            fnv_1a(hash, (sign * value).to_bits())
        },
    )
}

/// Start value of 64-bit FNV-1a (draft-eastlake-fnv).
const FNV_OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
/// Multiplier of 64-bit FNV-1a.
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Hashes the eight bytes of `word`, least significant first.
fn fnv_1a(hash: u64, word: u64) -> u64 {
    word.to_le_bytes().iter().fold(hash, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(FNV_PRIME)
    })
}

#[cfg(test)]
mod tests;
