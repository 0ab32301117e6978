use crate::codes::{LateCause, Outcome};
use crate::limits::{CABLES_MAX, SECTIONS_MAX, TEXT_BYTES};
use crate::message::message;
use crate::{Header, SolverSettings};

message! {
    /// One bending section of the robot that the daemon controls.
    pub struct SectionDescription "cdcr.SectionDescription.v1" {
        /// Length of the backbone \[m\].
        length_m: f64,
        /// Distance of the cables from the backbone \[m\].
        cable_radius_m: f64,
        /// Angle of the first cable \[rad\].
        cable_offset_rad: f64,
        /// Largest bend \[rad\].
        bend_max_rad: f64,
        /// Largest rate of each bend-vector component \[rad/s\].
        rate_max_rad_s: f64,
        /// Radius of the body \[m\].
        body_radius_m: f64,
    }

    /// The robot that the daemon controls.
    pub struct RobotDescription "cdcr.RobotDescription.v3" {
        /// Sections used, 1 ..= [`SECTIONS_MAX`].
        sections: u32 [length],
        /// Zero.
        reserved: u32 [reserved],
        /// Fingerprint of all parameters, equal to that of the telemetry.
        fingerprint: u64,
        /// Largest speed of a cable \[m/s\].
        cable_speed_max_m_s: f64,
        /// How far a cable can be pulled or paid out from its length at the straight robot \[m\].
        cable_stroke_max_m: f64,
        /// Largest commanded speed of the end of any section, seen from the base \[m/s\]; 0: no limit.
        tip_speed_max_m_s: f64,
        /// Overlap of two parts of the body, by their `body_radius_m`, that a command may lead to; as much as the body is thick: no check
        /// \[m\].
        self_overlap_max_m: f64,
        /// The sections, base first.
        section: [SectionDescription; SECTIONS_MAX] [used 1 sections],
    }

    /// Percentiles of one latency \[ns\].
    #[derive(Eq, serde::Serialize, serde::Deserialize)]
    pub struct LatencySummary "cdcr.LatencySummary.v1" {
        /// Values counted.
        count: u64,
        /// Smallest of the values.
        min_ns: u64,
        /// Median.
        p50_ns: u64,
        /// 99th percentile.
        p99_ns: u64,
        /// 99.9th percentile.
        p999_ns: u64,
        /// Largest of the values.
        max_ns: u64,
    }

    /// Counts and latencies of the cycles in one interval of time.
    #[derive(Eq)]
    pub struct Statistics "cdcr.Statistics.v5" {
        /// Cycles that ran.
        cycles: u64 [sum "cycles"],
        /// Cycles that started later than the late-start limit.
        late_starts: u64 [sum "late starts"],
        /// Cycles whose command was handed over after the deadline.
        deadline_misses: u64 [sum "deadline misses"],
        /// Releases that passed without a cycle.
        skipped_periods: u64 [sum "skipped periods"],
        /// Most releases in a row that were missed or skipped.
        longest_streak: u64 [max "longest streak"],
        /// Solves that the time budget ended.
        budget_hits: u64 [sum "budget hits"],
        /// Cycles that used the inputs of the cycle before again, because no gather came between.
        stale_inputs: u64 [sum "stale inputs"],
        /// Cycles that solved and whose command limits or guard changed.
        limited_cycles: u64 [sum "limited cycles"],
        /// Cycles that followed a reference.
        tracked_cycles: u64 [sum "tracked cycles"],
        /// Distances of tip and reference in them, as estimated, added up \[nm\].
        tip_error_sum_nm: u64 [sum "tip errors"],
        /// The largest of them \[nm\].
        tip_error_max_nm: u64 [max "largest tip error"],
        /// Cycles of a robot behind a driver that saw no newer measurement than the cycle before.
        stale_measurements: u64 [sum "stale measurements"],
        /// Tips that were not used: refused at their arrival, or measured beside bends or cables and implausible: they jumped, were frozen or were more than a ninth of the robot's length, or 0.1 m, from where the bends place them.
        tips_not_used: u64 [sum "measured tips not used"],
        /// Records, with their part of the statistics, and events that were lost inside the daemon because a queue was full.
        dropped_records: u64 [sum "dropped records"],
        /// Longest time between two clock reads in a cycle \[ns\], from its start to the end of the solve, work included. Far longer than
        /// a quantum of work: the processor stood still, though no deadline was missed.
        longest_gap_ns: u64 [max "longest gap"],
        /// Cycles that started late, missed their deadline or skipped periods, by their [`LateCause`]; index = code,
        /// so the first is 0. A punctual cycle whose skipped releases the late cycle before it took is not counted
        /// again.
        causes: [u64; LateCause::COUNT] [per LateCause 1],
        /// Release to start.
        wake: LatencySummary,
        /// Taking in what clients and driver sent, shortly before the release.
        gather: LatencySummary,
        /// Start to hand-over of the command.
        compute: LatencySummary,
        /// The solver, part of compute.
        solve: LatencySummary,
        /// Release to hand-over of the command.
        response: LatencySummary,
        /// Hand-over of the command to its being in the readers' queues.
        publish: LatencySummary,
    }

    /// The latest snapshot of the daemon for late joiners, published ten times a second.
    pub struct Status "cdcr.Status.v18" {
        /// The daemon, sequence, time.
        header: Header,
        /// Name of the robot, as in the service names.
        robot_name: [u8; TEXT_BYTES] [text],
        /// Version of the daemon.
        build: [u8; TEXT_BYTES] [text],
        /// Process id.
        process_id: u32,
        /// [`codes::Mode`](crate::codes::Mode).
        mode: u32 [code Mode],
        /// [`codes::Reason`](crate::codes::Reason) why this mode.
        reason: u32 [code Reason],
        /// [`codes::realtime`](crate::codes::realtime) bits that are **missing**; 0: real time.
        realtime_missing: u32 [bits realtime],
        /// [`codes::RobotLink`](crate::codes::RobotLink): simulated or driver.
        link: u32 [code RobotLink],
        /// Core that the real-time threads are pinned to; `u32::MAX`: none.
        core: u32 [or_none],
        /// Origin of the time grid \[ns, `CLOCK_MONOTONIC`\]: cycle k is released at origin + k · period.
        origin_ns: u64,
        /// Period T \[ns\].
        period_ns: u64,
        /// Deadline D \[ns\] after the release.
        deadline_ns: u64,

        /// Cycles run since the start, whatever was reset. The cycle numbers of answers and telemetry count the skipped
        /// releases, too: at `t`, they are at `(t - origin_ns) / period_ns`.
        cycles: u64,
        /// Cycles that started later than the late-start limit.
        late_starts: u64,
        /// Cycles whose command was handed over after the deadline.
        deadline_misses: u64,
        /// Releases that passed before the cycle could start.
        skipped_periods: u64,
        /// Solves that the time budget ended.
        budget_hits: u64,
        /// Records, with their part of the statistics, and events that were lost inside the daemon because a queue was full.
        dropped_records: u64,
        /// Faults since the start.
        faults: u64,
        /// Cycles in which the clearance guard changed the command.
        clearance_guarded: u64,
        /// Obstacle updates that were refused, for any reason.
        obstacles_refused: u64,
        /// Input messages by their [`Outcome`], index = code; 0 counts the accepted ones.
        outcomes: [u64; Outcome::COUNT] [per Outcome 0],

        /// When `since_reset` began \[ns, `CLOCK_MONOTONIC`\]: the start, or the last reset.
        statistics_since_ns: u64,
        /// Statistics since the start, or since a client reset them.
        since_reset: Statistics,
        /// Statistics of the last minute, in steps of ten seconds: 50 to 60 s.
        last_minute: Statistics,

        /// Holder of the reference lease; 0: nobody.
        lease_holder: u64,
        /// Last time of the buffered reference \[ns, `CLOCK_MONOTONIC`\]; 0: none.
        reference_end_ns: u64,
        /// Points of the buffered reference that are still ahead.
        reference_points: u32,
        /// Obstacles of the newest cycle.
        obstacle_count: u32,
        /// Smallest clearance in the newest cycle \[m\]: the smaller of that by the estimate, as in [`Telemetry`](crate::Telemetry), and that by the
        /// measured bends. Infinite without obstacles.
        clearance_m: f64,
        /// How far the tip may be from where the bends place it \[m\], as in [`Telemetry`](crate::Telemetry): in `clearance_m`
        /// the body is thicker by this distance.
        tip_margin_m: f64,

        /// The robot of the daemon's configuration.
        robot: RobotDescription,
        /// The solver's settings.
        settings: SolverSettings,

        /// How often the leaky bucket of deadline misses became full and the robot went on: it is simulated, and the
        /// configuration sets no `cycle.miss_limit`.
        misses_tolerated: u64,

        /// Position of the tip in the newest cycle \[m\], as in [`Telemetry`](crate::Telemetry).
        tip_position_m: [f64; 3],
        /// Distance of tip and reference in the newest cycle \[m\]; NaN without a reference.
        position_error_m: f64,
        /// Position of the reference in the newest cycle \[m\]; NaN without one.
        reference_position_m: [f64; 3],
        /// Distance of tip and reference when a sensor of the tip measured it last \[m\]: with the noise of the sensor and the error of the model. NaN without
        /// a reference or such a sensor.
        measured_error_m: f64,
        /// Following error of each section in the newest cycle \[rad\], as in [`Telemetry`](crate::Telemetry).
        following_error_rad: [f64; SECTIONS_MAX] [used 1 robot.sections],
        /// Following error of each cable in the newest cycle \[m\], as in [`Telemetry`](crate::Telemetry).
        following_error_m: [f64; CABLES_MAX] [used 3 robot.sections],
        /// Cycles in which the following error was above the warning.
        following_warnings: u64,
        /// [`codes::Interface`](crate::codes::Interface).
        interface: u32 [code Interface],
        /// [`codes::Reason`](crate::codes::Reason) why a reset is refused in the newest cycle, in the modes stopped and
        /// faulted; `Start`: it is not.
        reset_refused_by: u32 [code Reason],

        /// Smallest `safe_distance_m` that a client may ask for \[m\]: that of the configuration.
        safe_distance_min_m: f64,
        /// A sender of obstacles with a lifetime that is not heard for this long is silent \[ns\]; 0: no sender is watched.
        obstacle_source_timeout_ns: u64,
        /// The one of them that has been silent for the longest time, by its `header.sender_id`: its obstacles stay; 0: none is silent.
        silent_obstacle_source: u64,
        /// Begin of its silence \[ns, `CLOCK_MONOTONIC`\]: when its last update was taken, later by the time in which the daemon stood still.
        silent_since_ns: u64,
        /// [`SolverSettings`] has this `rate_weight` unless a client sets another: it depends on the robot.
        rate_weight_auto: f64 [unit "s²/rad²"],
        /// When the tip was measured last beside bends or cables \[ns, `CLOCK_MONOTONIC`\]; 0: it was not.
        tip_measured_ns: u64,
        /// Measurements of the tip that were refused since the start, for any reason.
        tips_refused: u64,
        /// Distance of the measured tip from where the newest refused first bends placed it \[m\], in whole millimetres; after them, from
        /// where the measured bends place it, where it is so far that a reset is refused; 0: nothing is refused for it.
        tip_contradiction_m: f64,
        /// [`Outcome`] of the newest of them; accepted: none was refused since a tip was accepted.
        tip_refused_by: u32 [code Outcome],
        /// A tip sensor beside the driver is configured (`link.tip_sensor`).
        has_tip_sensor: u32 [yes],
        /// A clearance below this is a fault \[m\] (`safety.clearance_fault_m`).
        clearance_fault_m: f64,
        /// [`codes::TipCause`](crate::codes::TipCause) why the newest tip measured beside bends or cables is not used, as in [`Telemetry`](crate::Telemetry).
        tip_cause: u32 [code TipCause],
        /// The driver has measured only the tip: also a tip sensor beside it for which `link.tip_sensor` is not set.
        driver_measures_tip_only: u32 [yes],
    }
}

/// Without values all are zero.
#[cfg(feature = "histogram")]
impl From<&hdrhistogram::Histogram<u64>> for LatencySummary {
    fn from(of: &hdrhistogram::Histogram<u64>) -> Self {
        Self {
            count: of.len(),
            min_ns: if of.is_empty() { 0 } else { of.min() },
            p50_ns: of.value_at_quantile(0.5),
            p99_ns: of.value_at_quantile(0.99),
            p999_ns: of.value_at_quantile(0.999),
            max_ns: of.max(),
        }
    }
}
