//! Right after each cycle: first the command, then the answers, then a report for monitoring clients.

use cdcr_shared_types as wire;

use super::{Exchange, Newest};
use crate::handover::{CycleRecord, CycleReport, InputReport, InputStatus, Shared};
use crate::rt::clock::Clock;
use crate::{convert, services};

impl Exchange {
    /// Publishes the command of the newest record from the cycle, and passes on every record. Several records
    /// wait if this thread stalled; the commands of the older ones are out of date and are not sent.
    pub(super) fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        let mut scheduling = None;
        let lost = self.ends.records.lost();
        while let Some(record) = self.ends.records.receive() {
            let is_newest = self.ends.records.is_empty();
            let command = self.publish_command(&record, is_newest, clock.now_ns(), shared);
            let publish_ns = clock.now_ns().saturating_sub(record.handed_over_ns);
            self.answer_decided(&record, clock.now_ns());
            self.newest = Newest {
                cycle: record.release.cycle,
                mode: record.mode.into(),
                rests: record.rates.as_slice().iter().all(|rate| *rate == 0.0),
            };
            // Records that wait together share one reading.
            let number = self.reports;
            let scheduling = *scheduling
                .get_or_insert_with(|| self.cycle_watch.read(&record, is_newest, number));
            self.reports += 1;
            // A stalled reporter loses records, which monitoring clients detect by the gap. The events follow
            // with a later record.
            if self.ends.reports.is_full() {
                shared.dropped_records.add(1);
                self.ends.records.recycle(record);
                continue;
            }
            let report = CycleReport {
                number: self.reports,
                scheduling,
                inputs: self.report_inputs(record.gather, clock.now_ns()),
                record,
                command,
                publish_ns,
            };
            // Only this thread fills the ring.
            let _ = self.ends.reports.push(report);
        }
        shared.dropped_records.add(self.ends.records.lost() - lost);
        if scheduling.is_some() {
            self.own_costs.note(clock.on_core_ns());
        }
    }

    /// The command of `record`. It is sent if the record is the newest, the configuration is known, and the
    /// command is still worth sending; otherwise its sequence number is 0.
    fn publish_command(
        &mut self,
        record: &CycleRecord,
        is_newest: bool,
        now_ns: u64,
        shared: &Shared,
    ) -> wire::Command {
        // While the robot's configuration is unknown, there is no target.
        let is_known = record.measurement.is_some() && record.configuration.is_finite();
        let mut command = wire::Command {
            header: self.header(0, now_ns),
            driver_id: self.measurements.driver_id().unwrap_or(0),
            ..convert::command(record, &self.robot, self.timing.period_ns)
        };
        if is_newest && is_known && is_worth_sending(&command, now_ns) {
            self.commands_sent += 1;
            command.header.sequence = self.commands_sent;
            // A failed send may have reached the driver and not another reader: assume the worse of both.
            let has_left = services::send(&self.ports.command, &command);
            if has_left || moves(&command) {
                shared.last_word_moves.set(moves(&command));
            }
        }
        command
    }

    fn report_inputs(&mut self, gather: u64, now_ns: u64) -> InputReport {
        let (events, event_count) = self.events.report(gather);
        InputReport {
            events,
            event_count,
            gather_took_ns: self.gather.took_ns,
            status: InputStatus {
                dropped_events: self.events.dropped(),
                outcomes: *self.events.outcomes(),
                lease_holder: self.references.holder(now_ns).unwrap_or(0),
                reference_end_ns: self.references.end_ns().unwrap_or(0),
                reference_points: self.references.points_ahead(now_ns) as u32,
                obstacles_refused: self.obstacles.refused(),
                silent_source: self.obstacles.silent_source(now_ns),
                refused_tips: self.measurements.refused_tips(),
                driver_measures_tip_only: self.measurements.driver_measures_tip_only(),
                safe_distance_min_m: self.settings.safe_distance_min_m,
            },
        }
    }
}

/// An expired command is not sent: the driver has rested since, and must not receive motion, even if it would
/// refuse it. Zero rates are valid at any time: they are the last command of a daemon that ends.
fn is_worth_sending(command: &wire::Command, now_ns: u64) -> bool {
    now_ns < command.valid_until_ns || !moves(command)
}

fn moves(command: &wire::Command) -> bool {
    command.bend_rate_rad_s.iter().any(|rate| *rate != 0.0)
}
