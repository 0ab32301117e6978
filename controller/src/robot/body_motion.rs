//! Motion of points of the backbone with the bends, in one shape (§1 of docs/model.md).

use nalgebra::Vector3;

use super::{Arc, COORDINATES_MAX, Configuration, Pose, Robot, SECTIONS_MAX};

/// The terms that the velocities of many points of one shape share. Fixed arrays, no heap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyMotion {
    sections: [SectionMotion; SECTIONS_MAX],
    section_count: usize,
}

/// One section, and the velocity and rotational velocity of its end for a unit rate of each component of its bend.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SectionMotion {
    start: Pose,
    end_m: Vector3<f64>,
    length_m: f64,
    bend_rad: [f64; 2],
    velocity_m_rad: [Vector3<f64>; 2],
    spin: [Vector3<f64>; 2],
}

impl SectionMotion {
    /// The part of a section up to a share `s` of its length. The arc up to s is an arc with bend s b and length s l,
    /// hence ∂p(s)/∂b = s ∂p/∂b of that arc.
    fn new(start: &Pose, length_m: f64, [u, v]: [f64; 2], s: f64) -> (Self, Arc) {
        let arc = Arc::new(s * length_m, [s * u, s * v]);
        let (p, w) = (arc.position_derivatives_m_rad(), arc.rotation_derivatives());
        let motion = Self {
            start: *start,
            end_m: start.position_m + start.rotation * arc.position_m(),
            length_m,
            bend_rad: [u, v],
            velocity_m_rad: p.map(|p| start.rotation * (p * s)),
            spin: w.map(|w| start.rotation * (w * s)),
        };
        (motion, arc)
    }
}

impl BodyMotion {
    /// Fills `jacobian` with the velocity of a point of the backbone (m/rad, base frame) for a unit rate of each
    /// coordinate (u1, v1, …): 2n columns, then zeros. Returns the point (m), as [`Robot::body_point`] does.
    ///
    /// `s` is clamped to [0, 1]; a section beyond the last gives the tip. Sections after the point do not move it.
    pub fn point_jacobian(
        &self,
        section: usize,
        s: f64,
        jacobian: &mut [[f64; 3]; COORDINATES_MAX],
    ) -> Vector3<f64> {
        let last = self.section_count - 1;
        let (section, s) = if section > last {
            (last, 1.0)
        } else {
            (section, s.clamp(0.0, 1.0))
        };
        let (below, own) = (&self.sections[..section], &self.sections[section]);
        let (own, _) = SectionMotion::new(&own.start, own.length_m, own.bend_rad, s);
        let point_m = own.end_m;
        let (columns, _) = jacobian.as_chunks_mut::<2>();
        columns.fill([[0.0; 3]; 2]);
        for (columns, moving) in columns.iter_mut().zip(below) {
            let lever_m = point_m - moving.end_m;
            let both = moving.velocity_m_rad.iter().zip(&moving.spin);
            for (column, (velocity, spin)) in columns.iter_mut().zip(both) {
                *column = (velocity + spin.cross(&lever_m)).into();
            }
        }
        columns[section] = own.velocity_m_rad.map(Into::into);
        point_m
    }
}

impl Robot {
    /// Prepares the Jacobians of the points of this shape.
    pub fn body_motion(&self, configuration: &Configuration) -> BodyMotion {
        let mut start = Pose::identity();
        let mut next = |j: usize| {
            let length_m = self.sections()[j].length_m;
            let (motion, arc) = SectionMotion::new(&start, length_m, configuration.section(j), 1.0);
            start = start.then(&arc);
            motion
        };
        let first = next(0);
        let mut sections = [first; SECTIONS_MAX];
        for (j, section) in sections[..self.section_count()]
            .iter_mut()
            .enumerate()
            .skip(1)
        {
            *section = next(j);
        }
        BodyMotion {
            sections,
            section_count: self.section_count(),
        }
    }
}
