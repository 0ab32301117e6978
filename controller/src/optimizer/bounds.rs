/// The box that a solution lies in: `lower[i] <= z[i] <= upper[i]`.
#[derive(Debug, Clone)]
pub(crate) struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Bounds {
    /// An empty box with room for `capacity` unknowns.
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self {
            lower: Vec::with_capacity(capacity),
            upper: Vec::with_capacity(capacity),
        }
    }

    /// Sets the box to `±half_width[i]`, repeated `repetitions` times. Does not allocate within the
    /// capacity.
    pub(crate) fn set_symmetric(
        &mut self,
        half_width: &(impl Iterator<Item = f64> + Clone),
        repetitions: usize,
    ) {
        self.lower.clear();
        self.upper.clear();
        for _ in 0..repetitions {
            self.upper.extend(half_width.clone());
            self.lower.extend(half_width.clone().map(|half| -half));
        }
    }

    /// Number of unknowns.
    pub(crate) fn dimension(&self) -> usize {
        self.lower.len()
    }

    /// Lower bounds.
    pub(crate) fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// Upper bounds.
    pub(crate) fn upper(&self) -> &[f64] {
        &self.upper
    }

    /// Moves every component of `z` into the box.
    pub(crate) fn project(&self, z: &mut [f64]) {
        for ((value, &low), &high) in z.iter_mut().zip(&self.lower).zip(&self.upper) {
            *value = value.clamp(low, high);
        }
    }

    /// Whether `z` lies in the box (NaN does not).
    #[cfg(test)]
    pub(crate) fn contains(&self, z: &[f64]) -> bool {
        z.len() == self.dimension()
            && z.iter()
                .zip(self.lower.iter().zip(&self.upper))
                .all(|(value, (low, high))| (*low..=*high).contains(value))
    }
}
