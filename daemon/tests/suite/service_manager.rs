//! The unit for the service manager matches the program.

use cdcr_daemon::exit::ExitCause;
use cdcr_shared_types::codes::RTPRIO_GRANTED;

const UNIT: &str = include_str!("../../../packaging/cdcrd.service");

/// The rest of the line that begins with `key`.
fn value_in<'t>(text: &'t str, key: &str) -> &'t str {
    text.lines()
        .find_map(|line| line.strip_prefix(key))
        .unwrap()
}

fn value(key: &str) -> &'static str {
    value_in(UNIT, key)
}

#[test]
fn the_unit_leaves_alone_what_a_restart_cannot_repair() {
    let named: Vec<u8> = value("RestartPreventExitStatus=")
        .split_whitespace()
        .map(|number| number.parse().unwrap())
        .collect();
    let hopeless = ExitCause::ALL
        .iter()
        .filter(|(.., restart)| restart.is_none());
    let hopeless: Vec<_> = hopeless.map(|(cause, ..)| cause.code()).collect();
    assert_eq!(named, hopeless);
}

#[test]
fn unit_and_limits_file_grant_the_priority_that_the_remedies_name() {
    const LIMITS: &str = include_str!("../../../packaging/limits.conf");
    assert_eq!(value("LimitRTPRIO="), RTPRIO_GRANTED.to_string());
    assert_eq!(
        value_in(LIMITS, "@cdcr - rtprio "),
        RTPRIO_GRANTED.to_string()
    );
}

/// Clients find a daemon by its name among the abstract sockets, which also refuses a second daemon if the
/// files are gone.
#[test]
fn the_unit_hides_the_daemons_name_from_nobody_and_leaves_it_no_network() {
    assert!(!UNIT.lines().any(|line| line == "PrivateNetwork=yes"));
    assert_eq!(value("RestrictAddressFamilies="), "AF_UNIX");
    assert_eq!(value("IPAddressDeny="), "any");
}

#[test]
fn the_unit_starts_a_daemon_again_that_is_killed_fifty_times_in_a_row() {
    let starts: u32 = value("StartLimitBurst=").parse().unwrap();
    assert!(starts > 50, "the first start, and one after each kill");
    assert_eq!(value("RestartSec="), "100ms");
}
