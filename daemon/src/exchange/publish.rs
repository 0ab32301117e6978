//! Right after each cycle: the command first, then answers, telemetry and the summary.

use cdcr_controller::nmpc::SolveStatus;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{ZeroCopySend, ipc};

use super::{Exchange, convert};
use crate::cycle::{CycleRecord, MeasurementUse};
use crate::ports::Clock;
use crate::rt::attribution::{Blame, Judged, Timing};
use crate::rt::handoff::Shared;
use crate::supervisor::Summary;

impl Exchange {
    /// Publishes every record that the cycle has handed over.
    pub(super) fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        let mut scheduling = None;
        while let Ok(record) = self.ends.records.pop() {
            let command = self.publish_command(&record, clock.now_ns());
            let publish_ns = clock.now_ns().saturating_sub(record.handed_over_ns);
            self.answer_decided(&record, clock.now_ns());
            // Records that wait together share one reading.
            let scheduling = scheduling.get_or_insert_with(|| self.scheduler.look());
            let judged = judged(&record, self.spin_ns);
            let blame = self.attribution.judge(&judged, scheduling.as_ref());
            let report =
                convert::scheduling(scheduling.as_ref(), record.longest_gap_ns, blame.cause());
            let begins_fault = convert::mode(record.mode) == codes::Mode::Faulted
                && self.last_mode != codes::Mode::Faulted;
            self.last_cycle = record.release.cycle;
            self.last_mode = convert::mode(record.mode);
            let telemetry = self.publish_telemetry(&record, &command, report, clock.now_ns());
            // Releases that an overrun took belong to its incident.
            if matches!(blame, Blame::Own(_)) || begins_fault {
                self.hand_incident_on(&telemetry, shared);
            }
            let late_cause = match blame {
                Blame::Own(_) => report.late_cause,
                Blame::InTime | Blame::Before(_) => codes::LateCause::None.code(),
            };
            self.sum_up(&record, late_cause, publish_ns, clock.now_ns(), shared);
        }
    }

    /// A bad cycle goes to the supervisor, which keeps it.
    fn hand_incident_on(&mut self, telemetry: &wire::Telemetry, shared: &Shared) {
        self.incidents_sent += 1;
        let incident = wire::Incident {
            header: self.header(self.incidents_sent, telemetry.header.sent_ns),
            telemetry: *telemetry,
            ..wire::Incident::default()
        };
        if self.ends.incidents.push(incident).is_err() {
            shared.count_dropped_record();
        }
    }

    fn publish_command(&mut self, record: &CycleRecord, now_ns: u64) -> wire::Command {
        // While nobody knows where the robot is, there is no target to go to.
        let is_known = record.measurement.is_some() && record.configuration.is_finite();
        self.commands_sent += u64::from(is_known);
        let command = wire::Command {
            header: self.header(self.commands_sent, now_ns),
            ..convert::command(record, &self.robot, self.period_ns, self.command_valid_ns)
        };
        if is_known {
            send(&self.ports.command, command);
        }
        command
    }

    fn publish_telemetry(
        &mut self,
        record: &CycleRecord,
        command: &wire::Command,
        scheduling: wire::SchedulingReport,
        now_ns: u64,
    ) -> wire::Telemetry {
        self.telemetry_sent += 1;
        let mut telemetry = wire::Telemetry {
            header: self.header(self.telemetry_sent, now_ns),
            command: *command,
            scheduling,
            ..convert::telemetry(record, &self.robot, self.period_ns)
        };
        self.events.report(&mut telemetry);
        send(&self.ports.telemetry, telemetry);
        telemetry
    }

    fn sum_up(
        &mut self,
        record: &CycleRecord,
        late_cause: u32,
        publish_ns: u64,
        now_ns: u64,
        shared: &Shared,
    ) {
        let due_ns = record.release.due_ns;
        let summary = Summary {
            cycle: record.release.cycle,
            wake_ns: record.release.start_ns - due_ns,
            solve_ns: record.solve_end_ns - record.solve_start_ns,
            solved: record.report.status != SolveStatus::Idle,
            budget_hit: record.report.budget_spent,
            compute_ns: record.handed_over_ns - record.release.start_ns,
            response_ns: record.handed_over_ns - due_ns,
            gather_ns: self.gather_took_ns,
            publish_ns,
            skipped_periods: record.release.skipped,
            due_ns,
            late_cause,
            stale_inputs: record.stale_inputs,
            stale_measurement: self.has_driver
                && record.measurement_use == MeasurementUse::Repeated,
            position_error_m: self.tracking_error_m(record),
            verdict: record.verdict,
            totals: record.totals,
            mode: self.last_mode,
            reason: convert::reason(record.mode.reason()),
            faults: record.faults,
            settings: convert::settings_to_wire(&record.settings),
            lease_holder: self.lease.holder(now_ns).unwrap_or(0),
            reference_end_ns: self.trajectory.end_ns().unwrap_or(0),
            reference_points: self.trajectory.points_ahead(now_ns) as u32,
            obstacle_count: record.obstacles.count() as u32,
            obstacles_refused: self.obstacles_refused,
            clearance_m: record.clearance_m,
            clearance_guarded: record.clearance_hit,
            dropped_events: self.events.dropped(),
            outcomes: *self.events.outcomes(),
        };
        if self.ends.summaries.push(summary).is_err() {
            shared.count_dropped_record();
        }
    }

    fn tracking_error_m(&self, record: &CycleRecord) -> Option<f64> {
        let tracks = self.last_mode == codes::Mode::Tracking;
        tracks.then(|| (record.tip.position_m - record.reference.position_m).norm())
    }
}

/// The cycle as far as its lateness is concerned; its thread wakes up `spin_ns` before its release.
fn judged(record: &CycleRecord, spin_ns: u64) -> Judged {
    let release = &record.release;
    Judged {
        count: record.totals.cycles,
        verdict: record.verdict,
        skipped: release.skipped,
        timing: Timing {
            early_ns: spin_ns,
            wake_ns: release.start_ns - release.due_ns,
            compute_ns: record.handed_over_ns - release.start_ns,
            longest_gap_ns: record.longest_gap_ns,
            after_solve_ns: record.handed_over_ns - record.solve_end_ns,
        },
    }
}

/// Copies a message into shared memory and sends it. Readers that are full lose their oldest; when no
/// memory can be loaned, the message is lost and its readers see a gap in the sequence.
fn send<T: ZeroCopySend + std::fmt::Debug + 'static>(
    publisher: &Publisher<ipc::Service, T, ()>,
    message: T,
) {
    if let Ok(sample) = publisher.loan_uninit() {
        let _ = sample.write_payload(message).send();
    }
}
