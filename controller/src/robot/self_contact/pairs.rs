//! The pairs of sections that can touch, now or along a motion.

use core::f64::consts::PI;

use super::{norm, overlap_m};
use crate::robot::{Configuration, Robot, SECTIONS_MAX};

/// Pairs of sections: bit `other` of the entry of `one`, which is nearer to the base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pairs {
    others: [u8; SECTIONS_MAX],
    /// Those between which an arc is narrower than the thickest body.
    narrow: [u8; SECTIONS_MAX],
}

/// The pairs that may overlap along a motion, each after a share of it; infinite: not at all.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearPairs {
    turned: Pairs,
    after: [[f64; SECTIONS_MAX]; SECTIONS_MAX],
}

impl NearPairs {
    /// Those that may overlap at this share of the motion.
    pub(crate) fn at(&self, share: f64) -> Pairs {
        let mut pairs = self.turned;
        for (others, after) in pairs.others.iter_mut().zip(&self.after) {
            for (other, after) in after.iter().enumerate() {
                if share < *after {
                    *others &= !(1 << other);
                }
            }
        }
        pairs
    }
}

impl Pairs {
    const NONE: Self = Self {
        others: [0; SECTIONS_MAX],
        narrow: [0; SECTIONS_MAX],
    };

    pub(crate) fn is_empty(&self) -> bool {
        self.others == [0; SECTIONS_MAX]
    }

    pub(super) fn iter(self) -> impl Iterator<Item = [usize; 2]> {
        (0..SECTIONS_MAX).flat_map(move |one| {
            let is_in = move |other: &usize| self.others[one] & (1 << other) != 0;
            let others = (one + 1..SECTIONS_MAX).filter(is_in);
            others.map(move |other| [one, other])
        })
    }

    pub(super) fn is_narrow(&self, [one, other]: [usize; 2]) -> bool {
        self.narrow[one] & (1 << other) != 0
    }

    /// Whether any pair has this section.
    pub(super) fn have(&self, section: usize) -> bool {
        let bit = 1 << section;
        self.others[section] != 0 || self.others.iter().any(|others| others & bit != 0)
    }
}

impl Robot {
    /// The pairs of sections whose parts may touch, by the bends alone, while each bend vector is at most `change_rad` (rad) from that of `at`.
    /// None of bends that are no numbers.
    pub(super) fn turned_pairs(
        &self,
        at: &Configuration,
        change_rad: &[f64; SECTIONS_MAX],
    ) -> Pairs {
        let mut pairs = Pairs::NONE;
        let mut bends_rad = [0.0; SECTIONS_MAX];
        let (mut all_rad, mut thickest_m, mut is_wide) = (0.0, 0.0_f64, true);
        for (j, section) in self.sections().iter().enumerate() {
            bends_rad[j] = norm(at.section(j)) + change_rad[j];
            all_rad += bends_rad[j];
            thickest_m = thickest_m.max(section.body_radius_m);
        }
        for (section, bend_rad) in self.sections().iter().zip(bends_rad) {
            is_wide &= bend_rad * thickest_m <= section.length_m;
        }
        if (all_rad <= PI && is_wide) || !at.is_finite() {
            return pairs;
        }
        for one in 0..self.section_count() {
            let (mut turned_rad, mut narrowest_m, mut thickest_m) = (0.0, f64::INFINITY, 0.0_f64);
            for (other, section) in self.sections().iter().enumerate().skip(one) {
                turned_rad += bends_rad[other];
                narrowest_m = narrowest_m.min(section.length_m / bends_rad[other]);
                thickest_m = thickest_m.max(section.body_radius_m);
                let is_narrow = narrowest_m < thickest_m;
                let is_turned = turned_rad > PI;
                let bit = |is_in: bool| u8::from(is_in && other > one) << other;
                pairs.others[one] |= bit(is_turned || is_narrow);
                pairs.narrow[one] |= bit(is_narrow);
            }
        }
        pairs
    }

    /// The pairs of sections that may overlap by more than `above_m` (m) while the bend vector of section k moves by up to `change_rad[k]` (rad)
    /// from a place up to `beside_rad[k]` beside that of `at`: a pair that is left out at a share of the change does not.
    ///
    /// Seen from a part of one section, a part of the next ones moves by at most [`travel_m`](Self::travel_m) without the bends before.
    pub(crate) fn near_pairs(
        &self,
        at: &Configuration,
        beside_rad: &[f64; SECTIONS_MAX],
        change_rad: &[f64; SECTIONS_MAX],
        above_m: f64,
    ) -> NearPairs {
        let all_rad = core::array::from_fn(|j| beside_rad[j] + change_rad[j]);
        let turned = self.turned_pairs(at, &all_rad);
        let mut near = NearPairs {
            turned,
            after: [[f64::INFINITY; SECTIONS_MAX]; SECTIONS_MAX],
        };
        if turned.is_empty() {
            return near;
        }
        let backbones = self.backbones(turned, at, &all_rad);
        let (mut beside_rad, mut change_rad) = (*beside_rad, *change_rad);
        let mut from = 0;
        for [one, other] in turned.iter() {
            beside_rad[from..one].fill(0.0);
            change_rad[from..one].fill(0.0);
            from = one;
            let [beside_m, way_m] =
                [&beside_rad, &change_rad].map(|change_rad| self.travel_m(change_rad)[other]);
            let is_narrow = turned.is_narrow([one, other]);
            let (now_m, least_m) = (above_m - beside_m, above_m - beside_m - way_m);
            let bound_m = overlap_m(&backbones, [one, other], is_narrow, least_m, Some(now_m));
            if let Some(bound_m) = bound_m {
                near.after[one][other] = (now_m - bound_m) / way_m;
            }
        }
        near
    }
}
