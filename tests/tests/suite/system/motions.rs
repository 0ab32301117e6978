//! Motions requested by a person: to a point, by a distance, along a reference, and all of it as a dry run.

use std::ops::ControlFlow;
use std::time::Duration;

use cdcr_client::Line;
use cdcr_client::model::robot_of;
use cdcr_controller::robot::{BendRates, Configuration};
use cdcr_shared_types::codes::{Mode, Reason, guard};
use cdcr_tests::driver::DriverProcess;
use cdcr_tests::{
    Daemon, STALL_TOLERANT, assert_output, text, tracked, until_undisturbed, wait_mode,
    wait_record, wait_until,
};
use rustix::process::Signal;

fn checked(daemon: &Daemon, line: &str, status: i32) -> String {
    daemon
        .place()
        .checked(&format!("cdcrctl {line}"), status, &[])
}

/// The same for a command that succeeds. `None` if a stall took the tip off its path, because the rates are
/// constant meanwhile.
fn checked_unless_stalled(daemon: &Daemon, line: &str) -> Option<String> {
    let output = daemon.place().start(&format!("cdcrctl {line}")).output();
    let by_stalls = [Reason::InputsStale.text(), "more than --max-error"];
    let is_stalled = by_stalls.iter().any(|words| text(&output).contains(words));
    (!is_stalled).then(|| assert_output(&output, 0, &[]))
}

/// Tip position of the newest cycle.
fn tip_m(daemon: &Daemon) -> [f64; 3] {
    let mut telemetry = daemon.connect().telemetry().unwrap();
    wait_record(&mut telemetry, |_| true).tip_position_m
}

fn wait_until_the_tip_rests(daemon: &Daemon) {
    wait_until("the tip rests", || {
        let before_m = tip_m(daemon);
        std::thread::sleep(Duration::from_millis(200));
        let mut telemetry = daemon.connect().telemetry().unwrap();
        let now = wait_record(&mut telemetry, |_| true);
        let is_commanded = now.command.bend_rate_rad_s.iter().any(|rate| *rate != 0.0);
        !is_commanded && distance_m(now.tip_position_m, before_m) < 5e-4
    });
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

#[test]
fn the_tip_goes_to_a_point_and_by_so_much_and_nothing_moves_that_cannot_be_reached() {
    let daemon = Daemon::start(STALL_TOLERANT);
    // The estimate begins with one measurement, whose noise is a millimetre and more at the tip.
    wait_until_the_tip_rests(&daemon);
    let start_m = tip_m(&daemon);
    let [near, away] = ["goto 0.05,0.02,0.87 --dry-run", "goto 0.5,0.5,0.5"];
    assert!(checked(&daemon, near, 0).contains("nothing moved; the ideal robot would need"));
    assert!(checked(&daemon, away, 1).contains("not reachable: the tip stays"));
    // Without a simulation, which refuses motions of more than 200 000 cycles with another reason.
    let far = checked(&daemon, "goto 5,5,5 --speed 0.001", 1);
    assert!(far.contains("and the robot is 0.900 m long"), "{far}");
    assert!(checked(&daemon, "jog 0,0,0.5 --dry-run", 1).contains("not reachable"));
    assert!(checked(&daemon, "goto 50,20,870", 1).contains("are these millimetres?"));
    // An obstacle covers the point.
    let covers = "obstacle add --id 42 --at 0.3,0,0.75 --radius 0.05";
    assert_ne!(checked(&daemon, covers, 0), "");
    let covered = checked(&daemon, "goto 0.3,0,0.75 --dry-run", 1);
    let names = ["Without the obstacles the tip arrives", "has id 42"];
    assert!(names.iter().all(|name| covered.contains(name)), "{covered}");
    checked(&daemon, "obstacle clear", 0);
    assert!(distance_m(tip_m(&daemon), start_m) < 0.002, "nothing moved");

    let fast = "--speed 0.2 --acceleration 2";
    until_undisturbed("the tip ends where it was sent", || {
        checked(&daemon, &format!("goto 0.05,0.02,0.87 {fast}"), 0);
        let there_m = tip_m(&daemon);
        checked(&daemon, &format!("jog 0.02,-0.04,-0.01 {fast}"), 0);
        let by_m = tip_m(&daemon);
        println!("{there_m:?}, then {by_m:?}");
        // A stall at the end of a motion leaves the tip where the last rates took it.
        let is_there = distance_m(there_m, [0.05, 0.02, 0.87]) < 0.002;
        (is_there && distance_m(by_m, [0.07, -0.02, 0.86]) < 0.004).then_some(())
    });
}

#[test]
fn a_curve_and_a_file_are_changed_before_they_are_sent() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let rows = "t_s,x_m,y_m,z_m\n0,0.1,0,0.85\n0.2,0.1,0.01,0.85\n0.8,0.1,0.05,0.85\n";
    daemon.place().write("path.csv", rows);
    checked(&daemon, "goto 0.1,0,0.85 --speed 0.2 --acceleration 2", 0);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    // Forwards and backwards, at half the speed and half the size, upright: longer than its approach, even
    // when a stall delays the approach.
    let file = "ref file path.csv --speed 0.5 --repeat 2 --scale 0.5 --plane xz --track --max-error 50mm --lead 1s";
    let fed = until_undisturbed(file, || checked_unless_stalled(&daemon, file));
    assert!(fed.contains("5 points") && fed.contains("3.20 s"), "{fed}");
    let last = wait_record(&mut telemetry, |record| record.reference.state == 3);
    assert!(distance_m(last.reference.position_m, [0.1, 0.0, 0.85]) < 1e-9);
    let line = checked(
        &daemon,
        "ref line --duration 400ms --repeat 2 --speed 2 --lead 1s",
        0,
    );
    assert!(line.contains("0.40 s"), "{line}");
    let turned = rows
        .replace("z_m\n", "z_m,qx,qy,qz,qw\n")
        .replace(".85\n", ".85,0,0,0,1\n");
    daemon.place().write("turned.csv", &turned);
    let reported = checked(&daemon, "ref file turned.csv --plane xz", 1);
    assert!(reported.contains("orientations"), "{reported}");
}

#[test]
fn a_reference_is_tried_without_moving_and_its_approach_is_reported_separately() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let reachable = checked(&daemon, "ref spiral --dry-run", 0);
    for word in [
        "first point",
        "tip error",
        "rate",
        "acceleration",
        "cable stroke",
    ] {
        assert!(reachable.contains(word), "{reachable}");
    }
    // The first share belongs to the path, the second to the approach.
    let (_, rate) = reachable.split_once("rad/s, ").unwrap();
    let share: f64 = rate.split_whitespace().next().unwrap().parse().unwrap();
    assert!(share < 60.0, "{reachable}");
    let has_row = |line: &str| line.trim_start().starts_with("clearance");
    assert!(!reachable.lines().any(has_row), "there is no obstacle");
    checked(
        &daemon,
        "obstacle add --id 1 --at 0.2,0,0.4 --radius 0.02",
        0,
    );
    let beside = checked(&daemon, "ref spiral --dry-run", 0);
    assert!(beside.lines().any(has_row), "{beside}");
    assert!(checked(&daemon, "ref line --start 0,0,0.95 --dry-run", 1).contains("not reachable"));
    // Also without a request for it: the first unreachable point, not the farthest one.
    let before_m = tip_m(&daemon);
    let far = "ref line --start 0,0,0.85 --velocity 0,0,0.1 --duration 2s --track";
    let reported = daemon
        .place()
        .checked(&format!("cdcrctl {far}"), 1, &["first point"]);
    let (_, after) = reported.split_once("at ").unwrap();
    let time_s: f64 = after.split(' ').next().unwrap().parse().unwrap();
    // The robot is 0.9 m long, and 1 mm is allowed.
    assert!((time_s - 0.51).abs() < 0.02, "{reported}");
    // Noise of the estimate; to the first unreachable point it is 51 mm.
    assert!(distance_m(tip_m(&daemon), before_m) < 0.01, "{reported}");
    // The approach may end before the spiral begins; it still counts.
    let spiral = "ref spiral --track --lead 1s --max-error 100mm";
    let reported = until_undisturbed(spiral, || checked_unless_stalled(&daemon, spiral));
    assert!(reported.contains("approached in"), "{reported}");
}

/// Output of a command that succeeds, and the largest speed of the tip meanwhile \[m/s\].
fn output_and_speed(daemon: &Daemon, line: &str) -> (String, f64) {
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let mut before = wait_record(&mut telemetry, |_| true);
    std::thread::scope(|scope| {
        let running = scope.spawn(|| checked(daemon, line, 0));
        let mut fastest_m_s = 0.0_f64;
        while !running.is_finished() {
            let record = wait_record(&mut telemetry, |_| true);
            let way_m = distance_m(record.tip_position_m, before.tip_position_m);
            let time_s = (record.release_ns - before.release_ns) as f64 * 1e-9;
            fastest_m_s = fastest_m_s.max(way_m / time_s);
            before = record;
        }
        (running.join().unwrap(), fastest_m_s)
    })
}

#[test]
fn a_curve_begins_without_a_jump_where_the_tip_is_brought_to_its_first_point() {
    // With immediate tracking, it moves at its largest rates.
    let daemon = Daemon::ideal(STALL_TOLERANT);
    let curve = "ref line --start 0.1,0,0.85 --velocity 0,0.03,0 --duration 300ms --track";
    let (_, jumps_m_s) = output_and_speed(&daemon, &format!("{curve} --max-error 1m"));
    // For a path at 0.05 m/s; after a stall of the machine, the tip catches up.
    until_undisturbed("the tip moves slowly", || {
        checked(&daemon, "goto 0.02,0,0.89 --speed 0.5 --acceleration 5", 0);
        let (reported, blends_m_s) = output_and_speed(&daemon, &format!("{curve} --blend"));
        assert!(
            reported.contains("mm from the point by the model; no sensor measures the tip"),
            "{reported}"
        );
        assert!(reported.contains("tracked to its end"), "{reported}");
        println!("{jumps_m_s} m/s, {blends_m_s} m/s");
        (blends_m_s < 0.5 * jumps_m_s).then_some(())
    });
}

#[test]
fn a_daemon_that_simulates_its_robot_itself_has_no_place_for_another() {
    let daemon = Daemon::start(STALL_TOLERANT);
    assert!(checked(&daemon, "plant", 1).contains("already measured"));
    let printed = checked(&daemon, "plant --force", 1);
    assert!(printed.contains("link.kind"), "{printed}");
}

#[test]
fn a_simulated_robot_in_a_process_of_its_own_is_driven() {
    for (interface, preset) in [("position", "sloppy"), ("velocity", "laboratory")] {
        let daemon = Daemon::start(&format!(
            "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"{interface}\"\nmeasurement_timeout_ms = 2000.0\n"
        ));
        let line = format!("cdcrctl plant --tip 100 --preset {preset}");
        let mut plant = daemon.place().start(&line);
        wait_mode(&mut daemon.connect().telemetry().unwrap(), Mode::Holding);
        // The estimate of the tip offset is still converging.
        wait_until_the_tip_rests(&daemon);
        let fast = "--speed 0.2 --acceleration 2 --max-error 3mm";
        let mut points = ["0.05,0.02,0.87", "0.02,0.05,0.87"].iter().cycle();
        until_undisturbed("the tip goes to a point", || {
            // A stall at the end of the path leaves the robot where its motors had brought it.
            checked_unless_stalled(&daemon, &format!("goto {} {fast}", points.next().unwrap()))
        });
        plant.signal(Signal::INT);
        let output = plant.output();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output));
        assert!(text(&output).contains(preset), "{}", text(&output));
    }
}

/// When straight, it has the true length of its sections, on a displaced base; its sensor reports this, and
/// the daemon uses it.
#[test]
fn a_simulated_robot_may_be_another_one_than_is_configured() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 2000.0\n"
    ));
    let refused = checked(&daemon, "plant --section 0.31,0.0125,0", 1);
    assert!(refused.contains("1 section given"), "{refused}");
    let sections = "--section 0.31,0.0125,0 --section 0.29,0.0125,0.7 --section 0.32,0.0125,1.4";
    let line = format!(
        "cdcrctl plant --preset ideal --tip 100 {sections} --flaw base_x_m=0.01 --flaw tip_tick_m=1e-4"
    );
    let mut plant = daemon.place().start(&line);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let measured = wait_record(&mut telemetry, |record| record.tip_measured_ns > 0);
    assert!(distance_m(measured.tip_measured_m, [0.01, 0.0, 0.92]) < 1e-9);
    plant.signal(Signal::INT);
    assert_eq!(plant.output().status.code(), Some(0));
}

/// Each of a thousand commands a second may be rejected; the terminal gets one line in ten seconds.
#[test]
fn a_simulated_robot_that_follows_nothing_is_reported_once() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"position\"\nmeasurement_timeout_ms = 300.0\n"
    ));
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let robot = daemon.place().start("cdcrctl plant");
    wait_mode(&mut telemetry, Mode::Holding);
    // The robot may still be on its way to where it is held.
    wait_until_the_tip_rests(&daemon);
    until_undisturbed("the tip goes to a point", || {
        checked_unless_stalled(&daemon, "goto 0.1,0,0.85 --speed 0.2 --max-error 20mm")
    });
    robot.signal(Signal::KILL);
    wait_mode(&mut telemetry, Mode::Faulted);
    let stopped = checked(&daemon, "jog 0.01,0,0", 1);
    assert!(
        stopped.contains("faulted (the measurement is lost)"),
        "{stopped}"
    );
    // When straight, it is not at its commanded position.
    let mut other = daemon.place().start("cdcrctl plant --force");
    std::thread::sleep(Duration::from_secs(1));
    other.signal(Signal::INT);
    let printed = text(&other.output());
    let reported = printed
        .matches("the first commanded position differs")
        .count();
    assert_eq!(reported, 1, "{printed}");
}

#[test]
fn a_way_from_where_the_tip_no_longer_is_is_not_gone() {
    // Homing takes 60 s.
    let bent = "[link]\ninitial_bend_rad = [[1.2, 0.0], [1.2, 0.0], [1.2, 0.0]]\n";
    let slow = "[motion]\nhome_rate_rad_s = 0.02\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{bent}{slow}"));
    checked(&daemon, "home", 0);
    let refused = checked(&daemon, "jog 0.01,0,0.01 --max-error 10mm", 1);
    let reason = "the tip moves, or has moved while the path was computed; nothing was sent";
    assert!(refused.contains(reason), "{refused}");
    let status = daemon.connect().status(cdcr_tests::TIMEOUT).unwrap();
    assert_eq!((status.mode, status.lease_holder), (Mode::Homing.code(), 0));
}

#[test]
fn a_way_beside_another_clients_reference_is_refused_by_its_lease() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let reason = "cannot acquire the lease: another client holds the reference lease (the daemon is tracking). Stop the other client";
    // After a stall, the daemon holds, and the other client ends or loses its lease.
    until_undisturbed("another client feeds", || {
        let mut other = daemon
            .place()
            .start("cdcrctl ref circle --duration 60s --track");
        wait_record(&mut daemon.connect().telemetry().unwrap(), |record| {
            let is_fed = record.mode == Mode::Tracking.code();
            is_fed && record.command.bend_rate_rad_s[0] != 0.0 || !other.runs()
        });
        let way = daemon.place().start("cdcrctl goto 0.1,0,0.85").output();
        if other.runs() {
            other.signal(Signal::INT);
        }
        let fed = other.output();
        println!("{}{}", text(&way), text(&fed));
        if fed.status.code() != Some(130) || !text(&way).contains(reason) {
            return None;
        }
        assert_output(&way, 1, &[]);
        assert_output(&fed, 130, &["the daemon holds"]);
        Some(())
    });
}

/// All points are in reach, but not at once.
#[test]
fn a_reference_with_an_outlier_is_refused_before_anything_moves() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let row = |k: usize| {
        let (time_s, x_m) = (0.05 * k as f64, if k == 40 { -0.1 } else { 0.1 });
        format!("{time_s},{x_m},{},0.85\n", 0.001 * k as f64)
    };
    let rows: String = (0..=80).map(row).collect();
    let rows = format!("t_s,x_m,y_m,z_m\n{rows}");
    daemon.place().write("path.csv", &rows);
    for line in [
        "ref file path.csv --track",
        "ref file path.csv --track --blend --max-error 20mm",
        "ref file path.csv --dry-run",
    ] {
        let refused = checked(&daemon, line, 1);
        let is_there = ["1.9", "2.0"].map(|s| refused.contains(&format!("too fast: at {s}")));
        let is_named = is_there.contains(&true) && refused.contains("(-0.");
        assert!(is_named && refused.contains("nothing moved"), "{refused}");
    }
    let status = daemon.connect().status(cdcr_tests::TIMEOUT).unwrap();
    assert_eq!(
        (status.mode, status.lease_holder),
        (Mode::Holding.code(), 0)
    );
}

#[test]
fn a_reference_that_ends_before_it_is_reached_is_an_error() {
    let daemon = Daemon::start(STALL_TOLERANT);
    // 0.4 m away, at 0.1 m/s at most.
    let far = "ref line --start 0.35,0,0.7 --duration 500ms --lead 1s --track";
    let output = daemon.place().start(&format!("cdcrctl {far}")).output();
    let parts = ["mm away, did not reach the reference in", "cdcrctl goto"];
    assert_output(&output, 1, &parts);
}

#[test]
fn obstacles_are_where_they_will_be_when_a_reference_is_tried() {
    let clearance_mm = |velocity: &str| {
        let daemon = Daemon::start(STALL_TOLERANT);
        let ball =
            format!("obstacle add --id 1 --at 0.3,0,0.4 --radius 0.02 --velocity {velocity}");
        checked(&daemon, &ball, 0);
        let tried = checked(&daemon, "ref spiral --duration 1s --lead 30s --dry-run", 0);
        let (_, rest) = tried.split_once("clearance ").expect("a clearance");
        let number = rest.split_whitespace().next().expect("a number");
        number.parse::<f64>().expect("in mm")
    };
    // 0.005 m/s for 30 s of lead and 1 s of reference are 155 mm, and the body bends by some of that.
    let [stands, comes, goes] = ["0,0,0", "-0.005,0,0", "0.005,0,0"].map(clearance_mm);
    assert!(comes < stands - 100.0, "{comes}, {stands} mm");
    assert!(goes > stands, "{goes}, {stands} mm");
}

#[test]
fn a_daemon_that_is_stopped_before_its_first_measurement_waits_for_one() {
    let driver = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{driver}"));
    checked(&daemon, "stop", 0);
    let refused = checked(&daemon, "reset", 1);
    assert!(refused.contains("its line reset"), "{refused}");
    let cause = "is refused now: the measurement is lost";
    wait_until("the status names the cause", || {
        checked(&daemon, "status", 0).contains(cause)
    });
    assert!(checked(&daemon, "calibrate noise", 1).contains("cdcrctl reset"));
    // Nothing has measured it: a simulated robot needs no force.
    let mut plant = daemon.place().start("cdcrctl plant");
    wait_until("a reset is accepted", || {
        daemon.place().cdcrctl(&["reset"]).status.success()
    });
    plant.signal(Signal::INT);
    assert_output(&plant.output(), 0, &["a simulated robot"]);
}

#[test]
fn a_simulated_robot_is_refused_beside_a_driver() {
    let driver = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{driver}"));
    let _driver = DriverProcess::start(daemon.place());
    let mut telemetry = daemon.connect().telemetry().unwrap();
    wait_mode(&mut telemetry, Mode::Holding);
    assert!(checked(&daemon, "plant", 1).contains("already measured"));
    let refused = checked(&daemon, "plant --force", 1);
    assert!(
        refused.contains("the daemon rejects this robot"),
        "{refused}"
    );
    // The driver's robot is measured and commanded as before.
    let status = daemon.connect().status(cdcr_tests::TIMEOUT).unwrap();
    assert_eq!((status.mode, status.faults), (Mode::Holding.code(), 0));
}

/// Commands that would leave the tip behind are refused before anything moves; slower ones and the way home keep the limit.
#[test]
fn a_speed_above_the_limit_of_the_tip_is_refused_with_the_limit_and_home_keeps_it() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[robot]\ntip_speed_max_m_s = 0.1\n"
    ));
    let limit = "at this --speed a section end is at its limit, robot.tip_speed_max_m_s = 0.1";
    let refused = checked(
        &daemon,
        "goto 0.25,0.02,0.82 --speed 0.6 --acceleration 9",
        1,
    );
    assert!(refused.contains(limit), "{refused}");
    let fast = "ref circle --radius 0.05 --rate 6 --dry-run";
    // In a stall the solver of the dry run ends early, and does not reach the limit.
    wait_until("the refusal names the limit", || {
        checked(&daemon, fast, 1).contains(limit)
    });
    until_undisturbed("the tip goes to a point and home", || {
        checked_unless_stalled(&daemon, "goto 0.15,0.02,0.86 --speed 0.08")?;
        let mut telemetry = daemon.connect().telemetry().unwrap();
        checked(&daemon, "home --wait", 0);
        let (mut fastest_m_s, mut limited) = (0.0_f64, 0);
        while let Some(record) = telemetry.try_next().unwrap() {
            let robot = robot_of(&record.robot).unwrap();
            let at = Configuration::from_slice(&record.bend_rad[..6]).unwrap();
            let rates = BendRates::from_slice(&record.command.bend_rate_rad_s[..6]).unwrap();
            fastest_m_s = fastest_m_s.max(robot.fastest_section_end_m_s(&at, &rates));
            limited += u32::from(record.mode == Mode::Homing.code());
        }
        println!("home at {fastest_m_s} m/s in {limited} cycles");
        assert!(fastest_m_s <= 0.1 * (1.0 + 1e-9));
        (fastest_m_s > 0.099).then_some(())
    });
}

/// The point is the base of the robot: its tip would end inside its first section. A program that sends such a reference as it is, without
/// computing the path, moves the body no deeper into itself than it may be.
#[test]
fn a_path_on_which_the_body_would_touch_itself_is_refused() {
    let daemon = Daemon::ideal(STALL_TOLERANT);
    for line in [
        "goto 0,0,0.02",
        "ref line --start 0.3,0,0.3 --velocity -0.06,0,-0.056 --duration 5s --dry-run",
    ] {
        let printed = checked(&daemon, line, 1);
        assert!(printed.contains("would touch"), "{printed}");
        assert!(printed.contains("nothing moved"), "{printed}");
    }
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let line = Line {
        start_m: [0.3, 0.0, 0.3],
        velocity_m_s: [-0.06, 0.0, -0.056],
        duration_s: 5.0,
        tip_axis: None,
    };
    let (mut deepest_m, mut guarded) = (0.0_f64, 0);
    let client = daemon.connect();
    let fed = client.feed(&line, tracked()).unwrap().run(|_| {
        while let Some(record) = telemetry.try_next().unwrap() {
            let robot = robot_of(&record.robot).unwrap();
            let at = Configuration::from_slice(&record.bend_rad[..6]).unwrap();
            let contact = robot.self_contact(&at, 0.0);
            deepest_m = contact.map_or(deepest_m, |contact| deepest_m.max(contact.overlap_m));
            guarded += u32::from(record.guard_flags & guard::SELF_CONTACT != 0);
        }
        ControlFlow::Continue(())
    });
    println!("{deepest_m} m deep, {guarded} cycles, {:?}", fed.is_ok());
    assert!(guarded > 0 && deepest_m <= 0.002 + 1e-9);
}
