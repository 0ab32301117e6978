//! The nearest point of a region that is bounded by half-spaces and a box, in the few dimensions of a
//! command.
//!
//! Invariant: nothing here knows the robot. Dual active-set method of Goldfarb and Idnani (Mathematical
//! Programming 27, 1983) with the identity as Hessian: it starts at the point itself, adds the half-space
//! that is violated most, and releases those with negative multipliers. A later search for the same point
//! continues from the previous solution after half-spaces were added or bounds moved. Work and memory are
//! bounded, nothing allocates, the same input gives the same bits.

mod active;

use crate::robot::COORDINATES_MAX;

use active::Active;

/// A point or a normal.
pub(super) type Vector = [f64; COORDINATES_MAX];

/// Largest number of half-spaces: those of cables and bends, and those of two corrections among many
/// obstacles. Further ones are left out, which [`Region::is_full`] reports.
const ROWS_MAX: usize = 152;
/// Active-set changes before a search fails.
const STEPS_MAX: usize = 100;
/// Cost of one change in products of two vectors, without the scan of the rows.
const STEP_PRODUCTS: u32 = 24;
/// Tolerance of the bounds, in the unit of the point; relative for bounds larger than 1.
const INSIDE: f64 = 1e-13;
/// Relative allowance for rounding in the travelled distance.
const ROUNDING: f64 = 1e-9;
/// A normal counts as linearly dependent on the active ones below this squared length of its remainder.
const DEPENDENT: f64 = 1e-14;

/// A box and half-spaces, in the first `dimensions` coordinates.
#[derive(Debug, Clone)]
pub(super) struct Region {
    dimensions: usize,
    /// The sides of the box as given, and restricted by [`Region::slow_down_to`].
    sides: [Vector; 2],
    lower: Vector,
    upper: Vector,
    /// Largest permitted component.
    most: f64,
    path_s: f64,
    rows: [ConstraintRow; ROWS_MAX],
    /// For each row, the travelled distance below which it cannot be violated.
    clear_until: [f64; ROWS_MAX],
    row_count: usize,
    /// Whether a half-space was left out.
    is_full: bool,
    /// Work since [`Region::take_products`], in products of two vectors.
    products: u32,
    /// The last solution, and its active set; updated in place, because both are large.
    found: LastSolution,
}

#[derive(Debug, Clone, Copy)]
struct LastSolution {
    /// Whether the solution is valid.
    is_known: bool,
    to: Vector,
    at: Vector,
    /// Upper bound of the distance travelled since all rows were evaluated.
    travelled: f64,
    active: Active,
}

/// Sensitivity of the solution to the bounds that change.
pub(super) struct Sensitivity {
    /// Half the squared distance of the solution.
    pub(super) half_square: f64,
    /// Its decrease per unit of the largest component, and per unit of 1 / path.
    pub(super) most: f64,
    pub(super) per_inverse_path: f64,
}

/// normal · x ≥ bound, with a normal of length 1.
#[derive(Debug, Clone, Copy)]
struct ConstraintRow {
    normal: Vector,
    bound: f64,
    /// Lower bound of `bound`, and the quantity that `bound` varies with.
    fixed: f64,
    varies: Varies,
}

/// The quantity that a bound varies with.
#[derive(Debug, Clone, Copy)]
enum Varies {
    /// The bound is constant.
    Never,
    /// The bound is -room / path.
    WithPath(f64),
    /// The bound is that of the largest component, as a side of the box.
    WithLargest,
}

impl Region {
    /// An empty region. A constant because of its size; it is modified in place.
    #[allow(
        clippy::large_stack_arrays,
        reason = "24 kB, once for each command that a limit or the guard changes"
    )]
    pub(super) const EMPTY: Self = Self {
        dimensions: 0,
        sides: [[0.0; COORDINATES_MAX]; 2],
        lower: [0.0; COORDINATES_MAX],
        upper: [0.0; COORDINATES_MAX],
        most: 0.0,
        path_s: 0.0,
        rows: [ConstraintRow::ZERO; ROWS_MAX],
        clear_until: [0.0; ROWS_MAX],
        row_count: 0,
        is_full: false,
        products: 0,
        found: LastSolution {
            is_known: false,
            to: [0.0; COORDINATES_MAX],
            at: [0.0; COORDINATES_MAX],
            travelled: 0.0,
            active: Active::NONE,
        },
    };

    /// A box without half-spaces, for points that are executed for `path_s`, with no component larger than
    /// `most`.
    pub(super) fn reset(&mut self, dimensions: usize, sides: [Vector; 2], most: f64, path_s: f64) {
        self.dimensions = dimensions;
        self.sides = sides;
        self.path_s = path_s;
        self.row_count = 0;
        self.is_full = false;
        self.slow_down_to(most);
    }

    /// Whether a half-space excludes a part of the box.
    fn is_cut_by(&self, ConstraintRow { normal, bound, .. }: &ConstraintRow) -> bool {
        // Components beyond the dimensions are zero in each normal and each side.
        let mut least = [0.0; COORDINATES_MAX];
        for (i, least) in least.iter_mut().enumerate() {
            *least = (normal[i] * self.lower[i]).min(normal[i] * self.upper[i]);
        }
        let least = sum(&least);
        least.is_nan() || least < *bound
    }

    /// Whether a half-space was left out, so that points which are found may be on the wrong side of it.
    pub(super) fn is_full(&self) -> bool {
        self.is_full
    }

    /// Returns the work since the last call, in products of two vectors.
    pub(super) fn take_products(&mut self) -> u32 {
        core::mem::take(&mut self.products)
    }

    /// Adds the half-space normal · x ≥ bound, unless it excludes no part of the box or its normal has no
    /// length. Returns whether it was added.
    pub(super) fn bound(&mut self, normal: &Vector, bound: f64) -> bool {
        let before = self.row_count;
        self.add(normal, bound, Varies::Never);
        self.row_count > before
    }

    /// Adds the half-spaces normal · x ≥ bound and normal · x · path ≥ -room.
    pub(super) fn bound_along(&mut self, normal: &Vector, bound: f64, room: f64) {
        self.add(normal, bound, Varies::WithPath(room));
    }

    fn add(&mut self, normal: &Vector, fixed: f64, varies: Varies) {
        let mut row = ConstraintRow {
            normal: *normal,
            bound: 0.0,
            fixed,
            varies,
        };
        row.move_to(self.most, self.path_s);
        if !self.is_cut_by(&row) {
            return;
        }
        let length = dot(normal, normal).sqrt();
        row.scale(1.0 / length);
        row.move_to(self.most, self.path_s);
        if length > 0.0 && length.is_finite() && row.bound.is_finite() {
            self.push(row);
        }
    }

    fn push(&mut self, row: ConstraintRow) {
        self.is_full = self.row_count == ROWS_MAX;
        if !self.is_full {
            self.rows[self.row_count] = row;
            self.clear_until[self.row_count] = f64::NEG_INFINITY;
            self.row_count += 1;
        }
    }

    /// Restricts every component to `most`.
    pub(super) fn slow_down_to(&mut self, most: f64) {
        self.found.is_known = false;
        self.most = most;
        self.lower = self.sides[0].map(|lower| lower.max(-most));
        self.upper = self.sides[1].map(|upper| upper.min(most));
    }

    /// Restricts every component to `most`, for points that are executed for `path_s`; neither may exceed its
    /// value at the first half-space. Of the half-spaces that vary with the path alone, the active ones stay.
    pub(super) fn move_to(&mut self, most: f64, path_s: f64) {
        let is_known = self.found.is_known;
        self.slow_down_to(most);
        self.path_s = path_s;
        let mut kept = 0;
        for index in 0..self.row_count {
            if !self.rows[index].is_free() {
                self.rows[kept] = self.rows[index];
                self.rows[kept].move_to(most, path_s);
                kept += 1;
            }
        }
        self.row_count = kept;
        if !is_known {
            return;
        }
        let active = &mut self.found.active;
        for row in &mut active.rows[..active.count] {
            row.move_to(most, path_s);
        }
        for index in 0..self.found.active.count {
            let row = self.found.active.rows[index];
            if row.is_free() {
                self.push(row);
            }
        }
        self.found.is_known = self.found.hold().is_some();
        self.mark_all_rows();
    }

    /// Sensitivity of the last solution. It gives a lower bound of half the squared distance for every other
    /// largest component and path, because that is a convex function of the largest component and 1 / path.
    /// `None` without a solution.
    pub(super) fn sensitivity(&self) -> Option<Sensitivity> {
        if !self.found.is_known {
            return None;
        }
        let LastSolution { to, at, active, .. } = &self.found;
        let mut away = *to;
        add(&mut away, at, -1.0);
        let mut sensitivity = Sensitivity {
            half_square: 0.5 * dot(&away, &away),
            most: 0.0,
            per_inverse_path: 0.0,
        };
        for (row, multiplier) in active.rows[..active.count].iter().zip(&active.multipliers) {
            match row.varies {
                Varies::WithPath(room) if row.bound > row.fixed => {
                    sensitivity.per_inverse_path += multiplier * room;
                }
                Varies::WithLargest if row.bound > row.fixed => sensitivity.most += multiplier,
                _ => {}
            }
        }
        Some(sensitivity)
    }

    /// The point of the region that is nearest to `to`, except for rounding. `None` if the region is empty,
    /// or if no solution was found in a bounded number of steps.
    pub(super) fn nearest(&mut self, to: &Vector) -> Option<Vector> {
        if !(self.found.is_known && self.found.to == *to) {
            self.found.to = *to;
            self.found.at = *to;
            self.found.active.count = 0;
            self.found.active.multipliers = [0.0; COORDINATES_MAX];
            self.mark_all_rows();
        }
        self.found.is_known = self.continue_search().is_some();
        self.found.is_known.then_some(self.found.at)
    }

    /// Marks all rows for evaluation, after the point or the bounds changed.
    fn mark_all_rows(&mut self) {
        self.found.travelled = 0.0;
        self.clear_until[..self.row_count].fill(f64::NEG_INFINITY);
    }

    /// Continues from a solution with fewer half-spaces. `None`: the region is empty, or the number of steps
    /// is exceeded.
    fn continue_search(&mut self) -> Option<()> {
        let mut steps = 0;
        while let Some(row) = self.most_violated() {
            let LastSolution {
                at,
                travelled,
                active,
                ..
            } = &mut self.found;
            let mut multiplier = 0.0;
            loop {
                steps += 1;
                self.products += STEP_PRODUCTS;
                if steps > STEPS_MAX {
                    return None;
                }
                let forward = active.solved_forward(|i| dot(&active.rows[i].normal, &row.normal));
                let shares = active.solved_back(&forward);
                let direction = active.rest(&row.normal, &shares);
                let square = dot(&direction, &row.normal);
                let full = if square > DEPENDENT && active.count < self.dimensions {
                    (row.bound - dot(&row.normal, at)) / square
                } else {
                    f64::INFINITY
                };
                let (until, released) = active.first_released(&shares);
                let step = full.min(until);
                if step == f64::INFINITY {
                    return None;
                }
                if full < f64::INFINITY {
                    add(at, &direction, step);
                    *travelled += step * dot(&direction, &direction).sqrt() * (1.0 + ROUNDING);
                }
                add(&mut active.multipliers, &shares, -step);
                multiplier += step;
                if full <= until {
                    active.push(row, multiplier, forward);
                    break;
                }
                active.remove(released);
            }
        }
        Some(())
    }

    /// The bound that is violated most at the present point; a NaN violates nothing.
    fn most_violated(&mut self) -> Option<ConstraintRow> {
        let LastSolution { at, travelled, .. } = &self.found;
        let (mut most, mut found) = (INSIDE, None);
        let mut look = |side: Side, bound: f64, violation: f64| {
            let scale = 1.0 + bound.abs();
            if violation > most * scale {
                (most, found) = (violation / scale, Some(side));
            }
        };
        let rows = self.rows[..self.row_count].iter().enumerate();
        for ((index, row), clear_until) in rows.zip(&mut self.clear_until) {
            if *clear_until > *travelled {
                continue;
            }
            self.products += 1;
            let violation = row.bound - dot(&row.normal, at);
            *clear_until = travelled - violation;
            look(Side::Row(index), row.bound, violation);
        }
        for i in 0..self.dimensions {
            let (lower, upper) = (self.lower[i], self.upper[i]);
            look(Side::Lower(i), lower, lower - at[i]);
            look(Side::Upper(i), upper, at[i] - upper);
        }
        found.map(|side| match side {
            Side::Row(index) => self.rows[index],
            Side::Lower(i) => ConstraintRow::axis(i, 1.0, self.sides[0][i], self.most),
            Side::Upper(i) => ConstraintRow::axis(i, -1.0, -self.sides[1][i], self.most),
        })
    }
}

/// Identifies a bound of a region.
#[derive(Debug, Clone, Copy)]
enum Side {
    Row(usize),
    Lower(usize),
    Upper(usize),
}

impl ConstraintRow {
    const ZERO: Self = Self {
        normal: [0.0; COORDINATES_MAX],
        bound: 0.0,
        fixed: 0.0,
        varies: Varies::Never,
    };

    /// A side of the box.
    fn axis(i: usize, sign: f64, fixed: f64, most: f64) -> Self {
        let mut row = Self {
            bound: fixed.max(-most),
            fixed,
            varies: Varies::WithLargest,
            ..Self::ZERO
        };
        row.normal[i] = sign;
        row
    }

    /// The same half-space with a scaled normal.
    fn scale(&mut self, by: f64) {
        self.normal = self.normal.map(|component| component * by);
        self.fixed *= by;
        if let Varies::WithPath(room) = &mut self.varies {
            *room *= by;
        }
    }

    fn move_to(&mut self, most: f64, path_s: f64) {
        self.bound = match self.varies {
            Varies::Never => self.fixed,
            Varies::WithPath(room) => self.fixed.max(-room / path_s),
            Varies::WithLargest => self.fixed.max(-most),
        };
    }

    /// Whether only the path bounds it.
    fn is_free(&self) -> bool {
        self.fixed == f64::NEG_INFINITY
    }
}

impl LastSolution {
    /// Recomputes the solution for the present bounds of the active set, and releases rows with negative
    /// multipliers. `None` if the rows are linearly dependent.
    fn hold(&mut self) -> Option<()> {
        let Self { to, at, active, .. } = self;
        loop {
            let violation = |row: &ConstraintRow| row.bound - dot(&row.normal, to);
            active.multipliers = active.solved(|i| violation(&active.rows[i]))?;
            let least = (0..active.count).min_by(|i, j| {
                let [one, other] = [i, j].map(|i| active.multipliers[*i]);
                one.total_cmp(&other)
            });
            match least {
                Some(least) if active.multipliers[least] < 0.0 => active.remove(least),
                _ => break,
            }
        }
        *at = *to;
        for (row, multiplier) in active.rows[..active.count].iter().zip(&active.multipliers) {
            add(at, &row.normal, *multiplier);
        }
        Some(())
    }
}

/// Four sums in parallel: a single one would wait for each addition.
fn dot(a: &Vector, b: &Vector) -> f64 {
    sum(&core::array::from_fn(|i| a[i] * b[i]))
}

fn sum(terms: &Vector) -> f64 {
    let mut sums = [0.0; 4];
    for terms in terms.as_chunks::<4>().0 {
        for (sum, term) in sums.iter_mut().zip(terms) {
            *sum += term;
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
mod tests;
