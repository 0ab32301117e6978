//! Where corrections lead to rest: all half-spaces made anew from one linearisation.

use super::near::REGION_LOOKS;
use super::{ClearanceGuard, Places, STANDING, faster, fastest, shortened_to, times};
use crate::robot::BendRates;
use crate::safety::Limits;
use crate::safety::projection::Region;

/// How a command is linearised anew: first for slow rates, because clearances are curved less along a short way, obstacles move less, and a check takes little.
pub(super) const BEGINNINGS: &[Beginning] = &[
    Beginning {
        speed: SLOW,
        shrinks: 0.5,
        renewals: 6,
        slack: 0.0,
        margin_m: 1e-9,
    },
    Beginning {
        speed: 1.0,
        shrinks: 1.0,
        renewals: 4,
        slack: 0.0,
        margin_m: 1e-7,
    },
    Beginning {
        speed: 1.0,
        shrinks: 1.0,
        renewals: 4,
        slack: 0.1,
        margin_m: 1e-9,
    },
    Beginning {
        speed: 1.0,
        shrinks: 1.0,
        renewals: 4,
        slack: 0.5,
        margin_m: 1e-9,
    },
];
/// Shares of what is found then that are checked.
const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// The first of them alone, which leaves enough to correct what is desired, too.
pub(super) const SLOWLY: &[Beginning] = &[Beginning {
    renewals: 2,
    ..BEGINNINGS[0]
}];
/// One that is made anew and leaves no more than this is taken where no other leaves more.
const SLOW: f64 = 0.1;

/// Around the standing robot each half-space is wider by a share of the fastest component, because all of them can meet in rest alone where clearances
/// are curved and there is a way. Later ones ask for a margin.
#[derive(Clone, Copy)]
pub(super) struct Beginning {
    /// The share of the desired rates that the nearest are looked for to.
    speed: f64,
    /// The share of that which is looked for next where nothing holds of what was found around other rates: what clearances are curved by falls with its square.
    shrinks: f64,
    /// Times that it is linearised.
    renewals: usize,
    pub(super) slack: f64,
    pub(super) margin_m: f64,
}

impl ClearanceGuard<'_> {
    /// As [`Self::corrected`], where that leads to rest. Half-spaces from several linearisations may leave nothing between them, and those of the
    /// standing robot nothing that holds exactly, because clearances are curved. So all of them are made anew from one linearisation:
    /// around the standing robot, where rest is inside, and then around what was found with those.
    pub(super) fn renewed(
        &self,
        near: &Places<'_>,
        limits: &Limits<'_>,
        desired_rates: &BendRates,
        beginnings: &[Beginning],
    ) -> BendRates {
        let mut slow = self.rest();
        for beginning in beginnings {
            let mut wished = times(desired_rates, beginning.speed);
            let mut limited = Region::EMPTY;
            limits.fill(&mut limited, fastest(&wished));
            let mut around = None;
            for _ in 0..beginning.renewals {
                if near.is_out_of_looks() {
                    return slow;
                }
                let mut region = limited.clone();
                near.bound_again(self, &wished, around.as_ref(), beginning, &mut region);
                let nearest = limits.nearest_in(&mut region, &wished);
                near.count(REGION_LOOKS + region.take_products());
                let Some(nearest) = nearest else {
                    // What was found is nearer to the standing robot then.
                    let Some(rates) = around else { break };
                    around = Some(times(&rates, 0.5));
                    continue;
                };
                let rates = shortened_to(nearest, fastest(&wished));
                if fastest(&rates) <= STANDING * fastest(&wished) {
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
                    beginning.shrinks
                } else {
                    1.0
                };
                wished = times(&wished, next);
                limited.slow_down_to(fastest(&wished));
                around = Some(times(&rates, next));
            }
        }
        slow
    }

    /// The largest of [`SHARES`] of `rates` that holds the rule.
    fn held_share(&self, near: &Places<'_>, rates: &BendRates) -> Option<BendRates> {
        near.forget_between();
        SHARES.into_iter().find_map(|share| {
            let shorter = times(rates, share);
            let is_held = near.check(self, &shorter).is_ok();
            if !is_held && share == 1.0 {
                near.note_between(self, rates);
            }
            is_held.then_some(shorter)
        })
    }
}
