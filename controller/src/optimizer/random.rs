use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::wide::Wide;

/// W independent xoshiro256++ generators (Blackman & Vigna 2021), one in each lane, so that a
/// particle's random numbers do not depend on how many lanes there are.
#[derive(Debug, Clone, Copy)]
pub(super) struct RandomLanes<const W: usize> {
    state: [[u64; W]; 4],
}

/// Takes the high 52 bits of a number as the fraction of one between 1 and 2.
const ONE_TO_TWO: u64 = 0x3FF0_0000_0000_0000;

impl<const W: usize> RandomLanes<W> {
    /// Generators of the particles `first_particle`, `first_particle + 1`, …
    pub(super) fn seed(seed: u64, first_particle: usize) -> Self {
        let mut state = [[0; W]; 4];
        for lane in 0..W {
            let particle = (first_particle + lane) as u64;
            let mut seeder = Xoshiro256PlusPlus::seed_from_u64(super::cycle_seed(seed, particle));
            for word in &mut state {
                word[lane] = seeder.random();
            }
        }
        Self { state }
    }

    /// Uniform in [0, 1), 52 bits.
    #[inline(always)]
    pub(super) fn unit(&mut self) -> Wide<W> {
        let mut unit = [0.0; W];
        for lane in 0..W {
            let (s0, s1) = (self.state[0][lane], self.state[1][lane]);
            let (s2, s3) = (self.state[2][lane], self.state[3][lane]);
            let result = s0.wrapping_add(s3).rotate_left(23).wrapping_add(s0);
            let (s2, s3, shifted) = (s2 ^ s0, s3 ^ s1, s1 << 17);
            self.state[1][lane] = s1 ^ s2;
            self.state[0][lane] = s0 ^ s3;
            self.state[2][lane] = s2 ^ shifted;
            self.state[3][lane] = s3.rotate_left(45);
            unit[lane] = f64::from_bits((result >> 12) | ONE_TO_TWO) - 1.0;
        }
        Wide(unit)
    }

    /// Uniform in [-1, 1).
    #[inline(always)]
    pub(super) fn symmetric(&mut self) -> Wide<W> {
        self.unit() * 2.0 + -1.0
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use super::*;

    #[test]
    fn each_lane_is_xoshiro256_plus_plus() {
        let mut lanes = RandomLanes::<4>::seed(7, 10);
        for lane in 0..4 {
            let mut seed = [0; 32];
            for (bytes, word) in seed.chunks_exact_mut(8).zip(lanes.state) {
                bytes.copy_from_slice(&word[lane].to_le_bytes());
            }
            let mut reference = Xoshiro256PlusPlus::from_seed(seed);
            let mut copy = lanes;
            for _ in 0..100 {
                let expected = (reference.next_u64() >> 12) as f64 / 2.0_f64.powi(52);
                assert_eq!(copy.unit().0[lane], expected);
            }
        }
        assert!(
            lanes
                .symmetric()
                .0
                .iter()
                .all(|value| (-1.0..1.0).contains(value))
        );
    }

    #[test]
    fn a_particle_draws_the_same_whatever_the_number_of_lanes() {
        let mut wide = RandomLanes::<8>::seed(3, 8);
        let mut narrow = RandomLanes::<1>::seed(3, 13);
        for _ in 0..50 {
            assert_eq!(wide.unit().0[5], narrow.unit().0[0]);
        }
    }
}
