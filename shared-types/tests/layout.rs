//! Pins the layout of every message. A failing line means that the wire contract changed: then the
//! version in the type's name has to change with it.

use std::mem::{align_of, offset_of, size_of};

use cdcr_shared_types::{
    Command, Header, Incident, InputEvent, LatencySummary, Measurement, Obstacle, ObstacleUpdate,
    ReferenceChunk, ReferencePoint, ReferenceSample, Request, Response, RobotDescription,
    SchedulingReport, SectionDescription, SolverReport, SolverSettings, Statistics, Status,
    Telemetry,
};

#[test]
fn sizes_are_pinned() {
    let sizes = [
        ("Header", size_of::<Header>(), 24),
        ("ReferencePoint", size_of::<ReferencePoint>(), 72),
        ("ReferenceChunk", size_of::<ReferenceChunk>(), 9256),
        ("Obstacle", size_of::<Obstacle>(), 104),
        ("ObstacleUpdate", size_of::<ObstacleUpdate>(), 6688),
        ("Measurement", size_of::<Measurement>(), 344),
        ("Command", size_of::<Command>(), 552),
        ("SolverSettings", size_of::<SolverSettings>(), 168),
        ("Request", size_of::<Request>(), 200),
        ("Response", size_of::<Response>(), 64),
        ("InputEvent", size_of::<InputEvent>(), 40),
        ("ReferenceSample", size_of::<ReferenceSample>(), 64),
        ("SolverReport", size_of::<SolverReport>(), 72),
        ("Telemetry", size_of::<Telemetry>(), 13856),
        ("LatencySummary", size_of::<LatencySummary>(), 48),
        ("SectionDescription", size_of::<SectionDescription>(), 48),
        ("RobotDescription", size_of::<RobotDescription>(), 320),
        ("Statistics", size_of::<Statistics>(), 408),
        ("Status", size_of::<Status>(), 2048),
        ("SchedulingReport", size_of::<SchedulingReport>(), 40),
        ("Incident", size_of::<Incident>(), 13896),
    ];
    let changed: Vec<_> = sizes.iter().filter(|(_, is, was)| is != was).collect();
    assert!(changed.is_empty(), "(type, is, was): {changed:?}");
    assert_eq!(align_of::<Telemetry>(), 8);
}

#[test]
#[allow(clippy::too_many_lines, reason = "a table")]
fn offsets_are_pinned() {
    let offsets = [
        (
            "ReferencePoint.position_m",
            offset_of!(ReferencePoint, position_m),
            8,
        ),
        (
            "ReferencePoint.orientation",
            offset_of!(ReferencePoint, orientation),
            32,
        ),
        (
            "ReferencePoint.orientation_kind",
            offset_of!(ReferencePoint, orientation_kind),
            64,
        ),
        ("ReferenceChunk.mode", offset_of!(ReferenceChunk, mode), 24),
        (
            "ReferenceChunk.count",
            offset_of!(ReferenceChunk, count),
            32,
        ),
        (
            "ReferenceChunk.points",
            offset_of!(ReferenceChunk, points),
            40,
        ),
        ("Obstacle.start_m", offset_of!(Obstacle, start_m), 8),
        ("Obstacle.radius_m", offset_of!(Obstacle, radius_m), 56),
        (
            "Obstacle.lifetime_ns",
            offset_of!(Obstacle, lifetime_ns),
            96,
        ),
        (
            "ObstacleUpdate.obstacles",
            offset_of!(ObstacleUpdate, obstacles),
            32,
        ),
        ("Measurement.kind", offset_of!(Measurement, kind), 32),
        (
            "Measurement.bend_rad",
            offset_of!(Measurement, bend_rad),
            48,
        ),
        (
            "Measurement.tip_position_m",
            offset_of!(Measurement, tip_position_m),
            144,
        ),
        (
            "Measurement.cable_length_m",
            offset_of!(Measurement, cable_length_m),
            200,
        ),
        ("Command.cycle", offset_of!(Command, cycle), 24),
        (
            "Command.bend_rate_rad_s",
            offset_of!(Command, bend_rate_rad_s),
            72,
        ),
        (
            "Command.cable_length_m",
            offset_of!(Command, cable_length_m),
            264,
        ),
        (
            "SolverSettings.inertia",
            offset_of!(SolverSettings, inertia),
            40,
        ),
        ("SolverSettings.seed", offset_of!(SolverSettings, seed), 160),
        ("Request.kind", offset_of!(Request, kind), 24),
        ("Request.settings", offset_of!(Request, settings), 32),
        ("Response.outcome", offset_of!(Response, outcome), 40),
        ("InputEvent.kind", offset_of!(InputEvent, kind), 24),
        (
            "Telemetry.release_ns",
            offset_of!(Telemetry, release_ns),
            32,
        ),
        ("Telemetry.mode", offset_of!(Telemetry, mode), 160),
        ("Telemetry.events", offset_of!(Telemetry, events), 192),
        (
            "Telemetry.measurement",
            offset_of!(Telemetry, measurement),
            1152,
        ),
        ("Telemetry.bend_rad", offset_of!(Telemetry, bend_rad), 1496),
        ("Telemetry.settings", offset_of!(Telemetry, settings), 1688),
        (
            "Telemetry.obstacles",
            offset_of!(Telemetry, obstacles),
            2272,
        ),
        (
            "Telemetry.clearance_m",
            offset_of!(Telemetry, clearance_m),
            12976,
        ),
        ("Status.clearance_m", offset_of!(Status, clearance_m), 1288),
        (
            "Telemetry.warm_plan",
            offset_of!(Telemetry, warm_plan),
            8928,
        ),
        ("Telemetry.plan", offset_of!(Telemetry, plan), 10848),
        ("Telemetry.report", offset_of!(Telemetry, report), 12768),
        ("Telemetry.command", offset_of!(Telemetry, command), 12984),
        ("Status.mode", offset_of!(Status, mode), 124),
        ("Status.cycles", offset_of!(Status, cycles), 168),
        ("Status.outcomes", offset_of!(Status, outcomes), 240),
        ("Status.robot", offset_of!(Status, robot), 1296),
        ("Status.settings", offset_of!(Status, settings), 1616),
        (
            "Status.misses_tolerated",
            offset_of!(Status, misses_tolerated),
            1784,
        ),
        (
            "Status.safe_distance_min_m",
            offset_of!(Status, safe_distance_min_m),
            2032,
        ),
        (
            "Status.statistics_since_ns",
            offset_of!(Status, statistics_since_ns),
            440,
        ),
        ("Status.since_reset", offset_of!(Status, since_reset), 448),
        ("Status.last_minute", offset_of!(Status, last_minute), 856),
        ("Statistics.causes", offset_of!(Statistics, causes), 72),
        ("Statistics.wake", offset_of!(Statistics, wake), 120),
        ("Statistics.publish", offset_of!(Statistics, publish), 360),
        (
            "Telemetry.scheduling",
            offset_of!(Telemetry, scheduling),
            120,
        ),
        (
            "SchedulingReport.late_cause",
            offset_of!(SchedulingReport, late_cause),
            32,
        ),
        (
            "Telemetry.measurement_state",
            offset_of!(Telemetry, measurement_state),
            2252,
        ),
        ("Incident.steal_ns", offset_of!(Incident, steal_ns), 24),
        ("Incident.telemetry", offset_of!(Incident, telemetry), 40),
    ];
    let moved: Vec<_> = offsets.iter().filter(|(_, is, was)| is != was).collect();
    assert!(moved.is_empty(), "(field, is, was): {moved:?}");
}
