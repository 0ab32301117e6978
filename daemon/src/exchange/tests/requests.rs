//! Requests that a cycle decides.

use cdcr_shared_types::codes::RequestKind;

use super::homing;
use crate::handover::CycleReport;

/// A replay knows no other sign of it.
#[test]
fn of_records_that_wait_together_a_request_names_the_cycle_that_decided_it() {
    let mut rig = homing("");
    let _answer = rig.ask(5, RequestKind::Hold);
    rig.gather();
    for cycle in 3..=5 {
        rig.run(cycle, None);
    }
    rig.publish();
    let reports: Vec<_> = std::iter::from_fn(|| rig.reports.reports.pop().ok()).collect();
    let inputs = &reports[0].inputs;
    assert_eq!((inputs.event_count, inputs.events[0].sender_id), (1, 5));
    let handed_over_ns = |report: &CycleReport| report.record.handed_over_ns;
    assert_eq!(inputs.events[0].judged_ns, handed_over_ns(&reports[0]));
    assert!(
        reports[1..]
            .iter()
            .all(|later| handed_over_ns(later) > handed_over_ns(&reports[0]))
    );
}
