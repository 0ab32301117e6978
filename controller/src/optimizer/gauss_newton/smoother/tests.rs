//! The step of staged rows, compared with that of the same dense rows and, where constraints are violated,
//! with a lower bound from convexity.

use proptest::prelude::*;

use super::super::{FoundStep, GaussNewton, Smoother};
use crate::optimizer::{
    Bounds, Budget, Evaluation, Incumbent, LinearModel, Problem, Reach, RowStage, Simd, Stages,
    WIDTH_MAX,
};
use crate::wide::Wide;

/// A problem given by its linear model only.
#[derive(Debug, Clone)]
struct Linear {
    stages: Stages,
    is_staged: bool,
    residuals: Vec<LinearRow>,
    constraints: Vec<LinearRow>,
    weight: f64,
}

#[derive(Debug, Clone)]
struct LinearRow {
    value: f64,
    derivatives: Vec<f64>,
    stage: RowStage,
}

impl Problem for Linear {
    fn stages(&self) -> &Stages {
        &self.stages
    }
    fn is_staged(&self) -> bool {
        self.is_staged
    }
    /// Infinite cost, so that no intermediate step is accepted.
    fn evaluate_below(&self, _: &[f64], _: f64, _: &mut Budget<'_>) -> Option<Evaluation<1>> {
        Some(Evaluation::from_cost(Wide([f64::INFINITY])))
    }
    fn linearise(&self, z: &[f64], model: &mut LinearModel, budget: &mut Budget<'_>) -> bool {
        for row in &self.residuals {
            model.push(row.value, &row.derivatives, row.stage);
        }
        if self.weight > 0.0 {
            model.weight_unknowns(self.weight, &CENTRE[..self.stages.width()], z);
        }
        budget.begin_quantum()
    }
    fn constrain(
        &self,
        _: &[f64],
        _: Option<Reach>,
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        for row in &self.constraints {
            model.push_constraint(0, row.value, row.value, &row.derivatives, row.stage);
        }
        budget.begin_quantum()
    }
}

/// Centre of a weight on the unknowns of each block.
const CENTRE: [f64; WIDTH_MAX] = [
    0.3, 0.0, -0.2, 0.1, 0.7, -0.4, 0.0, 0.5, -0.1, 0.2, -0.6, 0.05,
];
const ROWS_MAX: usize = 80;
const CONSTRAINTS_MAX: usize = 16;

/// The step from `z` in the box ±1.
fn step(problem: &Linear, damping: f64, z: &[f64], budget: &mut Budget<'_>) -> Option<Vec<f64>> {
    step_with(Simd::best(), problem, damping, z, budget)
}

fn step_with(
    simd: Simd,
    problem: &Linear,
    damping: f64,
    z: &[f64],
    budget: &mut Budget<'_>,
) -> Option<Vec<f64>> {
    let unknowns = problem.stages.unknowns();
    let mut bounds = Bounds::with_capacity(unknowns);
    bounds.set_symmetric(std::iter::repeat_n(1.0, unknowns), 1);
    let rows = ROWS_MAX + unknowns;
    let mut gauss_newton =
        GaussNewton::with_capacity(simd, unknowns, unknowns, rows, CONSTRAINTS_MAX);
    let mut incumbent = Incumbent::with_capacity(unknowns);
    incumbent.restart(z, None);
    let mut to = z.to_vec();
    let found = gauss_newton.propose(problem, &bounds, damping, budget, &mut incumbent, &mut to);
    (found != FoundStep::Nothing).then(|| to.iter().zip(z).map(|(to, from)| to - from).collect())
}

fn bits(step: &[f64]) -> Vec<u64> {
    step.iter().map(|number| number.to_bits()).collect()
}

fn problems() -> impl Strategy<Value = (Linear, Vec<f64>)> {
    let lengths = prop_oneof![
        prop::collection::vec(Just(1), 1..=8),
        prop::collection::vec(1..=3_u8, 1..=5),
    ];
    (1..=6_usize, lengths, prop_oneof![Just(0.0), 1e-4..1e-2_f64]).prop_flat_map(
        |(sections, lengths, weight)| {
            let (width, blocks) = (2 * sections, lengths.len());
            let stages = Stages::new(width, 0.1, lengths.iter().copied());
            let row = |scale: f64| {
                let derivatives = prop::collection::vec(-1.0..1.0_f64, width);
                let stage = (0..blocks, any::<bool>(), 0..3_u8);
                let lengths = lengths.clone();
                (-1.0..1.0_f64, derivatives, stage).prop_map(
                    move |(value, derivatives, (block, of_step, short))| LinearRow {
                        value: scale * value,
                        derivatives: derivatives.iter().map(|d| scale * d).collect(),
                        stage: RowStage {
                            block,
                            since_start: !of_step,
                            periods: if of_step {
                                1.0
                            } else {
                                f64::from(u8::max(1, lengths[block].saturating_sub(short)))
                            },
                        },
                    },
                )
            };
            let at_end = row(1.0).prop_map(|row| LinearRow {
                stage: RowStage {
                    since_start: true,
                    ..row.stage
                },
                ..row
            });
            let residuals = prop::collection::vec(at_end, 1..=3 * blocks);
            let constraints = prop::collection::vec(row(30.0), 0..=blocks);
            let z = prop::collection::vec(
                prop_oneof![3 => -0.9..0.9_f64, 1 => Just(1.0), 1 => Just(-1.0)],
                width * blocks,
            );
            (residuals, constraints, z).prop_map(move |(mut residuals, constraints, z)| {
                residuals.sort_by_key(|row| row.stage.block);
                let problem = Linear {
                    stages,
                    is_staged: true,
                    residuals,
                    constraints,
                    weight,
                };
                (problem, z)
            })
        },
    )
}

impl Linear {
    /// The derivatives of a row with respect to all unknowns.
    fn derivatives(&self, row: &LinearRow) -> Vec<f64> {
        let blocks = self.stages.lengths().enumerate();
        blocks
            .flat_map(|(block, length)| {
                let periods = match block.cmp(&row.stage.block) {
                    std::cmp::Ordering::Equal => row.stage.periods,
                    std::cmp::Ordering::Less if row.stage.since_start => length,
                    _ => 0.0,
                };
                row.derivatives.iter().map(move |d| 0.1 * periods * d)
            })
            .collect()
    }

    /// The value of a row after a step.
    fn value(&self, row: &LinearRow, step: &[f64]) -> f64 {
        let terms = self.derivatives(row);
        row.value + terms.iter().zip(step).map(|(d, s)| d * s).sum::<f64>()
    }

    fn breaks_any(&self, step: &[f64]) -> bool {
        self.constraints
            .iter()
            .any(|row| self.value(row, step) < 0.0)
    }

    /// Distances from the centre of the weight after a step.
    fn distances(&self, z: &[f64], step: &[f64]) -> impl Iterator<Item = f64> {
        let centre = CENTRE[..self.stages.width()].iter().cycle();
        let ends = z.iter().zip(step).map(|(z, step)| z + step);
        ends.zip(centre).map(|(end, centre)| end - centre)
    }

    /// The cost of a step.
    fn cost(&self, damping: f64, z: &[f64], step: &[f64]) -> f64 {
        let square = |row: &LinearRow, most: f64| self.value(row, step).min(most).powi(2);
        let residuals = self.residuals.iter().map(|row| square(row, f64::INFINITY));
        let constraints = self.constraints.iter().map(|row| square(row, 0.0));
        let own = self.distances(z, step).zip(step);
        let own = own.map(|(distance, s)| damping * s * s + self.weight * distance * distance);
        residuals.chain(constraints).chain(own).sum()
    }

    /// Lower bound of the cost of all steps in the box ±1. For any multipliers y ≥ 0, the square of a
    /// violated constraint v is at least -2 y v - y²; here s y = `mu`. The rest lies above its tangent at
    /// `step` and the squares of damping and weight.
    fn bound(&self, damping: f64, z: &[f64], step: &[f64], mu: f64) -> f64 {
        let own = self.distances(z, step).zip(step);
        let mut gradient: Vec<f64> = own
            .map(|(distance, step)| damping * step + self.weight * distance)
            .collect();
        let without = Self {
            constraints: vec![],
            ..self.clone()
        };
        let mut bound = without.cost(damping, z, step);
        let residuals = self
            .residuals
            .iter()
            .map(|row| (row, self.value(row, step)));
        let constraints = self.constraints.iter().map(|row| {
            let value = self.value(row, step);
            let force = 0.5 * ((value * value + 4.0 * mu).sqrt() - value);
            bound -= 2.0 * force * value + force * force;
            (row, -force)
        });
        for (row, force) in constraints.chain(residuals) {
            for (sum, derivative) in gradient.iter_mut().zip(self.derivatives(row)) {
                *sum += force * derivative;
            }
        }
        let square = damping + self.weight;
        for ((gradient, z), step) in gradient.iter().zip(z).zip(step) {
            let at = z + step;
            let change = (-gradient / square).clamp(-1.0 - at, 1.0 - at);
            bound += (2.0 * gradient + square * change) * change;
        }
        bound
    }
}

proptest! {
    /// One to six sections, so every width that is compiled for its own.
    #[test]
    fn every_instruction_set_gives_the_same_step((staged, z) in problems(), exponent in 2..14_i32) {
        let damping = 0.1_f64.powi(exponent);
        let of = |simd| step_with(simd, &staged, damping, &z, &mut Budget::unlimited()).map(|step| bits(&step));
        let best = of(Simd::best());
        for simd in Simd::available() {
            prop_assert_eq!(of(simd), best.clone(), "{:?}", simd);
        }
    }

    /// Other residuals, and another point of the weight, with the gains of the last solution.
    #[test]
    fn gains_serve_again_with_the_bits_of_a_new_solution((staged, z) in problems(), exponent in 2..14_i32, fixed in any::<u64>()) {
        let damping = 0.1_f64.powi(exponent);
        let unknowns = z.len();
        let free: Vec<usize> = (0..unknowns).filter(|i| fixed >> (i % 64) & 1 == 0).collect();
        let mut model = LinearModel::with_capacity(ROWS_MAX, CONSTRAINTS_MAX, unknowns, unknowns);
        let budget = &mut Budget::unlimited();
        for simd in Simd::available() {
            model.clear(&staged.stages, true);
            prop_assert!(staged.linearise(&z, &mut model, budget));
            let of = || (Smoother::with_capacity(simd, ROWS_MAX), vec![0.0; unknowns]);
            let ((mut smoother, mut step), (mut other, mut expected)) = (of(), of());
            prop_assert!(smoother.solve(&model, &free, damping, &mut step, budget));
            for (i, residual) in model.residuals_mut().iter_mut().enumerate() {
                *residual = 1e-3 * *residual - 1e-4 * i as f64;
            }
            if staged.weight > 0.0 {
                model.move_weighted_point(&step);
            }
            prop_assert!(smoother.solve_again(&model, &free, damping, &mut step, budget));
            prop_assert!(other.solve(&model, &free, damping, &mut expected, budget));
            prop_assert_eq!(bits(&step), bits(&expected));
        }
    }

    #[test]
    fn staged_rows_give_the_step_of_all_derivatives((staged, z) in problems(), exponent in 2..8_i32) {
        let damping = 0.1_f64.powi(exponent);
        let dense = Linear { is_staged: false, ..staged.clone() };
        let free = Linear { constraints: vec![], ..staged.clone() };
        let of = |problem| step(problem, damping, &z, &mut Budget::unlimited()).expect("solved");
        // So small that the bound is tight.
        let little = 1e-3 * damping;
        let little_damped = |problem| step(problem, little, &z, &mut Budget::unlimited()).expect("solved");
        if staged.breaks_any(&little_damped(&free)) {
            let (damping, best) = (little, little_damped(&staged));
            prop_assert!(best.iter().zip(&z).all(|(step, z)| (z + step).abs() <= 1.0));
            let cost = staged.cost(damping, &z, &best);
            let bounds = (0..120).map(|n| staged.bound(damping, &z, &best, 0.75_f64.powi(n)));
            let bound = bounds.fold(0.0, f64::max);
            // The bounds may deflect the step as much as the damping does.
            let left = 1e-4 * staged.cost(damping, &z, &vec![0.0; z.len()]);
            let most = bound + left + 4.0 * damping * z.len() as f64;
            prop_assert!(cost <= most, "{cost}, at least {bound}");
        }
        if !staged.breaks_any(&of(&free)) {
            for (staged, dense) in of(&staged).iter().zip(&of(&dense)) {
                prop_assert!((staged - dense).abs() < 1e-6, "{staged} {dense}");
            }
        }
    }
}

#[test]
fn a_number_that_is_not_finite_and_a_spent_budget_give_no_step() {
    let row = |value| LinearRow {
        value,
        derivatives: vec![0.3, 0.2],
        stage: RowStage {
            block: 3,
            since_start: true,
            periods: 1.0,
        },
    };
    let problem = |value| Linear {
        stages: Stages::new(2, 0.1, [1; 4].into_iter()),
        is_staged: true,
        residuals: vec![row(value)],
        constraints: vec![],
        weight: 0.0,
    };
    let z = [0.0; 8];
    let unlimited = &mut Budget::unlimited();
    assert!(step(&problem(0.01), 1e-9, &z, unlimited).is_some());
    assert_eq!(step(&problem(f64::NAN), 1e-9, &z, unlimited), None);
    let spent = &mut Budget::from_quanta(0);
    assert_eq!(step(&problem(0.01), 1e-9, &z, spent), None);
}
