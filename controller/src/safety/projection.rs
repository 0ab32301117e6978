//! The nearest point of a region that half-spaces and a box bound, in the few dimensions of a command.
//!
//! Knows no robot. Dual active-set method of Goldfarb and Idnani (Mathematical Programming 27, 1983) with the identity as
//! Hessian: it begins at the point itself, takes in the half-space that is violated most, and lets go of those that no
//! longer hold the point back. A search for the same point goes on from where the one before ended: with what is added afterwards, and
//! with bounds that moved. Work and memory are bounded, nothing allocates, the same input gives the same bits.

mod active;

use crate::robot::COORDINATES_MAX;

use active::Active;

/// A point, or a normal.
pub(super) type Vector = [f64; COORDINATES_MAX];

/// Half-spaces beside the box: those of the cables and bends, and of two corrections among many obstacles. More are left out, which
/// [`Region::is_full`] tells.
const ROWS_MAX: usize = 152;
/// Half-spaces that are taken in or let go before the search gives up.
const STEPS_MAX: usize = 100;
/// What each takes the time of, beside the rows that are looked at: products of two vectors.
const STEP_PRODUCTS: u32 = 24;
/// What counts as inside, in the unit of the point, or as a share of it where it is larger than 1.
const INSIDE: f64 = 1e-13;
/// What the way of a point may be longer by than its sum tells, as a share: rounding.
const ROUNDING: f64 = 1e-9;
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
    /// Beside each row how long the way of the point that is found must be before it can be violated.
    clear_until: [f64; ROWS_MAX],
    row_count: usize,
    /// Whether a half-space was left out.
    is_full: bool,
    /// What was looked for took the time of so many products of two vectors.
    products: u32,
    /// The nearest point to `to` before more half-spaces came, and what holds it there; changed in place, because they are large.
    found: Found,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    /// Whether there is one.
    is_known: bool,
    to: Vector,
    at: Vector,
    /// The length of its way from where all rows were looked at, at most.
    travelled: f64,
    active: Active,
}

/// What holds the nearest point, by what its bounds change with.
pub(super) struct Pulls {
    /// Half the squared distance of the point.
    pub(super) half_square: f64,
    /// How much that falls for each unit of the largest component, and of 1 / way.
    pub(super) most: f64,
    pub(super) per_way: f64,
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

impl Region {
    /// No point. A constant, because it is large: it is changed in place, too.
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
        way_s: 0.0,
        rows: [Row::ZERO; ROWS_MAX],
        clear_until: [0.0; ROWS_MAX],
        row_count: 0,
        is_full: false,
        products: 0,
        found: Found {
            is_known: false,
            to: [0.0; COORDINATES_MAX],
            at: [0.0; COORDINATES_MAX],
            travelled: 0.0,
            active: Active::NONE,
        },
    };

    /// A box without half-spaces, for points that are obeyed for `way_s`, with no component larger than `most`.
    pub(super) fn reset(&mut self, dimensions: usize, sides: [Vector; 2], most: f64, way_s: f64) {
        self.dimensions = dimensions;
        self.sides = sides;
        self.way_s = way_s;
        self.row_count = 0;
        self.is_full = false;
        self.slow_down_to(most);
    }

    /// Whether a half-space leaves out a part of the box.
    fn is_cut_by(&self, Row { normal, bound, .. }: &Row) -> bool {
        // No normal has a component beyond the dimensions, and no box a side.
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

    /// What was looked for since this was asked last took the time of so many products of two vectors.
    pub(super) fn take_products(&mut self) -> u32 {
        core::mem::take(&mut self.products)
    }

    /// Only where normal · x ≥ bound. What leaves out no part of the box is no row of the region; nor is a normal without length. Whether it is one.
    pub(super) fn bound(&mut self, normal: &Vector, bound: f64) -> bool {
        let before = self.row_count;
        self.add(normal, bound, Room::None);
        self.row_count > before
    }

    /// Only where normal · x ≥ bound, and normal · x · way ≥ -room.
    pub(super) fn bound_along(&mut self, normal: &Vector, bound: f64, room: f64) {
        self.add(normal, bound, Room::Way(room));
    }

    fn add(&mut self, normal: &Vector, fixed: f64, room: Room) {
        let mut row = Row {
            normal: *normal,
            bound: 0.0,
            fixed,
            room,
        };
        row.move_to(self.most, self.way_s);
        if !self.is_cut_by(&row) {
            return;
        }
        let length = dot(normal, normal).sqrt();
        row.scale(1.0 / length);
        row.move_to(self.most, self.way_s);
        if length > 0.0 && length.is_finite() && row.bound.is_finite() {
            self.push(row);
        }
    }

    fn push(&mut self, row: Row) {
        self.is_full = self.row_count == ROWS_MAX;
        if !self.is_full {
            self.rows[self.row_count] = row;
            self.clear_until[self.row_count] = f64::NEG_INFINITY;
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

    /// Only where no component is larger than `most`, of points that are obeyed for `way_s`, neither more than before the first half-space. Of the half-spaces that move freely with the way, those stay
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
        self.look_at_all();
    }

    /// What holds what was found last. For every other largest component and way half the squared distance is at least what these tell: it is a convex function of
    /// the largest component and 1 / way. `None` where nothing was found.
    pub(super) fn pulls(&self) -> Option<Pulls> {
        if !self.found.is_known {
            return None;
        }
        let Found { to, at, active, .. } = &self.found;
        let mut away = *to;
        add(&mut away, at, -1.0);
        let mut pulls = Pulls {
            half_square: 0.5 * dot(&away, &away),
            most: 0.0,
            per_way: 0.0,
        };
        for (row, multiplier) in active.rows[..active.count].iter().zip(&active.multipliers) {
            match row.room {
                Room::Way(room) if row.bound > row.fixed => pulls.per_way += multiplier * room,
                Room::Most if row.bound > row.fixed => pulls.most += multiplier,
                _ => {}
            }
        }
        Some(pulls)
    }

    /// The point of the region that is nearest to `to`, beside rounding. `None` when there is none, or it was not found in
    /// a bounded number of steps.
    pub(super) fn nearest(&mut self, to: &Vector) -> Option<Vector> {
        if !(self.found.is_known && self.found.to == *to) {
            self.found.to = *to;
            self.found.at = *to;
            self.found.active.count = 0;
            self.found.active.multipliers = [0.0; COORDINATES_MAX];
            self.look_at_all();
        }
        self.found.is_known = self.go_on().is_some();
        self.found.is_known.then_some(self.found.at)
    }

    /// The point is elsewhere, or the bounds are.
    fn look_at_all(&mut self) {
        self.found.travelled = 0.0;
        self.clear_until[..self.row_count].fill(f64::NEG_INFINITY);
    }

    /// From the nearest point to the same one with fewer half-spaces, and those that hold it. `None`: they hold no point.
    fn go_on(&mut self) -> Option<()> {
        let mut steps = 0;
        while let Some(row) = self.most_violated() {
            let Found {
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
                    *travelled += step * dot(&way, &way).sqrt() * (1.0 + ROUNDING);
                }
                add(&mut active.multipliers, &shares, -step);
                multiplier += step;
                if full <= until {
                    active.push(row, multiplier, forward);
                    break;
                }
                active.remove(let_go);
            }
        }
        Some(())
    }

    /// What is violated most at the point that is found; a NaN violates nothing.
    fn most_violated(&mut self) -> Option<Row> {
        let Found { at, travelled, .. } = &self.found;
        let (mut most, mut found) = (INSIDE, None);
        let mut look = |side: Side, bound: f64, lack: f64| {
            let scale = 1.0 + bound.abs();
            if lack > most * scale {
                (most, found) = (lack / scale, Some(side));
            }
        };
        let rows = self.rows[..self.row_count].iter().enumerate();
        for ((index, row), clear_until) in rows.zip(&mut self.clear_until) {
            if *clear_until > *travelled {
                continue;
            }
            self.products += 1;
            let lack = row.bound - dot(&row.normal, at);
            *clear_until = travelled - lack;
            look(Side::Row(index), row.bound, lack);
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

    /// The same half-space with a longer normal.
    fn scale(&mut self, by: f64) {
        self.normal = self.normal.map(|component| component * by);
        self.fixed *= by;
        if let Room::Way(room) = &mut self.room {
            *room *= by;
        }
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

/// Four sums side by side: one alone waits for each addition.
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
