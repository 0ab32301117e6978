use super::*;
use cdcr_shared_types::codes::{Interface, realtime};
use cdcr_shared_types::{RobotDescription, SectionDescription};

#[test]
fn the_table_shows_the_essential_values() {
    let mut status = Status {
        mode: Mode::Tracking.code(),
        realtime_missing: realtime::FIFO,
        core: u32::MAX,
        cycles: 1234,
        origin_ns: 1_000_000_000,
        period_ns: 5_000_000,
        faults: 5,
        obstacle_count: 2,
        clearance_m: 0.0105,
        tip_margin_m: 0.0452,
        clearance_guarded: 17,
        misses_tolerated: 3,
        statistics_since_ns: 1_000_000_000,
        interface: Interface::Position.code(),
        tip_position_m: [0.1, -0.02, 0.3],
        position_error_m: 0.0015,
        reference_position_m: [0.1015, -0.02, 0.3],
        measured_error_m: 0.0018,
        following_error_rad: [0.01, 0.02, 9.0, 0.0, 0.0, 0.0],
        following_warnings: 8,
        ..Status::default()
    };
    status.robot.sections = 2;
    status.header.sent_ns = 7_503_000_000;
    status.outcomes[Outcome::NoLease.code() as usize] = 3;
    status.since_reset.wake.count = 1;
    status.since_reset.wake.p99_ns = 42_500;
    status.since_reset.solve.count = 7;
    status.since_reset.limited_cycles = 1;
    status.since_reset.tracked_cycles = 4;
    status.since_reset.tip_error_sum_nm = 6_000_000;
    status.since_reset.tip_error_max_nm = 2_500_000;
    status.since_reset.solve.p50_ns = 4_000_000;
    status.last_minute.deadline_misses = 12;
    status.since_reset.causes[LateCause::Stall.code() as usize] = 4;
    let table = table(&status, None, 124_900_000_000).expect("formatted");
    for expected in [
        "mode        tracking (started), 5 faults in 1234 cycles\n",
        "\ncycle       1300 now, as answers and telemetry number them",
        "misses      the leaky bucket was full 3 times; a real robot would have been stopped",
        "tip         100.0, -20.0, 300.0 mm, 1.500 mm from its reference, 101.5, -20.0, 300.0 mm; measured 1.800 mm from it\n",
        "following   position interface, error 0.0200 rad, 0.00 mm of cable (8 cycles above the warning)\n",
        "SCHED_FIFO is missing: grant rtprio 90",
        "the last 2m 3s",
        "  wake-up                   0.0       42.5        0.0             -          -          -\n",
        "  compute                     -          -          -             -          -          -\n",
        "cycles that solved                    7 of the cycles                     0 of the cycles\n",
        "solve                    4000.0        0.0        0.0             -          -          -\n",
        &format!("deadline misses{:>38}{:>36}\n", 0, 12),
        &format!(
            "limited cycles (of solved){:>27}{:>36}\n",
            "1 (14.3 %)", "0 (0.0 %)"
        ),
        &format!("tip error mean, max mm{:>31}{:>36}\n", "1.500, 2.500", "-"),
        &format!("  by stall of the processor{:>26}{:>36}\n", 4, 0),
        "pinned to no core",
        "obstacles   2, smallest clearance 10.50 mm as estimated less the tip margin of 45.2 mm, safe",
        "the guard changed 17 commands",
        "3  the sender does not hold the reference lease",
        "budget all the remaining period\n",
    ] {
        assert!(table.contains(expected), "{expected} in\n{table}");
    }
    assert!(!table.contains("page fault"), "{table}");
    assert!(!table.contains("\nreset "), "{table}");
    status.misses_tolerated = 0;
    status.reset_refused_by = Reason::DeadlineMisses.code();
    let table = super::table(&status, None, 0).expect("formatted");
    assert!(!table.contains("leaky bucket"), "{table}");
    let line = "\nreset       is refused now: too many deadline misses (cycle.miss_limit)\n";
    assert!(table.contains(line), "{table}");
    assert!(!table.contains("\nremedy "), "{table}");
    assert!(object(&status)["remedy"].is_null());
    // A margin alone makes the clearance too small.
    (status.mode, status.clearance_m) = (Mode::Faulted.code(), -0.04);
    let share = "counts the tip margin of 45.2 mm";
    for (reason, is_named) in [
        (Reason::ClearanceBroken, true),
        (Reason::LimitBroken, false),
    ] {
        status.reason = reason.code();
        let table = super::table(&status, None, 0).expect("formatted");
        assert_eq!(table.contains(share), is_named, "{table}");
    }
    // The fault is below the configured limit.
    status.reason = Reason::ClearanceBroken.code();
    for (limit_m, clearance_m, is_named) in [
        (0.01, 0.005, true),
        (0.01, 0.015, false),
        (-0.01, -0.005, false),
    ] {
        (status.clearance_fault_m, status.clearance_m) = (limit_m, clearance_m);
        let table = super::table(&status, None, 0).expect("formatted");
        assert_eq!(table.contains(share), is_named, "{table}");
    }
}

#[test]
fn a_silent_source_of_obstacles_is_shown_with_the_time_since() {
    let mut status = Status {
        obstacle_count: 1,
        ..Status::default()
    };
    let shown = |status: &Status| table(status, None, 12_500_000_000).expect("formatted");
    assert!(!shown(&status).contains("silent"), "{}", shown(&status));
    status.silent_obstacle_source = 0xab;
    status.silent_since_ns = 10_000_000_000;
    let line = "\n            a source of them, client 00000000000000ab, has been silent for 2.5 s";
    assert!(shown(&status).contains(line), "{}", shown(&status));
    // After cdcrctl obstacle remove the robot still holds for this reason, which is over.
    (status.mode, status.reason) = (Mode::Holding.code(), Reason::ObstacleSourceSilent.code());
    let over =
        "(obstacles.source_timeout_ms); not any more: feed the reference, or go home, again)";
    assert!(!shown(&status).contains(over), "{}", shown(&status));
    status.silent_obstacle_source = 0;
    assert!(shown(&status).contains(over), "{}", shown(&status));
}

#[test]
fn a_daemon_that_waits_for_its_driver_shows_what_it_refused() {
    let mut status = Status {
        mode: Mode::Starting.code(),
        ..Status::default()
    };
    let tip = "tip         not known yet: control has not begun\n";
    let shown = table(&status, None, 0).expect("formatted");
    assert!(shown.contains(tip), "{shown}");
    let remedy = |status: &Status| object(status)["remedy"].to_string();
    assert!(
        remedy(&status).contains("check that the driver runs"),
        "{}",
        remedy(&status)
    );
    status.outcomes[Outcome::Accepted.code() as usize] = 900;
    status.outcomes[Outcome::NoLease.code() as usize] = 901;
    status.outcomes[Outcome::InThePast.code() as usize] = 2;
    status.outcomes[Outcome::CableMean.code() as usize] = 542;
    let table = table(&status, None, 0).expect("formatted");
    for part in [
        "\nmode        starting, 0 faults",
        "\nremedy ",
        "; 542 messages refused: the mean length",
        "from the first section on",
    ] {
        assert!(table.contains(part), "{part} in\n{table}");
    }
}

#[test]
fn a_pose_that_a_reset_has_to_accept_is_shown_with_section_and_distance() {
    let mut status = Status {
        mode: Mode::Stopped.code(),
        reset_refused_by: Reason::PoseDiffers.code(),
        ..Status::default()
    };
    let line = |status: &Status| {
        let table = table(status, None, 0).expect("formatted");
        let line = table.lines().find(|line| line.starts_with("reset "));
        line.expect("a line").to_owned()
    };
    let cause = Reason::PoseDiffers.text();
    let start = format!("reset       is refused now: {cause}");
    // The daemon before this one left it in doubt.
    assert_eq!(line(&status), start);
    status.following_error_rad[..2].copy_from_slice(&[0.3, 0.834]);
    assert_eq!(line(&status), format!("{start}: section 2 by 0.83 rad"));
    (status.reset_refused_by, status.tip_contradiction_m) = (Reason::TipElsewhere.code(), 0.1234);
    let cause = Reason::TipElsewhere.text();
    let start = format!("reset       is refused now: {cause}");
    assert_eq!(line(&status), format!("{start}: 123 mm away"));
}

#[test]
fn an_error_of_a_sections_three_cables_is_named_where_a_driver_refuses_it() {
    let mut status = Status {
        robot: RobotDescription {
            sections: 2,
            cable_speed_max_m_s: 0.5,
            cable_stroke_max_m: 0.25,
            ..RobotDescription::default()
        },
        ..Status::default()
    };
    status.robot.section[..2].fill(SectionDescription {
        length_m: 0.3,
        cable_radius_m: 0.0125,
        bend_max_rad: 2.8,
        rate_max_rad_s: 2.0,
        ..SectionDescription::default()
    });
    // Strokes of a bend cancel, and 1.2 mm are within the tolerance of the second section.
    status.following_error_m[..6].copy_from_slice(&[3e-3, -2e-3, 0.7e-3, 1.2e-3, 1.2e-3, 1.2e-3]);
    let named = |status: &Status| {
        let table = table(status, None, 0).expect("formatted");
        let mut lines = table.lines();
        lines
            .find(|line| line.contains("the three cables of section"))
            .map(str::to_owned)
    };
    assert_eq!(named(&status), None);
    status.following_error_m[3..6].fill(-2e-3);
    let line = named(&status).expect("a line");
    assert!(
        line.contains("section 2 are in the mean measured 2.0 mm shorter"),
        "{line}"
    );
}

#[test]
fn a_fault_is_shown_with_its_remedy() {
    let status = Status {
        mode: Mode::Faulted.code(),
        reason: Reason::MeasurementFrozen.code(),
        reset_refused_by: Reason::MeasurementLost.code(),
        ..Status::default()
    };
    let table = table(&status, None, 0).expect("formatted");
    let mut lines = table.lines().skip_while(|line| !line.starts_with("mode "));
    let starts = [
        "mode        faulted (",
        "remedy      Check that the driver still reads the sensors",
        "reset       is refused now: the measurement is lost",
        "            Check that the driver runs",
    ];
    for start in starts {
        let line = lines.next().expect("a line");
        assert!(line.starts_with(start), "{start} in\n{table}");
    }
    let remedy = object(&status)["remedy"].to_string();
    assert!(remedy.contains("still reads the sensors"), "{remedy}");
}

#[test]
fn a_tip_that_is_not_in_use_is_named_with_its_cause() {
    let mut status = Status {
        mode: Mode::Holding.code(),
        tip_measured_ns: 1,
        ..Status::default()
    };
    // The way out only where the tip is not used again by itself.
    for (cause, texts, way_out) in [
        (TipCause::None, "mm from it\nfollowing", false),
        (
            TipCause::Jumps,
            "is not in use: it moved faster than the robot can\n",
            false,
        ),
        (
            TipCause::Jumped,
            "it moved faster than the robot can many times in a row\n",
            true,
        ),
        (
            TipCause::Frozen,
            "; the measured tip is not in use: it had the same bits while the robot moved\n",
            true,
        ),
        (TipCause::WasFar, "by itself after 0.32 to 20 s", false),
    ] {
        status.tip_cause = cause.code();
        let table = table(&status, None, 0).expect("formatted");
        assert!(table.contains(texts), "{table}");
        let remedy =
            "only after cdcrctl stop and cdcrctl reset, or when its program is started again\n";
        assert_eq!(table.contains(remedy), way_out, "{table}");
    }
}

#[test]
fn a_tip_sensor_that_is_taken_for_the_driver_is_named() {
    for (tip_only, refused, is_declared, is_named) in [
        (1, 3, 0, true),
        (1, 0, 0, false),
        (0, 3, 0, false),
        (1, 3, 1, false),
    ] {
        let mut status = Status {
            driver_measures_tip_only: tip_only,
            has_tip_sensor: is_declared,
            ..Status::default()
        };
        status.outcomes[Outcome::OtherDriver.code() as usize] = refused;
        let table = table(&status, None, 0).expect("formatted");
        assert_eq!(
            table.contains("driver      measures only the tip"),
            is_named,
            "{table}"
        );
    }
}
