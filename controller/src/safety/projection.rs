//! The nearest point of a region that half-spaces and a box bound, in the few dimensions of a command.
//!
//! Knows no robot. Dual active-set method of Goldfarb and Idnani (Mathematical Programming 27, 1983) with the identity as
//! Hessian: it begins at the point itself, takes in the half-space that is violated most, and lets go of those that no
//! longer hold the point back. A search for the same point goes on from where the one before ended: with what is added afterwards, and
//! with bounds that moved. Work and memory are bounded, nothing allocates, the same input gives the same bits.

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
    /// The sides of the box, without and with what [`Region::slow_down_to`] leaves of it.
    sides: [Vector; 2],
    lower: Vector,
    upper: Vector,
    /// The largest component.
    most: f64,
    way_s: f64,
    rows: [Row; ROWS_MAX],
    row_count: usize,
    /// Whether a half-space was left out.
    is_full: bool,
    /// The nearest point to `to` before more half-spaces came, and what holds it there; changed in place, because they are large.
    found: Found,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    /// Whether there is one.
    is_known: bool,
    to: Vector,
    at: Vector,
    active: Active,
}

/// How the nearest point changes with the largest component.
pub(super) struct Slopes {
    /// First and second derivative of half its squared distance.
    pub(super) half_square: f64,
    pub(super) curvature: f64,
    /// Of itself.
    pub(super) at: Vector,
}

/// normal · x ≥ bound, with a normal of length 1.
#[derive(Debug, Clone, Copy)]
struct Row {
    normal: Vector,
    bound: f64,
    /// What the bound is at least, and what moves it.
    fixed: f64,
    room: Room,
}

/// What a bound changes with.
#[derive(Debug, Clone, Copy)]
enum Room {
    /// Nothing.
    None,
    /// It is -room / way.
    Way(f64),
    /// It is that of the largest component, as a side of the box.
    Most,
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
    /// A box, for points that are obeyed for `way_s`.
    #[allow(
        clippy::large_stack_arrays,
        reason = "19 kB, once for each command that a limit changes"
    )]
    pub(super) fn new(dimensions: usize, lower: Vector, upper: Vector, way_s: f64) -> Self {
        Self {
            dimensions,
            sides: [lower, upper],
            lower,
            upper,
            most: f64::INFINITY,
            way_s,
            rows: [Row::ZERO; ROWS_MAX],
            row_count: 0,
            is_full: false,
            found: Found {
                is_known: false,
                to: [0.0; COORDINATES_MAX],
                at: [0.0; COORDINATES_MAX],
                active: Active::NONE,
            },
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
        self.add(normal, bound, Room::None);
    }

    /// Only where normal · x ≥ bound, and normal · x · way ≥ -room.
    pub(super) fn bound_along(&mut self, normal: &Vector, bound: f64, room: f64) {
        self.add(normal, bound, Room::Way(room));
    }

    fn add(&mut self, normal: &Vector, fixed: f64, room: Room) {
        let length = dot(normal, normal).sqrt();
        let room = match room {
            Room::Way(room) => Room::Way(room / length),
            other => other,
        };
        let mut row = Row {
            normal: normal.map(|component| component / length),
            bound: 0.0,
            fixed: fixed / length,
            room,
        };
        row.move_to(self.most, self.way_s);
        if length > 0.0 && length.is_finite() && row.bound.is_finite() {
            self.push(row);
        }
    }

    fn push(&mut self, row: Row) {
        self.is_full = self.row_count == ROWS_MAX;
        if !self.is_full {
            self.rows[self.row_count] = row;
            self.row_count += 1;
        }
    }

    /// Only where no component is larger than `most`.
    pub(super) fn slow_down_to(&mut self, most: f64) {
        self.found.is_known = false;
        self.most = most;
        self.lower = self.sides[0].map(|lower| lower.max(-most));
        self.upper = self.sides[1].map(|upper| upper.min(most));
    }

    /// Only where no component is larger than `most`, of points that are obeyed for `way_s`. Of the half-spaces that move freely with the way, those stay
    /// that hold what was found.
    pub(super) fn move_to(&mut self, most: f64, way_s: f64) {
        let is_known = self.found.is_known;
        self.slow_down_to(most);
        self.way_s = way_s;
        let mut kept = 0;
        for index in 0..self.row_count {
            if !self.rows[index].is_free() {
                self.rows[kept] = self.rows[index];
                self.rows[kept].move_to(most, way_s);
                kept += 1;
            }
        }
        self.row_count = kept;
        if !is_known {
            return;
        }
        let active = &mut self.found.active;
        for row in &mut active.rows[..active.count] {
            row.move_to(most, way_s);
        }
        for index in 0..self.found.active.count {
            let row = self.found.active.rows[index];
            if row.is_free() {
                self.push(row);
            }
        }
        self.found.is_known = self.found.hold().is_some();
    }

    /// How what was found last changes with the largest component, where the way changes by `way_slope` times that, with the half-spaces that hold it.
    /// `None` where nothing was found.
    pub(super) fn slopes(&self, way_slope: f64) -> Option<Slopes> {
        if !self.found.is_known {
            return None;
        }
        let active = &self.found.active;
        let (mut half_square, mut curvature) = (0.0, 0.0);
        let mut bound_slopes = Vector::default();
        for i in 0..active.count {
            let [first, second] = active.rows[i].bound_slopes(self.way_s, way_slope);
            half_square += active.multipliers[i] * first;
            curvature += active.multipliers[i] * second;
            bound_slopes[i] = first;
        }
        let multiplier_slopes = active.solved(|i| bound_slopes[i])?;
        let mut at = Vector::default();
        for (row, slope) in active.rows[..active.count].iter().zip(&multiplier_slopes) {
            add(&mut at, &row.normal, *slope);
        }
        curvature += dot(&multiplier_slopes, &bound_slopes);
        Some(Slopes {
            half_square,
            curvature,
            at,
        })
    }

    /// The point of the region that is nearest to `to`, beside rounding. `None` when there is none, or it was not found in
    /// a bounded number of steps.
    pub(super) fn nearest(&mut self, to: &Vector) -> Option<Vector> {
        if !(self.found.is_known && self.found.to == *to) {
            self.found.to = *to;
            self.found.at = *to;
            self.found.active.count = 0;
            self.found.active.multipliers = [0.0; COORDINATES_MAX];
        }
        self.found.is_known = self.go_on().is_some();
        self.found.is_known.then_some(self.found.at)
    }

    /// From the nearest point to the same one with fewer half-spaces, and those that hold it. `None`: they hold no point.
    fn go_on(&mut self) -> Option<()> {
        let mut steps = 0;
        while let Some(row) = self.most_violated(&self.found.at) {
            let Found { at, active, .. } = &mut self.found;
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
                    (row.bound - dot(&row.normal, at)) / square
                } else {
                    f64::INFINITY
                };
                let (until, let_go) = active.lets_go(&shares);
                let step = full.min(until);
                if step == f64::INFINITY {
                    return None;
                }
                if full < f64::INFINITY {
                    add(at, &way, step);
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
        Some(())
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
            Side::Lower(i) => Row::axis(i, 1.0, self.sides[0][i], self.most),
            Side::Upper(i) => Row::axis(i, -1.0, -self.sides[1][i], self.most),
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
        fixed: 0.0,
        room: Room::None,
    };

    /// A side of the box.
    fn axis(i: usize, sign: f64, fixed: f64, most: f64) -> Self {
        let mut row = Self {
            bound: fixed.max(-most),
            fixed,
            room: Room::Most,
            ..Self::ZERO
        };
        row.normal[i] = sign;
        row
    }

    fn move_to(&mut self, most: f64, way_s: f64) {
        self.bound = match self.room {
            Room::None => self.fixed,
            Room::Way(room) => self.fixed.max(-room / way_s),
            Room::Most => self.fixed.max(-most),
        };
    }

    /// Whether nothing but the way bounds it.
    fn is_free(&self) -> bool {
        self.fixed == f64::NEG_INFINITY
    }

    /// The first and second derivative of the bound by the largest component.
    fn bound_slopes(&self, way_s: f64, way_slope: f64) -> [f64; 2] {
        let share = way_slope / way_s;
        match self.room {
            Room::Way(room) if self.bound > self.fixed => {
                let slope = room / way_s * share;
                [slope, -2.0 * slope * share]
            }
            Room::Most if self.bound > self.fixed => [-1.0, 0.0],
            _ => [0.0, 0.0],
        }
    }
}

impl Found {
    /// The nearest point that is on the bounds of those held, but for those that would not hold it there. `None` where they depend on each other.
    fn hold(&mut self) -> Option<()> {
        let Self { to, at, active, .. } = self;
        loop {
            let lack = |row: &Row| row.bound - dot(&row.normal, to);
            active.multipliers = active.solved(|i| lack(&active.rows[i]))?;
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
        self.solved(|i| dot(&self.rows[i].normal, normal))
    }

    /// The solution of Nᵀ N x = `right`. `None` where those held depend on each other.
    fn solved(&self, right: impl Fn(usize) -> f64) -> Option<Vector> {
        if (0..self.count).any(|i| self.factor[i][i] == 0.0) {
            return None;
        }
        let mut shares = self.solved_forward(self.count, right);
        for i in (0..self.count).rev() {
            let known: f64 = (i + 1..self.count)
                .map(|k| self.factor[k][i] * shares[k])
                .sum();
            shares[i] = (shares[i] - known) / self.factor[i][i];
        }
        Some(shares)
    }

    /// The first half of that, with the first `count` of those held.
    fn solved_forward(&self, count: usize, right: impl Fn(usize) -> f64) -> Vector {
        let mut solved = [0.0; COORDINATES_MAX];
        for i in 0..count {
            let known: f64 = (0..i).map(|k| self.factor[i][k] * solved[k]).sum();
            solved[i] = (right(i) - known) / self.factor[i][i];
        }
        solved
    }

    /// The row of the factor that belongs to the i-th of those held: zero on the diagonal where it depends on those before.
    fn factorise(&mut self, i: usize) {
        let normal = self.rows[i].normal;
        let mut row = self.solved_forward(i, |k| dot(&self.rows[k].normal, &normal));
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
mod tests;
