//! The rule of the guard for cables that move through their play.

use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, SECTIONS_MAX};

use super::ClearanceGuard;
use super::body_pose::BodyPose;
use super::near::NearObstacles;
use super::path_check::check;

/// Rounding of clearances that stay constant, in the sums of a play \[m\].
const ROUNDING_M: f64 = 1e-12;

impl<'a> ClearanceGuard<'a> {
    /// Calls `evaluate` with a predicate that tests the rule of [`Self::apply`] for cables with play, for
    /// rates that are not faster than `rates`. All tests share the work budget of one command; when it is
    /// spent, the predicate is false.
    pub(in crate::safety) fn through_play<T>(
        &self,
        slack: &'a Slack,
        rates: &BendRates,
        evaluate: impl FnOnce(&dyn Fn(&BendRates) -> bool) -> T,
    ) -> T {
        let slack = Some(slack);
        let guard = Self { slack, ..*self };
        let pose = BodyPose::new(guard.robot, guard.at);
        let near = NearObstacles::find(&guard, &pose, rates, false);
        let holds = |near: &NearObstacles<'_>, rates: &BendRates| {
            !near.is_budget_spent() && check(near, &guard, rates).is_ok()
        };
        evaluate(&|rates| near.as_ref().is_some_and(|near| holds(near, rates)))
    }

    /// Configuration after the motors moved for `path_s` at `rates`.
    pub(in crate::safety) fn after(
        &self,
        at: &Configuration,
        rates: &BendRates,
        path_s: f64,
    ) -> Configuration {
        let Some(slack) = self.slack else {
            return at.advanced(rates, path_s);
        };
        let moved = self.moved(rates, path_s);
        let before = slack.bends(self.robot);
        let after = slack.moved(self.robot, &moved).bends(self.robot);
        let mut cables = *at;
        let changes = moved.as_slice().iter().zip(after.as_slice());
        let changes = changes.zip(before.as_slice());
        for (cable, ((moved, after), before)) in cables.as_mut_slice().iter_mut().zip(changes) {
            *cable += moved + (after - before);
        }
        cables
    }

    /// Upper bound of each section's bending when its motors would bend it by `motors`, in any unit. Cables
    /// inside their play transmit any part of the pull of a section and of the sections before it, from none
    /// to all.
    pub(super) fn bend_bound(&self, motors: [f64; SECTIONS_MAX]) -> [f64; SECTIONS_MAX] {
        let mut most = motors;
        if self.slack.is_some() {
            let mut before = 0.0;
            let sections = self.robot.sections().iter();
            for ((most, motors), section) in most.iter_mut().zip(motors).zip(sections) {
                *most += before / section.cable_radius_m;
                before += section.cable_radius_m * motors;
            }
        }
        most
    }

    /// Whether the bends move on a straight line between two points of the path: no cable leaves its play
    /// there.
    pub(super) fn is_linear_between(&self, rates: &BendRates, from_s: f64, to_s: f64) -> bool {
        self.slack.is_none_or(|slack| {
            let [from, to] = [from_s, to_s].map(|path_s| self.moved(rates, path_s));
            slack.is_even_between(self.robot, &from, &to)
        })
    }

    /// Allowance for rounding where the rule holds exactly \[m\].
    pub(super) fn rounding_m(&self) -> f64 {
        self.slack.map_or(0.0, |_| ROUNDING_M)
    }

    fn moved(&self, rates: &BendRates, path_s: f64) -> Configuration {
        Configuration::straight(self.robot.section_count()).advanced(rates, path_s)
    }
}
