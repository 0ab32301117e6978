//! The search on Rastrigin's function: its budget, bit-identical results on every SIMD path, and its
//! solutions.

use super::*;
use crate::optimizer::Evaluation;
use crate::wide::Aligned;

use std::cell::Cell;

/// Time of one evaluation on the simulated clock \[ns\].
const EVALUATION_NS: u32 = 500;

/// Rastrigin's function: many local minima, the global one at `centre`. Each evaluation advances a simulated
/// clock \[ns\].
struct Rastrigin {
    centre: f64,
    clock: Cell<u64>,
}

impl Cost for Rastrigin {
    fn evaluate<const W: usize>(
        &self,
        z: impl Fn(usize) -> Wide<W>,
        _: &mut [Aligned<W>],
        budget: &mut Budget<'_>,
        _: impl pulp::Simd,
    ) -> Option<Evaluation<W>> {
        let part = |i| {
            let d = z(i) + -self.centre;
            let wave = d.0.map(|d| 1.0 - (std::f64::consts::TAU * d).cos());
            d * d + Wide(wave)
        };
        let evaluation = Evaluation::from_cost(part(0) + part(1));
        if !budget.spend(EVALUATION_NS) {
            return None;
        }
        self.clock.set(self.clock.get() + u64::from(EVALUATION_NS));
        Some(evaluation)
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
    search_with(Simd::best(), settings, seed, quanta)
}

fn search_with(simd: Simd, settings: &KpsoSettings, seed: u64, quanta: u32) -> Incumbent {
    let cost = rastrigin();
    let mut bounds = Bounds::with_capacity(2);
    bounds.set_symmetric(std::iter::repeat_n(5.0, 2), 1);
    let mut incumbent = Incumbent::with_capacity(2);
    let start = [-4.0, 4.0];
    incumbent.restart(
        &start,
        cost.evaluate(
            |i| Wide([start[i]]),
            &mut [],
            &mut Budget::unlimited(),
            pulp::Scalar,
        )
        .as_ref(),
    );
    let mut budget = Budget::from_quanta(quanta);
    let task = SwarmTask {
        cost: &cost,
        bounds: &bounds,
        settings: *settings,
        knowledge: &[],
        origins: &[],
        seed,
    };
    Kpso::with_capacity(simd, 24, 2).search(&task, &mut budget, &mut incumbent);
    assert!(bounds.contains(incumbent.z()));
    incumbent
}

fn rastrigin() -> Rastrigin {
    Rastrigin {
        centre: 1.7,
        clock: Cell::new(0),
    }
}

#[test]
fn on_a_simulated_clock_every_search_ends_within_5_us_of_its_budget() {
    let mut bounds = Bounds::with_capacity(2);
    bounds.set_symmetric(std::iter::repeat_n(5.0, 2), 1);
    let settings = settings(VelocityRule::Inertia);
    let mut swarm = Kpso::with_capacity(Simd::best(), 24, 2);
    for budget_ns in (0..1_000_000).step_by(7_900) {
        let cost = rastrigin();
        let mut incumbent = Incumbent::with_capacity(2);
        incumbent.restart(&[-4.0, 4.0], None);
        let mut is_spent = || cost.clock.get() >= budget_ns;
        let mut budget = Budget::new(&mut is_spent);
        let task = SwarmTask {
            cost: &cost,
            bounds: &bounds,
            settings,
            knowledge: &[],
            origins: &[],
            seed: budget_ns,
        };
        swarm.search(&task, &mut budget, &mut incumbent);
        let over_ns = cost.clock.get().saturating_sub(budget_ns);
        assert!(over_ns <= 5_000, "{budget_ns} ns: {over_ns} ns more");
    }
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
fn every_path_gives_the_same_bits() {
    for size in [1, 6, 8, 13, 24] {
        let kpso = KpsoSettings {
            size,
            ..settings(VelocityRule::Inertia)
        };
        // A quantum counts evaluations of W particles, so the same budget covers more of them with eight
        // lanes.
        let limited = search_with(Simd::Portable, &kpso, 5, 40);
        for simd in Simd::available().filter(|simd| *simd != Simd::Scalar) {
            assert_eq!(
                search_with(simd, &kpso, 5, 40).z(),
                limited.z(),
                "{simd:?}, {size}"
            );
        }
        let scalar = search_with(Simd::Scalar, &kpso, 5, u32::MAX);
        for simd in Simd::available() {
            let other = search_with(simd, &kpso, 5, u32::MAX);
            assert_eq!(
                other.cost().to_bits(),
                scalar.cost().to_bits(),
                "{simd:?}, {size}"
            );
            assert_eq!(other.z(), scalar.z(), "{simd:?}, {size}");
        }
    }
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
    let rule = KpsoSettings {
        cognitive: 2.05,
        social: 2.05,
        ..settings(VelocityRule::Constriction)
    };
    let chi = rule.factors().inertia;
    assert!((chi - 0.7298).abs() < 1e-4, "{chi}");
}

#[test]
fn cycle_seeds_differ() {
    let seeds: std::collections::BTreeSet<_> =
        (0..1000).map(|cycle| cycle_seed(1, cycle)).collect();
    assert_eq!(seeds.len(), 1000);
}
