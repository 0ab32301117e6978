use cdcr_shared_types::codes::TipCause;

use super::measured::FRESH_NS;
use super::*;

fn record(mode: Mode, state: ReferenceState, release_ns: u64, error_m: f64) -> Telemetry {
    let mut record = Telemetry {
        mode: mode.code(),
        release_ns,
        position_error_m: error_m,
        ..Telemetry::default()
    };
    record.reference.state = state.code();
    record
}

#[test]
fn only_cycles_that_track_the_reference_count() {
    use ReferenceState::{Before, Ended, Inside};
    let mut error = TipError {
        start_ns: 100,
        ..TipError::default()
    };
    for (mode, state, release_ns, error_m) in [
        (Mode::Tracking, Inside, 99, 1.0),
        (Mode::Tracking, Before, 100, 1.0),
        (Mode::Tracking, Inside, 100, 0.003),
        (Mode::Tracking, Inside, 105, 0.002),
        (Mode::Holding, Inside, 110, 1.0),
        (Mode::Tracking, Ended, 115, f64::NAN),
        (Mode::Tracking, Inside, 120, 0.001),
    ] {
        let mut record = record(mode, state, release_ns, error_m);
        record.guard_flags = guard::SELF_CONTACT * u32::from(release_ns <= 100)
            + guard::CLEARANCE * u32::from(error_m == 0.003);
        error.take(&record);
    }
    assert_eq!(
        (error.cycles, error.max_m, error.final_m),
        (3, 0.003, 0.001)
    );
    assert_eq!((error.limited_cycles, error.self_contact_cycles), (1, 3));
    assert!(error.max_beside_obstacle);
    // Larger, where no obstacle is.
    error.take(&record(Mode::Tracking, Inside, 125, 0.004));
    assert!(!error.max_beside_obstacle);
    assert!((error.sum_m - 0.01).abs() < 1e-15);
}

#[test]
fn what_is_measured_is_held_against_where_the_reference_was_then() {
    let mut error = TipError::default();
    for (release_ns, x_m, tip_ns) in [(10, 1.0, 5), (20, 2.0, 15), (30, 3.0, 15), (40, 4.0, 39)] {
        let mut record = record(Mode::Tracking, ReferenceState::Inside, release_ns, 0.0);
        record.reference.position_m[0] = x_m;
        record.tip_measured_ns = tip_ns;
        // An offset of 0.25: one measurement is from before the first release, and one is repeated.
        record.tip_measured_m = [tip_ns as f64 / 10.0, 0.25, 0.0];
        error.take(&record);
    }
    let Sums {
        count,
        sum_m,
        max_m,
    } = error.measured.sums();
    assert_eq!(count, 2);
    assert!((max_m - 0.25).abs() < 1e-12 && (sum_m - 0.5).abs() < 1e-12);
    assert_eq!(
        error.live().as_deref(),
        Some("error 0.000, measured 250.000 mm")
    );
    // The estimated error, 0, is not the only criterion.
    assert!(error.print(Some(0.251)).is_ok());
    let text = error.print(Some(0.249)).expect_err("larger").to_string();
    assert!(
        text.contains("250.000 mm from its reference as measured"),
        "{text}"
    );
}

#[test]
fn an_outlier_is_named_with_its_place_unless_an_obstacle_kept_the_tip_away() {
    // The safe distance is 5 mm, and the robot 0.5 m long.
    let (none, near, far) = ((f64::INFINITY, 0), (0.014, 0), (0.016, 0));
    let guarded = (0.016, guard::CLEARANCE);
    let limited = (0.044, guard::RATE);
    for (error_m, obstacles, is_followed) in [
        (0.051, [none; 4], false),
        (0.049, [none; 4], true),
        (0.051, [near; 4], true),
        (0.051, [guarded; 4], true),
        // It is not in the way.
        (0.051, [far; 4], false),
        (0.051, [limited; 4], false),
        // It expires, and the tip is still away.
        (0.051, [none, near, none, none], true),
        // Since then, the tip has been at its reference.
        (0.051, [near, none, none, none], false),
    ] {
        let mut error = TipError {
            start_ns: 1_000_000_000,
            ..TipError::default()
        };
        let errors_m = [(1, 0.3), (2, 0.001), (3, error_m), (4, 0.001)];
        for ((release_s, error_m), (clearance_m, guard_flags)) in
            errors_m.into_iter().zip(obstacles)
        {
            let release_ns = release_s * 1_000_000_000;
            let inside = ReferenceState::Inside;
            let mut record = record(Mode::Tracking, inside, release_ns, error_m);
            record.obstacle_count = u32::from(clearance_m.is_finite());
            (record.clearance_m, record.guard_flags) = (clearance_m, guard_flags);
            record.settings.safe_distance_m = 0.005;
            (record.robot.sections, record.robot.section[0].length_m) = (1, 0.5);
            record.reference.position_m[0] = release_s as f64;
            error.take(&record);
        }
        let checked = error.print(None);
        assert_eq!(checked.is_ok(), is_followed, "{error_m} {obstacles:?}");
        if let Err(error) = checked {
            let text = error.to_string();
            assert!(
                text.contains("51.000 mm from its reference at 2.00 s, (3.0000,"),
                "{text}"
            );
        }
    }
}

#[test]
fn a_sensor_that_fell_silent_does_not_decide_about_the_end() {
    // Without an interval, of a fast sensor, and of one of 5 Hz.
    const SLOW_NS: u64 = 200_000_000;
    for (before_ns, silent_ns, is_followed) in [
        (0, FRESH_NS - 1, false),
        (0, FRESH_NS, true),
        (5_000_000, FRESH_NS, true),
        (SLOW_NS, 2 * SLOW_NS - 1, false),
        (SLOW_NS, 2 * SLOW_NS, true),
    ] {
        let mut error = TipError::default();
        let measured_ns = 15 + before_ns;
        let releases = [(10, 0), (20, 15), (20 + before_ns, measured_ns)];
        for (release_ns, tip_ns) in releases
            .into_iter()
            .chain([(measured_ns + silent_ns, measured_ns)])
        {
            let mut record = record(Mode::Tracking, ReferenceState::Inside, release_ns, 0.0);
            record.tip_measured_ns = tip_ns;
            record.tip_measured_m[0] = 0.3;
            error.take(&record);
        }
        assert_eq!(error.print(None).is_ok(), is_followed, "{silent_ns}");
        assert_eq!(error.live().unwrap().contains("measured"), !is_followed);
    }
}

#[test]
fn an_approach_is_no_error() {
    let mut error = TipError {
        fed_ns: 1,
        start_ns: 3,
        ..TipError::default()
    };
    for (state, release_ns, error_m) in [
        (ReferenceState::Inside, 0, 0.2),
        // Most of the approach may end before the reference begins.
        (ReferenceState::Before, 1, 0.1),
    ] {
        let mut record = record(Mode::Tracking, state, release_ns, error_m);
        record.approach.duration_ns = 7;
        record.period_ns = 5_000_000;
        error.take(&record);
    }
    assert_eq!(
        (error.cycles, error.approach_cycles, error.approach_max_m),
        (0, 1, 0.1)
    );
    assert!(error.print(Some(0.2)).is_err(), "nothing was tracked yet");
}

#[test]
fn a_limit_is_for_the_largest_error_and_for_something_that_was_tracked() {
    let mut error = TipError::default();
    assert!(error.print(None).is_ok());
    assert_eq!(error.live(), None);
    // Without a limit, the end counts for a tip that had not arrived before.
    for (error_m, is_followed) in [(0.5, false), (0.021, false), (0.019, true)] {
        let mut error = TipError::default();
        error.take(&record(Mode::Tracking, ReferenceState::Inside, 1, 0.5));
        error.take(&record(Mode::Tracking, ReferenceState::Inside, 2, error_m));
        assert_eq!(error.print(None).is_ok(), is_followed, "{error_m}");
    }
    assert!(error.print(Some(1.0)).is_err());
    error.take(&record(Mode::Tracking, ReferenceState::Inside, 1, 0.003));
    error.take(&record(Mode::Tracking, ReferenceState::Inside, 2, 0.001));
    assert!(error.print(Some(0.003)).is_ok());
    let text = error.print(Some(0.0029)).expect_err("larger").to_string();
    assert!(
        text.contains("3.000 mm") && text.contains("2.900 mm"),
        "{text}"
    );
}

#[test]
fn an_error_is_by_the_model_where_the_measured_tip_was_not_in_use() {
    let mut error = TipError::default();
    // The reference jumps where it is not tracked; the measured tip stays 0.25 m beside it.
    for (mode, release_ns, x_m, tip_ns, tip_x_m) in [
        (Mode::Tracking, 10, 1.0, 0, 0.0),
        (Mode::Tracking, 20, 1.0, 15, 1.25),
        (Mode::Holding, 30, f64::NAN, 25, 1.25),
        (Mode::Tracking, 40, 7.0, 35, 1.25),
        (Mode::Tracking, 50, 7.0, 45, 7.25),
    ] {
        let mut record = record(mode, ReferenceState::Inside, release_ns, 0.001);
        record.reference.position_m[0] = x_m;
        (record.tip_measured_ns, record.tip_measured_m[0]) = (tip_ns, tip_x_m);
        if release_ns >= 50 {
            record.tip_cause = TipCause::WasFar.code();
        }
        error.take(&record);
    }
    assert_eq!(error.unused_percent(), Some(25.0));
    assert_eq!(error.measured_mean_max_m(), Some(([0.25, 0.25], 2)));
    assert_eq!(error.measured_now_m(), Some(0.25));
    assert_eq!(TipError::default().unused_percent(), None);
}

#[test]
fn a_sensor_that_falls_silent_on_the_way_is_named_and_its_whole_silence_counts() {
    const STEP_NS: u64 = 5_000_000;
    // Measured for 100 cycles; then a pause that is not a silence, and again; then silence to the end, or to the last cycle.
    for (is_silent_at_the_end, notes) in [
        (
            true,
            &[
                "up to 2.0 s",
                "also the final one (tip sensor silent for 2.0 s)",
            ][..],
        ),
        (
            false,
            &[
                "up to 2.0 s: the errors of that time are by the model",
                "check the tip sensor",
            ],
        ),
    ] {
        let mut error = TipError::default();
        let mut tip_ns = 0;
        for cycle in 1..=600 {
            let release_ns = cycle * STEP_NS;
            let is_measured = cycle <= 100 || (150..=200).contains(&cycle);
            if is_measured || cycle == 600 && !is_silent_at_the_end {
                tip_ns = release_ns - 1;
            }
            let mut record = record(Mode::Tracking, ReferenceState::Inside, release_ns, 0.001);
            record.tip_measured_ns = tip_ns;
            error.take(&record);
        }
        let cycles = 399 + u64::from(is_silent_at_the_end);
        assert!((cycles - 1..=cycles + 1).contains(&error.unused_cycles));
        let note = error.unmeasured_note().expect("it was silent");
        assert!(notes.iter().all(|part| note.contains(part)), "{note}");
        assert_eq!(note.contains("final"), is_silent_at_the_end, "{note}");
    }
    // One that measures all the time, slowly, is not silent; nor is one that is not there.
    for interval in [180, u64::MAX] {
        let mut error = TipError::default();
        for cycle in 1..=600 {
            let release_ns = cycle * STEP_NS;
            let mut record = record(Mode::Tracking, ReferenceState::Inside, release_ns, 0.001);
            record.tip_measured_ns = cycle / interval * interval * STEP_NS;
            error.take(&record);
        }
        assert_eq!(error.unused_percent(), None);
        assert_eq!(error.unmeasured_note(), None);
    }
}

#[test]
fn a_limit_that_the_model_decided_is_named_where_it_is_broken() {
    let failed = |error: &TipError| error.print(Some(0.0005)).expect_err("larger").to_string();
    let mut error = TipError::default();
    for cycle in 1..=400 {
        let release_ns = 5_000_000 * cycle;
        let mut record = record(Mode::Tracking, ReferenceState::Inside, release_ns, 0.001);
        record.tip_measured_ns = 5_000_000 * cycle.min(100);
        error.take(&record);
    }
    let text = failed(&error);
    assert!(
        text.contains("0.500 mm; it was decided by the model for 75."),
        "{text}"
    );
    let mut error = TipError {
        unheard: Some("no tip measurement accepted yet; none arrived".to_owned()),
        ..TipError::default()
    };
    error.take(&record(Mode::Tracking, ReferenceState::Inside, 1, 0.001));
    let text = failed(&error);
    assert!(
        text.ends_with("; it was decided by the model, because no measured tip was in use"),
        "{text}"
    );
    let note = error.unmeasured_note().expect("a note");
    assert_eq!(
        note,
        "all errors are by the model: no tip measurement accepted yet; none arrived"
    );
}

#[test]
fn stray_tips_are_counted_beside_the_measured_error_and_those_of_a_wrong_sensor_in_it() {
    use TipCause::{Far, Jumped, Jumps, None};
    const STEP_NS: u64 = 30_000_000;
    let run = |causes: &[TipCause]| {
        let mut error = TipError::default();
        for (k, cause) in (1..).zip(causes) {
            let mut record = record(Mode::Tracking, ReferenceState::Inside, k * STEP_NS, 0.001);
            record.measurement_jump_limit = 3;
            record.tip_measured_ns = k * STEP_NS - 1;
            record.tip_cause = cause.code();
            record.tip_measured_m[0] = if *cause == None { 0.002 } else { 0.3 };
            error.take(&record);
        }
        error
    };
    let error = run(&[None, None, Jumps, None, Far, Jumps, None, Jumps]);
    assert_eq!((error.strays(), error.unused_percent()), (4, Option::None));
    assert_eq!(error.measured_mean_max_m(), Some(([0.002; 2], 3)));
    assert_eq!(
        error.live().as_deref(),
        Some("error 1.000, measured 2.000 mm")
    );
    assert_eq!(error.final_by_model, Option::None);
    assert!(error.print(Some(0.003)).is_ok() && error.print(Option::None).is_ok());
    let text = error.strays_text().expect("four");
    assert_eq!(text, "4 stray measurements of the tip refused and left out");
    // As many in a row as the daemon takes for a wrong sensor.
    let error = run(&[None, None, Jumps, Jumps, Jumped, Jumped]);
    assert_eq!((error.strays(), error.strays_text()), (0, Option::None));
    assert_eq!(error.measured_mean_max_m().map(|(_, count)| count), Some(5));
    assert!(error.unused_percent().is_some() && error.final_by_model.is_some());
    let text = error.print(Some(0.003)).expect_err("wrong").to_string();
    assert!(
        text.contains("300.000 mm from its reference as measured"),
        "{text}"
    );
}

#[test]
fn refused_tips_count_as_measured_when_a_second_has_passed_without_another() {
    const STEP_NS: u64 = 30_000_000;
    for (end, after_ns, measured, strays) in [
        (Mode::Tracking, 1_000_000_000, 3, 0),
        (Mode::Holding, 1_000_000_000, 3, 0),
        (Mode::Tracking, 900_000_000, 1, 2),
    ] {
        let mut error = TipError::default();
        let mut take = |mode, release_ns, tip_ns, cause: TipCause| {
            let mut record = record(mode, ReferenceState::Inside, release_ns, 0.001);
            record.measurement_jump_limit = 9;
            (record.tip_measured_ns, record.tip_cause) = (tip_ns, cause.code());
            error.take(&record);
        };
        for (k, cause) in (1..).zip([
            TipCause::None,
            TipCause::None,
            TipCause::Jumps,
            TipCause::Jumps,
        ]) {
            take(Mode::Tracking, k * STEP_NS, k * STEP_NS - 1, cause);
        }
        // Of the last tip, four steps after the first.
        let last_ns = 3 * STEP_NS + 1 + after_ns;
        take(end, last_ns, 4 * STEP_NS - 1, TipCause::Jumps);
        let count = error.measured_mean_max_m().map(|(_, count)| count);
        assert_eq!((count, error.strays()), (Some(measured), strays), "{end:?}");
    }
}

#[test]
fn without_a_measured_tip_the_error_is_by_the_model() {
    let is_by_model = |kind: MeasurementKind, tip_measured_ns: u64| {
        let mut record = Telemetry {
            release_ns: 1_000_000_000,
            tip_measured_ns,
            ..Telemetry::default()
        };
        record.measurement.kind = kind.code();
        let mut error = TipError::default();
        error.take(&record);
        error.is_by_model(&record)
    };
    assert!(is_by_model(MeasurementKind::CableLengths, 0));
    assert!(!is_by_model(MeasurementKind::CableLengths, 999_000_000));
    assert!(!is_by_model(MeasurementKind::TipPose, 0));
}
