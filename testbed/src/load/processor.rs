//! Threads that only compute.

use std::hint::black_box;

use super::Done;
use super::task::Signals;

/// Steps between two checks for the end.
const STEPS: u64 = 100_000;

/// Computes with integers in registers until the load ends.
pub(super) fn spin(signals: &Signals) -> Done {
    signals.works();
    let mut done = Done::default();
    let mut state = 1_u64;
    while !signals.is_ending() {
        for step in 0..STEPS {
            state = black_box(
                state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(step),
            );
        }
        done.spins += 1;
    }
    done
}
