/// The box of the solution: `lower[i] <= z[i] <= upper[i]`.
#[derive(Debug)]
pub(crate) struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Bounds {
    /// An empty box with memory for `capacity` unknowns.
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self {
            lower: Vec::with_capacity(capacity),
            upper: Vec::with_capacity(capacity),
        }
    }

    /// Sets the box to `±half_width[i]`, repeated `repetitions` times. Does not allocate within the capacity.
    pub(crate) fn set_symmetric(
        &mut self,
        half_width: impl Iterator<Item = f64>,
        repetitions: usize,
    ) {
        self.lower.clear();
        self.upper.clear();
        self.upper.extend(half_width);
        let width = self.upper.len();
        for _ in 1..repetitions {
            self.upper.extend_from_within(..width);
        }
        self.lower.extend(self.upper.iter().map(|half| -half));
    }

    /// Limits the growth of component i from `previous` to `change(block)` in each repetition of the box, in
    /// both directions from zero. A decrease towards zero is not limited.
    pub(crate) fn limit_growth(&mut self, previous: &[f64], change: impl Fn(usize) -> f64) {
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

    /// Clamps every component of `z` to the box.
    pub(crate) fn project(&self, z: &mut [f64]) {
        for ((value, &low), &high) in z.iter_mut().zip(&self.lower).zip(&self.upper) {
            *value = value.clamp(low, high);
        }
    }

    /// Whether `z` lies in the box; false for NaN.
    #[cfg(test)]
    pub(crate) fn contains(&self, z: &[f64]) -> bool {
        z.len() == self.dimension()
            && z.iter()
                .zip(self.lower.iter().zip(&self.upper))
                .all(|(value, (low, high))| (*low..=*high).contains(value))
    }
}
