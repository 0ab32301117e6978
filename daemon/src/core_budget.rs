//! Division of the core among the real-time threads: the only module that adds up their time.
//!
//! ```text
//! release                                                              next release
//!    │ early │ estimate, solve ... │ guard, command, record │ exchange │ ordinary tasks │
//!    │◄──────────────────── real-time share, at most ──────────────────►│
//! ```
//!
//! Linux halts real-time threads that exceed their share of a core (95 % of a second by default), for 50 ms
//! and more. Only the solver can be cut: it ends early enough for the measured costs of the other parts. A
//! replay needs no budget: the record contains the extent of the solve.

use crate::config::{Config, CycleConfig, RealtimeMode, ns};
use crate::rt::schedule::Release;

/// Share of a core that Linux leaves to real-time threads by default: `sched_rt_runtime_us`, and the fair
/// server of newer kernels.
pub const KERNEL_SHARE: f64 = 0.95;
/// Unused part of the kernel's share: reserve for stalls, interrupts and underestimated costs.
const KEPT_BACK: f64 = 0.025;

/// Measured costs per period of the parts beside the solver \[ns\].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Costs {
    /// From the end of the solver until the cycle thread sleeps: limits, clearance guard, command, record.
    pub after_solve_ns: u64,
    /// Core time of the exchange thread.
    pub exchange_ns: u64,
}

/// Division of one period among the real-time threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CoreBudget {
    period_ns: u64,
    deadline_ns: u64,
    margin_ns: u64,
    spin_ns: u64,
    is_real_time: bool,
    /// Time available to the real-time threads.
    real_time_ns: u64,
}

impl CoreBudget {
    /// Budget of a configuration, with the kernel's default share.
    pub fn new(config: &Config) -> Self {
        let period_ns = ns(config.cycle.period_ms);
        let budget = Self {
            period_ns,
            deadline_ns: config.cycle.deadline_ns(),
            margin_ns: config.cycle.budget_margin_ns(),
            spin_ns: config.realtime.spin_ns(config.cycle.period_ms),
            is_real_time: config.realtime.mode != RealtimeMode::Off,
            real_time_ns: period_ns,
        };
        budget.with_kernel_share(KERNEL_SHARE)
    }

    /// Sets the share of the core that the kernel leaves to real-time threads. Ordinary threads are not
    /// limited.
    #[must_use]
    pub fn with_kernel_share(mut self, share: f64) -> Self {
        if self.is_real_time {
            let kept = (share - KEPT_BACK).max(0.0);
            self.real_time_ns = (self.period_ns as f64 * kept) as u64;
        }
        self
    }

    /// Time by which the solver in the cycle of `release` has to end \[ns\].
    ///
    /// Before the deadline one and a half times the measured cost is reserved: one late command is a miss. In
    /// the kernel's share, which counts over a second, only the measured cost is reserved.
    pub fn solve_end_ns(&self, release: &Release, costs: Costs) -> u64 {
        let left_ns = self
            .margin_ns
            .max(costs.after_solve_ns.saturating_mul(3) / 2);
        let by_deadline_ns = self.deadline_ns.saturating_sub(left_ns);
        let others_ns = self.spin_ns + costs.after_solve_ns + exchange_ns(costs);
        let by_share_ns = self.real_time_ns.saturating_sub(others_ns);
        (release.release_ns + by_deadline_ns).min(release.start_ns + by_share_ns)
    }

    /// Longest time from the release to the end of the solver, with a punctual start \[ns\].
    pub fn solve_ns(&self, costs: Costs) -> u64 {
        self.solve_end_ns(&Release::default(), costs)
    }

    /// `costs` leave the solver less than half of its time without costs.
    pub fn is_cut_short(&self, costs: Costs) -> bool {
        2 * self.solve_ns(costs) < self.solve_ns(Costs::default())
    }

    /// Time by which a cycle that takes `least_ns` without any search does not fit \[ns\]; `None`: it fits.
    pub fn shortfall_ns(&self, least_ns: u64) -> Option<u64> {
        let needs_ns = least_ns + self.spin_ns + exchange_ns(Costs::default());
        needs_ns
            .checked_sub(self.real_time_ns)
            .filter(|shortfall_ns| *shortfall_ns > 0)
    }

    /// The parts of the budget as text.
    pub fn describe(&self, costs: Costs) -> String {
        let ms = |ns: u64| ns as f64 / 1e6;
        format!(
            "of each period of {} ms, real-time threads can use {:.3} ms: {:.3} ms until the solver ends, {:.3} ms \
             after it, {:.3} ms for the exchange, {:.3} ms before the release",
            ms(self.period_ns),
            ms(self.real_time_ns),
            ms(self.solve_ns(costs)),
            ms(costs.after_solve_ns),
            ms(exchange_ns(costs)),
            ms(self.spin_ns),
        )
    }

    /// Largest share of the core that the real-time threads take, 0 to 1.
    pub fn share_max(&self) -> f64 {
        self.real_time_ns as f64 / self.period_ns as f64
    }
}

/// Time reserved for the exchange: at least its cost without any messages.
fn exchange_ns(costs: Costs) -> u64 {
    costs.exchange_ns.max(CycleConfig::EXCHANGE_NS)
}

/// Number of recent costs: 0.64 s at 5 ms.
const REMEMBERED: usize = 128;
/// Number of the largest costs that count as stalls of the processor. A thread clock includes stalls by a
/// hypervisor.
const STALLS: usize = 3;
/// One in this many costs counts as a stall, if the clock continues while the thread does not run. Costs are
/// not recorded when the scheduler reports that another task had the core, but it may not know of a
/// hypervisor's stalls.
const STALLED: usize = 30;

#[derive(Debug, Clone)]
pub struct RecentCosts {
    /// In order of arrival.
    costs_ns: [u64; REMEMBERED],
    /// Sorted, smallest first: the cycle reads the costs each time.
    sorted_ns: [u64; REMEMBERED],
    noted: usize,
    next: usize,
}

impl Default for RecentCosts {
    fn default() -> Self {
        Self {
            costs_ns: [0; REMEMBERED],
            sorted_ns: [0; REMEMBERED],
            noted: 0,
            next: 0,
        }
    }
}

impl RecentCosts {
    pub fn note(&mut self, cost_ns: u64) {
        let oldest_ns = core::mem::replace(&mut self.costs_ns[self.next % REMEMBERED], cost_ns);
        // The place of the forgotten cost, or the first free one.
        let from = if self.noted < REMEMBERED {
            self.noted
        } else {
            self.count_below(oldest_ns)
        };
        let to = self.count_below(cost_ns);
        if to <= from {
            self.sorted_ns.copy_within(to..from, to + 1);
            self.sorted_ns[to] = cost_ns;
        } else {
            self.sorted_ns.copy_within(from + 1..to, from);
            self.sorted_ns[to - 1] = cost_ns;
        }
        self.next = (self.next + 1) % REMEMBERED;
        self.noted = (self.noted + 1).min(REMEMBERED);
    }

    /// The largest cost on the thread's clock, except a few attributed to stalls \[ns\].
    pub fn high_on_core_ns(&self) -> u64 {
        self.largest_but_ns(STALLS)
    }

    /// The largest cost on the machine's clock, except the thirtieth that stalls may have lengthened \[ns\].
    /// The thread's clock is a system call, which the cycle thread must not make.
    pub fn high_by_clock_ns(&self) -> u64 {
        self.largest_but_ns((self.noted / STALLED).max(STALLS))
    }

    /// 0 if there is none \[ns\].
    pub fn median_ns(&self) -> u64 {
        self.largest_but_ns(self.noted / 2)
    }

    /// The largest cost below the `left_out` largest ones; 0 if there is none \[ns\].
    fn largest_but_ns(&self, left_out: usize) -> u64 {
        let at = self.noted.checked_sub(1 + left_out);
        at.and_then(|at| self.sorted_ns.get(at))
            .map_or(0, |cost_ns| *cost_ns)
    }

    fn count_below(&self, cost_ns: u64) -> usize {
        let noted_ns = self.sorted_ns.get(..self.noted).unwrap_or_default();
        noted_ns.partition_point(|noted_ns| *noted_ns < cost_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1000;

    fn budget(change: impl FnOnce(&mut Config)) -> CoreBudget {
        let mut config = Config::default();
        config.realtime.spin_us = 0.0;
        change(&mut config);
        CoreBudget::new(&config)
    }

    fn costs(after_us: u64, exchange_us: u64) -> Costs {
        Costs {
            after_solve_ns: after_us * US,
            exchange_ns: exchange_us * US,
        }
    }

    #[test]
    fn the_solver_ends_so_early_that_the_other_parts_fit_into_the_share() {
        let plain = budget(|_| ());
        // A tenth of the period is more than small costs need.
        assert_eq!(plain.solve_ns(Costs::default()), 4500 * US);
        assert_eq!(plain.solve_ns(costs(30, 60)), 4500 * US);
        // Six sections among 64 obstacles: 4.5 + 0.28 + 0.15 ms would be 98.6 %.
        assert_eq!(plain.solve_ns(costs(280, 150)), 4195 * US);
        for after_us in [0, 100, 400, 2000] {
            for exchange_us in [0, 60, 400] {
                for spin_us in [0.0, 200.0, 1000.0] {
                    let budget = budget(|config| config.realtime.spin_us = spin_us);
                    let costs = costs(after_us, exchange_us);
                    let others_ns = spin_us as u64 * US + costs.after_solve_ns + costs.exchange_ns;
                    let sum_ns = budget.solve_ns(costs) + others_ns;
                    assert!(sum_ns <= 4625 * US, "{after_us} {exchange_us} {spin_us}");
                }
            }
        }
    }

    #[test]
    fn a_late_start_moves_the_end_by_the_share_and_never_beyond_the_deadline() {
        let plain = budget(|_| ());
        let release = Release {
            start_ns: 200 * US,
            ..Release::default()
        };
        assert_eq!(plain.solve_end_ns(&release, costs(280, 150)), 4395 * US);
        assert_eq!(plain.solve_end_ns(&release, Costs::default()), 4500 * US);
        // With a long time after the solver, the deadline requires more than the share.
        assert_eq!(plain.solve_end_ns(&release, costs(800, 0)), 3800 * US);
        assert_eq!(plain.solve_end_ns(&release, costs(9000, 0)), 0);
    }

    #[test]
    fn a_smaller_share_of_the_kernel_is_kept_to_and_ordinary_threads_have_none() {
        let mut config = Config::default();
        let half = CoreBudget::new(&config).with_kernel_share(0.5);
        assert_eq!(half.solve_ns(Costs::default()), 2260 * US);
        assert!((half.share_max() - 0.475).abs() < 1e-9);
        config.realtime.mode = RealtimeMode::Off;
        let off = CoreBudget::new(&config).with_kernel_share(0.5);
        assert_eq!(off.solve_ns(costs(280, 150)), 4495 * US);
    }

    #[test]
    fn what_cannot_fit_is_found() {
        let short = budget(|config| config.cycle.period_ms = 0.1);
        assert_eq!(short.shortfall_ns(52 * US), None);
        assert_eq!(short.shortfall_ns(60 * US), Some(7500));
        assert!(!short.is_cut_short(costs(10, 40)));
        assert!(short.is_cut_short(costs(30, 40)));
        assert!(short.describe(costs(30, 40)).contains("0.030 ms after it"));
    }

    #[test]
    fn a_few_stalls_are_no_costs_and_old_costs_are_forgotten() {
        let mut recent = RecentCosts::default();
        assert_eq!(recent.high_on_core_ns(), 0);
        for turn in 0..200 {
            recent.note(if turn % 50 == 0 { 9_000_000 } else { 280 });
        }
        assert_eq!(recent.high_on_core_ns(), 280);
        for _ in 0..10 {
            recent.note(500);
        }
        assert_eq!(recent.high_on_core_ns(), 500);
        for _ in 0..REMEMBERED {
            recent.note(20);
        }
        assert_eq!(recent.high_on_core_ns(), 20);
    }

    #[test]
    fn the_order_that_is_kept_is_that_of_sorting_anew() {
        let (mut recent, mut random, mut all_ns) = (RecentCosts::default(), 1_u64, Vec::new());
        for turn in 0..1000 {
            random = random.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            // With many equal costs.
            let cost_ns = if turn % 3 == 0 {
                random >> 61
            } else {
                random >> 50
            };
            recent.note(cost_ns);
            all_ns.push(cost_ns);
            let mut last_ns = all_ns[all_ns.len().saturating_sub(REMEMBERED)..].to_vec();
            last_ns.sort_unstable();
            assert_eq!(recent.sorted_ns[..recent.noted], last_ns);
            let expected_ns = last_ns
                .len()
                .checked_sub(1 + STALLS)
                .map_or(0, |at| last_ns[at]);
            assert_eq!(recent.high_on_core_ns(), expected_ns);
        }
    }

    #[test]
    fn what_one_cycle_in_eight_takes_is_a_cost() {
        let mut recent = RecentCosts::default();
        for turn in 0..200 {
            recent.note(if turn % 8 == 0 { 2000 * US } else { 280 * US });
        }
        assert_eq!(recent.high_by_clock_ns(), 2000 * US);
        // The first few may all be stalls.
        let mut recent = RecentCosts::default();
        let begin: Vec<_> = (0..4)
            .map(|turn| {
                recent.note(9000 * US - turn);
                recent.high_by_clock_ns()
            })
            .collect();
        assert_eq!(begin, [0, 0, 0, 9000 * US - 3]);
    }
}
