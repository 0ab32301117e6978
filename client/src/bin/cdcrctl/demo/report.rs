use anyhow::bail;
use cdcr_client::realtime_missing;
use cdcr_shared_types::Status;
use serde::Serialize;

use super::baseline::Baseline;
use super::causes::{IncidentCauses, MissCauses};
use super::cycle::Cycle;
use super::diagnosis::Diagnosis;
use super::steal::Steal;
use crate::args::DemoOptions;
use crate::spread::Spread;

/// Mean errors claimed in the paper for 1, 2 and 3 sections \[mm\].
const PAPER_MEAN_ERROR_MM: [f64; 3] = [5e-9, 7e-4, 5e-3];

#[derive(Debug)]
pub(super) struct Run {
    /// The baseline, or the reason of its failure.
    pub(super) baseline: Result<Baseline, String>,
    /// The tracking cycles with a release inside the reference.
    pub(super) cycles: Vec<Cycle>,
    pub(super) incidents: IncidentCauses,
    pub(super) steal: Option<Steal>,
    pub(super) status: Status,
    pub(super) lost_records: u64,
}

/// Result of the demo. Its fields are those of `--format json`, explained in `cdcrctl demo --help`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct DemoReport {
    pub(super) sections: u32,
    /// Tracking cycles with a release inside the reference: the basis of all numbers below.
    pub(super) cycles: usize,
    pub(super) mean_error_mm: f64,
    pub(super) max_error_mm: f64,
    pub(super) deadline_misses: usize,
    pub(super) deadline_misses_per_s: f64,
    pub(super) misses_by_cause: MissCauses,
    /// Misses during which the hypervisor used the core for half of the delay or more.
    pub(super) misses_explained_by_steal: usize,
    pub(super) late_starts: usize,
    pub(super) late_starts_per_s: f64,
    pub(super) skipped_periods: u64,
    /// `None` when the kernel does not report it.
    pub(super) steal: Option<Steal>,
    /// `None` when the baseline failed.
    pub(super) baseline: Option<Baseline>,
    /// Reason of that failure.
    pub(super) baseline_error: Option<String>,
    #[serde(rename = "verdict")]
    pub(super) diagnosis: Diagnosis,
    pub(super) realtime: bool,
    pub(super) realtime_missing: Vec<&'static str>,
    pub(super) wake_us: Spread,
    pub(super) solve_us: Spread,
    pub(super) response_us: Spread,
    pub(super) paper_mean_error_mm: f64,
    pub(super) lost_records: u64,
    pub(super) duration_s: f64,
    pub(super) out: Option<String>,
}

impl DemoReport {
    pub(super) fn new(options: &DemoOptions, run: &Run) -> anyhow::Result<Self> {
        let Run { cycles, status, .. } = run;
        let lost_records = run.lost_records;
        if cycles.is_empty() {
            bail!("the daemon tracked, but no record arrived ({lost_records} lost)");
        }
        let errors_mm = || cycles.iter().map(|cycle| 1e3 * cycle.error_m);
        let missing = realtime_missing(status.realtime_missing);
        let duration_s = options.duration.as_secs_f64();
        let count = |is: fn(&Cycle) -> bool| cycles.iter().filter(|cycle| is(cycle)).count();
        let (deadline_misses, late_starts) = (count(|c| c.deadline_miss), count(|c| c.late_start));
        let spread =
            |of: fn(&Cycle) -> f64| Spread::from_values(cycles.iter().map(of)).unwrap_or_default();
        let causes = MissCauses::new(cycles, &run.incidents);
        let baseline = run.baseline.as_ref().ok();
        let diagnosis = Diagnosis::new(&causes, baseline, run.steal, status.realtime_missing);
        Ok(Self {
            sections: options.sections,
            cycles: cycles.len(),
            mean_error_mm: errors_mm().sum::<f64>() / cycles.len() as f64,
            max_error_mm: errors_mm().fold(0.0, f64::max),
            deadline_misses,
            deadline_misses_per_s: deadline_misses as f64 / duration_s,
            misses_explained_by_steal: causes.stolen(),
            misses_by_cause: causes,
            late_starts,
            late_starts_per_s: late_starts as f64 / duration_s,
            steal: run.steal,
            baseline: baseline.cloned(),
            baseline_error: run.baseline.as_ref().err().cloned(),
            diagnosis,
            skipped_periods: cycles.iter().map(|c| u64::from(c.skipped_periods)).sum(),
            realtime: missing.is_empty(),
            realtime_missing: missing.iter().map(|&(name, _)| name).collect(),
            wake_us: spread(|cycle| cycle.wake_us),
            solve_us: spread(|cycle| cycle.solve_us),
            response_us: spread(|cycle| cycle.response_us),
            paper_mean_error_mm: PAPER_MEAN_ERROR_MM[options.sections as usize - 1],
            lost_records,
            duration_s,
            out: options.out.as_ref().map(|out| out.display().to_string()),
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::baseline::tests::baseline;
    use super::super::causes::tests::missed;
    use super::super::cycle::tests::synthetic;
    use super::*;
    use crate::args::Format;
    use cdcr_shared_types::codes::LateCause;
    use std::time::Duration;

    fn options() -> DemoOptions {
        DemoOptions {
            sections: 3,
            duration: Duration::from_millis(4970),
            format: Format::Text,
            out: None,
        }
    }

    pub(in crate::demo) fn run(cycles: &[Cycle], status: &Status) -> Run {
        Run {
            baseline: Ok(baseline(3, 4)),
            cycles: cycles.to_vec(),
            incidents: IncidentCauses::default(),
            steal: Some(Steal {
                steal_s: 1.3,
                window_s: 5.0,
            }),
            status: *status,
            lost_records: 0,
        }
    }

    pub(in crate::demo) fn report(cycles: &[Cycle], status: &Status) -> DemoReport {
        DemoReport::new(&options(), &run(cycles, status)).expect("cycles were tracked")
    }

    #[test]
    fn errors_and_times_count_over_the_same_cycles() {
        let (mut cycles, _) = synthetic(4);
        for (cycle, error_m) in cycles.iter_mut().zip([1e-9, 2e-9, 4e-9, 5e-9]) {
            cycle.error_m = error_m;
        }
        cycles[1].skipped_periods = 2;
        cycles[3].deadline_miss = true;
        let report = report(&cycles, &Status::default());
        assert!((report.mean_error_mm - 3e-6).abs() < 1e-18);
        assert!((report.max_error_mm - 5e-6).abs() < 1e-18);
        assert_eq!(report.cycles, 4);
        assert_eq!((report.deadline_misses, report.skipped_periods), (1, 2));
        assert!(report.realtime);
    }

    #[test]
    fn a_run_without_tracking_is_an_error() {
        assert!(DemoReport::new(&options(), &run(&[], &Status::default())).is_err());
    }

    #[test]
    fn misses_have_causes_a_baseline_and_a_diagnosis_in_the_json() {
        let mut cycles = missed(&[LateCause::Platform, LateCause::Platform, LateCause::Load]);
        cycles[7].late_start = true;
        let json = serde_json::to_value(report(&cycles, &Status::default())).expect("JSON");
        assert_eq!(
            (&json["deadline_misses"], &json["late_starts"]),
            (&3.into(), &1.into())
        );
        let rate = json["deadline_misses_per_s"].as_f64().expect("a number");
        assert!((rate - 3.0 / 4.97).abs() < 1e-12, "{rate}");
        assert_eq!(json["misses_by_cause"]["platform"], 2);
        assert_eq!(json["misses_by_cause"]["another task had the core"], 1);
        assert_eq!(json["misses_by_cause"]["compute"], 0);
        assert_eq!(json["steal"]["steal_s"], 1.3);
        assert_eq!(json["steal"]["window_s"], 5.0);
        assert_eq!(json["verdict"]["limited_by"], "platform");
        assert!(json["verdict"]["next"].is_string());
        assert!(json["verdict"]["grant"].is_null());
        let baseline = &json["baseline"];
        for field in [
            "duration_s",
            "cycles",
            "late_starts",
            "late_starts_per_s",
            "deadline_misses",
            "deadline_misses_per_s",
            "skipped_periods",
        ] {
            assert!(baseline[field].is_number(), "{field}");
        }
        assert_eq!(baseline["wake_us"]["p99"], 90.0);
        assert_eq!(baseline["causes"]["platform"], 3);
        assert!(json["baseline_error"].is_null());
    }

    #[test]
    fn the_report_names_a_bare_loop_that_failed() {
        let (cycles, _) = synthetic(10);
        let run = Run {
            baseline: Err("cdcrd bare failed (exit status: 1)".to_owned()),
            ..run(&cycles, &Status::default())
        };
        let report = DemoReport::new(&options(), &run).expect("cycles were tracked");
        let json = serde_json::to_value(report).expect("JSON");
        assert!(json["baseline"].is_null());
        assert_eq!(json["baseline_error"], "cdcrd bare failed (exit status: 1)");
        assert_eq!(json["verdict"]["text"], "No deadline was missed.");
    }
}
