//! The daemon beside the bare loop: what can be believed on a machine that is not quiet.

use serde::Serialize;
use statrs::distribution::{Binomial, DiscreteCDF};

use super::Setup;
use super::case::{Case, Cases, Key, Round};
use super::segment::Subject;
use super::tally::{Counts, TimeQuantiles};
use crate::load::Load;
use crate::metric::{median, range};

/// Two counts of misses differ when chance alone would make such a difference less often than this.
const SIGNIFICANCE: f64 = 0.05;

/// One load: the daemon over the bare loop, round by round.
#[derive(Debug, Clone, Serialize)]
pub struct Ratio {
    pub load: Load,
    pub set_up: Setup,
    pub realtime: bool,
    /// Median wake-up of the daemon over that of the bare loop: median of the rounds.
    pub wake_p50: Option<f64>,
    pub wake_p99: Option<f64>,
    pub wake_p50_range: Option<(f64, f64)>,
    pub wake_p99_range: Option<(f64, f64)>,
    /// Misses of the daemon beyond those of the bare loop \[per million cycles\]; negative: it missed less often.
    pub misses_beyond_bare: f64,
    /// How often chance alone gives the daemon at least so many of the misses of both.
    pub misses_p_value: f64,
    /// Whether the daemon misses more often than the bare loop, as far as can be told.
    pub misses_more: bool,
    /// Misses of the daemon that are its own: a computation that took too long, a page that was missing.
    pub own_misses: u64,
    /// Median of release → command in the client's hands, less the median wake-up \[µs\]: median of the rounds.
    pub command_beyond_wake_p50_us: Option<f64>,
    /// 99th percentile of the daemon's response under this load over that without one, round by round.
    pub response_p99_to_unloaded: Option<f64>,
    /// The ratios of the single rounds, for the comparison of runs.
    #[serde(skip)]
    pub rounds: Rounds,
}

#[derive(Debug, Clone, Default)]
pub struct Rounds {
    pub wake_p50: Vec<f64>,
    pub wake_p99: Vec<f64>,
    /// Of the median command, less the median wake-up \[µs\].
    pub command_beyond_wake: Vec<f64>,
    /// Of the response under load over that without.
    pub response_p99_to_unloaded: Vec<f64>,
}

/// A ratio for each load that was measured with both the bare loop and the daemon.
pub fn ratios(cases: &Cases) -> Vec<Ratio> {
    let daemons = cases.values().filter(|c| c.key.subject == Subject::Daemon);
    daemons
        .filter_map(|daemon| {
            let of = |load, subject| {
                let setup = daemon.key.setup;
                cases.get(&Key {
                    setup,
                    load,
                    subject,
                })
            };
            let bare = of(daemon.key.load, Subject::Bare)?;
            Some(Ratio::of(daemon, bare, of(Load::None, Subject::Daemon)))
        })
        .collect()
}

impl Ratio {
    fn of(daemon: &Case, bare: &Case, unloaded: Option<&Case>) -> Self {
        let rounds = Rounds {
            wake_p50: over(daemon, bare, |t| t.wake.map(|q| q.p50)),
            wake_p99: over(daemon, bare, |t| t.wake.map(|q| q.p99)),
            command_beyond_wake: daemon.each(|t| Some(t.command?.p50 - t.wake?.p50)),
            response_p99_to_unloaded: unloaded.map_or_else(Vec::new, |unloaded| {
                over(daemon, unloaded, |t| t.response.map(|q| q.p99))
            }),
        };
        let (ours, theirs) = (&daemon.total.counts, &bare.total.counts);
        let p_value = misses_p_value(
            (ours.deadline_misses, due(ours)),
            (theirs.deadline_misses, due(theirs)),
        );
        Self {
            load: daemon.key.load,
            set_up: daemon.key.setup,
            realtime: daemon.key.setup == Setup::Realtime,
            wake_p50: median(rounds.wake_p50.iter().copied()),
            wake_p99: median(rounds.wake_p99.iter().copied()),
            wake_p50_range: range(rounds.wake_p50.iter().copied()),
            wake_p99_range: range(rounds.wake_p99.iter().copied()),
            misses_beyond_bare: per_million(ours) - per_million(theirs),
            misses_p_value: p_value,
            misses_more: p_value < SIGNIFICANCE,
            own_misses: ours.own_misses,
            command_beyond_wake_p50_us: median(rounds.command_beyond_wake.iter().copied()),
            response_p99_to_unloaded: median(rounds.response_p99_to_unloaded.iter().copied()),
            rounds,
        }
    }
}

/// One number of each round of `above` over that of the same round of `below`; rounds in which one of them lacks it are
/// left out. A clock that was read at once counts as a hundredth of a microsecond, so that nothing is divided by nothing.
fn over(above: &Case, below: &Case, value: fn(&TimeQuantiles) -> Option<f64>) -> Vec<f64> {
    let pairs = above.rounds.iter().zip(&below.rounds);
    let of = |round: &Round| value(&round.segment.tally.quantiles());
    pairs
        .filter_map(|(above, below)| Some(of(above)?.max(0.01) / of(below)?.max(0.01)))
        .collect()
}

/// Releases that were due: cycles that ran, and those that were skipped.
fn due(counts: &Counts) -> u64 {
    counts.cycles + counts.skipped_periods
}

/// Misses in a million cycles that were due.
pub(super) fn per_million(counts: &Counts) -> f64 {
    1e6 * counts.deadline_misses as f64 / due(counts).max(1) as f64
}

/// The probability that chance alone gives the daemon at least its part of the misses of both, each given as misses and
/// due cycles: the conditional test of two Poisson rates (Przyborowski and Wilenski, Biometrika 31, 1940). 1 when the
/// daemon missed nothing.
pub fn misses_p_value(ours: (u64, u64), theirs: (u64, u64)) -> f64 {
    let (misses, due) = (ours.0 + theirs.0, ours.1 + theirs.1);
    if ours.0 == 0 || due == 0 {
        return 1.0;
    }
    let share = ours.1 as f64 / due as f64;
    // At least so many is more than one less.
    Binomial::new(share, misses).map_or(1.0, |all| all.sf(ours.0 - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(cycles: u64, deadline_misses: u64) -> Counts {
        Counts {
            cycles,
            deadline_misses,
            ..Counts::default()
        }
    }

    #[test]
    fn as_many_misses_as_the_bare_loop_are_no_difference() {
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(near(misses_p_value((0, 1000), (9, 1000)), 1.0));
        // One of one: half of the time.
        assert!(near(misses_p_value((1, 1000), (0, 1000)), 0.5));
        // Five of five: (1/2)^5.
        assert!(near(misses_p_value((5, 1000), (0, 1000)), 1.0 / 32.0));
        // At least 3 of 4: (4 + 1) / 16.
        assert!(near(misses_p_value((3, 1000), (1, 1000)), 5.0 / 16.0));
        // Twice the cycles may have twice the misses: at least 1 of 1 with 2/3.
        assert!(near(misses_p_value((1, 2000), (0, 1000)), 2.0 / 3.0));
        assert!(near(per_million(&counts(2000, 1)), 500.0));
    }
}
