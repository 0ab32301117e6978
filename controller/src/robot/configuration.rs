//! Bends of a robot and their rates of change, as two types, so that an angle cannot be passed as a rate.
//!
//! Invariant: components beyond the section count are zero. Equality and copies therefore compare and copy whole
//! arrays, and a robot with more sections takes the missing ones as straight.

use super::{COORDINATES_MAX, SECTIONS_MAX};

/// Storage and access, shared by both types.
macro_rules! bend_vector {
    ($(#[$doc:meta])* $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $name {
            components: [f64; COORDINATES_MAX],
            section_count: usize,
        }

        impl $name {
            /// All components zero. `section_count` is held within 1 to 6.
            fn zeros(section_count: usize) -> Self {
                Self { components: [0.0; COORDINATES_MAX], section_count: section_count.clamp(1, SECTIONS_MAX) }
            }

            #[doc = concat!("From (u1, v1, u2, v2, …) ", $unit, ", base first. `None` unless the length is even and 2 to 12.")]
            /// Values are not checked, and may be NaN: see [`Self::is_finite`].
            pub fn from_slice(components: &[f64]) -> Option<Self> {
                let length = components.len();
                if length == 0 || length > COORDINATES_MAX || !length.is_multiple_of(2) {
                    return None;
                }
                let mut vector = Self::zeros(length / 2);
                vector.as_mut_slice().copy_from_slice(components);
                Some(vector)
            }

            #[doc = concat!("(u1, v1, u2, v2, …) ", $unit, ", base first: 2n components.")]
            pub fn as_slice(&self) -> &[f64] {
                &self.components[..2 * self.section_count]
            }

            #[doc = concat!("(u1, v1, u2, v2, …) ", $unit, ", base first: 2n components.")]
            pub fn as_mut_slice(&mut self) -> &mut [f64] {
                &mut self.components[..2 * self.section_count]
            }

            /// The components of all [`SECTIONS_MAX`] sections; those beyond the section count are zero.
            pub(crate) fn pairs(&self) -> &[[f64; 2]] {
                self.components.as_chunks::<2>().0
            }

            /// Number of sections n, 1 to 6.
            pub fn section_count(&self) -> usize {
                self.section_count
            }

            #[doc = concat!("(u, v) of section `j` ", $unit, ", 0 at the base. Zero for a section that is not there.")]
            pub fn section(&self, j: usize) -> [f64; 2] {
                self.pairs().get(j).copied().unwrap_or_default()
            }

            /// True if no component is NaN or infinite.
            pub fn is_finite(&self) -> bool {
                self.components.iter().all(|component| component.is_finite())
            }
        }
    };
}

bend_vector! {
    /// The shape of a robot: the bend vector (u, v) = θ (cos φ, sin φ) (rad) of each section, base first.
    ///
    /// Any finite value is a shape. A robot limits each section's bend to `bend_max_rad`. §1 of docs/model.md.
    Configuration, "(rad)"
}

bend_vector! {
    /// Rates of change of the shape: (u̇, v̇) (rad/s) of each section, base first. They are the control input of the
    /// robot.
    BendRates, "(rad/s)"
}

impl Configuration {
    /// The straight robot. `section_count` is clamped to 1 to 6.
    pub fn straight(section_count: usize) -> Self {
        Self::zeros(section_count)
    }

    /// Distance to another configuration of as many sections, in all bends \[rad\].
    pub fn distance_rad(&self, other: &Self) -> f64 {
        let pairs = self.as_slice().iter().zip(other.as_slice());
        pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    }

    /// From components (rad), which must be zero beyond `section_count`, 1 to 6.
    pub(crate) fn padded(components: [f64; COORDINATES_MAX], section_count: usize) -> Self {
        debug_assert!((1..=SECTIONS_MAX).contains(&section_count));
        debug_assert!(
            components[2 * section_count..]
                .iter()
                .all(|bend| *bend == 0.0)
        );
        Self {
            components,
            section_count,
        }
    }

    /// From the paper's coordinates: (θ, φ) (rad) of each section, base first, 1 to 6 sections. Surplus sections are
    /// ignored; an empty slice gives one straight section. A negative θ is legal and bends towards φ + π.
    pub fn from_bend_angles(bend_angles_rad: &[[f64; 2]]) -> Self {
        let mut configuration = Self::zeros(bend_angles_rad.len());
        let (sections, _) = configuration.as_mut_slice().as_chunks_mut::<2>();
        for (section, [bend_rad, direction_rad]) in sections.iter_mut().zip(bend_angles_rad) {
            let (sin, cos) = direction_rad.sin_cos();
            *section = [bend_rad * cos, bend_rad * sin];
        }
        configuration
    }

    /// Bend θ of section `j` (rad), 0 at the base; never negative.
    pub fn bend_rad(&self, j: usize) -> f64 {
        let [u, v] = self.section(j);
        u.hypot(v)
    }

    /// Direction φ in which section `j` bends (rad), in [-π, π]; 0 for a straight section.
    pub fn direction_rad(&self, j: usize) -> f64 {
        let [u, v] = self.section(j);
        v.atan2(u)
    }

    /// The shape after `dt_s` (s) at constant rates. Exact, because the bend vector is linear in time. Rates of
    /// sections beyond this shape's are ignored.
    #[must_use]
    pub fn advanced(&self, rates: &BendRates, dt_s: f64) -> Self {
        let mut next = *self;
        for (component, rate) in next.as_mut_slice().iter_mut().zip(rates.as_slice()) {
            *component += rate * dt_s;
        }
        next
    }
}

impl BendRates {
    /// A robot at rest. `section_count` is clamped to 1 to 6.
    pub fn zero(section_count: usize) -> Self {
        Self::zeros(section_count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_two_to_twelve_components_in_pairs_are_a_shape() {
        let many = [0.5; 14];
        for length in 0..=14 {
            let valid = (2..=12).contains(&length) && length % 2 == 0;
            assert_eq!(
                Configuration::from_slice(&many[..length]).is_some(),
                valid,
                "{length}"
            );
            assert_eq!(
                BendRates::from_slice(&many[..length]).is_some(),
                valid,
                "{length}"
            );
        }
        assert_eq!(Configuration::straight(0).section_count(), 1);
        assert_eq!(BendRates::zero(7).section_count(), SECTIONS_MAX);
    }

    #[test]
    fn bend_and_direction_come_back_from_bend_angles() {
        let shape = Configuration::from_bend_angles(&[[0.6, -2.0], [-1.1, 0.7], [0.0, 1.0]]);
        assert_eq!(shape.section_count(), 3);
        assert!(
            (shape.bend_rad(0) - 0.6).abs() < 1e-15 && (shape.direction_rad(0) + 2.0).abs() < 1e-15
        );
        let opposite = 0.7 - core::f64::consts::PI;
        assert!(
            (shape.bend_rad(1) - 1.1).abs() < 1e-15
                && (shape.direction_rad(1) - opposite).abs() < 1e-15
        );
        assert!(shape.bend_rad(2) == 0.0 && shape.direction_rad(2) == 0.0);
        for absent in [5, 99] {
            assert_eq!(shape.section(absent).map(f64::to_bits), [0; 2]);
        }
    }

    #[test]
    fn a_nan_is_detected_in_every_component() {
        for i in 0..6 {
            for bad in [f64::NAN, f64::INFINITY] {
                let mut shape = Configuration::straight(3);
                assert!(shape.is_finite());
                shape.as_mut_slice()[i] = bad;
                assert!(!shape.is_finite());
            }
        }
    }

    #[test]
    fn one_long_step_equals_many_short_ones() {
        let start = Configuration::from_bend_angles(&[[0.6, -2.0], [1.1, 0.7]]);
        let rates = BendRates::from_slice(&[0.25, -0.5, 1.0, 2.0]).unwrap();
        let mut stepped = start;
        for _ in 0..8 {
            stepped = stepped.advanced(&rates, 0.125);
        }
        for (many, one) in stepped
            .as_slice()
            .iter()
            .zip(start.advanced(&rates, 1.0).as_slice())
        {
            assert!((many - one).abs() < 1e-15);
        }
    }

    #[test]
    fn rates_of_absent_sections_have_no_effect() {
        let rates = BendRates::from_slice(&[1.0; 6]).unwrap();
        let moved = Configuration::straight(1).advanced(&rates, 1.0);
        assert_eq!(moved, Configuration::from_slice(&[1.0, 1.0]).unwrap());
    }
}
