//! The rule of the guard for cables that go through their play.

use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, SECTIONS_MAX};

use super::ClearanceGuard;
use super::near::{Near, Stance};
use super::way::check;

/// What the sums of a play leave of a clearance that stays \[m\].
const ROUNDING_M: f64 = 1e-12;

impl<'a> ClearanceGuard<'a> {
    /// Gives `judge` what tells whether the rule of [`Self::apply`] holds, from where the robot is, for cables with play: for `rates`, and for
    /// others that are not faster. All that it asks shares the work for one command; when that is used up, nothing holds.
    pub(in crate::safety) fn through_play<T>(
        &self,
        slack: &'a Slack,
        rates: &BendRates,
        judge: impl FnOnce(&dyn Fn(&BendRates) -> bool) -> T,
    ) -> T {
        let slack = Some(slack);
        let guard = Self { slack, ..*self };
        let stance = Stance::new(guard.robot, guard.at);
        let near = Near::find(&guard, &stance, rates, false);
        let holds = |near: &Near<'_>, rates: &BendRates| {
            !near.is_out_of_looks() && check(near, &guard, rates).is_ok()
        };
        judge(&|rates| near.as_ref().is_some_and(|near| holds(near, rates)))
    }

    /// Where the robot is after its motors moved for `way_s` at `rates`.
    pub(in crate::safety) fn after(
        &self,
        at: &Configuration,
        rates: &BendRates,
        way_s: f64,
    ) -> Configuration {
        let Some(slack) = self.slack else {
            return at.advanced(rates, way_s);
        };
        let moved = self.moved(rates, way_s);
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

    /// How much each section bends at most when its motors would bend it by `motors`, in any unit: cables that stand in their play leave of
    /// what a section and those before it pull together anything between nothing and all.
    pub(super) fn bent_most(&self, motors: [f64; SECTIONS_MAX]) -> [f64; SECTIONS_MAX] {
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

    /// Whether bends move on a line between these two places of the way: no cable comes out of its play there.
    pub(super) fn is_even_between(&self, rates: &BendRates, from_s: f64, to_s: f64) -> bool {
        self.slack.is_none_or(|slack| {
            let [from, to] = [from_s, to_s].map(|way_s| self.moved(rates, way_s));
            slack.is_even_between(self.robot, &from, &to)
        })
    }

    /// What a clearance may lack by rounding where the rule holds exactly \[m\].
    pub(super) fn rounding_m(&self) -> f64 {
        self.slack.map_or(0.0, |_| ROUNDING_M)
    }

    fn moved(&self, rates: &BendRates, way_s: f64) -> Configuration {
        Configuration::straight(self.robot.section_count()).advanced(rates, way_s)
    }
}
