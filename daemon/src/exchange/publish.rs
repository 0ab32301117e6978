//! Right after each cycle: the command first, then answers, telemetry and the summary.

use cdcr_controller::nmpc::SolveStatus;
use cdcr_shared_types as wire;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{ZeroCopySend, ipc};

use super::{Exchange, convert};
use crate::cycle::CycleRecord;
use crate::ports::Clock;
use crate::rt::handoff::Shared;
use crate::supervisor::Summary;

impl Exchange {
    /// Publishes every record that the cycle has handed over.
    pub(super) fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        while let Ok(record) = self.ends.records.pop() {
            let command = self.publish_command(&record, clock.now_ns());
            self.last_cycle = record.release.cycle;
            self.last_mode = convert::mode(record.mode);
            self.answer_decided(&record, clock.now_ns());
            self.publish_telemetry(&record, &command, clock.now_ns());
            self.sum_up(&record, clock.now_ns(), shared);
        }
    }

    fn publish_command(&mut self, record: &CycleRecord, now_ns: u64) -> wire::Command {
        // Before the first measurement nobody knows where the robot is, so there is no target to go to.
        let is_known = record.measurement.is_some();
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

    fn publish_telemetry(&mut self, record: &CycleRecord, command: &wire::Command, now_ns: u64) {
        self.telemetry_sent += 1;
        let mut telemetry = wire::Telemetry {
            header: self.header(self.telemetry_sent, now_ns),
            command: *command,
            ..convert::telemetry(record, &self.robot, self.period_ns)
        };
        self.events.report(&mut telemetry);
        send(&self.ports.telemetry, telemetry);
    }

    fn sum_up(&mut self, record: &CycleRecord, now_ns: u64, shared: &Shared) {
        let due_ns = record.release.due_ns;
        let summary = Summary {
            cycle: record.release.cycle,
            wake_ns: record.release.start_ns - due_ns,
            solve_ns: record.solve_end_ns - record.solve_start_ns,
            solved: record.report.status != SolveStatus::Idle,
            budget_hit: record.report.budget_spent,
            response_ns: record.handed_over_ns - due_ns,
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
