//! The nearest point of a region that half-spaces and a box bound, in the few dimensions of a command.
//!
//! Knows no robot. Dual active-set method of Goldfarb and Idnani (Mathematical Programming 27, 1983) with the identity as
//! Hessian: it begins at the point itself, takes in the half-space that is violated most, and lets go of those that no
//! longer hold the point back. A search for the same point goes on from where the one before ended: what is added afterwards only
//! bounds more. Work and memory are bounded, nothing allocates, the same input gives the same bits.

use crate::robot::COORDINATES_MAX;

/// A point, or a normal.
pub(super) type Vector = [f64; COORDINATES_MAX];

/// Half-spaces beside the box: those of the cables and bends, and of two corrections among many obstacles. More are left out, which
/// [`Region::is_full`] tells.
const ROWS_MAX: usize = 152;
/// Half-spaces that are taken in or let go before the search gives up.
const STEPS_MAX: usize = 100;
/// What counts as inside, in the unit of the point, or as a share of it where it is larger than 1.
const INSIDE: f64 = 1e-13;
/// Below this squared length a normal depends on those that hold the point already.
const DEPENDENT: f64 = 1e-14;

/// A box and half-spaces, in the first `dimensions` coordinates.
#[derive(Debug, Clone)]
pub(super) struct Region {
    dimensions: usize,
    pub(super) lower: Vector,
    pub(super) upper: Vector,
    rows: [Row; ROWS_MAX],
    row_count: usize,
    /// Whether a half-space was left out.
    is_full: bool,
    /// What was found last.
    found: Option<Found>,
}

/// The nearest point to `to` before more half-spaces came, and what holds it there.
#[derive(Debug, Clone, Copy)]
struct Found {
    to: Vector,
    at: Vector,
    active: Active,
}

/// normal · x ≥ bound, with a normal of length 1.
#[derive(Debug, Clone, Copy)]
struct Row {
    normal: Vector,
    bound: f64,
}

/// The half-spaces that hold the point, and how strongly.
#[derive(Debug, Clone, Copy)]
struct Active {
    rows: [Row; COORDINATES_MAX],
    multipliers: Vector,
    count: usize,
    /// Cholesky's factor of Nᵀ N, with the normals as N: row by row, as they are taken in.
    factor: [Vector; COORDINATES_MAX],
}

impl Region {
    /// Everything.
    pub(super) fn new(dimensions: usize) -> Self {
        Self {
            dimensions,
            lower: [f64::NEG_INFINITY; COORDINATES_MAX],
            upper: [f64::INFINITY; COORDINATES_MAX],
            rows: [Row::ZERO; ROWS_MAX],
            row_count: 0,
            is_full: false,
            found: None,
        }
    }

    /// Whether normal · x ≥ bound leaves out a part of the box.
    pub(super) fn is_cut_by(&self, normal: &Vector, bound: f64) -> bool {
        let sides = self.lower.iter().zip(&self.upper).take(self.dimensions);
        let least: f64 = normal
            .iter()
            .zip(sides)
            .map(|(normal, (lower, upper))| (normal * lower).min(normal * upper))
            .sum();
        least.is_nan() || least < bound
    }

    /// Whether a half-space was left out, so that points which are found may be on the wrong side of it.
    pub(super) fn is_full(&self) -> bool {
        self.is_full
    }

    /// Only where normal · x ≥ bound. A normal without length bounds nothing.
    pub(super) fn bound(&mut self, normal: &Vector, bound: f64) {
        let length = dot(normal, normal).sqrt();
        if !(length > 0.0 && length.is_finite() && bound.is_finite()) {
            return;
        }
        self.is_full = self.row_count == ROWS_MAX;
        if !self.is_full {
            self.rows[self.row_count] = Row {
                normal: normal.map(|component| component / length),
                bound: bound / length,
            };
            self.row_count += 1;
        }
    }

    /// Only where no component is larger than `most`.
    pub(super) fn slow_down_to(&mut self, most: f64) {
        self.found = None;
        for (lower, upper) in self.lower.iter_mut().zip(&mut self.upper) {
            *lower = lower.max(-most);
            *upper = upper.min(most);
        }
    }

    /// The point of the region that is nearest to `to`, beside rounding. `None` when there is none, or it was not found in
    /// a bounded number of steps.
    pub(super) fn nearest(&mut self, to: &Vector) -> Option<Vector> {
        let before = self.found.take().filter(|found| found.to == *to);
        let Found { at, active, .. } = before.unwrap_or(Found {
            to: *to,
            at: *to,
            active: Active::NONE,
        });
        let (at, active) = self.nearest_from(at, active)?;
        self.found = Some(Found {
            to: *to,
            at,
            active,
        });
        Some(at)
    }

    /// From the nearest point to the same one with fewer half-spaces, and those that hold it.
    fn nearest_from(&self, mut at: Vector, mut active: Active) -> Option<(Vector, Active)> {
        let mut steps = 0;
        while let Some(row) = self.most_violated(&at) {
            let mut multiplier = 0.0;
            loop {
                steps += 1;
                if steps > STEPS_MAX {
                    return None;
                }
                let shares = active.shares(&row.normal)?;
                let way = active.rest(&row.normal, &shares);
                let square = dot(&way, &row.normal);
                let full = if square > DEPENDENT && active.count < self.dimensions {
                    (row.bound - dot(&row.normal, &at)) / square
                } else {
                    f64::INFINITY
                };
                let (until, let_go) = active.lets_go(&shares);
                let step = full.min(until);
                if step == f64::INFINITY {
                    return None;
                }
                if full < f64::INFINITY {
                    add(&mut at, &way, step);
                }
                add(&mut active.multipliers, &shares, -step);
                multiplier += step;
                if full <= until {
                    active.push(row, multiplier);
                    break;
                }
                active.remove(let_go);
            }
        }
        Some((at, active))
    }

    /// What is violated most at `at`; a NaN violates nothing.
    fn most_violated(&self, at: &Vector) -> Option<Row> {
        let (mut most, mut found) = (INSIDE, None);
        let mut look = |side: Side, bound: f64, lack: f64| {
            let scale = 1.0 + bound.abs();
            if lack > most * scale {
                (most, found) = (lack / scale, Some(side));
            }
        };
        for (index, row) in self.rows[..self.row_count].iter().enumerate() {
            look(
                Side::Row(index),
                row.bound,
                row.bound - dot(&row.normal, at),
            );
        }
        for i in 0..self.dimensions {
            let (lower, upper) = (self.lower[i], self.upper[i]);
            look(Side::Lower(i), lower, lower - at[i]);
            look(Side::Upper(i), upper, at[i] - upper);
        }
        found.map(|side| match side {
            Side::Row(index) => self.rows[index],
            Side::Lower(i) => Row::axis(i, 1.0, self.lower[i]),
            Side::Upper(i) => Row::axis(i, -1.0, -self.upper[i]),
        })
    }
}

/// A half-space of a region, by its number or its coordinate.
#[derive(Debug, Clone, Copy)]
enum Side {
    Row(usize),
    Lower(usize),
    Upper(usize),
}

impl Row {
    const ZERO: Self = Self {
        normal: [0.0; COORDINATES_MAX],
        bound: 0.0,
    };

    fn axis(i: usize, sign: f64, bound: f64) -> Self {
        let mut row = Self {
            bound,
            ..Self::ZERO
        };
        row.normal[i] = sign;
        row
    }
}

impl Active {
    const NONE: Self = Self {
        rows: [Row::ZERO; COORDINATES_MAX],
        multipliers: [0.0; COORDINATES_MAX],
        count: 0,
        factor: [[0.0; COORDINATES_MAX]; COORDINATES_MAX],
    };

    /// How much of each held normal there is in `normal`: the least-squares solution of N r = normal. `None` where the held
    /// ones depend on each other.
    fn shares(&self, normal: &Vector) -> Option<Vector> {
        if (0..self.count).any(|i| self.factor[i][i] == 0.0) {
            return None;
        }
        let mut shares = self.solved_forward(self.count, normal);
        for i in (0..self.count).rev() {
            let known: f64 = (i + 1..self.count)
                .map(|k| self.factor[k][i] * shares[k])
                .sum();
            shares[i] = (shares[i] - known) / self.factor[i][i];
        }
        Some(shares)
    }

    /// The first half of that, with the first `count` of those held.
    fn solved_forward(&self, count: usize, normal: &Vector) -> Vector {
        let mut solved = [0.0; COORDINATES_MAX];
        for i in 0..count {
            let known: f64 = (0..i).map(|k| self.factor[i][k] * solved[k]).sum();
            solved[i] = (dot(&self.rows[i].normal, normal) - known) / self.factor[i][i];
        }
        solved
    }

    /// The row of the factor that belongs to the i-th of those held: zero on the diagonal where it depends on those before.
    fn factorise(&mut self, i: usize) {
        let normal = self.rows[i].normal;
        let mut row = self.solved_forward(i, &normal);
        let known: f64 = row[..i].iter().map(|share| share * share).sum();
        row[i] = (dot(&normal, &normal) - known).max(0.0).sqrt();
        self.factor[i] = row;
    }

    /// What of `normal` the held ones do not span.
    fn rest(&self, normal: &Vector, shares: &Vector) -> Vector {
        let mut rest = *normal;
        for (row, share) in self.rows[..self.count].iter().zip(shares) {
            add(&mut rest, &row.normal, -share);
        }
        rest
    }

    /// The step after which the first of those held lets go, and which that is.
    fn lets_go(&self, shares: &Vector) -> (f64, usize) {
        let (mut until, mut first) = (f64::INFINITY, 0);
        for i in 0..self.count {
            let step = self.multipliers[i].max(0.0) / shares[i];
            if shares[i] > 0.0 && step < until {
                (until, first) = (step, i);
            }
        }
        (until, first)
    }

    fn push(&mut self, row: Row, multiplier: f64) {
        self.rows[self.count] = row;
        self.multipliers[self.count] = multiplier;
        self.factorise(self.count);
        self.count += 1;
    }

    fn remove(&mut self, i: usize) {
        self.count -= 1;
        self.rows.copy_within(i + 1..=self.count, i);
        self.multipliers.copy_within(i + 1..=self.count, i);
        self.multipliers[self.count] = 0.0;
        for later in i..self.count {
            self.factorise(later);
        }
    }
}

/// Four sums side by side: one alone waits for each addition.
fn dot(a: &Vector, b: &Vector) -> f64 {
    let mut sums = [0.0; 4];
    for (a, b) in a.as_chunks::<4>().0.iter().zip(b.as_chunks::<4>().0) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

fn add(to: &mut Vector, direction: &Vector, length: f64) {
    for (to, direction) in to.iter_mut().zip(direction) {
        *to += length * direction;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn padded(values: &[f64]) -> Vector {
        core::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
    }

    #[test]
    fn corners_edges_and_regions_without_a_point() {
        let mut region = Region::new(2);
        region.lower = padded(&[-1.0, -1.0]);
        region.upper = padded(&[1.0, 1.0]);
        let near = |region: &mut Region, x: f64, y: f64| {
            region.nearest(&padded(&[x, y])).map(|p| [p[0], p[1]])
        };
        assert_eq!(near(&mut region, 0.5, -0.5), Some([0.5, -0.5]));
        assert_eq!(near(&mut region, 3.0, 0.5), Some([1.0, 0.5]));
        assert_eq!(near(&mut region, 3.0, -4.0), Some([1.0, -1.0]));
        region.bound(&padded(&[-1.0, -1.0]), 0.0);
        let [x, y] = near(&mut region, 3.0, 3.0).unwrap();
        assert!(x.abs() < 1e-12 && y.abs() < 1e-12, "{x} {y}");
        // A half-space that says the same again, and one that no point satisfies.
        region.bound(&padded(&[-2.0, -2.0]), 0.0);
        assert!(near(&mut region, 3.0, 3.0).is_some());
        region.bound(&padded(&[1.0, 1.0]), 1.0);
        assert_eq!(near(&mut region, 3.0, 3.0), None);
    }

    #[test]
    fn a_full_region_says_that_it_left_one_out() {
        let mut region = Region::new(2);
        for turn in 0..ROWS_MAX {
            let (sin, cos) = (turn as f64).sin_cos();
            region.bound(&padded(&[sin, cos]), -1.0);
            // Nothing that bounds nothing takes a place.
            region.bound(&padded(&[0.0, 0.0]), -1.0);
        }
        assert!(!region.is_full());
        region.bound(&padded(&[1.0, 0.0]), 0.5);
        assert!(region.is_full());
    }

    proptest! {
        /// The nearest point is inside, and no other point of the region is on the near side of it: for each y inside,
        /// (to - x) · (y - x) ≤ 0.
        #[test]
        fn the_nearest_point_is_inside_and_nothing_inside_is_nearer(
            to in prop::collection::vec(-5.0..5.0_f64, 12),
            normals in prop::collection::vec(prop::collection::vec(-1.0..1.0_f64, 12), 0..40),
            slack in 0.0..0.5_f64,
            inside in prop::collection::vec(-1.0..1.0_f64, 12),
            others in prop::collection::vec(prop::collection::vec(-1.0..1.0_f64, 12), 20),
        ) {
            let mut region = Region::new(12);
            region.lower = [-1.0; COORDINATES_MAX];
            region.upper = [1.0; COORDINATES_MAX];
            let inside = padded(&inside);
            for normal in &normals {
                let normal = padded(normal);
                region.bound(&normal, dot(&normal, &inside) - slack);
            }
            let to = padded(&to);
            let nearest = region.nearest(&to);
            prop_assert!(nearest.is_some(), "`inside` is one");
            // The same beside rounding, however many half-spaces there were when it was looked for first.
            let mut grown = Region { rows: [Row::ZERO; ROWS_MAX], row_count: 0, found: None, ..region.clone() };
            for row in &region.rows[..region.row_count] {
                grown.bound(&row.normal, row.bound);
                prop_assert!(grown.nearest(&to).is_some());
            }
            for (one, other) in grown.nearest(&to).unwrap().iter().zip(nearest.unwrap()) {
                prop_assert!((one - other).abs() < 1e-9);
            }
            let nearest = nearest.unwrap();
            let lack = |at: &Vector| region.most_violated(at).map_or(0.0, |row| row.bound - dot(&row.normal, at));
            prop_assert!(lack(&nearest) < 1e-12);
            let mut away = to;
            add(&mut away, &nearest, -1.0);
            for other in &others {
                // As far from `inside` towards it as the region goes.
                let mut other = padded(other);
                while lack(&other) > 0.0 {
                    let mut half = inside;
                    add(&mut half, &inside, -0.5);
                    add(&mut half, &other, 0.5);
                    other = half;
                    if other == inside {
                        break;
                    }
                }
                add(&mut other, &nearest, -1.0);
                prop_assert!(dot(&away, &other) < 1e-9);
            }
        }
    }
}
