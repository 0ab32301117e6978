/// The box that a solution lies in: `lower[i] <= z[i] <= upper[i]`.
#[derive(Debug, Clone)]
pub struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Bounds {
    /// An empty box with room for `capacity` unknowns.
    pub fn with_capacity(capacity: usize) -> Self {
        Self {
            lower: Vec::with_capacity(capacity),
            upper: Vec::with_capacity(capacity),
        }
    }

    /// Sets the box to `±half_width[i]`, repeated `repetitions` times. Does not allocate within the
    /// capacity.
    pub fn set_symmetric(
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
    pub fn dimension(&self) -> usize {
        self.lower.len()
    }

    /// Lower bounds.
    pub fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// Upper bounds.
    pub fn upper(&self) -> &[f64] {
        &self.upper
    }

    /// Moves every component of `z` into the box.
    pub fn project(&self, z: &mut [f64]) {
        for ((value, &low), &high) in z.iter_mut().zip(&self.lower).zip(&self.upper) {
            *value = value.clamp(low, high);
        }
    }

    /// Whether `z` lies in the box (NaN does not).
    pub fn contains(&self, z: &[f64]) -> bool {
        z.len() == self.dimension()
            && z.iter()
                .zip(self.lower.iter().zip(&self.upper))
                .all(|(value, (low, high))| (*low..=*high).contains(value))
    }
}
