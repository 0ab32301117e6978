use std::path::Path;

use cdcr_client::{Changed, Circle, FigurePlane, FileTrajectory};
use cdcr_controller::nmpc::RateWeight;
use cdcr_controller::robot::RobotParameters;
use cdcr_shared_types::RobotDescription;

use super::*;

/// A robot with equal sections.
pub(crate) fn robot(sections: u32) -> RobotDescription {
    let mut robot = RobotDescription {
        sections,
        cable_speed_max_m_s: 1.0,
        cable_stroke_max_m: 0.2,
        self_overlap_max_m: 0.002,
        ..RobotDescription::default()
    };
    for section in &mut robot.section[..sections as usize] {
        (section.length_m, section.cable_radius_m) = (0.3, 0.02);
        (section.bend_max_rad, section.rate_max_rad_s) = (2.5, 4.0);
        section.body_radius_m = 0.01;
    }
    robot
}

/// A record of a robot with two sections, straight and at rest.
pub(crate) fn two_sections() -> Telemetry {
    Telemetry {
        period_ns: 5_000_000,
        acceleration_rad_s2: 50.0,
        deceleration_rad_s2: 50.0,
        robot: robot(2),
        ..Telemetry::default()
    }
}

fn reference(rows: &str) -> FileTrajectory {
    FileTrajectory::parse(Path::new("r.csv"), rows).unwrap()
}

#[test]
fn an_orientation_that_the_robot_cannot_hold_is_not_called_too_fast() {
    // Both sections bend to one side: its tip is not upright there.
    let rows = "t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0.3,0,0.45,0,0,0,1\n2,0.3,0.05,0.45,0,0,0,1\n";
    let file = reference(rows);
    let (record, options) = (two_sections(), FeedOptions::default());
    let simulated = |trajectory: &dyn Trajectory, settings| {
        simulate(&record, settings, trajectory, &options).unwrap()
    };
    let default = NmpcSettings::default();
    let demands = simulated(&file, default);
    let positions = simulated(&PositionsOf(&file), default);
    assert!(positions.error_max_m < 1e-3, "{positions}");
    let checked = |demands: &Demands, free: &Demands| {
        let checked = demands.check_orientation(1e-3, || Ok(free.clone()));
        checked.map_err(|error| error.to_string())
    };
    let text = checked(&demands, &positions).unwrap_err();
    let start = "position and orientation cannot both be reached: at ";
    assert!(text.starts_with(start), "{text}");
    let remedy = "lower controller.orientation_weight";
    assert!(text.contains(remedy), "{text}");
    // Where the positions alone are missed, too, the orientation is not the cause.
    assert_eq!(checked(&demands, &demands), Ok(()));
    assert!(demands.check(1e-3).is_err());
    let lower = NmpcSettings {
        orientation_weight: 1e-6,
        ..default
    };
    let lower = simulated(&file, lower);
    assert!(lower.check(1e-3).is_ok(), "{lower}");
}

#[test]
fn a_reference_above_the_speed_limit_of_the_tip_names_it() {
    let mut record = two_sections();
    record.robot.tip_speed_max_m_s = 0.02;
    let file = reference("t_s,x_m,y_m,z_m\n0,0.1,0,0.57\n2,0.2,0,0.53\n");
    let settings = NmpcSettings::default();
    let demands = simulate(&record, settings, &file, &FeedOptions::default()).unwrap();
    let limit = "at this --speed a section end is at its limit, robot.tip_speed_max_m_s = 0.02";
    for (error, remedy) in [
        (demands.check(1e-3), "use a lower one, or raise the limit"),
        (demands.check_end(1e-3), "not reachable: the tip stays "),
    ] {
        let text = error.unwrap_err().to_string();
        assert!(text.contains(limit) && text.contains(remedy), "{text}");
    }
    record.robot.tip_speed_max_m_s = 0.1;
    let demands = simulate(&record, settings, &file, &FeedOptions::default()).unwrap();
    assert!(demands.check(1e-3).is_ok(), "{demands}");
}

#[test]
fn an_obstacle_on_the_way_is_named_before_the_speed_limit_at_every_speed() {
    let mut record = two_sections();
    record.robot.tip_speed_max_m_s = 0.1;
    record.obstacle_count = 1;
    record.obstacles[0] = cdcr_shared_types::Obstacle {
        id: 1,
        radius_m: 0.02,
        start_m: [0.2, 0.0, 0.53],
        ..cdcr_shared_types::Obstacle::default()
    };
    for end_s in [1, 2, 20] {
        let rows = format!("t_s,x_m,y_m,z_m\n0,0.1,0,0.57\n{end_s},0.2,0,0.53\n");
        let settings = NmpcSettings::default();
        let demands = simulate(
            &record,
            settings,
            &reference(&rows),
            &FeedOptions::default(),
        )
        .unwrap();
        let text = demands.check(1e-3).unwrap_err().to_string();
        assert!(
            text.starts_with("obstructed or too fast, beside an obstacle at "),
            "{text}"
        );
        assert!(
            text.contains("remove the obstacle") && !text.contains("raise"),
            "{text}"
        );
    }
}

#[test]
fn a_limit_for_which_a_motion_takes_too_long_is_named() {
    let file = reference("t_s,x_m,y_m,z_m\n0,0.1,0,0.57\n2,0.2,0,0.53\n");
    let settings = NmpcSettings::default();
    let refused = |record: &Telemetry| {
        let demands = simulate(record, settings, &file, &FeedOptions::default()).unwrap();
        let checked = demands.check_end(1e-3);
        checked.map_or_else(|error| error.to_string(), |()| String::new())
    };
    let mut record = two_sections();
    assert_eq!(refused(&record), "");
    record.acceleration_rad_s2 = 0.01;
    let text = refused(&record);
    let limit = "at this --speed a bend would have to accelerate by more than its limit, motion.acceleration_rad_s2 = 0.01; nothing moved";
    assert!(text.contains(limit), "{text}");
    record = two_sections();
    record.robot.cable_speed_max_m_s = 0.0005;
    let text = refused(&record);
    let limit = "at this --speed a cable is at its limit, robot.cable_speed_max_m_s = 0.0005; nothing moved";
    assert!(text.contains(limit), "{text}");
}

#[test]
fn a_cable_at_its_limit_is_not_called_too_fast() {
    let mut record = two_sections();
    record.robot.cable_stroke_max_m = 0.01;
    let file = reference("t_s,x_m,y_m,z_m\n0,0.05,0,0.59\n4,0.3,0,0.45\n");
    let settings = NmpcSettings::default();
    let demands = simulate(&record, settings, &file, &FeedOptions::default()).unwrap();
    for error in [demands.check(1e-3), demands.check_end(1e-3)] {
        let text = error.unwrap_err().to_string();
        let limit = "a cable is at its limit, robot.cable_stroke_max_m = 0.01";
        assert!(text.contains(limit), "{text}");
    }
}

#[test]
fn a_bend_at_its_limit_is_named_and_one_near_it_warned_of() {
    let mut record = two_sections();
    let file = reference("t_s,x_m,y_m,z_m\n0,0.05,0,0.59\n4,0.3,0,0.45\n");
    let mut at = |bend_max_rad: f64| {
        for section in &mut record.robot.section[..2] {
            section.bend_max_rad = bend_max_rad;
        }
        let settings = NmpcSettings::default();
        simulate(&record, settings, &file, &FeedOptions::default()).unwrap()
    };
    let far = at(2.5);
    assert!(
        far.check(1e-3).is_ok() && !far.to_string().contains("limit"),
        "{far}"
    );
    let near = at(1.03 * far.bend_and_rate().0);
    assert!(near.check(1e-3).is_ok(), "{near}");
    let text = near.to_string();
    assert!(text.contains("% of its limit, robot.sections["), "{text}");
    let beyond = at(0.5);
    let text = beyond.check_end(1e-3).unwrap_err().to_string();
    let way_out = "= 0.5; in another shape the tip may arrive: cdcrctl home, then this again";
    assert!(text.contains(way_out), "{text}");
    for error in [beyond.check(1e-3), beyond.check_end(1e-3)] {
        let text = error.unwrap_err().to_string();
        assert!(
            text.contains("is at its bend limit, robot.sections["),
            "{text}"
        );
        assert!(text.contains("bend_max_rad = 0.5"), "{text}");
    }
}

/// The paper's circle begins at 0.17 m/s, and the daemon joins it smoothly. A tip that tried to follow it from rest at once would stay 2.4 mm
/// away.
#[test]
fn a_tip_that_joins_a_moving_reference_is_not_called_too_slow_for_it() {
    let mut record = two_sections();
    record.robot.sections = 1;
    record.acceleration_rad_s2 = 40.0;
    let section = &mut record.robot.section[0];
    (section.cable_radius_m, section.bend_max_rad) = (0.0125, 2.8);
    section.rate_max_rad_s = 2.0;
    let checked = |speed: f64, allowed_m: f64| {
        let circle = Box::new(Circle::for_sections(&[0.3]));
        let circle = Changed::new(circle, speed, 1.0, FigurePlane::Xy, 1);
        let (settings, options) = (NmpcSettings::default(), FeedOptions::default());
        let checked = check_speed(&record, settings, &circle, &options, allowed_m);
        checked.map_err(|error| error.to_string())
    };
    assert_eq!(checked(1.0, 1e-3), Ok(()));
    // Faster than the rates allow, all the way.
    let text = checked(4.0, 1e-3).unwrap_err();
    assert!(text.contains("too fast: at "), "{text}");
}

/// The statement in docs/tuning.md, A repeated path.
#[test]
fn a_body_that_does_not_repeat_a_path_is_reported() {
    let mut record = two_sections();
    record.robot = robot(3);
    let note = |rounds, posture_gain| {
        let circle = Circle {
            radius_m: 0.1,
            height_m: 0.75,
            rate_rad_s: 2.0,
            duration_s: std::f64::consts::PI,
        };
        let circle = Changed::new(Box::new(circle), 1.0, 1.0, FigurePlane::Xy, rounds);
        let settings = NmpcSettings {
            rate_weight: RateWeight::auto(posture_gain == 0.0),
            posture_gain,
            ..NmpcSettings::default()
        };
        let demands = simulate(&record, settings, &circle, &FeedOptions::default()).unwrap();
        println!("{demands}");
        (demands.to_string().lines().map(str::trim)).find_map(|line| {
            let (section, moved) = line
                .strip_prefix("note: the path ends where it begins, and the end of section ")?
                .split_once(" then is ")?;
            Some((
                section.to_owned(),
                moved.split_once(" mm ")?.0.parse::<f64>().ok()?,
            ))
        })
    };
    let moved = [1, 20].map(|rounds| note(rounds, 0.0).expect("a note"));
    assert!(moved.iter().all(|(section, _)| section == "2"), "{moved:?}");
    assert!(moved[0].1 + 20.0 < moved[1].1, "{moved:?}");
    // With a posture the body settles during the first rounds.
    let settled_mm = note(20, 5.0).map_or(0.0, |(_, mm)| mm);
    assert!(settled_mm < 0.5 * moved[1].1, "{settled_mm} {moved:?}");
}

#[test]
fn rows_seconds_apart_are_asked_about() {
    let error = |rows: &str| {
        check_duration(&reference(rows), 1000.0)
            .unwrap_err()
            .to_string()
    };
    let text = error("t_s,x_m,y_m,z_m\n0,0,0,0.5\n2000,0,0,0.5\n4000,0,0,0.5\n");
    assert!(
        text.contains("rows 2000.0 s apart: are these milliseconds?"),
        "{text}"
    );
    let rows = (0..=4000).map(|k| format!("{},0,0,0.5", 0.5 * f64::from(k)));
    let rows = rows.collect::<Vec<_>>().join("\n");
    let slow = format!("t_s,x_m,y_m,z_m\n{rows}\n");
    let text = error(&slow);
    assert!(
        text.ends_with("2000 s, more than 1000 s: use a higher speed"),
        "{text}"
    );
    assert!(check_duration(&reference(&slow), 2000.0).is_ok());
}

#[test]
fn an_obstacle_in_the_way_is_named() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let settings = NmpcSettings {
        safe_distance_m: 0.03,
        ..NmpcSettings::default()
    };
    let mut demands = Demands::new(&robot, &settings, 0.1);
    demands.note_error(0.0, [0.0; 3], 0.0989, f64::INFINITY);
    let text = |demands: &Demands| demands.check_end(1e-3).unwrap_err().to_string();
    assert!(!text(&demands).contains("obstacle"));
    demands.along.clearance_m = 0.2;
    assert!(!text(&demands).contains("obstacle"));
    demands.before.clearance_m = 0.0302;
    let text = text(&demands);
    assert!(text.contains("obstacle at 30.2 mm"), "{text}");
}

#[test]
fn the_fastest_way_to_a_far_first_point_is_not_taken_for_the_approach() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let says_so = |distance_m: f64| {
        let mut demands = Demands::new(&robot, &NmpcSettings::default(), distance_m);
        demands.may_join = true;
        demands
            .to_string()
            .contains("--track does not take this fastest way")
    };
    assert!(says_so(0.1) && !says_so(1e-4));
    // Ways that begin at the tip, as those of `goto` and `calibrate excite`, have no such options.
    let from_the_tip = Demands::new(&robot, &NmpcSettings::default(), 0.1).to_string();
    assert!(!from_the_tip.contains("--track") && !from_the_tip.contains("--blend"));
}

#[test]
fn what_is_too_fast_is_refused_before_it_is_tracked_also_beside_obstacles() {
    let rows = |step_s: f64| {
        let row = |k: usize| {
            let x_m = if k < 50 { 0.05 } else { 0.2 };
            format!("{},{x_m},0,0.5\n", step_s * k as f64)
        };
        (0..100).map(row).collect::<String>()
    };
    let options = FeedOptions::default();
    let checked = |record: &Telemetry, step_s: f64, allowed_m: f64| {
        let file = reference(&format!("t_s,x_m,y_m,z_m\n{}", rows(step_s)));
        let settings = NmpcSettings::default();
        let checked = check_speed(record, settings, &file, &options, allowed_m);
        checked.map_err(|error| error.to_string())
    };
    let mut record = two_sections();
    for known in [0, 1] {
        record.obstacle_count = known;
        record.obstacles[0] = cdcr_shared_types::Obstacle {
            id: 1,
            radius_m: 0.02,
            start_m: [0.05, 0.0, 0.5],
            ..cdcr_shared_types::Obstacle::default()
        };
        let text = checked(&record, 0.02, 1e-3).unwrap_err();
        for part in [
            "too fast: at 1.0",
            "(0.2000, 0.0000, 0.5000) m",
            "use a lower --speed, or allow more than 1 mm (--max-error); nothing moved",
        ] {
            assert!(text.contains(part), "{text}");
        }
        // It is allowed, slow, or too long to be simulated. An obstacle on it is the guard's.
        assert_eq!(checked(&record, 0.02, 0.2), Ok(()));
        assert_eq!(checked(&record, 2.0, 1e-3), Ok(()));
        assert_eq!(checked(&record, 20.0, 1e-3), Ok(()));
    }
}
