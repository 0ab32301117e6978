//! Random choices of a run, all from one seed.

use std::time::Duration;

use cdcr_controller::plant::{Flaws, RobotPreset};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A seeded generator of choices.
#[derive(Debug)]
pub(crate) struct Dice(Xoshiro256PlusPlus);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// Another generator, seeded from this one.
    pub(crate) fn split(&mut self) -> Self {
        Self::new(self.0.random())
    }

    /// True in `percent` of all cases.
    pub(crate) fn chance(&mut self, percent: u32) -> bool {
        self.0.random_range(0..100) < percent
    }

    pub(crate) fn below(&mut self, end: u32) -> u32 {
        self.0.random_range(0..end)
    }

    pub(crate) fn between(&mut self, least: f64, most: f64) -> f64 {
        self.0.random_range(least..most)
    }

    pub(crate) fn duration_ms(&mut self, least: u64, most: u64) -> Duration {
        Duration::from_micros(self.0.random_range(1000 * least..=1000 * most))
    }

    pub(crate) fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.0.random_range(0..of.len())]
    }

    /// A vector of this length in any direction.
    pub(crate) fn vector(&mut self, length: f64) -> [f64; 3] {
        loop {
            let v = [(); 3].map(|()| self.between(-1.0, 1.0));
            let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            if (0.01..=1.0).contains(&norm) {
                return v.map(|x| length * x / norm);
            }
        }
    }

    pub(crate) fn shuffle<T>(&mut self, cards: &mut [T]) {
        cards.shuffle(&mut self.0);
    }

    /// The flaws of a random preset. Unless mild, also single flaws, small ones more often than large ones.
    pub(crate) fn flaws(&mut self, is_mild: bool) -> Flaws {
        let mut flaws = self.pick(&RobotPreset::ALL).flaws();
        if is_mild {
            return flaws;
        }
        let percent = 10 + self.below(21);
        for (_, flaw, allowed) in flaws.named() {
            if self.chance(percent) {
                let (least, most) = allowed.into_inner();
                let is_negative = least < 0.0 && self.chance(50);
                let end = if is_negative { least } else { most };
                *flaw = (self.between(0.0, 1.0).powi(3) * end).clamp(least, most);
            }
        }
        flaws
    }
}
