//! Corrections that would end at rest: all half-spaces are recomputed from one linearisation.

use super::near::REGION_COST;
use super::{ClearanceGuard, Origins, REST_SHARE, faster};
use crate::robot::BendRates;
use crate::safety::Limits;
use crate::safety::projection::Region;
use crate::safety::stopping::{fastest, scaled_by, shortened_to};

/// Settings of the relinearisations, in order. Slow rates come first: along a short path clearances are less
/// curved, obstacles move less, and a check costs less.
pub(super) const LINEARISATIONS: &[Linearisation] = &[
    Linearisation {
        speed: SLOW,
        shrinks: 0.5,
        rounds: 6,
        slack: 0.0,
        extra_m: 1e-9,
    },
    Linearisation {
        speed: 1.0,
        shrinks: 1.0,
        rounds: 4,
        slack: 0.0,
        extra_m: 1e-7,
    },
    Linearisation {
        speed: 1.0,
        shrinks: 1.0,
        rounds: 4,
        slack: 0.1,
        extra_m: 1e-9,
    },
    Linearisation {
        speed: 1.0,
        shrinks: 1.0,
        rounds: 4,
        slack: 0.5,
        extra_m: 1e-9,
    },
];
/// Shares of the nearest rates that are checked.
const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// The first relinearisation alone, which leaves enough budget to correct the desired rates.
pub(super) const SLOW_LINEARISATION: &[Linearisation] = &[Linearisation {
    rounds: 2,
    ..LINEARISATIONS[0]
}];
/// A result below this share of the desired rates is used only if no later relinearisation gives faster
/// rates.
const SLOW: f64 = 0.1;

/// Settings of one relinearisation. At rest, each half-space is widened by a share of the fastest component:
/// with curved clearances the exact half-spaces may meet in rest alone although the robot can move. Later
/// linearisations ask for an extra margin.
#[derive(Clone, Copy)]
pub(super) struct Linearisation {
    /// Share of the desired rates to which the nearest rates are searched.
    speed: f64,
    /// Factor on that share when no result around other rates satisfies the rule: the error of the
    /// linearisation falls with its square.
    shrinks: f64,
    /// Number of linearisations.
    rounds: usize,
    pub(super) slack: f64,
    pub(super) extra_m: f64,
}

impl ClearanceGuard<'_> {
    /// Like [`Self::corrected`], for corrections that end at rest. Half-spaces from several linearisations
    /// may have no common point, and those linearised at rest may contain no rates that satisfy the rule
    /// exactly, because clearances are curved. So all half-spaces are recomputed from one linearisation:
    /// first at rest, which is inside, then at the rates found before.
    pub(super) fn relinearised(
        &self,
        near: &Origins<'_>,
        limits: &Limits<'_>,
        desired_rates: &BendRates,
        linearisations: &[Linearisation],
    ) -> BendRates {
        let mut slow = self.rest();
        for linearisation in linearisations {
            let mut target = scaled_by(desired_rates, linearisation.speed);
            let mut limited = Region::EMPTY;
            limits.fill(&mut limited, fastest(&target));
            let mut around = None;
            for _ in 0..linearisation.rounds {
                if near.is_budget_spent() {
                    return slow;
                }
                let mut region = limited.clone();
                near.bound_relinearised(self, &target, around.as_ref(), linearisation, &mut region);
                let nearest = limits.nearest_in(&mut region, &target);
                near.spend(REGION_COST + region.take_products());
                let Some(nearest) = nearest else {
                    // The rates found before are closer to rest.
                    let Some(rates) = around else { break };
                    around = Some(scaled_by(&rates, 0.5));
                    continue;
                };
                let rates = shortened_to(nearest, fastest(&target));
                if fastest(&rates) <= REST_SHARE * fastest(&target) {
                    break;
                }
                let held = self.held_share(near, &rates);
                if let Some(held) = held {
                    if fastest(&held) > SLOW * fastest(desired_rates) {
                        return held;
                    }
                    slow = faster(slow, held);
                }
                let next = if held.is_none() && around.is_some() {
                    linearisation.shrinks
                } else {
                    1.0
                };
                target = scaled_by(&target, next);
                limited.slow_down_to(fastest(&target));
                around = Some(scaled_by(&rates, next));
            }
        }
        slow
    }

    /// The largest of [`SHARES`] of `rates` that satisfies the rule.
    fn held_share(&self, near: &Origins<'_>, rates: &BendRates) -> Option<BendRates> {
        near.clear_between();
        SHARES.into_iter().find_map(|share| {
            let shorter = scaled_by(rates, share);
            let is_held = near.check(self, &shorter).is_ok();
            if !is_held && share == 1.0 {
                near.note_between(self, rates);
            }
            is_held.then_some(shorter)
        })
    }
}
