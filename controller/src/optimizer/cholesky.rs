//! Cholesky factorisation in place, in memory provided by the caller.

use super::Budget;
use super::products::{ANNOUNCED_MAX, dot, with_known_size};

/// Factorises a symmetric positive definite A (`order`², row-major; only the lower triangle is read) in
/// place. False: A is not positive definite to working precision, or the budget was spent.
pub(super) fn factorise(a: &mut [f64], order: usize, budget: &mut Budget<'_>) -> bool {
    with_known_size!(order, factorise_of(a, order, budget))
}

#[inline(always)]
fn factorise_of(a: &mut [f64], order: usize, budget: &mut Budget<'_>) -> bool {
    let at_once = order <= ANNOUNCED_MAX;
    for column in 0..order {
        // A multiplication and an addition take half a nanosecond.
        let each_ns = column as u32 / 2;
        let (own, below) = a[column * order..order * order].split_at_mut(order);
        let (own, diagonal) = own.split_at_mut(column);
        let square = diagonal[0] - dot(own, own);
        if !(budget.spend(each_ns) && square > 0.0 && square.is_finite()) {
            return false;
        }
        let root = square.sqrt();
        diagonal[0] = root;
        let below_ns = core::iter::repeat_n(each_ns, order - column - 1);
        if at_once && !budget.spend_each(below_ns) {
            return false;
        }
        for row in below.chunks_exact_mut(order) {
            if !(at_once || budget.spend(each_ns)) {
                return false;
            }
            row[column] = (row[column] - dot(&row[..column], own)) / root;
        }
    }
    true
}

/// Solves A x = b in place with the factor of A. False: the budget was spent, and `b` is undefined.
pub(super) fn substitute(
    factor: &[f64],
    order: usize,
    b: &mut [f64],
    budget: &mut Budget<'_>,
) -> bool {
    with_known_size!(order, substitute_of(factor, order, b, budget))
}

#[inline(always)]
fn substitute_of(factor: &[f64], order: usize, b: &mut [f64], budget: &mut Budget<'_>) -> bool {
    let at_once = order <= ANNOUNCED_MAX;
    if at_once && !budget.spend_each(0..order as u32) {
        return false;
    }
    for row in 0..order {
        if !(at_once || budget.spend(row as u32)) {
            return false;
        }
        let (line, (known, rest)) = (&factor[row * order..][..=row], b.split_at_mut(row));
        let terms = line.iter().zip(known);
        rest[0] = terms.fold(rest[0], |sum, (entry, x)| sum - entry * *x) / line[row];
    }
    if at_once && !budget.spend_each(1..=order as u32) {
        return false;
    }
    for row in (0..order).rev() {
        if !(at_once || budget.spend((order - row) as u32)) {
            return false;
        }
        let (own, known) = b[row..].split_at_mut(1);
        let (line, below) = factor[row * order..].split_at(order);
        let terms = below.chunks_exact(order).zip(known);
        own[0] = terms.fold(own[0], |sum, (line, x)| sum - line[row] * *x) / line[row];
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solve_in_place(a: &mut [f64], order: usize, b: &mut [f64]) -> bool {
        let budget = &mut Budget::unlimited();
        factorise(a, order, budget) && substitute(a, order, b, budget)
    }

    #[test]
    fn solves_a_known_system() {
        // A = [[4,2,0],[2,5,1],[0,1,3]], x = (1,-2,3)
        let mut a = [4.0, 0.0, 0.0, 2.0, 5.0, 0.0, 0.0, 1.0, 3.0];
        let mut b = [0.0, -5.0, 7.0];
        assert!(solve_in_place(&mut a, 3, &mut b));
        for (is, should) in b.iter().zip([1.0, -2.0, 3.0]) {
            assert!((is - should).abs() < 1e-14, "{b:?}");
        }
    }

    #[test]
    fn refuses_what_is_not_positive_definite() {
        let mut a = [1.0, 0.0, 2.0, 1.0];
        assert!(!solve_in_place(&mut a, 2, &mut [1.0, 1.0]));
        assert!(!solve_in_place(&mut [f64::NAN], 1, &mut [1.0]));
    }
}
