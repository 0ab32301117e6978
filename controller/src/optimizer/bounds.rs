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

    /// Leaves of the box what can be reached from `previous`: so that component i goes no farther beyond it, away from zero, and no farther
    /// beyond zero than `change(block)`, for each repetition of the box. To go towards zero is free.
    pub(crate) fn keep_near(&mut self, previous: &[f64], change: impl Fn(usize) -> f64) {
        let width = previous.len();
        let blocks = self.lower.chunks_exact_mut(width);
        let blocks = blocks.zip(self.upper.chunks_exact_mut(width)).enumerate();
        for (block, (lower, upper)) in blocks {
            let change = change(block);
            for ((lower, upper), previous) in lower.iter_mut().zip(upper).zip(previous) {
                *lower = lower.max(previous.min(0.0) - change);
                *upper = upper.min(previous.max(0.0) + change);
            }
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
