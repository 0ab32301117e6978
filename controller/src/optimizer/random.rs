use super::kpso::{SPLITMIX64_INCREMENT, cycle_seed, splitmix64_output};
use crate::wide::Wide;

/// W independent xoshiro256+ generators (Blackman & Vigna 2021), one for each lane, so that a particle's
/// random numbers do not depend on W. Their lowest three bits are weak; here they contribute at most 2⁻²⁹.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct RandomLanes<const W: usize> {
    state: [[u64; W]; 4],
}

/// Exponent bits of a double in [1, 2).
const ONE_TO_TWO: u64 = 0x3FF0_0000_0000_0000;
/// The upper 32 bits of its fraction.
const FRACTION_32: u64 = 0x000F_FFFF_FFF0_0000;

impl<const W: usize> RandomLanes<W> {
    /// Generators for the particles `first_particle`, `first_particle + 1`, …
    #[inline(always)]
    pub(super) fn seed(seed: u64, first_particle: usize) -> Self {
        let mut seeder = Self { state: [[0; W]; 4] };
        for lane in 0..W {
            let mut own = cycle_seed(seed, (first_particle + lane) as u64);
            for word in &mut seeder.state {
                own = own.wrapping_add(SPLITMIX64_INCREMENT);
                word[lane] = splitmix64_output(own);
            }
        }
        let mut state = [[0; W]; 4];
        for word in &mut state {
            *word = seeder.draw();
        }
        Self { state }
    }

    /// The next number of each generator.
    #[inline(always)]
    fn draw(&mut self) -> [u64; W] {
        let mut drawn = [0; W];
        for lane in 0..W {
            let (s0, s1) = (self.state[0][lane], self.state[1][lane]);
            let (s2, s3) = (self.state[2][lane], self.state[3][lane]);
            drawn[lane] = s0.wrapping_add(s3);
            let (s2, s3, shifted) = (s2 ^ s0, s3 ^ s1, s1 << 17);
            self.state[1][lane] = s1 ^ s2;
            self.state[0][lane] = s0 ^ s3;
            self.state[2][lane] = s2 ^ shifted;
            self.state[3][lane] = s3.rotate_left(45);
        }
        drawn
    }

    /// Two numbers, uniform in [0, 1), of 32 bits each: the halves of one draw, which is the most expensive
    /// operation here.
    #[inline(always)]
    pub(super) fn units(&mut self) -> [Wide<W>; 2] {
        let (drawn, mut units) = (self.draw(), [[0.0; W]; 2]);
        for lane in 0..W {
            let halves = [drawn[lane] >> 12, drawn[lane] << 20];
            for (unit, fraction) in units.iter_mut().zip(halves) {
                unit[lane] = f64::from_bits((fraction & FRACTION_32) | ONE_TO_TWO) - 1.0;
            }
        }
        units.map(Wide)
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256Plus;

    use super::*;

    #[test]
    fn each_lane_is_xoshiro256_plus() {
        let lanes = RandomLanes::<4>::seed(7, 10);
        for lane in 0..4 {
            let mut seed = [0; 32];
            for (bytes, word) in seed.chunks_exact_mut(8).zip(lanes.state) {
                bytes.copy_from_slice(&word[lane].to_le_bytes());
            }
            let mut reference = Xoshiro256Plus::from_seed(seed);
            let mut copy = lanes;
            for _ in 0..100 {
                let drawn = reference.next_u64();
                let halves = [drawn >> 32, drawn & 0xFFFF_FFFF];
                let expected = halves.map(|half| half as f64 / 2.0_f64.powi(32));
                assert_eq!(copy.units().map(|unit| unit.0[lane]), expected);
            }
        }
    }

    #[test]
    fn seeds_are_the_first_numbers_of_a_generator_of_the_cycle_and_the_particle() {
        let lanes = RandomLanes::<8>::seed(7, 16);
        for lane in 0..8 {
            let seed = cycle_seed(7, 16 + lane as u64);
            let mut seeder = Xoshiro256Plus::seed_from_u64(seed);
            for word in lanes.state {
                assert_eq!(word[lane], seeder.random::<u64>());
            }
        }
    }

    #[test]
    fn a_particle_draws_the_same_whatever_the_number_of_lanes() {
        let mut wide = RandomLanes::<8>::seed(3, 8);
        let mut narrow = RandomLanes::<1>::seed(3, 13);
        for _ in 0..50 {
            assert_eq!(
                wide.units().map(|unit| unit.0[5]),
                narrow.units().map(|unit| unit.0[0])
            );
        }
    }
}
