//! A homing request without a running daemon.

use super::*;

const SLOWLY: &str = "[motion]\nhome_rate_rad_s = 0.05\n";

/// For a bent robot that homes slowly.
fn far_from_home() -> Place {
    let bent = "[link]\ninitial_bend_rad = [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
    place(&format!("{STALL_TOLERANT}{SLOWLY}{bent}"))
}

#[test]
fn a_home_reaches_the_next_daemon_and_is_carried_out() {
    let place = far_from_home();
    let daemon = begin(&place);
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    old.wait_mode(Mode::Holding, 0);
    drop(daemon);
    let begin_ns = monotonic_ns();
    thread::scope(|scope| {
        let next = scope.spawn(|| {
            thread::sleep(Duration::from_millis(100));
            begin(&place)
        });
        let answer = connection.request_within(RequestKind::Home, TIMEOUT);
        assert_eq!(answer.unwrap().mode, Mode::Homing.code());
        old.wait_mode(Mode::Homing, begin_ns);
        next.join().unwrap()
    });
}

/// A request whose client has given up is not executed.
#[test]
fn a_home_whose_client_has_given_up_moves_no_next_daemon() {
    let place = far_from_home();
    let daemon = begin(&place);
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    old.wait_mode(Mode::Holding, 0);
    drop(daemon);
    let answer = connection.request_within(RequestKind::Home, Duration::from_millis(100));
    assert!(
        matches!(answer, Err(RequestError::Timeout { .. })),
        "{answer:?}"
    );
    let begin_ns = monotonic_ns();
    let _next = begin(&place);
    old.wait_mode(Mode::Holding, begin_ns);
    let mut held = 0;
    wait_record(&mut old.telemetry, |record| {
        let is_next = record.header.sender_id == old.daemon;
        assert!(!is_next || record.mode == Mode::Holding.code());
        held += u32::from(is_next);
        held > 100
    });
}

#[test]
fn a_home_waits_until_the_next_daemon_has_heard_of_its_robot() {
    let link = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 10000.0\n";
    let place = place(&format!("{STALL_TOLERANT}{SLOWLY}{link}"));
    let daemon = begin(&place);
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    let (is_connected, is_dead) = (AtomicBool::new(false), AtomicBool::new(false));
    let (is_over, commanded_by) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        let _over = EndWhenDropped(&is_over);
        let asking = scope.spawn(|| {
            let client = connect(&place);
            is_connected.store(true, Ordering::Relaxed);
            wait_until("the first daemon is dead", || {
                is_dead.load(Ordering::Relaxed)
            });
            let answer = client.request_within(RequestKind::Home, TIMEOUT);
            answer.unwrap().mode
        });
        wait_until("the client is there", || {
            is_connected.load(Ordering::Relaxed)
        });
        drop(daemon);
        is_dead.store(true, Ordering::Relaxed);
        // It sends its request without a daemon.
        thread::sleep(Duration::from_millis(100));
        let begin_ns = monotonic_ns();
        let _next = begin(&place);
        old.wait_mode(Mode::Starting, begin_ns);
        // The request has been rejected many times meanwhile.
        let refused = Outcome::WrongMode.code() as usize;
        wait_status(&connection, |status| status.outcomes[refused] > 3);
        scope.spawn(|| drive(&connect(&place), 1.0, &commanded_by, &is_over));
        old.wait_mode(Mode::Homing, begin_ns);
        assert_eq!(asking.join().unwrap(), Mode::Homing.code());
    });
}
