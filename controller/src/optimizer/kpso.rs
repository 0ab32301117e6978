//! Knowledge-based particle swarm optimisation, Eq. 6-7 of the paper.

use pulp::WithSimd;

use super::random::RandomLanes;
use super::{Bounds, Budget, Candidate, Cost, Incumbent, Simd};
use crate::wide::{Aligned, LANES, Wide, any_set};

/// How a particle's velocity follows from its last one, v ← χ (w v + c₁ρ₁(p - x) + c₂ρ₂(g - x)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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

/// Settings of [`Kpso`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct KpsoSettings {
    /// Number of particles, knowledge candidates included.
    pub(crate) size: usize,
    /// Largest number of iterations.
    pub(crate) iterations: u32,
    pub(crate) rule: VelocityRule,
    /// Inertia w of [`VelocityRule::Inertia`].
    pub(crate) inertia: f64,
    /// Cognitive coefficient c₁.
    pub(crate) cognitive: f64,
    /// Social coefficient c₂.
    pub(crate) social: f64,
    /// Iterations without improvement after which the swarm is regenerated; 0: never.
    pub(crate) regenerate_after: u32,
    /// A cost at or below this counts as zero and ends the search.
    pub(crate) cost_tolerance: f64,
}

/// A particle swarm. The constructor allocates memory for the largest one.
#[derive(Debug)]
pub(crate) struct Kpso {
    simd: Simd,
    layout: SwarmLayout,
}

/// The particles, by number of lanes.
#[derive(Debug)]
enum SwarmLayout {
    #[cfg(any(test, feature = "scalar"))]
    Scalar(Swarm<1>),
    Wide(Swarm<LANES>),
}

impl Kpso {
    /// Memory for `size` particles of `dimension` unknowns, evaluated with `simd`.
    pub(crate) fn with_capacity(simd: Simd, size: usize, dimension: usize) -> Self {
        let layout = match simd {
            #[cfg(any(test, feature = "scalar"))]
            Simd::Scalar => SwarmLayout::Scalar(Swarm::with_capacity(size, dimension)),
            _ => SwarmLayout::Wide(Swarm::with_capacity(size, dimension)),
        };
        Self { simd, layout }
    }

    pub(crate) fn simd(&self) -> Simd {
        self.simd
    }

    /// Searches around the incumbent while the budget lasts, and returns the iterations begun.
    pub(crate) fn search<C: Cost>(
        &mut self,
        task: &SwarmTask<C>,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) -> u32 {
        match &mut self.layout {
            #[cfg(any(test, feature = "scalar"))]
            SwarmLayout::Scalar(swarm) => Search {
                swarm,
                task,
                budget,
                incumbent,
            }
            .with_simd(pulp::Scalar),
            SwarmLayout::Wide(swarm) => self.simd.run(Search {
                swarm,
                task,
                budget,
                incumbent,
            }),
        }
    }
}

/// Inputs of one search.
#[derive(Debug)]
pub(crate) struct SwarmTask<'a, C> {
    pub(crate) cost: &'a C,
    /// Bounds of the unknowns.
    pub(crate) bounds: &'a Bounds,
    /// Settings of the swarm.
    pub(crate) settings: KpsoSettings,
    /// Candidates that become the first particles, `dimension` values each.
    pub(crate) knowledge: &'a [f64],
    /// Origin of each candidate.
    pub(crate) origins: &'a [Candidate],
    /// Seed of the random numbers.
    pub(crate) seed: u64,
}

/// One search, compiled for an instruction set; all its functions are inlined.
struct Search<'a, 'b, C, const W: usize> {
    swarm: &'a mut Swarm<W>,
    task: &'a SwarmTask<'a, C>,
    budget: &'a mut Budget<'b>,
    incumbent: &'a mut Incumbent,
}

impl<C: Cost, const W: usize> WithSimd for Search<'_, '_, C, W> {
    type Output = u32;

    /// Fig. 1 of the paper.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, instructions: S) -> u32 {
        let Self {
            swarm,
            task,
            budget,
            incumbent,
        } = self;
        let settings = &task.settings;
        let mut left = budget.begin_quantum()
            && swarm.initialise(task, budget)
            && swarm.scatter(swarm.candidate_count, task.bounds, budget, incumbent);
        let (mut iterations, mut stagnant) = (0, 0);
        while left && iterations < settings.iterations && incumbent.cost() > settings.cost_tolerance
        {
            let before = incumbent.cost();
            let origins = if iterations == 0 { task.origins } else { &[] };
            left = swarm.evaluate(task.cost, origins, budget, incumbent, instructions);
            iterations += 1;
            stagnant = if incumbent.cost() < before {
                0
            } else {
                stagnant + 1
            };
            if iterations == settings.iterations {
                break;
            }
            if settings.regenerate_after > 0 && stagnant >= settings.regenerate_after {
                left = left && swarm.scatter(1, task.bounds, budget, incumbent);
                stagnant = 0;
            } else {
                left = left && swarm.update_particles(settings, task.bounds, budget, incumbent);
            }
        }
        iterations
    }
}

/// Particles in blocks of W, one in each lane.
#[derive(Debug)]
struct Swarm<const W: usize> {
    dimension: usize,
    count: usize,
    /// Particles set from knowledge candidates.
    candidate_count: usize,
    positions: Vec<Aligned<W>>,
    velocities: Vec<Aligned<W>>,
    best_positions: Vec<Aligned<W>>,
    best_costs: Vec<Wide<W>>,
    /// Costs of the present positions; infinite where not evaluated.
    costs: Vec<Wide<W>>,
    random: Vec<RandomLanes<W>>,
    /// Largest velocity of each unknown.
    limits: Vec<f64>,
    /// Scratch memory for the cost.
    scratch: Vec<Aligned<W>>,
}

/// Nearest distance of scattered particles, as a share of the box. The distances are evenly spaced in the
/// logarithm from the whole box down to it, because the distance of the solution is not known in advance.
const SCATTER_NEAREST: f64 = 1e-6;
/// Nominal time of seeding the generator of one particle \[ns\].
const SEEDING_NS: u32 = 15;
/// Largest change of a particle in one iteration, as a share of the box.
const VELOCITY_LIMIT: f64 = 0.5;

impl<const W: usize> Swarm<W> {
    fn with_capacity(size: usize, dimension: usize) -> Self {
        let blocks = size.div_ceil(W);
        let zero = Aligned(Wide::splat(0.0));
        Self {
            dimension: 0,
            count: 0,
            candidate_count: 0,
            positions: vec![zero; blocks * dimension],
            velocities: vec![zero; blocks * dimension],
            best_positions: vec![zero; blocks * dimension],
            best_costs: vec![zero.0; blocks],
            costs: vec![zero.0; blocks],
            random: vec![RandomLanes::seed(0, 0); blocks],
            limits: Vec::with_capacity(dimension),
            scratch: vec![zero; dimension],
        }
    }

    fn blocks(&self) -> usize {
        self.count.div_ceil(W)
    }

    /// Sizes the swarm for the task, and places the candidates first. False: the budget was spent.
    #[inline(always)]
    fn initialise<C: Cost>(&mut self, task: &SwarmTask<C>, budget: &mut Budget<'_>) -> bool {
        let knowledge = task.knowledge;
        self.dimension = task.bounds.dimension();
        self.count = task.settings.size.min(self.best_costs.len() * W);
        let widths = task.bounds.upper().iter().zip(task.bounds.lower());
        self.limits.clear();
        self.limits
            .extend(widths.map(|(high, low)| VELOCITY_LIMIT * (high - low)));
        self.candidate_count = (knowledge.len() / self.dimension).min(self.count);
        for block in 0..self.blocks() {
            if !budget.spend(SEEDING_NS * W as u32) {
                return false;
            }
            self.random[block] = RandomLanes::seed(task.seed, block * W);
            self.best_costs[block] = Wide::splat(f64::INFINITY);
            self.costs[block] = Wide::splat(f64::INFINITY);
        }
        for (particle, candidate) in knowledge
            .chunks_exact(self.dimension)
            .take(self.candidate_count)
            .enumerate()
        {
            for (i, &value) in candidate.iter().enumerate() {
                let at = particle / W * self.dimension + i;
                self.positions[at].0.0[particle % W] = value;
                self.velocities[at].0.0[particle % W] = 0.0;
            }
        }
        true
    }

    /// Draws the particles from index `first` on around the incumbent, at log-spaced distances. False: the
    /// budget was spent.
    #[inline(always)]
    fn scatter(
        &mut self,
        first: usize,
        bounds: &Bounds,
        budget: &mut Budget<'_>,
        incumbent: &Incumbent,
    ) -> bool {
        let drawn = self.count.saturating_sub(first).max(2);
        let nearer = SCATTER_NEAREST.powf(1.0 / (drawn - 1) as f64);
        let mut next_reach = 1.0;
        for block in 0..self.blocks() {
            if !budget.spend(self.block_ns()) {
                return false;
            }
            let mut chosen = [true; W];
            for (lane, chosen) in chosen.iter_mut().enumerate() {
                *chosen = block * W + lane >= first;
            }
            let reach = Wide::from_fn(|lane| {
                let reach = next_reach;
                if chosen[lane] {
                    next_reach *= nearer;
                }
                reach
            });
            let mut random = self.random[block];
            let better = self.costs[block].less_mask(self.best_costs[block]);
            for i in 0..self.dimension {
                let (low, high) = (bounds.lower()[i], bounds.upper()[i]);
                let half_width = reach * (0.5 * (high - low));
                let [aside, speed] = random.units().map(|unit| unit * 2.0 + -1.0);
                let position = Wide::splat(incumbent.z()[i]) + half_width * aside;
                let velocity = half_width * speed;
                let at = block * self.dimension + i;
                let [Aligned(x), Aligned(v)] = [&mut self.positions[at], &mut self.velocities[at]];
                let Aligned(best) = &mut self.best_positions[at];
                *best = x.masked(*best, better);
                *x = position.clamp(low, high).select(*x, chosen);
                *v = velocity.select(*v, chosen);
            }
            self.random[block] = random;
            let forgotten = Wide::splat(f64::INFINITY);
            let kept = self.costs[block].min(self.best_costs[block]);
            self.best_costs[block] = forgotten.select(kept, chosen);
        }
        true
    }

    /// Evaluates every particle; `origins` are those of the first particles. False: the budget was spent.
    #[inline(always)]
    fn evaluate(
        &mut self,
        cost: &impl Cost,
        origins: &[Candidate],
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
        instructions: impl pulp::Simd,
    ) -> bool {
        for block in 0..self.blocks() {
            let position = &self.positions[block * self.dimension..][..self.dimension];
            let scratch = &mut self.scratch;
            let evaluation = cost.evaluate(|i| position[i].0, scratch, budget, instructions);
            let Some(evaluation) = evaluation else {
                return false;
            };
            let now = evaluation.cost;
            self.costs[block] = now;
            let first = block * W;
            let particles = W.min(self.count - first);
            if !any_set(now.less_mask(Wide::splat(incumbent.cost()))) {
                incumbent.count_evaluations(particles);
                continue;
            }
            // The first of the lowest costs, as if the particles were offered one after another.
            let lane = now.first_least(particles);
            let z = |i: usize| position[i].0.0[lane];
            let origin = origins.get(first + lane).copied();
            incumbent.offer(z, &evaluation, lane, origin.unwrap_or(Candidate::Swarm));
            incumbent.count_evaluations(particles - 1);
        }
        true
    }

    /// Eq. 6 and 7 for every particle. Stores the present position first if it is the particle's best. False:
    /// the budget was spent.
    #[inline(always)]
    fn update_particles(
        &mut self,
        settings: &KpsoSettings,
        bounds: &Bounds,
        budget: &mut Budget<'_>,
        incumbent: &Incumbent,
    ) -> bool {
        let factors = settings.factors();
        for block in 0..self.blocks() {
            if !budget.spend(self.block_ns()) {
                return false;
            }
            let range = block * self.dimension..(block + 1) * self.dimension;
            let mut random = self.random[block];
            let (now, before) = (self.costs[block], self.best_costs[block]);
            let better = now.less_mask(before);
            self.best_costs[block] = now.min(before);
            let moving = self.positions[range.clone()]
                .iter_mut()
                .zip(&mut self.velocities[range.clone()])
                .zip(&mut self.best_positions[range])
                .zip(incumbent.z());
            let intervals = bounds.lower().iter().zip(bounds.upper());
            let intervals = intervals.zip(&self.limits);
            for ((((position, velocity), own_best), &global_best), ((&low, &high), &limit)) in
                moving.zip(intervals)
            {
                let x = position.0;
                own_best.0 = x.masked(own_best.0, better);
                let [own, social] = random.units();
                let pull = own * factors.cognitive * (own_best.0 - x)
                    + social * factors.social * (Wide::splat(global_best) - x);
                let desired = velocity.0 * factors.inertia + pull;
                let target = (x + desired.clamp(-limit, limit)).clamp(low, high);
                position.0 = target;
                // At a bound the velocity is only the motion inside the box.
                velocity.0 = target - x;
            }
            self.random[block] = random;
        }
        true
    }

    /// Nominal time of updating one block \[ns\].
    fn block_ns(&self) -> u32 {
        10 * self.dimension as u32
    }
}

/// Factors of a velocity rule, each multiplied by χ.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Factors {
    /// w, factor of the last velocity.
    inertia: f64,
    /// c₁, factor towards a particle's own best.
    cognitive: f64,
    /// c₂, factor towards the best of the swarm.
    social: f64,
}

impl KpsoSettings {
    fn factors(&self) -> Factors {
        let (constriction, inertia) = match self.rule {
            VelocityRule::Inertia => (1.0, self.inertia),
            VelocityRule::Verbatim => (1.0, 1.0),
            VelocityRule::Constriction => {
                let c = (self.cognitive + self.social).max(4.0 + 1e-9);
                (2.0 / (c - 2.0 + (c * c - 4.0 * c).sqrt()), 1.0)
            }
        };
        Factors {
            inertia: constriction * inertia,
            cognitive: constriction * self.cognitive,
            social: constriction * self.social,
        }
    }
}

/// The seed of one cycle's swarm, from the configured seed and the number of the cycle. So a cycle can be
/// repeated without those before it (`SplitMix64`, Steele, Lea & Flood 2014).
#[inline]
pub fn cycle_seed(seed: u64, cycle: u64) -> u64 {
    splitmix64_output(seed ^ cycle.wrapping_mul(SPLITMIX64_INCREMENT))
}

/// Increment of `SplitMix64`.
pub(super) const SPLITMIX64_INCREMENT: u64 = 0x9E37_79B9_7F4A_7C15;

/// Output function of `SplitMix64`.
#[inline(always)]
pub(super) fn splitmix64_output(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests;
