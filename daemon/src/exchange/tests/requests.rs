//! Requests that a cycle decides.

use cdcr_controller::safety::Mode;
use cdcr_shared_types::codes::{Outcome, RequestKind};

use super::homing;
use crate::handover::CycleReport;

/// A replay has no other information about the deciding cycle.
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
    assert_eq!(inputs.events[0].evaluated_ns, handed_over_ns(&reports[0]));
    assert!(
        reports[1..]
            .iter()
            .all(|later| handed_over_ns(later) > handed_over_ns(&reports[0]))
    );
}

/// The exchange stalls with a reset and a motion waiting, and a signal stops the robot.
#[test]
fn what_was_asked_before_a_signal_is_not_carried_out_after_it() {
    let mut rig = homing("");
    rig.cycle.stop();
    assert!(matches!(rig.run(3, None), Mode::Stopped { .. }));
    let before = [RequestKind::Reset, RequestKind::Home].map(|kind| rig.ask(5, kind));
    rig.cycle.stop();
    rig.run(4, None);
    rig.next_cycle = 5;
    rig.measure(1, 1.5, 0);
    rig.gather();
    // This rig passes one request per cycle.
    for cycle in [5, 6] {
        assert!(matches!(rig.run(cycle, None), Mode::Stopped { .. }));
    }
    rig.publish();
    for asked in before {
        let answer = asked.receive().unwrap().unwrap();
        assert_eq!(answer.payload().outcome, Outcome::Overruled.code());
    }
    let _after = rig.ask(5, RequestKind::Reset);
    rig.next_cycle = 7;
    rig.measure(1, 1.5, 0);
    rig.gather();
    assert!(matches!(rig.run(7, None), Mode::Holding { .. }));
}

/// A client whose clock is ahead: by its time, the reset would always be newer than the stop.
#[test]
fn a_request_from_the_future_resets_no_stop_that_came_after_it() {
    let mut rig = homing("");
    let answer = rig.ask_at(5, RequestKind::Reset, u64::MAX);
    rig.cycle.stop();
    assert!(matches!(rig.run(3, None), Mode::Stopped { .. }));
    rig.next_cycle = 4;
    rig.measure(1, 1.5, 0);
    rig.gather();
    assert!(matches!(rig.run(4, None), Mode::Stopped { .. }));
    rig.publish();
    let answer = answer.receive().unwrap().unwrap();
    assert_eq!(answer.payload().outcome, Outcome::InTheFuture.code());
}
