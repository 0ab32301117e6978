use std::collections::{BTreeMap, HashMap};

use cdcr_shared_types::Incident;
use cdcr_shared_types::codes::LateCause;
use serde::Serialize;

use super::cycle::Cycle;

/// How many deadline misses each cause made.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[serde(transparent)]
pub(super) struct MissCauses {
    /// By the words of the cause; every cause is there.
    counts: BTreeMap<&'static str, usize>,
}

/// The causes that the daemon put into its incidents, by cycle: it knows the steal, which the records do not.
#[derive(Debug, Default)]
pub(super) struct JudgedCycles {
    causes: HashMap<u64, LateCause>,
}

impl JudgedCycles {
    pub(super) fn take(&mut self, incident: &Incident) {
        let record = &incident.telemetry;
        if let Ok(cause) = LateCause::try_from(record.scheduling.late_cause) {
            self.causes.insert(record.cycle, cause);
        }
    }

    fn cause(&self, cycle: &Cycle) -> LateCause {
        let judged = self.causes.get(&cycle.number);
        judged.copied().unwrap_or(cycle.late_cause)
    }
}

impl MissCauses {
    /// Counts the misses of `cycles` by the daemon's judgement, and without one by the cause in the record.
    pub(super) fn new(cycles: &[Cycle], judged: &JudgedCycles) -> Self {
        let known = LateCause::ALL
            .iter()
            .filter(|cause| **cause != LateCause::None);
        let mut counts: BTreeMap<_, _> = known.map(|cause| (words(*cause), 0)).collect();
        for cycle in cycles.iter().filter(|cycle| cycle.deadline_miss) {
            *counts.entry(words(judged.cause(cycle))).or_default() += 1;
        }
        Self { counts }
    }

    pub(super) fn count(&self, cause: LateCause) -> usize {
        self.counts.get(words(cause)).copied().unwrap_or(0)
    }

    pub(super) fn total(&self) -> usize {
        self.counts.values().sum()
    }

    /// The causes that made misses, and how many, the most first.
    pub(super) fn ranked(&self) -> Vec<(&'static str, usize)> {
        let made = self.counts.iter().filter(|(_, count)| **count > 0);
        let mut ranked: Vec<_> = made.map(|(cause, count)| (*cause, *count)).collect();
        ranked.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        ranked
    }
}

/// A miss is never in time: where no cause is recorded, that is what it is called.
fn words(cause: LateCause) -> &'static str {
    match cause {
        LateCause::None => "not recorded",
        cause => cause.text(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::cycle::tests::synthetic;
    use super::*;

    /// Cycles whose first `causes.len()` missed their deadline, for these causes.
    pub(in crate::demo) fn missed(causes: &[LateCause]) -> Vec<Cycle> {
        let (mut cycles, _) = synthetic(100);
        for (cycle, cause) in cycles.iter_mut().zip(causes) {
            cycle.deadline_miss = true;
            cycle.late_cause = *cause;
        }
        cycles
    }

    #[test]
    fn misses_are_counted_by_cause_and_late_starts_are_not() {
        use LateCause::{Load, None, Platform, Stall};
        let mut cycles = missed(&[Load, Platform, Platform, None]);
        cycles[50].late_cause = Stall;
        let causes = MissCauses::new(&cycles, &JudgedCycles::default());
        assert_eq!(
            causes.ranked(),
            [
                ("platform", 2),
                ("another task had the core", 1),
                ("not recorded", 1)
            ]
        );
        assert_eq!((causes.count(Platform), causes.count(Stall)), (2, 0));
        let json = serde_json::to_value(&causes).expect("JSON");
        assert_eq!(json["platform"], 2);
        assert_eq!(json["stall of the processor"], 0, "each cause is there");
    }

    #[test]
    fn the_incident_of_a_cycle_wins_over_its_record() {
        let cycles = missed(&[LateCause::Load, LateCause::Load]);
        let mut judged = JudgedCycles::default();
        let mut incident = Incident::default();
        incident.telemetry.cycle = cycles[1].number;
        incident.telemetry.scheduling.late_cause = LateCause::Platform.code();
        judged.take(&incident);
        let causes = MissCauses::new(&cycles, &judged);
        assert_eq!(causes.count(LateCause::Load), 1);
        assert_eq!(causes.count(LateCause::Platform), 1);
    }

    #[test]
    fn without_misses_there_is_no_cause() {
        let causes = MissCauses::new(&missed(&[]), &JudgedCycles::default());
        assert_eq!(causes.ranked(), []);
    }
}
