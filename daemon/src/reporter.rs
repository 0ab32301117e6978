//! The reporter thread publishes the telemetry of each cycle, outside the control path.
//!
//! ```text
//! loop { sleep for four periods, 1 ms at least and 20 ms at most
//!          evaluate: lateness of the cycle and its cause
//!          publish:  telemetry of every cycle
//!          pass on:  incidents and summaries to the supervisor }
//! ```
//!
//! When a reader joins or leaves, files in the root folder are created and removed under one lock of that
//! folder. A client starved on a crowded core may hold the lock for a tenth of a second or more, and no
//! priority helps. Only this thread waits for it, so monitoring clients delay neither inputs nor commands.
//! The reporter runs outside the core of the cycle, above ordinary tasks.
//!
//! Invariant: it only reads records and reports; it sends nothing to the cycle or the exchange, but returns their
//! memory.

mod measured_error;

use std::time::Duration;

use cdcr_controller::nmpc::SolveStatus;
use cdcr_controller::robot::Robot;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{LateCause, Mode};
use cdcr_shared_types::ipc;
use cdcr_shared_types::model::guard_flags;
use iceoryx2::port::publisher::Publisher;

use crate::config::{LinkKind, Validated, ns};
use crate::handover::{
    CycleRecord, CycleReport, FaultPlace, MeasurementUse, ReporterEnds, Shared, Summary,
    TipRejection,
};
use crate::rt::attribution::{Attribution, CauseAssignment, EvaluatedCycle, Timing};
use crate::rt::clock::Clock;
use crate::{convert, services};
use measured_error::MeasuredError;

/// Reports are read every four periods, at the cost of one wake-up in four cycles, but not more often than
/// once a millisecond.
const PERIODS_PER_CHECK: u64 = 4;
const CHECK_INTERVAL_MIN: Duration = Duration::from_millis(1);
/// Upper limit, because each check is a heartbeat for the watchdog.
const CHECK_INTERVAL_MAX: Duration = Duration::from_millis(20);

#[derive(Debug)]
pub struct Reporter {
    telemetry: Publisher<ipc::Variant, wire::Telemetry, ()>,
    ends: ReporterEnds,
    /// The newest telemetry; the next one overwrites it.
    newest: Box<wire::Telemetry>,
    robot: Robot,
    has_driver: bool,
    period_ns: u64,
    /// Time before its release at which the cycle thread wakes up \[ns\].
    spin_ns: u64,
    daemon_id: u64,
    incidents_sent: u64,
    last_mode: Mode,
    /// Where the cycle that began the present fault saw its cause.
    fault_place: Option<FaultPlace>,
    measured_error: MeasuredError,
    /// The newest tip measured beside the bends, if it was rejected.
    tip_rejected: Option<TipRejection>,
    /// Refused tips that the statistics have.
    refused_tips: u64,
    attribution: Attribution,
}

impl Reporter {
    /// The reporter of a validated configuration that publishes through `telemetry`.
    pub fn new(
        validated: &Validated,
        telemetry: Publisher<ipc::Variant, wire::Telemetry, ()>,
        ends: ReporterEnds,
        daemon_id: u64,
    ) -> Self {
        let config = &validated.config;
        Self {
            telemetry,
            ends,
            newest: Box::default(),
            robot: validated.robot.clone(),
            has_driver: config.link.kind == LinkKind::Driver,
            period_ns: ns(config.cycle.period_ms),
            spin_ns: config.realtime.spin_ns(config.cycle.period_ms),
            daemon_id,
            incidents_sent: 0,
            last_mode: Mode::Starting,
            measured_error: MeasuredError::default(),
            tip_rejected: None,
            refused_tips: 0,
            fault_place: None,
            attribution: Attribution::default(),
        }
    }

    /// Runs until the exchange has ended and its last report is published.
    pub fn run(&mut self, clock: &impl Clock, shared: &Shared) {
        let check_interval = Duration::from_nanos(PERIODS_PER_CHECK * self.period_ns);
        let check_interval = check_interval.clamp(CHECK_INTERVAL_MIN, CHECK_INTERVAL_MAX);
        loop {
            shared.reporter_beats.add(1);
            // Checked before the ring is emptied: after the end no further report can come.
            let is_last = shared.exchange_ended.is_set();
            self.publish(clock, shared);
            if is_last {
                break;
            }
            std::thread::park_timeout(check_interval);
        }
    }

    fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        while let Ok(report) = self.ends.reports.pop() {
            shared.reporter_beats.add(1);
            let record = &report.record;
            let scheduler_delta = report.scheduling.as_ref();
            let evaluated = evaluated(record, self.spin_ns);
            let assignment = self.attribution.evaluate(&evaluated, scheduler_delta);
            let scheduling =
                convert::scheduling(scheduler_delta, record.longest_gap_ns, assignment.cause());
            let mode = Mode::from(record.mode);
            let begins_fault = mode == Mode::Faulted && self.last_mode != Mode::Faulted;
            self.last_mode = mode;
            if mode != Mode::Faulted {
                self.fault_place = None;
            } else if begins_fault {
                self.fault_place = FaultPlace::find(&self.robot, record);
            }
            self.publish_telemetry(&report, scheduling, clock.now_ns());
            // Releases skipped by an overrun belong to its incident.
            if matches!(assignment, CauseAssignment::Own(_)) || begins_fault {
                self.forward_incident(shared);
            }
            self.measured_error.take(
                record.release.release_ns,
                convert::reference_position_m(record),
                (record.tip_measurement.as_ref(), record.tip_unused),
                record.measurement.as_ref(),
            );
            match record.tip_use {
                MeasurementUse::Implausible => {
                    self.tip_rejected = TipRejection::find(&self.robot, record);
                }
                MeasurementUse::Used => self.tip_rejected = None,
                MeasurementUse::None | MeasurementUse::Repeated => {}
            }
            let late_cause = match assignment {
                CauseAssignment::Own(_) => scheduling.late_cause,
                CauseAssignment::InTime | CauseAssignment::Before(_) => LateCause::None.code(),
            };
            if self
                .ends
                .summaries
                .push(self.summarise(&report, late_cause))
                .is_err()
            {
                shared.dropped_records.add(1);
            }
            self.refused_tips = report.inputs.status.refused_tips.count;
            self.ends.used.recycle(report.record);
        }
    }

    fn publish_telemetry(
        &mut self,
        report: &CycleReport,
        scheduling: wire::SchedulingReport,
        now_ns: u64,
    ) {
        let header = self.header(report.number, now_ns);
        let telemetry = &mut *self.newest;
        convert::fill_telemetry(telemetry, &report.record, &self.robot, self.period_ns);
        telemetry.header = header;
        telemetry.command = report.command;
        telemetry.scheduling = scheduling;
        telemetry.events = report.inputs.events;
        telemetry.event_count = report.inputs.event_count as u32;
        services::send(&self.telemetry, telemetry);
    }

    /// Passes on an incident to the supervisor.
    fn forward_incident(&mut self, shared: &Shared) {
        self.incidents_sent += 1;
        let incident = wire::Incident {
            header: self.header(self.incidents_sent, self.newest.header.sent_ns),
            telemetry: *self.newest,
            ..wire::Incident::default()
        };
        if self.ends.incidents.push(incident).is_err() {
            shared.dropped_records.add(1);
        }
    }

    fn summarise(&self, report: &CycleReport, late_cause: u32) -> Summary {
        let CycleReport { record, inputs, .. } = report;
        let due_ns = record.release.due_ns;
        Summary {
            cycle: record.release.cycle,
            wake_ns: record.release.start_ns - due_ns,
            solve_ns: record.solve_end_ns - record.solve_start_ns,
            core_budget: record.core_budget,
            costs: record.costs,
            solved: record.report.status != SolveStatus::Idle,
            compute_ns: record.handed_over_ns - record.release.start_ns,
            response_ns: record.handed_over_ns - due_ns,
            gather_ns: inputs.gather_took_ns,
            publish_ns: report.publish_ns,
            skipped_periods: record.release.skipped,
            due_ns,
            late_cause,
            counts: self.counts(record, inputs.status.refused_tips.count),
            position_error_m: self.tracking_error_m(record),
            lateness: record.lateness,
            misses_tolerated: record.policy.tolerates(record.miss_bucket),
            totals: record.totals,
            mode: self.last_mode,
            reason: record.mode.reason().into(),
            reset_refused_by: (record.seen.reset_refused_by())
                .filter(|_| record.mode.is_latched())
                .map(Into::into),
            faults: record.faults,
            settings: convert::settings_to_wire(&record.settings),
            inputs: inputs.status,
            obstacle_count: record.obstacles.count() as u32,
            clearance_m: record.clearance_m.min(record.measured_clearance_m),
            tip_margin_m: record.tip_margin_m,
            clearance_guarded: record.clearance_hit,
            tip_position_m: record.tip.position_m.into(),
            reference_distance_m: convert::position_error_m(record),
            reference_position_m: convert::reference_position_m(record).into(),
            measured_error_m: self.measured_error.distance_m(),
            following: record.following,
            following_warning: !record.mode.is_latched()
                && record.following.largest_rad() > record.policy.following.warning_rad,
            pose_differs: record.seen.pose_differs,
            tip_contradiction_m: record.seen.tip_contradiction_m,
            tip_measured_ns: (record.tip_measurement).map_or(0, |timed| timed.measured_ns),
            tip_rejected: self.tip_rejected,
            fault_place: self.fault_place,
        }
    }

    fn counts(&self, record: &CycleRecord, refused_tips: u64) -> wire::Statistics {
        let has_solved = record.report.status != SolveStatus::Idle;
        let is_repeated = record.measurement_use == MeasurementUse::Repeated;
        let error_m = self.tracking_error_m(record);
        let is_implausible = record.tip_use == MeasurementUse::Implausible;
        let error_nm = error_m.map_or(0, |error_m| (1e9 * error_m) as u64);
        wire::Statistics {
            budget_hits: u64::from(record.report.budget_spent),
            stale_inputs: u64::from(record.stale_inputs),
            limited_cycles: u64::from(
                has_solved && guard_flags(&record.limits_hit, record.clearance_hit) != 0,
            ),
            tracked_cycles: u64::from(error_m.is_some()),
            tip_error_sum_nm: error_nm,
            tip_error_max_nm: error_nm,
            stale_measurements: u64::from(self.has_driver && is_repeated),
            tips_not_used: u64::from(is_implausible) + refused_tips - self.refused_tips,
            longest_gap_ns: record.longest_gap_ns,
            ..wire::Statistics::default()
        }
    }

    fn tracking_error_m(&self, record: &CycleRecord) -> Option<f64> {
        let tracks = self.last_mode == Mode::Tracking;
        tracks.then(|| (record.tip.position_m - record.reference.position_m).norm())
    }

    fn header(&self, sequence: u64, now_ns: u64) -> wire::Header {
        wire::Header {
            sender_id: self.daemon_id,
            sequence,
            sent_ns: now_ns,
        }
    }
}

/// The times of a cycle that concern its lateness; its thread wakes up `spin_ns` before its release.
fn evaluated(record: &CycleRecord, spin_ns: u64) -> EvaluatedCycle {
    let release = &record.release;
    EvaluatedCycle {
        count: record.totals.cycles,
        lateness: record.lateness,
        skipped: release.skipped,
        timing: Timing {
            early_ns: spin_ns,
            woke_early: record.rehearsed,
            wake_ns: release.start_ns - release.due_ns,
            compute_ns: record.handed_over_ns - release.start_ns,
            planned_ns: record
                .solve_until_ns
                .saturating_sub(record.release.start_ns),
            longest_gap_ns: record.longest_gap_ns,
            after_solve_ns: record.handed_over_ns - record.solve_end_ns,
        },
    }
}
