use iceoryx2::prelude::ZeroCopySend;

use crate::codes::{LateCause, Outcome};
use crate::limits::{CABLES_MAX, SECTIONS_MAX, TEXT_BYTES};
use crate::{Header, SolverSettings};

/// One bending section of the robot that the daemon controls.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.SectionDescription.v1")]
pub struct SectionDescription {
    /// Length of the backbone \[m\].
    pub length_m: f64,
    /// Distance of the cables from the backbone \[m\].
    pub cable_radius_m: f64,
    /// Angle of the first cable \[rad\].
    pub cable_offset_rad: f64,
    /// Largest bend \[rad\].
    pub bend_max_rad: f64,
    /// Largest rate of each bend-vector component \[rad/s\].
    pub rate_max_rad_s: f64,
    /// Radius of the body \[m\].
    pub body_radius_m: f64,
}

/// The robot that the daemon controls.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.RobotDescription.v1")]
pub struct RobotDescription {
    /// Sections used, 1 ..= [`SECTIONS_MAX`].
    pub sections: u32,
    /// Zero.
    pub reserved: u32,
    /// Fingerprint of all parameters, equal to that of the telemetry.
    pub fingerprint: u64,
    /// Largest speed of a cable \[m/s\].
    pub cable_speed_max_m_s: f64,
    /// How far a cable can be pulled or paid out from its length at the straight robot \[m\].
    pub cable_stroke_max_m: f64,
    /// The sections, base first.
    pub section: [SectionDescription; SECTIONS_MAX],
}

/// Percentiles of one latency \[ns\].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("cdcr.LatencySummary.v1")]
pub struct LatencySummary {
    /// Values counted.
    pub count: u64,
    /// Smallest.
    pub min_ns: u64,
    /// Median.
    pub p50_ns: u64,
    /// 99th percentile.
    pub p99_ns: u64,
    /// 99.9th percentile.
    pub p999_ns: u64,
    /// Largest.
    pub max_ns: u64,
}

/// Counts and latencies of the cycles in one stretch of time.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("cdcr.Statistics.v1")]
pub struct Statistics {
    /// Cycles that ran.
    pub cycles: u64,
    /// Cycles that started later than the late-start limit.
    pub late_starts: u64,
    /// Cycles whose command was handed over after the deadline.
    pub deadline_misses: u64,
    /// Releases that passed without a cycle.
    pub skipped_periods: u64,
    /// Most releases in a row that were missed or skipped.
    pub longest_streak: u64,
    /// Solves that the time budget ended.
    pub budget_hits: u64,
    /// Cycles that used the inputs of the cycle before again, because no gather came between.
    pub stale_inputs: u64,
    /// Cycles of a robot behind a driver that saw no newer measurement than the cycle before.
    pub stale_measurements: u64,
    /// Records, with their part of the statistics, and events that were lost inside the daemon because a queue was full.
    pub dropped_records: u64,
    /// Cycles that started late, missed their deadline or skipped periods, by their [`LateCause`]; index = code,
    /// so the first is 0. A punctual cycle whose skipped releases the late cycle before it took is not counted
    /// again.
    pub causes: [u64; LateCause::COUNT],
    /// Release to start.
    pub wake: LatencySummary,
    /// Taking in what clients and driver sent, shortly before the release.
    pub gather: LatencySummary,
    /// Start to hand-over of the command.
    pub compute: LatencySummary,
    /// The solver, part of compute.
    pub solve: LatencySummary,
    /// Release to hand-over of the command.
    pub response: LatencySummary,
    /// Hand-over of the command to its being in the readers' queues.
    pub publish: LatencySummary,
}

/// The latest snapshot of the daemon, for whoever joins late. Published ten times a second.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.Status.v4")]
pub struct Status {
    /// The daemon, sequence, time.
    pub header: Header,
    /// Name of the robot, as in the service names.
    pub robot_name: [u8; TEXT_BYTES],
    /// Version of the daemon.
    pub build: [u8; TEXT_BYTES],
    /// Process id.
    pub process_id: u32,
    /// [`codes::Mode`](crate::codes::Mode).
    pub mode: u32,
    /// [`codes::Reason`](crate::codes::Reason) why this mode.
    pub reason: u32,
    /// [`codes::realtime`](crate::codes::realtime) bits that are **missing**; 0: real time.
    pub realtime_missing: u32,
    /// [`codes::RobotLink`](crate::codes::RobotLink): simulated or driver.
    pub link: u32,
    /// Core that the real-time threads are pinned to; `u32::MAX`: none.
    pub core: u32,
    /// Origin of the time grid \[ns, `CLOCK_MONOTONIC`\]: cycle k is released at origin + k · period.
    pub origin_ns: u64,
    /// Period T \[ns\].
    pub period_ns: u64,
    /// Deadline D \[ns\] after the release.
    pub deadline_ns: u64,

    /// Cycles run since the start, whatever was reset.
    pub cycles: u64,
    /// Cycles that started later than the late-start limit.
    pub late_starts: u64,
    /// Cycles whose command was handed over after the deadline.
    pub deadline_misses: u64,
    /// Releases that passed before the cycle could start.
    pub skipped_periods: u64,
    /// Solves that the time budget ended.
    pub budget_hits: u64,
    /// Records, with their part of the statistics, and events that were lost inside the daemon because a queue was full.
    pub dropped_records: u64,
    /// Faults since the start.
    pub faults: u64,
    /// Cycles in which the clearance guard changed the command.
    pub clearance_guarded: u64,
    /// Obstacle updates that were refused, for whatever reason.
    pub obstacles_refused: u64,
    /// Input messages by their [`Outcome`], index = code; 0 counts the accepted ones.
    pub outcomes: [u64; Outcome::COUNT],

    /// When `since_reset` began \[ns, `CLOCK_MONOTONIC`\]: the start, or the last reset.
    pub statistics_since_ns: u64,
    /// Statistics since the start, or since a client reset them.
    pub since_reset: Statistics,
    /// Statistics of the last minute, in steps of ten seconds: 50 to 60 s.
    pub last_minute: Statistics,

    /// Holder of the reference lease; 0: nobody.
    pub lease_holder: u64,
    /// Last time of the buffered reference \[ns, `CLOCK_MONOTONIC`\]; 0: none.
    pub reference_end_ns: u64,
    /// Points of the buffered reference that are still ahead.
    pub reference_points: u32,
    /// Obstacles of the newest cycle.
    pub obstacle_count: u32,
    /// Smallest clearance in the newest cycle \[m\], as in [`Telemetry`](crate::Telemetry): infinite
    /// without obstacles.
    pub clearance_m: f64,

    /// The robot.
    pub robot: RobotDescription,
    /// The solver's settings.
    pub settings: SolverSettings,

    /// How often the leaky bucket of deadline misses became full and the robot went on: it is simulated, and the
    /// configuration sets no `cycle.miss_limit`.
    pub misses_tolerated: u64,

    /// Position of the tip in the newest cycle \[m\], as in [`Telemetry`](crate::Telemetry).
    pub tip_position_m: [f64; 3],
    /// Distance of tip and reference in the newest cycle \[m\]; NaN without a reference.
    pub position_error_m: f64,
    /// Following error of each section in the newest cycle \[rad\], as in [`Telemetry`](crate::Telemetry).
    pub following_error_rad: [f64; SECTIONS_MAX],
    /// Following error of each cable in the newest cycle \[m\], as in [`Telemetry`](crate::Telemetry).
    pub following_error_m: [f64; CABLES_MAX],
    /// Cycles in which the following error was above the warning.
    pub following_warnings: u64,
    /// [`codes::Interface`](crate::codes::Interface).
    pub interface: u32,
    /// Zero.
    pub reserved: u32,

    /// Smallest `safe_distance_m` that a client may ask for \[m\]: that of the configuration.
    pub safe_distance_min_m: f64,
    /// A sender of obstacles with a lifetime that is not heard for this long is silent \[ns\]; 0: nobody is watched.
    pub obstacle_source_timeout_ns: u64,
}

impl Default for Status {
    fn default() -> Self {
        Self {
            header: Header::default(),
            robot_name: [0; TEXT_BYTES],
            build: [0; TEXT_BYTES],
            process_id: 0,
            mode: 0,
            reason: 0,
            realtime_missing: 0,
            link: 0,
            core: 0,
            origin_ns: 0,
            period_ns: 0,
            deadline_ns: 0,
            cycles: 0,
            late_starts: 0,
            deadline_misses: 0,
            skipped_periods: 0,
            budget_hits: 0,
            dropped_records: 0,
            faults: 0,
            clearance_guarded: 0,
            obstacles_refused: 0,
            outcomes: [0; Outcome::COUNT],
            statistics_since_ns: 0,
            since_reset: Statistics::default(),
            last_minute: Statistics::default(),
            lease_holder: 0,
            reference_end_ns: 0,
            reference_points: 0,
            obstacle_count: 0,
            clearance_m: 0.0,
            robot: RobotDescription::default(),
            settings: SolverSettings::default(),
            misses_tolerated: 0,
            tip_position_m: [0.0; 3],
            position_error_m: 0.0,
            following_error_rad: [0.0; SECTIONS_MAX],
            following_error_m: [0.0; CABLES_MAX],
            following_warnings: 0,
            interface: 0,
            reserved: 0,
            safe_distance_min_m: 0.0,
            obstacle_source_timeout_ns: 0,
        }
    }
}
