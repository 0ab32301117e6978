use cdcr_controller::nmpc::{SolveInput, SolveReport, SolveStatus};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::GridPoint;
use cdcr_controller::robot::BendRates;
use cdcr_controller::safety::Reason;

use super::Cycle;
use crate::core_budget::Costs;
use crate::handover::CycleInputs;
use crate::rt::clock::Clock;
use crate::rt::schedule::Release;

impl Cycle {
    /// Runs the NMPC in the remaining time.
    pub(super) fn track(
        &mut self,
        release: &Release,
        inputs: &CycleInputs,
        elapsed_ns: u64,
        costs: Costs,
        clock: &impl Clock,
    ) -> (BendRates, SolveReport) {
        self.nmpc
            .limit_acceleration(self.policy.acceleration_rad_s2);
        let settings = *self.nmpc.settings();
        let steps = settings.horizon_steps as usize;
        let now = GridPoint {
            cycle: release.cycle,
            release_ns: release.release_ns,
            period_ns: self.period_ns,
        };
        let (state, offset_m) = (&self.state, self.state.tip_offset_m());
        let followed = self.followed.ahead(
            &inputs.window,
            now,
            steps,
            || state.commanded_tip(),
            &offset_m,
        );
        self.nmpc.limit_pace(followed.pace_m_s);
        let input = SolveInput {
            configuration: self.state.configuration(),
            previous_rates: &self.rates,
            reference: followed.samples,
            obstacles: &self.obstacles,
            tip_offset_m: state.tip_margin_m(),
            elapsed_periods: elapsed_ns / self.period_ns,
            seed: cycle_seed(settings.seed, release.cycle),
        };
        let mut checked_ns = clock.now_ns();
        let left_ns = self.core_budget.solve_end_ns(release, costs);
        let end_ns = match self.budget_ns {
            0 => left_ns,
            budget_ns => left_ns.min(checked_ns + budget_ns),
        };
        self.solve_until_ns = end_ns;
        let longest_gap_ns = &mut self.longest_gap_ns;
        let mut is_spent = || {
            let now_ns = clock.now_ns();
            *longest_gap_ns = (*longest_gap_ns).max(now_ns - checked_ns);
            checked_ns = now_ns;
            now_ns >= end_ns
        };
        let (rates, report) = self.nmpc.solve(&input, &mut Budget::new(&mut is_spent));
        if report.status == SolveStatus::NonFinite {
            self.modes.fault(Reason::NonFinite);
        }
        (rates, report)
    }
}
