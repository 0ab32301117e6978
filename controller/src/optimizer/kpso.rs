//! Knowledge-based particle swarm optimisation, Eq. 6-7 of the paper.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{Bounds, Budget, Candidate, Incumbent, Problem};

/// How a particle's velocity follows from its last one, v ← χ (w v + c₁ρ₁(p - x) + c₂ρ₂(g - x)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum VelocityRule {
    /// χ = 1 and the inertia w of the settings (Shi & Eberhart 1998).
    #[default]
    Inertia,
    /// χ from c₁ + c₂ > 4 so that the swarm contracts (Clerc & Kennedy 2002).
    Constriction,
    /// χ = w = 1: Eq. 6 as printed. Its second moment grows by 1.15 an iteration at c = 1.2, so the
    /// velocity limit and the box are all that hold it together.
    Verbatim,
}

/// What tunes [`Kpso`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KpsoSettings {
    /// Particles, the knowledge candidates among them.
    pub size: usize,
    /// Iterations.
    pub iterations: u32,
    /// Velocity rule.
    pub rule: VelocityRule,
    /// Inertia w of [`VelocityRule::Inertia`].
    pub inertia: f64,
    /// Cognitive coefficient c₁.
    pub cognitive: f64,
    /// Social coefficient c₂.
    pub social: f64,
    /// Iterations without improvement after which the swarm is regenerated; 0: never.
    pub regenerate_after: u32,
    /// A cost at or below this counts as zero and ends the search.
    pub cost_tolerance: f64,
}

/// A swarm. Memory for the largest one is taken at construction.
#[derive(Debug, Clone)]
pub struct Kpso {
    dimension: usize,
    count: usize,
    positions: Vec<f64>,
    velocities: Vec<f64>,
    best_positions: Vec<f64>,
    best_costs: Vec<f64>,
}

/// Scattered particles start at distances between the whole box and this part of it, spaced
/// evenly in the logarithm: the solution of the last cycle is as near as the reference is smooth,
/// which nobody knows beforehand.
const SCATTER_NEAREST: f64 = 1e-6;
/// A particle may cross at most this part of the box in one iteration.
const VELOCITY_LIMIT: f64 = 0.5;

impl Kpso {
    /// Room for `size` particles of `dimension` unknowns.
    pub fn with_capacity(size: usize, dimension: usize) -> Self {
        Self {
            dimension: 0,
            count: 0,
            positions: vec![0.0; size * dimension],
            velocities: vec![0.0; size * dimension],
            best_positions: vec![0.0; size * dimension],
            best_costs: vec![0.0; size],
        }
    }

    /// Searches around the incumbent while the budget lasts, and returns the iterations begun.
    ///
    /// `knowledge` holds the candidates that the caller has judged already, `dimension` values each;
    /// they become the first particles.
    #[expect(
        clippy::too_many_arguments,
        reason = "the parts of Fig. 1, each of another owner"
    )]
    pub fn search<P: Problem, F: FnMut() -> bool>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        settings: &KpsoSettings,
        knowledge: &[f64],
        seed: u64,
        budget: &mut Budget<F>,
        incumbent: &mut Incumbent,
    ) -> u32 {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        self.dimension = problem.dimension();
        self.count = settings.size.min(self.best_costs.len());
        self.settle(knowledge, incumbent);
        self.scatter(
            knowledge.len() / self.dimension,
            bounds,
            incumbent,
            &mut rng,
        );
        let mut iterations = 0;
        let mut stagnant = 0;
        while iterations < settings.iterations && incumbent.cost() > settings.cost_tolerance {
            let Some(improved) = self.judge(problem, budget, incumbent) else {
                break;
            };
            iterations += 1;
            stagnant = if improved { 0 } else { stagnant + 1 };
            if settings.regenerate_after > 0 && stagnant >= settings.regenerate_after {
                self.scatter(1, bounds, incumbent, &mut rng);
                stagnant = 0;
            } else {
                self.fly(settings, bounds, incumbent, &mut rng);
            }
        }
        iterations
    }

    /// Puts the knowledge candidates in the first places.
    fn settle(&mut self, knowledge: &[f64], incumbent: &Incumbent) {
        let known = (knowledge.len() / self.dimension).min(self.count);
        let values = known * self.dimension;
        self.positions[..values].copy_from_slice(&knowledge[..values]);
        self.best_positions[..values].copy_from_slice(&knowledge[..values]);
        self.velocities[..values].fill(0.0);
        // They never beat the incumbent, which has seen them; their own cost is found when judged.
        self.best_costs[..known].fill(f64::INFINITY);
        debug_assert_eq!(incumbent.z().len(), self.dimension);
    }

    /// Draws the particles from `first` on around the incumbent, at log-spaced distances.
    fn scatter(
        &mut self,
        first: usize,
        bounds: &Bounds,
        incumbent: &Incumbent,
        rng: &mut Xoshiro256PlusPlus,
    ) {
        let drawn = self.count.saturating_sub(first);
        for particle in first..self.count {
            let place = (particle - first) as f64 / (drawn.max(2) - 1) as f64;
            let reach = SCATTER_NEAREST.powf(place);
            let range = particle * self.dimension..(particle + 1) * self.dimension;
            for (i, at) in range.clone().enumerate() {
                let half_width = 0.5 * (bounds.upper()[i] - bounds.lower()[i]) * reach;
                self.positions[at] = incumbent.z()[i] + half_width * symmetric(rng);
                self.velocities[at] = half_width * symmetric(rng);
            }
            bounds.project(&mut self.positions[range.clone()]);
            self.best_positions[range.clone()].copy_from_slice(&self.positions[range]);
            self.best_costs[particle] = f64::INFINITY;
        }
    }

    /// Evaluates every particle. `None`: the budget ended it. Otherwise whether the best improved.
    fn judge<P: Problem, F: FnMut() -> bool>(
        &mut self,
        problem: &P,
        budget: &mut Budget<F>,
        incumbent: &mut Incumbent,
    ) -> Option<bool> {
        let quantum = problem.evaluations_per_quantum();
        let mut improved = false;
        for particle in 0..self.count {
            if particle % quantum == 0 && !budget.left() {
                return None;
            }
            let range = particle * self.dimension..(particle + 1) * self.dimension;
            let position = &self.positions[range.clone()];
            let cost = problem.cost(position);
            if cost < self.best_costs[particle] {
                self.best_costs[particle] = cost;
                self.best_positions[range].copy_from_slice(position);
            }
            improved |= incumbent.offer(position, cost, Candidate::Swarm);
        }
        Some(improved)
    }

    /// Eq. 6 and 7 for every particle.
    fn fly(
        &mut self,
        settings: &KpsoSettings,
        bounds: &Bounds,
        incumbent: &Incumbent,
        rng: &mut Xoshiro256PlusPlus,
    ) {
        let (constriction, inertia) = settings.factors();
        for particle in 0..self.count {
            for i in 0..self.dimension {
                let at = particle * self.dimension + i;
                let (low, high) = (bounds.lower()[i], bounds.upper()[i]);
                let x = self.positions[at];
                let to_own_best = self.best_positions[at] - x;
                let to_global_best = incumbent.z()[i] - x;
                let pull = settings.cognitive * rng.random::<f64>() * to_own_best
                    + settings.social * rng.random::<f64>() * to_global_best;
                let limit = VELOCITY_LIMIT * (high - low);
                let velocity =
                    (constriction * (inertia * self.velocities[at] + pull)).clamp(-limit, limit);
                let target = (x + velocity).clamp(low, high);
                self.positions[at] = target;
                // A particle that meets the border loses what it would have gone beyond.
                self.velocities[at] = target - x;
            }
        }
    }
}

impl KpsoSettings {
    /// Constriction χ and inertia w of the velocity rule.
    fn factors(&self) -> (f64, f64) {
        match self.rule {
            VelocityRule::Inertia => (1.0, self.inertia),
            VelocityRule::Verbatim => (1.0, 1.0),
            VelocityRule::Constriction => {
                let c = (self.cognitive + self.social).max(4.0 + 1e-9);
                (2.0 / (c - 2.0 + (c * c - 4.0 * c).sqrt()), 1.0)
            }
        }
    }
}

/// Uniform in [-1, 1).
fn symmetric(rng: &mut Xoshiro256PlusPlus) -> f64 {
    2.0 * rng.random::<f64>() - 1.0
}

/// The seed of one cycle's swarm: a mix of the configured seed and the number of the cycle, so that a
/// cycle can be repeated without those before it (`SplitMix64`, Steele, Lea & Flood 2014).
pub fn cycle_seed(seed: u64, cycle: u64) -> u64 {
    let mut z = seed ^ cycle.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimizer::LinearModel;

    /// Rastrigin's function: many local minima, the global one at `centre`.
    struct Rastrigin {
        centre: f64,
    }

    impl Problem for Rastrigin {
        fn dimension(&self) -> usize {
            2
        }
        fn rows(&self) -> usize {
            0
        }
        fn cost(&self, z: &[f64]) -> f64 {
            z.iter()
                .map(|z| z - self.centre)
                .map(|d| d * d + 1.0 - (std::f64::consts::TAU * d).cos())
                .sum()
        }
        fn linearise(&self, _: &[f64], _: &mut LinearModel) {}
        fn evaluations_per_quantum(&self) -> usize {
            4
        }
    }

    fn settings(rule: VelocityRule) -> KpsoSettings {
        KpsoSettings {
            size: 24,
            iterations: 200,
            rule,
            inertia: 0.6,
            cognitive: 1.5,
            social: 1.5,
            regenerate_after: 20,
            cost_tolerance: 0.0,
        }
    }

    fn search(settings: &KpsoSettings, seed: u64, quanta: u32) -> Incumbent {
        let problem = Rastrigin { centre: 1.7 };
        let mut bounds = Bounds::with_capacity(2);
        bounds.set_symmetric(&std::iter::repeat_n(5.0, 2), 1);
        let mut incumbent = Incumbent::with_capacity(2);
        incumbent.restart(&[-4.0, 4.0], problem.cost(&[-4.0, 4.0]));
        let mut budget = Budget::of_quanta(quanta);
        Kpso::with_capacity(24, 2).search(
            &problem,
            &bounds,
            settings,
            &[],
            seed,
            &mut budget,
            &mut incumbent,
        );
        assert!(bounds.contains(incumbent.z()));
        incumbent
    }

    #[test]
    fn finds_the_global_minimum_among_many() {
        let found = (0..10)
            .filter(|&seed| search(&settings(VelocityRule::Inertia), seed, u32::MAX).cost() < 1e-6)
            .count();
        assert!(found >= 9, "{found} of 10");
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_does_not() {
        let kpso = settings(VelocityRule::Constriction);
        let bits = |seed| {
            search(&kpso, seed, 60)
                .z()
                .iter()
                .map(|z| z.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(7), bits(7));
        assert_ne!(bits(7), bits(8));
    }

    #[test]
    fn more_budget_is_never_worse() {
        let mut last = f64::INFINITY;
        for quanta in 0..80 {
            let cost = search(&settings(VelocityRule::Inertia), 3, quanta).cost();
            assert!(cost <= last, "{quanta}: {cost} > {last}");
            last = cost;
        }
    }

    #[test]
    fn constriction_is_clerc_and_kennedys() {
        let (chi, _) = KpsoSettings {
            cognitive: 2.05,
            social: 2.05,
            ..settings(VelocityRule::Constriction)
        }
        .factors();
        assert!((chi - 0.7298).abs() < 1e-4, "{chi}");
    }

    #[test]
    fn cycle_seeds_differ() {
        let seeds: std::collections::BTreeSet<_> =
            (0..1000).map(|cycle| cycle_seed(1, cycle)).collect();
        assert_eq!(seeds.len(), 1000);
    }
}
