use cdcr_shared_types::codes::{LateCause, realtime};
use rustix::process::geteuid;
use serde::Serialize;

use super::baseline::Baseline;
use super::causes::MissCauses;
use super::steal::Steal;

/// A hypervisor that took less than this share of the core does not explain misses.
const STEAL_SHARE: f64 = 0.01;
/// What looks for everything on this machine that is in the way of a punctual loop.
const DOCTOR: &str = "cdcrd doctor";

/// What kept the loop from being punctual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Limit {
    /// No deadline was missed.
    Nothing,
    /// The hypervisor had the core.
    Hypervisor,
    /// The timer came late or the processor stood still, with the core free.
    Platform,
    /// Another task had the core, in spite of real-time priority.
    OtherTask,
    /// The loop has no real-time priority.
    NoRealTime,
    /// Memory was not there when it was used.
    PageFaults,
    /// The computation itself took too long.
    Cdcr,
}

/// What limits the loop on this machine, and what to do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Verdict {
    pub(super) limited_by: Limit,
    /// One sentence.
    pub(super) text: String,
    /// The command to run next.
    pub(super) next: Option<&'static str>,
    /// The command that grants real time, where it is missing.
    pub(super) grant: Option<&'static str>,
}

impl Verdict {
    /// Judges a run by the causes of its misses, the bare loop before it, and what it lacks for real time.
    pub(super) fn new(
        causes: &MissCauses,
        baseline: &Baseline,
        steal: Option<Steal>,
        realtime_missing: u32,
    ) -> Self {
        let taken = steal.filter(|steal| steal.steal_s >= STEAL_SHARE * steal.window_s);
        let limited_by = limit(causes, taken.is_some(), realtime_missing);
        let is_granted = realtime_missing & (realtime::FIFO | realtime::LOCKED) == 0;
        Self {
            limited_by,
            text: sentence(limited_by, causes.total(), baseline, taken),
            next: (limited_by != Limit::Nothing).then_some(DOCTOR),
            grant: (!is_granted).then(|| grant(geteuid().is_root())),
        }
    }
}

fn limit(causes: &MissCauses, is_stolen: bool, realtime_missing: u32) -> Limit {
    let has_fifo = realtime_missing & (realtime::FIFO | realtime::OFF) == 0;
    let outside = causes.count(LateCause::Platform) + causes.count(LateCause::Stall);
    let platform = if is_stolen {
        Limit::Hypervisor
    } else {
        Limit::Platform
    };
    let other = if has_fifo {
        Limit::OtherTask
    } else {
        Limit::NoRealTime
    };
    // Of equal counts the last wins: cdcr does not blame others for as much as it did itself.
    let parts = [
        (outside, platform),
        (causes.count(LateCause::Load), other),
        (causes.count(LateCause::PageFault), Limit::PageFaults),
        (causes.count(LateCause::Compute), Limit::Cdcr),
    ];
    match parts.into_iter().max_by_key(|(count, _)| *count) {
        Some((count, limit)) if count > 0 => limit,
        _ if !has_fifo => Limit::NoRealTime,
        _ => Limit::Nothing,
    }
}

fn sentence(limit: Limit, misses: usize, baseline: &Baseline, taken: Option<Steal>) -> String {
    let bare = bare_loop(baseline);
    match limit {
        Limit::Nothing => format!("No deadline was missed; {bare}."),
        Limit::Hypervisor => {
            let took = taken.map(|Steal { steal_s, window_s }| {
                format!("it took {steal_s:.1} of {window_s:.1} s from the core of the loop; ")
            });
            let took = took.unwrap_or_default();
            format!("The hypervisor limits this machine: {took}{bare}.")
        }
        Limit::Platform => format!(
            "The platform limits this machine: the timer came late or the processor stood still while no task \
             had the core (hypervisor, firmware, power saving); {bare}."
        ),
        Limit::OtherTask => format!(
            "Another task limits this machine: it had the core of the loop although the loop has real-time \
             priority; {bare}."
        ),
        Limit::NoRealTime if misses == 0 => format!(
            "No deadline was missed, but without real-time priority any other task can delay the loop; {bare}."
        ),
        Limit::NoRealTime => format!(
            "Other tasks had the core of the loop, and without real-time priority it cannot go first; {bare}."
        ),
        Limit::PageFaults => format!(
            "Page faults limit this run: memory of the daemon was not resident when it was used; {bare}."
        ),
        Limit::Cdcr => format!(
            "The computation of cdcr limits this run: it takes too long on this processor; {bare}."
        ),
    }
}

/// What the loop without work did.
fn bare_loop(baseline: &Baseline) -> String {
    let cycles = baseline.cycles;
    match (baseline.deadline_misses, baseline.late_starts) {
        (0, 0) => format!("a bare loop, without work, started all its {cycles} cycles in time"),
        (0, late) => format!("a bare loop, without work, started {late} of {cycles} cycles late"),
        (misses, _) => {
            format!("a bare loop, without work, missed {misses} of {cycles} deadlines")
        }
    }
}

/// The one command that grants real time to the shell that it runs in. Who is root and has it not is in a container.
fn grant(is_root: bool) -> &'static str {
    if is_root {
        "docker run --ulimit rtprio=90 --ulimit memlock=-1 ..."
    } else {
        "sudo prlimit --pid $$ --rtprio=90 --memlock=unlimited"
    }
}

#[cfg(test)]
mod tests {
    use super::super::baseline::tests::baseline;
    use super::super::causes::tests::missed;
    use super::super::causes::{JudgedCycles, MissCauses};
    use super::*;

    const TAKEN: Steal = Steal {
        steal_s: 1.3,
        window_s: 5.0,
    };

    fn causes(causes: &[LateCause]) -> MissCauses {
        MissCauses::new(&missed(causes), &JudgedCycles::default())
    }

    fn verdict(of: &[LateCause], steal: Option<Steal>, missing: u32) -> Verdict {
        Verdict::new(&causes(of), &baseline(3, 4), steal, missing)
    }

    #[test]
    fn the_largest_cause_is_the_limit() {
        use LateCause::{Compute, Load, PageFault, Platform, Stall};
        let little = Steal {
            steal_s: 0.01,
            window_s: 5.0,
        };
        for (of, steal, missing, limit) in [
            (&[][..], None, 0, Limit::Nothing),
            // Steal without a miss limits nothing.
            (&[], Some(TAKEN), 0, Limit::Nothing),
            (&[], None, realtime::FIFO, Limit::NoRealTime),
            (&[], None, realtime::OFF, Limit::NoRealTime),
            (&[], None, realtime::LOCKED, Limit::Nothing),
            (
                &[Platform, Platform, Load],
                Some(TAKEN),
                0,
                Limit::Hypervisor,
            ),
            (&[Platform], Some(little), 0, Limit::Platform),
            (&[Platform], None, 0, Limit::Platform),
            // Both come from outside of the system.
            (&[Platform, Stall, Load], None, 0, Limit::Platform),
            (&[Platform, Load, Load], Some(TAKEN), 0, Limit::OtherTask),
            (&[Load], None, realtime::FIFO, Limit::NoRealTime),
            (&[Platform], Some(TAKEN), realtime::FIFO, Limit::Hypervisor),
            (&[PageFault, PageFault, Load], None, 0, Limit::PageFaults),
            (&[Compute, Compute, Platform], None, 0, Limit::Cdcr),
        ] {
            let verdict = verdict(of, steal, missing);
            assert_eq!(verdict.limited_by, limit, "{of:?} {steal:?} {missing}");
            assert_eq!(verdict.next.is_some(), limit != Limit::Nothing, "{limit:?}");
            assert_eq!(verdict.text.matches(". ").count(), 0, "one sentence");
        }
    }

    #[test]
    fn the_sentence_has_the_steal_and_the_bare_loop() {
        let text = verdict(&[LateCause::Platform], Some(TAKEN), 0).text;
        assert_eq!(
            text,
            "The hypervisor limits this machine: it took 1.3 of 5.0 s from the core of the loop; a bare loop, \
             without work, missed 3 of 100 deadlines."
        );
        let quiet = Verdict::new(&causes(&[]), &baseline(0, 0), None, 0).text;
        assert_eq!(
            quiet,
            "No deadline was missed; a bare loop, without work, started all its 100 cycles in time."
        );
        let late = Verdict::new(&causes(&[]), &baseline(0, 4), None, 0).text;
        assert!(late.contains("started 4 of 100 cycles late"), "{late}");
        let ordinary = |of: &[LateCause]| verdict(of, None, realtime::FIFO).text;
        assert!(ordinary(&[]).starts_with("No deadline was missed, but"));
        assert!(ordinary(&[LateCause::Load]).starts_with("Other tasks had the core"));
    }

    #[test]
    fn what_is_not_granted_has_one_command_and_what_is_granted_has_none() {
        assert_eq!(verdict(&[], None, 0).grant, None);
        assert_eq!(verdict(&[], None, realtime::PINNED).grant, None);
        for missing in [realtime::FIFO, realtime::LOCKED] {
            assert!(verdict(&[], None, missing).grant.is_some());
        }
        assert!(grant(false).starts_with("sudo prlimit"));
        assert!(grant(true).contains("--ulimit rtprio=90"));
    }

    #[test]
    fn the_json_names_the_limit() {
        let json = serde_json::to_value(verdict(&[LateCause::Load], None, realtime::FIFO));
        let json = json.expect("JSON");
        assert_eq!(json["limited_by"], "no-real-time");
        assert_eq!(json["next"], "cdcrd doctor");
        assert!(json["grant"].is_string() && json["text"].is_string());
    }
}
