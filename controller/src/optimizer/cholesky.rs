//! Cholesky factorisation in place, in memory of the caller.

use super::Budget;
use super::linear_model::dot;

/// Factorises symmetric positive definite A (`order`², row-major, only the lower triangle is read), and writes the factor over it. False: A is not positive
/// definite to working precision, or the budget was spent on the way.
pub(super) fn factorise(a: &mut [f64], order: usize, budget: &mut Budget<'_>) -> bool {
    for column in 0..order {
        for row in column..order {
            // A product and a sum in half a nanosecond.
            if !budget.spend(column as u32 / 2) {
                return false;
            }
            let (row_so_far, column_so_far) =
                (&a[row * order..][..column], &a[column * order..][..column]);
            let sum = a[row * order + column] - dot(row_so_far, column_so_far);
            if row > column {
                a[row * order + column] = sum / a[column * order + column];
            } else if sum > 0.0 && sum.is_finite() {
                a[row * order + column] = sum.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// Solves A x = b with the factor of A; `b` becomes x, undefined when the budget was spent on the way: false.
pub(super) fn substitute(
    factor: &[f64],
    order: usize,
    b: &mut [f64],
    budget: &mut Budget<'_>,
) -> bool {
    for row in 0..order {
        if !budget.spend(row as u32) {
            return false;
        }
        let mut sum = b[row];
        for k in 0..row {
            sum -= factor[row * order + k] * b[k];
        }
        b[row] = sum / factor[row * order + row];
    }
    for row in (0..order).rev() {
        if !budget.spend((order - row) as u32) {
            return false;
        }
        let mut sum = b[row];
        for k in row + 1..order {
            sum -= factor[k * order + row] * b[k];
        }
        b[row] = sum / factor[row * order + row];
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
