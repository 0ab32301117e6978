//! Body and obstacles of the oracle: arcs by chords and axis-angle rotations, distances to their points in
//! closed form, and the minimum by branch and bound.

use cdcr_controller::robot::{Obstacle, RobotParameters, Shape};
use nalgebra::{Rotation3, Vector3};

/// The backbone of one section: an arc of a circle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arc {
    base_m: Vector3<f64>,
    /// Unit vectors at the base: along the backbone, and in the direction of the bend.
    along: Vector3<f64>,
    inwards: Vector3<f64>,
    length_m: f64,
    bend_rad: f64,
    body_radius_m: f64,
}

/// The arcs of a robot with these bends (rad), base first.
pub(super) fn arcs(parameters: &RobotParameters, bends_rad: &[f64]) -> Vec<Arc> {
    let (mut base_m, mut frame) = (Vector3::zeros(), Rotation3::identity());
    let sections = parameters.sections.iter().zip(bends_rad.chunks(2));
    sections
        .map(|(section, bend)| {
            let bend_rad = bend[0].hypot(bend[1]);
            let inwards = if bend_rad > 0.0 {
                Vector3::new(bend[0] / bend_rad, bend[1] / bend_rad, 0.0)
            } else {
                Vector3::x()
            };
            let arc = Arc {
                base_m,
                along: frame * Vector3::z(),
                inwards: frame * inwards,
                length_m: section.length_m,
                bend_rad,
                body_radius_m: section.body_radius_m,
            };
            base_m = arc.end_m();
            frame *= Rotation3::from_scaled_axis(Vector3::new(-bend[1], bend[0], 0.0));
            arc
        })
        .collect()
}

impl Arc {
    /// End of the arc (m).
    pub(super) fn end_m(&self) -> Vector3<f64> {
        self.point_and_tangent(self.length_m).0
    }

    /// The point at `s_m` along the arc, and the tangent there. With an angle α, the chord to the point has
    /// the length 2 ρ sin(α/2) and half that angle to the tangent at the base.
    pub(super) fn point_and_tangent(&self, s_m: f64) -> (Vector3<f64>, Vector3<f64>) {
        let angle = self.bend_rad * s_m / self.length_m;
        let (sin, cos) = (0.5 * angle).sin_cos();
        let chord_m = if angle > 0.0 {
            s_m * sin / (0.5 * angle)
        } else {
            s_m
        };
        let towards = self.along * cos + self.inwards * sin;
        let tangent = self.along * (cos * cos - sin * sin) + self.inwards * (2.0 * sin * cos);
        (self.base_m + towards * chord_m, tangent)
    }

    /// Distance from the surface of the section to that of the obstacle (m), at most `within_m` too large,
    /// and its place on the arc. Above `cutoff_m`, any value above it.
    ///
    /// The distance to a convex set, here a point or a segment, is a convex function with slopes of at most
    /// one. Along an arc of curvature κ its second derivative is at least -κ. So within h of a point with
    /// distance d and slope d' it is at least d - |d'| h - κ h²/2, and at least d - h. The arc is halved
    /// where these bounds do not suffice.
    pub(super) fn nearest_m(&self, ball: &Ball, cutoff_m: f64, within_m: f64) -> (f64, f64) {
        let radii_m = self.body_radius_m + ball.radius_m;
        let cutoff_m = cutoff_m + radii_m;
        let curvature = self.bend_rad / self.length_m;
        let mut nearest = (f64::INFINITY, 0.0);
        let mut look = |s_m: f64| {
            let (point_m, tangent) = self.point_and_tangent(s_m);
            let (distance_m, away) = ball.distance_m(point_m);
            if distance_m < nearest.0 {
                nearest = (distance_m, s_m);
            }
            let slope = away.map_or(1.0, |away| away.dot(&tangent).abs());
            (distance_m, slope, nearest.0)
        };
        let half_m = 0.5 * self.length_m;
        let mut open = vec![(half_m, half_m)];
        while let Some((middle_m, half_m)) = open.pop() {
            let (distance_m, slope, least_m) = look(middle_m);
            let by_slope_m = slope * half_m + 0.5 * curvature * half_m * half_m;
            if distance_m - by_slope_m.min(half_m) < least_m.min(cutoff_m) - within_m {
                let quarter_m = 0.5 * half_m;
                if middle_m == half_m {
                    look(0.0);
                }
                if middle_m + half_m == self.length_m {
                    look(self.length_m);
                }
                open.push((middle_m - quarter_m, quarter_m));
                open.push((middle_m + quarter_m, quarter_m));
            }
        }
        (nearest.0 - radii_m, nearest.1)
    }

    /// The clearance of one point of the section, and around it (m).
    pub(super) fn clearance_at_m(&self, ball: &Ball, s_m: f64) -> f64 {
        ball.distance_m(self.point_and_tangent(s_m).0).0 - self.body_radius_m - ball.radius_m
    }
}

/// An obstacle: all points within `radius_m` of a segment, or of a point if its span is zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    pub(super) start_m: Vector3<f64>,
    pub(super) span_m: Vector3<f64>,
    pub(super) radius_m: f64,
    pub(super) velocity_m_s: Vector3<f64>,
}

impl Ball {
    /// The obstacle at a later time.
    pub(super) fn after(&self, time_s: f64) -> Self {
        Self {
            start_m: self.start_m + self.velocity_m_s * time_s,
            ..*self
        }
    }

    /// Distance from a point to the axis (m), and the direction away from it; none on the axis.
    fn distance_m(&self, point_m: Vector3<f64>) -> (f64, Option<Vector3<f64>>) {
        let mut apart_m = point_m - self.start_m;
        let square_m2 = self.span_m.norm_squared();
        if square_m2 > 0.0 {
            let share = (apart_m.dot(&self.span_m) / square_m2).clamp(0.0, 1.0);
            apart_m -= self.span_m * share;
        }
        let distance_m = apart_m.norm();
        (
            distance_m,
            (distance_m > 1e-9).then(|| apart_m / distance_m),
        )
    }

    /// The same obstacle for the controller.
    pub(super) fn obstacle(&self) -> Obstacle {
        let shape = if self.span_m == Vector3::zeros() {
            Shape::Sphere {
                centre_m: self.start_m,
            }
        } else {
            Shape::Capsule {
                start_m: self.start_m,
                end_m: self.start_m + self.span_m,
            }
        };
        Obstacle::new(shape, self.radius_m, self.velocity_m_s).unwrap()
    }
}

/// Upper bound of the motion of each section (m) for this change of the bends (rad). The tangents of section
/// j turn by at most the changes of all sections up to it; those of a section act only beyond its base.
pub(super) fn travel_m(parameters: &RobotParameters, change_rad: &[f64]) -> Vec<f64> {
    let (mut turn_rad, mut way_m) = (0.0, 0.0);
    let sections = parameters.sections.iter().zip(change_rad.chunks(2));
    sections
        .map(|(section, change)| {
            turn_rad += change[0].hypot(change[1]);
            way_m += turn_rad * section.length_m;
            way_m
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix4;
    use proptest::prelude::*;

    use super::*;

    /// Σ twistᵏ/k!: the terms shrink below rounding long before the fortieth.
    fn exponential(twist: Matrix4<f64>) -> Matrix4<f64> {
        let (mut sum, mut term) = (Matrix4::identity(), Matrix4::identity());
        for k in 1..40 {
            term *= twist / f64::from(k);
            sum += term;
        }
        sum
    }

    proptest! {
        /// A section is the exponential of its twist: a rotation by (-v, u, 0) and a translation by its
        /// length along z.
        #[test]
        fn arcs_are_exponentials_of_twists(bends in prop::collection::vec(-3.0..3.0_f64, 6), share in 0.0..1.0_f64) {
            let parameters = RobotParameters::paper(3);
            let mut pose = Matrix4::<f64>::identity();
            for (arc, bend) in arcs(&parameters, &bends).iter().zip(bends.chunks(2)) {
                let [u, v] = [bend[0], bend[1]];
                #[rustfmt::skip]
                let twist = Matrix4::new(
                    0.0, 0.0, u, 0.0,
                    0.0, 0.0, v, 0.0,
                    -u, -v, 0.0, arc.length_m,
                    0.0, 0.0, 0.0, 0.0,
                );
                let (point_m, tangent) = arc.point_and_tangent(share * arc.length_m);
                let there: Matrix4<f64> = pose * exponential(twist * share);
                prop_assert!((there.fixed_view::<3, 1>(0, 3) - point_m).norm() < 1e-14);
                prop_assert!((there.fixed_view::<3, 1>(0, 2) - tangent).norm() < 1e-14);
                pose *= exponential(twist);
            }
        }

        /// The minimum of many samples is never below the result, and as close as samples are.
        #[test]
        fn no_sample_is_nearer(
            bends in prop::collection::vec(-3.0..3.0_f64, 2),
            start in prop::array::uniform3(-0.4..0.4_f64),
            span in prop::array::uniform3(-0.4..0.4_f64),
            is_sphere: bool,
        ) {
            const SAMPLES: u32 = 3000;
            const WITHIN_M: f64 = 1e-10;
            let arc = arcs(&RobotParameters::paper(1), &bends)[0];
            let ball = Ball {
                start_m: start.into(),
                span_m: if is_sphere { Vector3::zeros() } else { span.into() },
                radius_m: 0.0,
                velocity_m_s: Vector3::zeros(),
            };
            let least_m = (0..=SAMPLES)
                .map(|i| ball.distance_m(arc.point_and_tangent(arc.length_m * f64::from(i) / f64::from(SAMPLES)).0).0)
                .fold(f64::INFINITY, f64::min);
            let (clearance_m, s_m) = arc.nearest_m(&ball, f64::INFINITY, WITHIN_M);
            prop_assert_eq!(clearance_m, arc.clearance_at_m(&ball, s_m));
            let distance_m = clearance_m + arc.body_radius_m;
            let spacing_m = arc.length_m / f64::from(SAMPLES);
            prop_assert!(distance_m <= least_m + WITHIN_M && distance_m >= least_m - 0.5 * spacing_m);
        }
    }
}
