use std::collections::{BTreeMap, HashMap};

use cdcr_shared_types::Incident;
use cdcr_shared_types::codes::LateCause;
use serde::Serialize;

use super::cycle::Cycle;

/// Number of deadline misses per cause.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[serde(transparent)]
pub(super) struct MissCauses {
    /// Counts by the text of the cause; every cause has an entry.
    counts: BTreeMap<&'static str, usize>,
    /// Misses explained by steal.
    #[serde(skip)]
    stolen: usize,
}

/// The causes in the daemon's incidents, by cycle: they include the steal, which records do not contain.
#[derive(Debug, Default)]
pub(super) struct IncidentCauses {
    cycles: HashMap<u64, IncidentCause>,
}

#[derive(Debug)]
struct IncidentCause {
    cause: LateCause,
    /// The hypervisor used the core for at least half of the delay.
    is_stolen: bool,
}

impl IncidentCauses {
    pub(super) fn take(&mut self, incident: &Incident) {
        let record = &incident.telemetry;
        if let Ok(cause) = LateCause::try_from(record.scheduling.late_cause) {
            let late_ns = record.handed_over_ns.saturating_sub(record.due_ns);
            let is_stolen = incident.steal_ns > 0 && incident.steal_ns >= late_ns / 2;
            let known = IncidentCause { cause, is_stolen };
            self.cycles.insert(record.cycle, known);
        }
    }

    fn cause(&self, cycle: &Cycle) -> LateCause {
        let incident = self.cycles.get(&cycle.number);
        incident.map_or(cycle.late_cause, |incident| incident.cause)
    }

    fn is_stolen(&self, cycle: &Cycle) -> bool {
        let incident = self.cycles.get(&cycle.number);
        incident.is_some_and(|incident| incident.is_stolen)
    }
}

impl MissCauses {
    /// Counts the misses of `cycles` by the cause in the incident, otherwise by the one in the record.
    pub(super) fn new(cycles: &[Cycle], incidents: &IncidentCauses) -> Self {
        let known = LateCause::ALL
            .iter()
            .filter(|cause| **cause != LateCause::None);
        let mut counts: BTreeMap<_, _> = known.map(|cause| (words(*cause), 0)).collect();
        let missed = || cycles.iter().filter(|cycle| cycle.deadline_miss);
        for cycle in missed() {
            *counts.entry(words(incidents.cause(cycle))).or_default() += 1;
        }
        let stolen = missed().filter(|cycle| incidents.is_stolen(cycle)).count();
        Self { counts, stolen }
    }

    /// Misses in which the hypervisor used the core for at least half of the delay.
    pub(super) fn stolen(&self) -> usize {
        self.stolen
    }

    pub(super) fn count(&self, cause: LateCause) -> usize {
        self.counts.get(words(cause)).copied().unwrap_or(0)
    }

    pub(super) fn total(&self) -> usize {
        self.counts.values().sum()
    }

    /// The causes with misses and their counts, the most frequent first.
    pub(super) fn ranked(&self) -> Vec<(&'static str, usize)> {
        let made = self.counts.iter().filter(|(_, count)| **count > 0);
        let mut ranked: Vec<_> = made.map(|(cause, count)| (*cause, *count)).collect();
        ranked.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        ranked
    }
}

/// Text of a cause: for a miss, `None` means unknown rather than in time.
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

    /// The incident of a platform miss that came `late_ns` after its release.
    pub(in crate::demo) fn stolen_cycle(
        cycle: &Cycle,
        steal_ns: u64,
        late_ns: u64,
    ) -> IncidentCauses {
        let mut incident = Incident {
            steal_ns,
            ..Incident::default()
        };
        let record = &mut incident.telemetry;
        record.cycle = cycle.number;
        record.handed_over_ns = record.due_ns + late_ns;
        record.scheduling.late_cause = LateCause::Platform.code();
        let mut incidents = IncidentCauses::default();
        incidents.take(&incident);
        incidents
    }

    #[test]
    fn misses_are_counted_by_cause_and_late_starts_are_not() {
        use LateCause::{Load, None, Platform, Stall};
        let mut cycles = missed(&[Load, Platform, Platform, None]);
        cycles[50].late_cause = Stall;
        let causes = MissCauses::new(&cycles, &IncidentCauses::default());
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
        let mut incidents = IncidentCauses::default();
        let mut incident = Incident::default();
        incident.telemetry.cycle = cycles[1].number;
        incident.telemetry.scheduling.late_cause = LateCause::Platform.code();
        incidents.take(&incident);
        let causes = MissCauses::new(&cycles, &incidents);
        assert_eq!(causes.count(LateCause::Load), 1);
        assert_eq!(causes.count(LateCause::Platform), 1);
    }

    #[test]
    fn a_miss_is_stolen_where_the_steal_is_half_of_its_lateness() {
        for (steal_ns, stolen) in [(0, 0), (10_000_000, 0), (20_000_000, 1)] {
            let cycles = missed(&[LateCause::Platform, LateCause::Platform]);
            let incidents = stolen_cycle(&cycles[0], steal_ns, 40_000_000);
            let causes = MissCauses::new(&cycles, &incidents);
            assert_eq!(causes.stolen(), stolen, "{steal_ns} ns");
            assert_eq!(causes.count(LateCause::Platform), 2);
        }
    }

    #[test]
    fn without_misses_there_is_no_cause() {
        let causes = MissCauses::new(&missed(&[]), &IncidentCauses::default());
        assert_eq!(causes.ranked(), []);
    }
}
