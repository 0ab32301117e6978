//! Products of vectors, with a fixed order of the additions.

/// An expression with a number of unknowns or rows. Those of short plans become constants, of which the compiler makes
/// straight code instead of loops.
macro_rules! with_known_size {
    ($size:ident, $each:expr) => {
        match $size {
            4 => {
                let $size = 4;
                $each
            }
            6 => {
                let $size = 6;
                $each
            }
            _ => $each,
        }
    };
}
pub(super) use with_known_size;

/// Largest size whose work is announced at once, not line by line.
pub(super) const ANNOUNCED_MAX: usize = 8;

/// Adds a row times a factor, up to the shorter length. A section has two unknowns in each block, so most rows are
/// made of fours.
#[inline(always)]
pub(super) fn add_times(factor: f64, row: &[f64], into: &mut [f64]) {
    let length = row.len().min(into.len());
    let (into, last) = into[..length].as_chunks_mut::<4>();
    let (row, row_last) = row[..length].as_chunks::<4>();
    for (into, row) in into.iter_mut().zip(row) {
        for i in 0..4 {
            into[i] += row[i] * factor;
        }
    }
    for (sum, derivative) in last.iter_mut().zip(row_last) {
        *sum += derivative * factor;
    }
}

/// Σ aᵢ bᵢ over the shorter length, in eight partial sums: the order is fixed, and the additions do not wait
/// for each other.
#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    if length < 8 {
        return 0.0 + a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    }
    dot_eights(a, b, length)
}

fn dot_eights(a: &[f64], b: &[f64], length: usize) -> f64 {
    let (a, a_rest) = a[..length].as_chunks::<8>();
    let (b, b_rest) = b[..length].as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let [s0, s1, s2, s3, s4, s5, s6, s7] = sums;
    ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7)) + rest
}
