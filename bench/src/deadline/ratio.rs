//! The daemon beside the bare loop: what can be believed on a machine that is not quiet.

use serde_json::{Value, json};
use statrs::distribution::{Binomial, DiscreteCDF};

use super::Setup;
use super::case::{Case, Cases, Key, Round};
use super::segment::Subject;
use super::tally::{COMMAND, Counts, RESPONSE, TimeQuantiles, WAKE};
use crate::load::Load;
use crate::metric::{median, range};

/// Two counts of misses differ when chance alone would make such a difference less often than this.
const SIGNIFICANCE: f64 = 0.05;

/// One load: the daemon over the bare loop, round by round.
#[derive(Debug)]
pub struct Ratio {
    pub row: Value,
    /// Name, unit and the rounds of what two runs are compared by.
    pub metrics: [(String, &'static str, Vec<f64>); 4],
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
        let wake_p50 = over(daemon, bare, |t| t[WAKE].map(|q| q.p50));
        let wake_p99 = over(daemon, bare, |t| t[WAKE].map(|q| q.p99));
        let command = daemon.each(|t| Some(t[COMMAND]?.p50 - t[WAKE]?.p50));
        let response = unloaded.map_or_else(Vec::new, |unloaded| {
            over(daemon, unloaded, |t| t[RESPONSE].map(|q| q.p99))
        });
        let (ours, theirs) = (&daemon.total.counts, &bare.total.counts);
        let p_value = misses_p_value(
            (ours.deadline_misses, due(ours)),
            (theirs.deadline_misses, due(theirs)),
        );
        let middle = |rounds: &[f64]| median(rounds.iter().copied());
        let ends = |rounds: &[f64]| range(rounds.iter().copied());
        let (load, setup) = (daemon.key.load, daemon.key.setup);
        let row = json!({
            "load": load,
            "set_up": setup,
            "realtime": setup == Setup::Realtime,
            // Wake-up of the daemon over that of the bare loop: median of the rounds, and their range.
            "wake_p50": middle(&wake_p50),
            "wake_p99": middle(&wake_p99),
            "wake_p50_range": ends(&wake_p50),
            "wake_p99_range": ends(&wake_p99),
            // Per million cycles that were due; negative: the daemon missed less often.
            "misses_beyond_bare": per_million(ours) - per_million(theirs),
            "misses_p_value": p_value,
            "misses_more": p_value < SIGNIFICANCE,
            "own_misses": ours.own_misses,
            "command_beyond_wake_p50_us": middle(&command),
            "response_p99_to_unloaded": middle(&response),
        });
        let name = |what: &str| format!("deadline/{}/{}/{what}", load.name(), setup.name());
        let metrics = [
            (name("wake_p50_to_bare"), "", wake_p50),
            (name("wake_p99_to_bare"), "", wake_p99),
            (name("command_beyond_wake_p50"), "µs", command),
            (name("response_p99_to_unloaded"), "", response),
        ];
        Self { row, metrics }
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
