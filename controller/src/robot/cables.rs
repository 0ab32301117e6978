//! Cable lengths and speeds from a shape, and the shape from cable lengths (§2 of docs/model.md).
//!
//! Section j has three cables 120° apart, at its radius r from the backbone. They pass through every section before j,
//! so that the lengths are coupled by the **pull** s of the first j sections:
//! ```text
//! β_ij = 2πi/3 + offset_j
//! s_j  = Σ_{k≤j} r_k (u_k, v_k)                           (m)
//! L_ij = Σ_{k≤j} l_k - s_j · (cos β_ij, sin β_ij)
//! ```
//! The lengths are linear in the bend vector. Cables are modelled parallel to the backbone, as in a continuous guide.
//! With n disks per section they are chords: shorter at the outside, by 0.05 mm with 20 disks at 75°.

use super::{BendRates, CABLES_MAX, Configuration, Robot, SECTIONS_MAX};
use crate::wide::Wide;

/// Largest difference of the mean length of a section's cables from its backbone, as a part of the backbone. Strokes of a bend cancel in the
/// mean; errors of encoders' zeros and of lengths in a configuration are smaller.
const CABLE_MEAN_TOLERANCE: f64 = 0.1;

/// Common mode of each section: the mean length of its three cables (m), which does not depend on the bends. Sections that the robot does
/// not have follow.
pub(crate) fn common_modes_m(lengths_m: &[f64; CABLES_MAX]) -> [f64; SECTIONS_MAX] {
    let (sections_m, _) = lengths_m.as_chunks::<3>();
    core::array::from_fn(|j| sections_m[j].iter().sum::<f64>() / 3.0)
}

impl Robot {
    /// Length of each cable (m): three for each section, base section first; 3n are used, the rest are 0. The three
    /// lengths of a section always sum to three times the backbone length up to its end.
    pub fn cable_lengths(&self, configuration: &Configuration) -> [f64; CABLES_MAX] {
        let mut lengths_m = self.cable_shortening(configuration.pairs());
        let (cables, _) = lengths_m.as_chunks_mut::<3>();
        let mut backbone_m = 0.0;
        for (cables, section) in cables.iter_mut().zip(self.sections()) {
            backbone_m += section.length_m;
            *cables = cables.map(|shortening_m| backbone_m - shortening_m);
        }
        lengths_m
    }

    /// The first section whose common mode differs by more than a tenth from the backbone up to its end: such lengths are of another robot,
    /// unit or order of sections, or have no zero.
    pub fn section_of_foreign_cables(&self, lengths_m: &[f64; CABLES_MAX]) -> Option<usize> {
        let mut backbone_m = 0.0;
        let mut sections = self.sections().iter().zip(self.common_errors_m(lengths_m));
        sections.position(|(section, error_m)| {
            backbone_m += section.length_m;
            error_m.abs() > CABLE_MEAN_TOLERANCE * backbone_m
        })
    }

    /// By how much the common mode of each section is above the backbone up to its end (m). The bends do not contain it.
    pub(crate) fn common_errors_m(&self, lengths_m: &[f64; CABLES_MAX]) -> [f64; SECTIONS_MAX] {
        let mut backbone_m = 0.0;
        let mut errors_m = [0.0; SECTIONS_MAX];
        let sections = self.sections().iter().zip(common_modes_m(lengths_m));
        for (error_m, (section, mean_m)) in errors_m.iter_mut().zip(sections) {
            backbone_m += section.length_m;
            *error_m = mean_m - backbone_m;
        }
        errors_m
    }

    /// Speed of each cable (m/s) in the order of [`Self::cable_lengths`]; positive when the cable is paid out. 3n are
    /// used, the rest are 0.
    pub fn cable_speeds(&self, rates: &BendRates) -> [f64; CABLES_MAX] {
        self.cable_shortening(rates.pairs())
            .map(|speed_m_s| 0.0 - speed_m_s)
    }

    /// Stroke of each cable (m) in the order of [`Self::cable_lengths`]: its length minus that of the straight robot,
    /// positive when paid out. 3n are used, the rest are 0. Linear in the bends.
    pub fn cable_strokes(&self, configuration: &Configuration) -> [f64; CABLES_MAX] {
        self.cable_shortening(configuration.pairs())
            .map(|stroke_m| 0.0 - stroke_m)
    }

    /// The shape from cable lengths (m), in the order of [`Self::cable_lengths`].
    ///
    /// Two unknowns from three cables: the least-squares solution, which ignores an error common to the three. The pull
    /// of the proximal sections is subtracted. Bend limits are not applied. Lengths after the first 3n are ignored.
    pub fn bend_from_cable_lengths(&self, lengths_m: &[f64; CABLES_MAX]) -> Configuration {
        let mut configuration = Configuration::straight(self.section_count());
        let (bends, _) = configuration.as_mut_slice().as_chunks_mut::<2>();
        let (cables, _) = lengths_m.as_chunks::<3>();
        let mut backbone_m = 0.0;
        let mut proximal_pull_m = [0.0; 2];
        for (((bend, cables), section), directions) in bends
            .iter_mut()
            .zip(cables)
            .zip(self.sections())
            .zip(self.cable_directions())
        {
            backbone_m += section.length_m;
            // Least squares for directions 120° apart: Σ cos² = Σ sin² = 3/2, Σ cos sin = Σ cos = Σ sin = 0.
            let pull_m = core::array::from_fn(|axis| {
                let along = |(length_m, direction): (&f64, &[f64; 2])| {
                    (backbone_m - length_m) * direction[axis]
                };
                cables.iter().zip(directions).map(along).sum::<f64>() / 1.5
            });
            *bend = core::array::from_fn(|axis| {
                (pull_m[axis] - proximal_pull_m[axis]) / section.cable_radius_m
            });
            proximal_pull_m = pull_m;
        }
        configuration
    }

    /// The shape from cable strokes (m), as [`Self::cable_strokes`] returns them. An error common to the three cables
    /// of a section is ignored. Linear in the strokes.
    pub fn bend_from_cable_strokes(&self, strokes_m: &[f64; CABLES_MAX]) -> Configuration {
        let mut lengths_m = self.cable_lengths(&Configuration::straight(self.section_count()));
        for (length_m, stroke_m) in lengths_m.iter_mut().zip(strokes_m) {
            *length_m += stroke_m;
        }
        self.bend_from_cable_lengths(&lengths_m)
    }

    /// `s_j · (cos β_ij, sin β_ij)` for each cable: the linear part of lengths and speeds.
    fn cable_shortening(&self, bends: &[[f64; 2]]) -> [f64; CABLES_MAX] {
        self.cable_shortening_wide(|i| Wide([bends[i / 2][i % 2]]))
            .map(|shortening| shortening.0[0])
    }

    /// Shortening of each cable relative to the straight robot (m), for W shapes side by side, in the order of
    /// [`Self::cable_lengths`]. `bend_rad(i)` is the i-th bend-vector component of each (rad). Linear: rates (rad/s)
    /// give the speed at which cables are pulled (m/s). 3n are used, the rest are 0.
    #[doc(hidden)]
    #[inline(always)]
    pub(crate) fn cable_shortening_wide<const W: usize>(
        &self,
        bend_rad: impl Fn(usize) -> Wide<W>,
    ) -> [Wide<W>; CABLES_MAX] {
        let zero = Wide::splat(0.0);
        let mut shortening = [zero; CABLES_MAX];
        let mut pull = [zero; 2];
        for (j, section) in self.sections().iter().enumerate() {
            for axis in 0..2 {
                pull[axis] = pull[axis] + bend_rad(2 * j + axis) * section.cable_radius_m;
            }
            for (cable, [cos, sin]) in self.cable_directions()[j].iter().enumerate() {
                shortening[3 * j + cable] = pull[0] * *cos + pull[1] * *sin;
            }
        }
        shortening
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{RobotParameters, SECTIONS_MAX};

    /// Robots whose sections differ in every parameter that affects the cables, each with a shape.
    fn robots_and_shapes() -> impl Strategy<Value = (Robot, Configuration)> {
        let section = (
            0.05..0.5_f64,
            0.005..0.04_f64,
            -6.0..6.0_f64,
            [-2.2..2.2_f64, -2.2..2.2_f64],
        );
        prop::collection::vec(section, 1..=SECTIONS_MAX).prop_map(|sections| {
            let mut parameters = RobotParameters::paper(sections.len());
            let mut bend_rad = Vec::new();
            for (target, (length_m, radius_m, offset_rad, bend)) in
                parameters.sections.iter_mut().zip(sections)
            {
                target.length_m = length_m;
                target.cable_radius_m = radius_m;
                target.cable_offset_rad = offset_rad;
                bend_rad.extend(bend);
            }
            (
                Robot::new(&parameters).unwrap(),
                Configuration::from_slice(&bend_rad).unwrap(),
            )
        })
    }

    proptest! {
        #[test]
        fn lengths_give_the_shape_back((robot, shape) in robots_and_shapes()) {
            let back = robot.bend_from_cable_lengths(&robot.cable_lengths(&shape));
            for (found, expected) in back.as_slice().iter().zip(shape.as_slice()) {
                // Rounding of a 3 m length over the smallest radius, 5 mm.
                prop_assert!((found - expected).abs() < 3e-13, "{found} for {expected}");
            }
        }

        #[test]
        fn the_three_cables_of_a_section_sum_to_three_backbones((robot, shape) in robots_and_shapes()) {
            let lengths_m = robot.cable_lengths(&shape);
            let mut backbone_m = 0.0;
            for (cables, section) in lengths_m.chunks(3).zip(robot.sections()) {
                backbone_m += section.length_m;
                prop_assert!((cables.iter().sum::<f64>() - 3.0 * backbone_m).abs() < 5e-15);
            }
            for unused in &lengths_m[robot.cable_count()..] {
                prop_assert_eq!(unused.to_bits(), 0);
            }
        }

        #[test]
        fn speeds_are_the_slope_of_the_lengths((robot, shape) in robots_and_shapes(), rate in -2.0..2.0_f64) {
            let mut rates = BendRates::zero(shape.section_count());
            for (i, component) in rates.as_mut_slice().iter_mut().enumerate() {
                *component = rate * (1.0 + i as f64).sin();
            }
            let moved = shape.advanced(&rates, 1.0);
            let (before, after) = (robot.cable_lengths(&shape), robot.cable_lengths(&moved));
            for (i, speed_m_s) in robot.cable_speeds(&rates).iter().enumerate() {
                prop_assert!((after[i] - before[i] - speed_m_s).abs() < 1e-14);
            }
        }

        #[test]
        fn strokes_are_lengths_minus_those_of_the_straight_robot((robot, shape) in robots_and_shapes()) {
            let straight = robot.cable_lengths(&Configuration::straight(shape.section_count()));
            let bent = robot.cable_lengths(&shape);
            for (i, stroke_m) in robot.cable_strokes(&shape).iter().enumerate() {
                prop_assert!((bent[i] - straight[i] - stroke_m).abs() < 1e-15);
            }
        }

        #[test]
        fn an_error_common_to_a_sections_cables_changes_nothing((robot, shape) in robots_and_shapes(), error_m in -0.01..0.01_f64) {
            let stretched = robot.cable_lengths(&shape).map(|length_m| length_m + error_m);
            for (found, expected) in robot.bend_from_cable_lengths(&stretched).as_slice().iter().zip(shape.as_slice()) {
                prop_assert!((found - expected).abs() < 3e-13);
            }
        }

        #[test]
        fn the_shape_found_is_the_least_squares_one((robot, shape) in robots_and_shapes(), noise_m in -0.002..0.002_f64) {
            // One section: the residual must be orthogonal to the columns of the linear map.
            let parameters = RobotParameters { sections: vec![robot.sections()[0]], ..RobotParameters::paper(1) };
            let robot = Robot::new(&parameters).unwrap();
            let mut measured = robot.cable_lengths(&shape);
            measured[1] += noise_m;
            let fitted = robot.cable_lengths(&robot.bend_from_cable_lengths(&measured));
            for unit in [[1.0, 0.0], [0.0, 1.0]] {
                let column = robot.cable_speeds(&BendRates::from_slice(&unit).unwrap());
                let along: f64 = (0..3).map(|i| (measured[i] - fitted[i]) * column[i]).sum();
                prop_assert!(along.abs() < 1e-16, "{along:e}");
            }
        }
    }

    #[test]
    fn bending_towards_a_cable_shortens_it_by_radius_times_bend() {
        let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
        let lengths_m =
            robot.cable_lengths(&Configuration::from_bend_angles(&[[0.8, 0.0], [0.0; 2]]));
        assert!((lengths_m[0] - (0.3 - 0.0125 * 0.8)).abs() < 1e-16);
        // The second section's first cable passes the bent one at 40°.
        assert!((lengths_m[3] - (0.6 - 0.0125 * 0.8 * 40.0_f64.to_radians().cos())).abs() < 2e-16);
    }
}
