use std::path::Path;

use cdcr_shared_types::codes::{LateCause, RTPRIO_GRANTED, realtime};
use rustix::process::geteuid;
use serde::Serialize;

use super::baseline::Baseline;
use super::causes::MissCauses;
use super::steal::Steal;

/// The main cause of deadline misses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Limit {
    /// No deadline was missed.
    Nothing,
    /// The hypervisor used the core.
    Hypervisor,
    /// The timer was late or the processor stalled, with the core idle.
    Platform,
    /// Another task used the core, despite real-time priority.
    OtherTask,
    /// The loop has no real-time priority.
    NoRealTime,
    /// Page faults.
    PageFaults,
    /// The computation itself took too long.
    Cdcr,
    /// Deadlines were missed for an unknown cause.
    Unknown,
}

/// What limits the loop on this machine, and the remedy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Diagnosis {
    pub(super) limited_by: Limit,
    /// One sentence.
    pub(super) text: String,
    pub(super) next: Option<String>,
    /// Command that grants real-time priority, if that is missing.
    pub(super) grant: Option<String>,
}

impl Diagnosis {
    /// Evaluates a run: the causes of its misses, the baseline if there is one, and the missing real-time
    /// properties.
    pub(super) fn new(
        causes: &MissCauses,
        baseline: Option<&Baseline>,
        steal: Option<Steal>,
        realtime_missing: u32,
    ) -> Self {
        let limited_by = limit(causes, realtime_missing);
        let is_granted = realtime_missing & (realtime::FIFO | realtime::LOCKED) == 0;
        Self {
            limited_by,
            text: sentence(limited_by, causes.total(), baseline, steal),
            next: (limited_by != Limit::Nothing).then(|| {
                let started_as = std::env::args_os().next().unwrap_or_default();
                doctor(Path::new(&started_as))
            }),
            grant: (!is_granted).then(|| grant(geteuid().is_root())),
        }
    }
}

fn limit(causes: &MissCauses, realtime_missing: u32) -> Limit {
    let has_fifo = realtime_missing & (realtime::FIFO | realtime::OFF) == 0;
    let outside = causes.count(LateCause::Platform) + causes.count(LateCause::Stall);
    let platform = if 2 * causes.stolen() >= outside {
        Limit::Hypervisor
    } else {
        Limit::Platform
    };
    let other = if has_fifo {
        Limit::OtherTask
    } else {
        Limit::NoRealTime
    };
    // For equal counts the last one wins: then cdcr itself is named rather than others.
    let parts = [
        (causes.count(LateCause::None), Limit::Unknown),
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

fn sentence(
    limit: Limit,
    misses: usize,
    baseline: Option<&Baseline>,
    steal: Option<Steal>,
) -> String {
    let bare = baseline.map(bare_loop).unwrap_or_default();
    match limit {
        Limit::Nothing => format!("No deadline was missed{bare}."),
        Limit::Hypervisor => {
            let took = steal.map(|steal| format!(": it stole {steal} from a core"));
            let took = took.unwrap_or_default();
            format!("The hypervisor limits this machine{took}{bare}.")
        }
        Limit::Platform => format!(
            "The platform limits this machine: late timers or processor stalls while no task had the core \
             (hypervisor, firmware, power saving){bare}."
        ),
        Limit::OtherTask => format!(
            "Another task limits this machine: it had the core of the loop despite the loop's real-time \
             priority{bare}."
        ),
        Limit::NoRealTime if misses == 0 => format!(
            "No deadline was missed, but without real-time priority any other task can delay the loop{bare}."
        ),
        Limit::NoRealTime => {
            format!("Other tasks had the core of the loop, which lacks real-time priority{bare}.")
        }
        Limit::PageFaults => {
            format!("Page faults limit this run: memory of the daemon was not resident{bare}.")
        }
        Limit::Cdcr => {
            format!("cdcr limits this run: its computation takes too long on this processor{bare}.")
        }
        Limit::Unknown => {
            format!("Deadlines were missed, mostly without a recorded cause{bare}.")
        }
    }
}

/// Result of the baseline, as the end of a sentence.
fn bare_loop(baseline: &Baseline) -> String {
    let cycles = baseline.cycles;
    let did = match (baseline.deadline_misses, baseline.late_starts) {
        (0, 0) => format!("started all its {cycles} cycles in time"),
        (0, late) => format!("started {late} of {cycles} cycles late"),
        (misses, _) => format!("missed {misses} of {cycles} deadlines"),
    };
    format!("; a bare loop without work {did}")
}

/// The command that examines this machine for causes of latency. It is in the folder of this program, with
/// the path by which this program was started.
fn doctor(started_as: &Path) -> String {
    let program = started_as.with_file_name("cdcrd");
    let program = program.display().to_string();
    if program.contains(|letter: char| letter.is_whitespace() || letter == '\'') {
        let quoted = program.replace('\'', "'\\''");
        return format!("'{quoted}' doctor");
    }
    format!("{program} doctor")
}

/// The command that grants real-time priority to the shell that runs it. If root lacks it, the process is in
/// a container.
fn grant(is_root: bool) -> String {
    if is_root {
        format!(
            "in a container: docker run --ulimit rtprio={RTPRIO_GRANTED} --ulimit memlock=-1 ..."
        )
    } else {
        format!("sudo prlimit --pid $$ --rtprio={RTPRIO_GRANTED} --memlock=unlimited")
    }
}

#[cfg(test)]
mod tests {
    use super::super::baseline::tests::baseline;
    use super::super::causes::tests::{missed, stolen_cycle};
    use super::super::causes::{IncidentCauses, MissCauses};
    use super::*;

    const TAKEN: Steal = Steal {
        steal_s: 1.3,
        window_s: 5.0,
    };

    fn causes(causes: &[LateCause]) -> MissCauses {
        MissCauses::new(&missed(causes), &IncidentCauses::default())
    }

    fn diagnosis(of: &[LateCause], missing: u32) -> Diagnosis {
        Diagnosis::new(&causes(of), Some(&baseline(3, 4)), Some(TAKEN), missing)
    }

    /// The first of the misses is explained by the steal.
    fn stolen(of: &[LateCause], missing: u32) -> Diagnosis {
        let cycles = missed(of);
        let causes = MissCauses::new(&cycles, &stolen_cycle(&cycles[0], 20_000_000, 20_000_000));
        Diagnosis::new(&causes, Some(&baseline(3, 4)), Some(TAKEN), missing)
    }

    #[test]
    fn the_largest_cause_is_the_limit() {
        use LateCause::{Compute, Load, None, PageFault, Platform, Stall};
        for (of, missing, limit) in [
            // Steal without a miss limits nothing.
            (&[][..], 0, Limit::Nothing),
            (&[], realtime::FIFO, Limit::NoRealTime),
            (&[], realtime::OFF, Limit::NoRealTime),
            (&[], realtime::LOCKED, Limit::Nothing),
            (&[Platform], 0, Limit::Platform),
            // Both have causes outside the system.
            (&[Platform, Stall, Load], 0, Limit::Platform),
            (&[Platform, Load, Load], 0, Limit::OtherTask),
            (&[Load], realtime::FIFO, Limit::NoRealTime),
            (&[PageFault, PageFault, Load], 0, Limit::PageFaults),
            (&[Compute, Compute, Platform], 0, Limit::Cdcr),
            (&[None], 0, Limit::Unknown),
            (&[None], realtime::FIFO, Limit::Unknown),
            (&[None, None, Load], 0, Limit::Unknown),
            (&[None, Load], 0, Limit::OtherTask),
        ] {
            let diagnosis = diagnosis(of, missing);
            assert_eq!(diagnosis.limited_by, limit, "{of:?} {missing}");
            assert_eq!(
                diagnosis.next.is_some(),
                limit != Limit::Nothing,
                "{limit:?}"
            );
            assert_eq!(diagnosis.text.matches(". ").count(), 0, "one sentence");
        }
    }

    #[test]
    fn the_hypervisor_is_the_limit_where_it_explains_half_of_the_misses_from_outside() {
        use LateCause::{Load, Platform, Stall};
        for (of, missing, limit) in [
            (&[Platform, Stall, Load][..], 0, Limit::Hypervisor),
            (&[Platform], realtime::FIFO, Limit::Hypervisor),
            (&[Platform, Platform, Stall], 0, Limit::Platform),
            (&[Platform, Load, Load], 0, Limit::OtherTask),
        ] {
            assert_eq!(stolen(of, missing).limited_by, limit, "{of:?} {missing}");
        }
    }

    #[test]
    fn the_sentence_has_the_steal_and_the_bare_loop() {
        let text = stolen(&[LateCause::Platform], 0).text;
        assert_eq!(
            text,
            "The hypervisor limits this machine: it stole 1.30 of 5.0 s from a core; a bare loop \
             without work missed 3 of 100 deadlines."
        );
        let with_baseline = |baseline: Option<Baseline>| {
            Diagnosis::new(&causes(&[]), baseline.as_ref(), None, 0).text
        };
        assert_eq!(
            with_baseline(Some(baseline(0, 0))),
            "No deadline was missed; a bare loop without work started all its 100 cycles in time."
        );
        assert_eq!(with_baseline(None), "No deadline was missed.");
        let late = with_baseline(Some(baseline(0, 4)));
        assert!(late.contains("started 4 of 100 cycles late"), "{late}");
        let ordinary = |of: &[LateCause]| diagnosis(of, realtime::FIFO).text;
        assert!(ordinary(&[]).starts_with("No deadline was missed, but"));
        assert!(ordinary(&[LateCause::Load]).starts_with("Other tasks had the core"));
    }

    #[test]
    fn the_doctor_is_found_beside_the_program() {
        for (started_as, next) in [
            ("cdcrctl", "cdcrd doctor"),
            ("./target/release/cdcrctl", "./target/release/cdcrd doctor"),
            ("/opt/my robot/cdcrctl", "'/opt/my robot/cdcrd' doctor"),
            ("", "cdcrd doctor"),
        ] {
            assert_eq!(doctor(Path::new(started_as)), next);
        }
    }

    #[test]
    fn what_is_not_granted_has_one_command_and_what_is_granted_has_none() {
        assert_eq!(diagnosis(&[], 0).grant, None);
        assert_eq!(diagnosis(&[], realtime::PINNED).grant, None);
        for missing in [realtime::FIFO, realtime::LOCKED] {
            assert!(diagnosis(&[], missing).grant.is_some());
        }
        assert!(grant(false).starts_with("sudo prlimit"));
        assert!(grant(true).contains("--ulimit rtprio=90"));
    }

    #[test]
    fn the_json_names_the_limit() {
        let json = serde_json::to_value(diagnosis(&[LateCause::Load], realtime::FIFO));
        let json = json.expect("JSON");
        assert_eq!(json["limited_by"], "no-real-time");
        let next = json["next"].as_str().expect("a command");
        assert!(next.ends_with("cdcrd doctor"), "{next}");
        assert!(json["grant"].is_string() && json["text"].is_string());
    }
}
