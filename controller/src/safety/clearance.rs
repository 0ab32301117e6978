//! The clearance guard: a command, and the ramp to rest after it, never brings the body nearer to one than is
//! allowed.

mod near;
mod play;
mod renewed;
mod rows;
mod watched;
mod way;

use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, Obstacle, Robot, SECTIONS_MAX};

use super::Limits;
use super::projection::Region;
use near::{Lack, Near, Stance};
use renewed::{BEGINNINGS, Beginning, SLOWLY};

/// Times that a command is corrected before it is scaled down instead.
const CORRECTIONS: usize = 12;
/// A correction that leaves less than this share of the fastest component is rest.
const STANDING: f64 = 1e-6;
/// Scales that are tried.
const SCALES: u32 = 12;
/// A command that is scaled down is at most this share of the rates shorter than one that was found not to hold.
const SCALE_WITHIN: f64 = 1.0 / 256.0;

/// A command that keeps clear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Guarded {
    /// The rates \[rad/s\].
    pub(super) rates: BendRates,
    /// Whether they are not those that were asked for.
    pub(super) hit: bool,
    /// Smallest clearance of the body to any obstacle, both as they are now \[m\]: negative inside an
    /// obstacle, infinite without obstacles, NaN when the state is not finite.
    pub(super) clearance_m: f64,
}

/// How the robot comes to rest when no other command follows: it obeys the last one for a while, and then its rates shrink
/// together, the fastest component evenly in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stopping {
    /// How long the robot obeys a command \[s\].
    pub(super) moving_s: f64,
    /// How fast the fastest component shrinks after that \[rad/s²\]; infinite: at once.
    pub(super) deceleration_rad_s2: f64,
}

/// What the robot does by one command: it moves on one line in bends, bend + s q̇, with s from 0 to `way_s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoppingWay {
    moving_s: f64,
    /// s at the end: longer than the command is obeyed by half the time of the ramp \[s\].
    pub(super) way_s: f64,
}

impl Stopping {
    /// From rates of which no component is faster than this.
    pub(super) fn way(&self, fastest_rad_s: f64) -> StoppingWay {
        StoppingWay {
            moving_s: self.moving_s,
            way_s: self.moving_s + 0.5 * fastest_rad_s / self.deceleration_rad_s2,
        }
    }

    /// How much longer the way is for each rad/s of the fastest component \[s²\].
    pub(super) fn way_slope_s2(&self) -> f64 {
        0.5 / self.deceleration_rad_s2
    }
}

impl StoppingWay {
    /// The time at which the robot is at s = `way_s`, after the command \[s\].
    pub(super) fn time_s(&self, way_s: f64) -> f64 {
        let (beyond_s, ramp_way_s) = (way_s - self.moving_s, self.way_s - self.moving_s);
        if beyond_s <= 0.0 || ramp_way_s <= 0.0 {
            return way_s;
        }
        let left = (1.0 - beyond_s / ramp_way_s).max(0.0);
        self.moving_s + 2.0 * ramp_way_s * (1.0 - left.sqrt())
    }

    /// Whether the robot moves evenly up to there.
    fn is_even(&self, way_s: f64) -> bool {
        way_s <= self.moving_s
    }

    /// Where it is at a time \[s\]: s.
    fn way_after_s(&self, time_s: f64) -> f64 {
        let (beyond_s, ramp_way_s) = (time_s - self.moving_s, self.way_s - self.moving_s);
        if beyond_s <= 0.0 || ramp_way_s <= 0.0 {
            return time_s;
        }
        let left = (1.0 - 0.5 * beyond_s / ramp_way_s).max(0.0);
        self.moving_s + ramp_way_s * (1.0 - left * left)
    }
}

/// What the body must keep clear of.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClearanceGuard<'a> {
    /// The robot.
    pub(super) robot: &'a Robot,
    /// Where it is.
    pub(super) at: &'a Configuration,
    /// Where it is commanded to be, when it obeys positions: its motors are on their way there.
    pub(super) commanded: Option<&'a Configuration>,
    /// What is taken of the play of its cables, where those are what moves by the commands.
    pub(super) slack: Option<&'a Slack>,
    /// Where they are now.
    pub(super) obstacles: &'a [Obstacle],
    /// Distance D \[m\].
    pub(super) safe_distance_m: f64,
    /// Period \[s\].
    pub(super) period_s: f64,
    /// What follows a command.
    pub(super) stopping: Stopping,
}

impl ClearanceGuard<'_> {
    /// Changes `rates`, which are inside the limits, as little as keeping clear of the obstacles asks for.
    ///
    /// Let cⱼ(s) be the clearance of section j to an obstacle: of the section at bend + s q̇, to the obstacle moved on by its
    /// velocity for the time that the robot takes to get there, and c⁰ⱼ(s) the same of the robot that stands still. The rates
    /// that are returned have, for every obstacle and section,
    ///
    /// ```text
    /// cⱼ(s) ≥ min(D, c⁰ⱼ(s))            at the end of the period, and at the end of the stopping way: exactly
    /// cⱼ(s) ≥ min(D, c⁰ⱼ(s)) - 1 mm     everywhere between; less by what a moving obstacle moves in a period
    /// ```
    ///
    /// So no command leads a section from outside into D, or one inside nearer, and none jumps through an obstacle that stands:
    /// neither now, nor when no command follows. A robot that a command finds between, because others were lost, keeps what it
    /// has there: the millimetre may lack anew each time. The rates stay inside the limits, and no component is
    /// faster than the fastest of `rates`. Where those break the rule, the nearest that keep it are looked for, which slide along the
    /// obstacle: clearances are made linear where they are too small, as often as it takes. Where that does not hold
    /// exactly, what was found is scaled down, and then `rates` themselves; and where nothing is left among few obstacles, all clearances are
    /// made linear anew at one place, for slow rates first. Among many obstacles that is done before all else, for slow rates alone, while there is time. Slower
    /// rates stop sooner: each that are looked at
    /// have the way and the time that are theirs. Standing still always holds. A robot that obeys
    /// positions keeps the same rule from where it is commanded to be, too.
    ///
    /// What it cannot do: it does not plan a way around; and it does not flee: an obstacle that runs into the standing robot
    /// does so.
    ///
    /// Nothing allocates; the work is bounded, and a few comparisons where no obstacle is near. The same inputs give the
    /// same bits.
    pub(super) fn apply(&self, limits: &Limits<'_>, rates: &BendRates) -> Guarded {
        self.guarded(rates, false, |near| {
            if !near.are_few() {
                let lacks = near.lacks();
                let slow = self.renewed(near, limits, rates, SLOWLY);
                near.begin_again(lacks);
                let found = self.corrected(near, limits, rates);
                return faster(found, slow);
            }
            let found = self.corrected(near, limits, rates);
            if found == self.rest() {
                near.allow_renewal();
                return self.renewed(near, limits, rates, BEGINNINGS);
            }
            found
        })
    }

    /// For a robot that comes to rest: `ramp` is only scaled down, so no component becomes larger.
    ///
    /// The ramp goes on along the stopping way of the command before it, and may end anywhere on it. So from an obstacle that
    /// stands it keeps 1 mm less than D at its ends, and another 1 mm less between: what the command before was allowed, the ramp
    /// is allowed.
    pub(super) fn scale_down(&self, ramp: &BendRates) -> Guarded {
        self.guarded(ramp, true, |near| self.scaled(near, ramp))
    }

    /// `rates`, scaled down to where the rule of [`Self::apply`] holds.
    pub(super) fn shorten(&self, rates: &BendRates) -> Guarded {
        self.guarded(rates, false, |near| self.scaled(near, rates))
    }

    /// The rates where they hold the rule, and what `mend` makes of them elsewhere.
    fn guarded(
        &self,
        rates: &BendRates,
        is_ramp: bool,
        mend: impl FnOnce(&Places<'_>) -> BendRates,
    ) -> Guarded {
        let guarded = |allowed: BendRates, clearance_m| Guarded {
            rates: allowed,
            hit: allowed != *rates,
            clearance_m,
        };
        if self.obstacles.is_empty() {
            return guarded(*rates, f64::INFINITY);
        }
        let stance = Stance::new(self.robot, self.at);
        let Some(measured) = Near::find(self, &stance, rates, is_ramp) else {
            return guarded(self.rest(), self.clearance_m(&stance));
        };
        let clearance_m = match measured.least_clearance_m() {
            Some(clearance_m) => clearance_m,
            None => self.clearance_m(&stance),
        };
        let commanded = self.commanded.filter(|commanded| *commanded != self.at);
        let stance = commanded.map(|commanded| Stance::new(self.robot, commanded));
        let commanded = stance
            .as_ref()
            .map(|it| Near::find(&self.without_play(), it, rates, is_ramp));
        let places = match &commanded {
            None => [Some(&measured), None],
            Some(Some(commanded)) => [Some(&measured), Some(commanded)],
            Some(None) => return guarded(self.rest(), clearance_m),
        };
        let places = Places(places);
        if places.check(self, rates).is_ok() {
            return guarded(*rates, clearance_m);
        }
        guarded(mend(&places), clearance_m)
    }

    /// The nearest rates inside the limits that hold the rule, as far as they are found.
    fn corrected(
        &self,
        near: &Places<'_>,
        limits: &Limits<'_>,
        desired_rates: &BendRates,
    ) -> BendRates {
        // What is shortened afterwards may come nearer than what was found.
        let mut region = Region::EMPTY;
        limits.fill(&mut region, fastest(desired_rates));
        let mut rates = *desired_rates;
        for _ in 0..CORRECTIONS {
            let rows = near.row_count();
            if !near.has_looks_to_correct()
                || !near.bound(self, &rates, &mut region)
                || region.is_full()
            {
                break;
            }
            let Some(nearest) = limits.nearest_in(&mut region, desired_rates) else {
                break;
            };
            let before = rates;
            rates = shortened_to(nearest, fastest(desired_rates));
            if rates == before {
                if near.row_count() == rows {
                    // What is too small has its row around these rates already.
                    break;
                }
                // The first rows are around the standing robot, and leave them; the next are around them.
                continue;
            }
            if fastest(&rates) <= STANDING * fastest(desired_rates) {
                return self.rest();
            }
            if near.check(self, &rates).is_ok() {
                return rates;
            }
        }
        let scaled = self.scaled(near, &rates);
        if scaled == self.rest() {
            return self.scaled(near, desired_rates);
        }
        scaled
    }

    /// `rates`, scaled down to where the rule holds: between a scale that does and one that does not, the one is tried where the
    /// clearance that was too small would be large enough, were it linear.
    fn scaled(&self, near: &Places, rates: &BendRates) -> BendRates {
        let mut held = self.rest();
        let (mut low, mut high, mut between) = (0.0, 1.0, 0.5_f64);
        for _ in 0..SCALES {
            if near.is_out_of_looks() || high - low <= SCALE_WITHIN {
                break;
            }
            let middle = low + (high - low) * between.clamp(0.125, 0.875);
            let scaled = times(rates, middle);
            match near.check(self, &scaled) {
                Ok(()) => (low, held, between) = (middle, scaled, 0.5),
                Err(share) => {
                    high = middle;
                    between = (share * high - low) / (high - low);
                }
            }
        }
        held
    }

    /// What no point of each section moves by along the whole way \[m\], at these rates or any others inside the limits that are
    /// not faster.
    fn farthest_m(&self, rates: &BendRates) -> [f64; SECTIONS_MAX] {
        let way_s = self.stopping.way(fastest(rates)).way_s;
        let mut change_rad = [0.0; SECTIONS_MAX];
        for (change_rad, section) in change_rad.iter_mut().zip(self.robot.sections()) {
            let largest_rad_s = fastest(rates).min(section.rate_max_rad_s);
            *change_rad = way_s * core::f64::consts::SQRT_2 * largest_rad_s;
        }
        self.robot.travel_m(&self.bent_most(change_rad))
    }

    fn without_play(&self) -> Self {
        Self {
            slack: None,
            ..*self
        }
    }

    fn clearance_m(&self, stance: &Stance) -> f64 {
        let obstacles = self.obstacles.iter();
        stance.body.least_clearance_m(obstacles.copied())
    }

    fn rest(&self) -> BendRates {
        BendRates::zero(self.robot.section_count())
    }
}

/// What is near where the robot is, and where it is commanded to be.
struct Places<'a>([Option<&'a Near<'a>>; 2]);

impl Places<'_> {
    fn iter(&self) -> impl Iterator<Item = &Near<'_>> {
        self.0.iter().copied().flatten()
    }

    fn is_out_of_looks(&self) -> bool {
        self.iter().any(Near::is_out_of_looks)
    }

    fn has_looks_to_correct(&self) -> bool {
        self.iter().all(Near::has_looks_to_correct)
    }

    /// [`way::check`] of each.
    fn check(&self, guard: &ClearanceGuard<'_>, rates: &BendRates) -> Result<(), f64> {
        self.iter().for_each(Near::forget_lack);
        // Motors have no play.
        let guards = [guard, &guard.without_play()];
        self.iter()
            .zip(guards)
            .try_for_each(|(near, guard)| way::check(near, guard, rates))
    }

    /// Of [`Near::row_count`] the sum.
    fn row_count(&self) -> u32 {
        self.iter().map(Near::row_count).sum()
    }

    fn count(&self, looks: u32) {
        self.iter().for_each(|near| near.count(looks));
    }

    fn are_few(&self) -> bool {
        self.iter().all(Near::are_few)
    }

    /// What the last check of rates found.
    fn lacks(&self) -> [Option<Lack>; 2] {
        [0, 1].map(|k| self.0[k].and_then(Near::lack))
    }

    /// As when that check was made, but for the work since.
    fn begin_again(&self, lacks: [Option<Lack>; 2]) {
        for (near, lack) in self.0.into_iter().zip(lacks) {
            if let Some(near) = near {
                near.begin_again(lack);
            }
        }
    }

    /// More work.
    fn allow_renewal(&self) {
        self.iter().for_each(Near::allow_renewal);
    }

    /// [`rows::bound_again`] of each.
    fn bound_again(
        &self,
        guard: &ClearanceGuard<'_>,
        desired_rates: &BendRates,
        around: Option<&BendRates>,
        beginning: &Beginning,
        region: &mut Region,
    ) {
        for near in self.iter() {
            rows::bound_again(near, guard, desired_rates, around, beginning, region);
        }
    }

    fn forget_between(&self) {
        self.iter().for_each(|near| near.note_between(None));
    }

    /// What the last check of these rates found between the ends of the way.
    fn note_between(&self, guard: &ClearanceGuard<'_>, rates: &BendRates) {
        let ends_s = near::ends_s(guard, rates);
        for near in self.iter() {
            near.note_between(near.lack().filter(|lack| !ends_s.contains(&lack.way_s)));
        }
    }

    /// [`rows::bound`] of each.
    fn bound(&self, guard: &ClearanceGuard<'_>, rates: &BendRates, region: &mut Region) -> bool {
        let is_bounded = |near: &Near<'_>| rows::bound(near, guard, rates, &mut *region);
        self.iter()
            .map(is_bounded)
            .fold(false, |any, one| any | one)
    }
}

pub(super) fn times(rates: &BendRates, factor: f64) -> BendRates {
    let mut scaled = *rates;
    for rate in scaled.as_mut_slice() {
        *rate *= factor;
    }
    scaled
}

/// The rates, with a fastest component of `fastest_rad_s` at most.
pub(super) fn shortened_to(rates: BendRates, fastest_rad_s: f64) -> BendRates {
    let present_rad_s = fastest(&rates);
    if present_rad_s <= fastest_rad_s {
        return rates;
    }
    // A little shorter, so that rounding does not make it longer.
    times(&rates, fastest_rad_s / present_rad_s * (1.0 - 1e-15))
}

/// That with the faster component; the first where both are as fast.
fn faster(one: BendRates, other: BendRates) -> BendRates {
    if fastest(&one) < fastest(&other) {
        other
    } else {
        one
    }
}

/// The fastest component \[rad/s\].
pub(super) fn fastest(rates: &BendRates) -> f64 {
    let components = rates.as_slice().iter();
    components.fold(0.0, |most, rate| rate.abs().max(most))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests;
