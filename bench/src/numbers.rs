//! Random numbers, reproducible from a seed on every machine.

use cdcr_controller::optimizer::cycle_seed;

pub(crate) struct Numbers {
    seed: u64,
    drawn: u64,
}

impl Numbers {
    pub(crate) fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        const BITS: u32 = 53;
        self.drawn += 1;
        let bits = cycle_seed(self.seed, self.drawn) >> (u64::BITS - BITS);
        low + (high - low) * bits as f64 / (1_u64 << BITS) as f64
    }
}
