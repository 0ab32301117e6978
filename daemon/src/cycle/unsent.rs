//! Commands that were not sent. The exchange gathers and publishes in turn: a stalled exchange brings no
//! inputs and sends nothing. When it continues, it sends the newest command only. Meanwhile the driver
//! executed the last command sent, until that expired.

use cdcr_controller::estimator::Estimator;
use cdcr_controller::robot::{BendRates, Configuration};
use cdcr_controller::safety::{FollowingWatch, MeasurementWatch};

use super::Cycle;
use super::state::RobotState;
use crate::handover::CycleInputs;
use crate::rt::schedule::Release;

/// The state that commands advance, as it was when the last command was sent.
#[derive(Debug)]
pub(super) struct LastSent {
    /// The last command sent; `elapsed_ns` is the time since then.
    rates: BendRates,
    elapsed_ns: u64,
    /// That command was the first after rest. While the exchange is held up, it may not have left.
    is_first: bool,
    estimator: Estimator,
    commanded: Configuration,
    following: FollowingWatch,
    plausibility: MeasurementWatch,
    tip_plausibility: MeasurementWatch,
}

impl LastSent {
    pub(super) fn new(state: &RobotState) -> Self {
        Self {
            rates: BendRates::zero(state.robot.section_count()),
            elapsed_ns: 0,
            is_first: true,
            estimator: state.estimator.clone(),
            commanded: state.commanded,
            following: state.following.clone(),
            plausibility: state.plausibility.clone(),
            tip_plausibility: state.tip_watch.plausibility.clone(),
        }
    }

    /// Saves the state at the last release, with the command given there.
    fn note(&mut self, state: &RobotState, rates: &BendRates) {
        self.rates = *rates;
        self.elapsed_ns = 0;
        self.estimator.clone_from(&state.estimator);
        self.commanded = state.commanded;
        self.following.clone_from(&state.following);
        self.plausibility.clone_from(&state.plausibility);
        self.tip_plausibility
            .clone_from(&state.tip_watch.plausibility);
    }

    /// Restores the saved state and advances it by that command alone.
    fn obey_alone(&self, state: &mut RobotState) {
        state.estimator.clone_from(&self.estimator);
        state.commanded = self.commanded;
        state.following.clone_from(&self.following);
        state.plausibility.clone_from(&self.plausibility);
        state
            .tip_watch
            .plausibility
            .clone_from(&self.tip_plausibility);
        state.move_on(&self.rates, self.elapsed_ns);
    }
}

impl Cycle {
    /// Counts stale inputs; true if the inputs are those of the previous cycle.
    pub(super) fn count_stale(&mut self, inputs: &CycleInputs) -> bool {
        let is_stale = self.last_gather.replace(inputs.gather) == Some(inputs.gather);
        self.stale_ns = if is_stale {
            self.stale_ns + self.period_ns
        } else {
            0
        };
        is_stale
    }

    /// The inputs are so old that a command sent with them has expired.
    pub(super) fn has_stale_inputs(&self) -> bool {
        self.stale_ns > self.policy.stale_inputs_max_ns
    }

    /// Advances the state by the commands sent. In a first cycle with old inputs, the gather alone may be late.
    /// In the next one the exchange has stood still for a period, and nothing was sent.
    pub(super) fn move_on(&mut self, elapsed_ns: u64) {
        if self.stale_ns == self.period_ns {
            self.last_sent.note(&self.state, &self.rates);
        }
        self.last_sent.elapsed_ns += elapsed_ns;
        if self.is_behind_exchange() && self.stale_ns > self.period_ns {
            self.last_sent.obey_alone(&mut self.state);
        } else {
            self.state.move_on(&self.rates, elapsed_ns);
        }
        self.rest_if_run_out(elapsed_ns);
    }

    /// Hands over the next command.
    pub(super) fn command(&mut self, release_ns: u64, rates: BendRates) {
        self.last_sent.is_first = self.is_at_rest();
        self.rates = rates;
        let begins = self.state.way_to_begin().is_some();
        self.link
            .command(release_ns, &rates, self.state.commanded(), begins);
    }

    /// Inputs and commands pass the exchange; a simulated robot is measured and commanded in the cycle.
    fn is_behind_exchange(&self) -> bool {
        self.policy.stale_inputs_max_ns < u64::MAX
    }

    /// After a stall, or while the exchange is held up, the robot has come to rest by itself before this
    /// command arrives, or has not begun to move: rates grow from zero, and no ramp begins again.
    fn rest_if_run_out(&mut self, elapsed_ns: u64) {
        let rests_after_ns = self.policy.rests_after_ns(self.period_ns);
        let has_stalled = elapsed_ns > self.period_ns && self.runs_out(elapsed_ns);
        // A command that waits for the exchange leaves before the next release.
        let leaves_ns = self.last_sent.elapsed_ns + self.period_ns;
        let is_held_up =
            self.is_behind_exchange() && self.stale_ns > 0 && leaves_ns > rests_after_ns;
        let may_stand = self.is_behind_exchange() && self.stale_ns > 0 && self.last_sent.is_first;
        if has_stalled || is_held_up || may_stand || self.has_stale_inputs() {
            self.forget_rates();
        }
    }

    /// The same at `now_ns`, after a stall inside the cycle of `release`; true if the command has run out by then.
    pub(super) fn rest_if_run_out_by(
        &mut self,
        now_ns: u64,
        release: &Release,
        elapsed_ns: u64,
    ) -> bool {
        let late_ns = now_ns.saturating_sub(release.release_ns);
        let has_run_out = late_ns > self.period_ns && self.runs_out(elapsed_ns + late_ns);
        if has_run_out {
            self.forget_rates();
        }
        has_run_out
    }

    /// At the end of the validity the driver stops, and the next command arrives after that.
    fn runs_out(&self, since_ns: u64) -> bool {
        since_ns >= self.policy.command_valid_ns
            || since_ns > self.policy.rests_after_ns(self.period_ns)
    }

    fn forget_rates(&mut self) {
        self.rates = BendRates::zero(self.robot.section_count());
    }

    /// Control has begun again, and no command has been sent since.
    pub(super) fn begin_unsent(&mut self) {
        let rest = BendRates::zero(self.robot.section_count());
        self.last_sent.note(&self.state, &rest);
    }
}
