use serde::Serialize;

/// Exact percentiles of all values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Spread {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) max: f64,
}

impl Spread {
    /// Nearest rank: the smallest value that is not exceeded by at least this share of all values. `None`
    /// without values.
    pub(crate) fn from_values(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(rank.saturating_sub(1)).copied()
        };
        Some(Self {
            p50: at(0.5)?,
            p99: at(0.99)?,
            max: at(1.0)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact() {
        let of = |values: &[f64]| {
            let spread = Spread::from_values(values.iter().copied())?;
            Some([spread.p50, spread.p99, spread.max])
        };
        let many: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(of(&many), Some([100.0, 198.0, 200.0]));
        assert_eq!(of(&[7.0]), Some([7.0; 3]));
        assert_eq!(of(&[]), None);
    }
}
