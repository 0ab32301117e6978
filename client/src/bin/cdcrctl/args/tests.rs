use super::complete::SHELLS;
use super::*;
use cdcr_shared_types::limits::INCIDENTS_MAX;
use clap::CommandFactory;

use crate::standstill::{REST_RAD_S, WINDOW_NS};
use crate::tip_error::{ENDED_OFF_M, PASSED_OFF_M};
use crate::value::{AROUND_S, SPEED_M_S_MAX};

#[test]
fn the_command_line_is_consistent() {
    Arguments::command().debug_assert();
}

#[test]
fn the_manual_matches_the_command_line() {
    cdcr_packaging::check(
        &Arguments::command(),
        "1",
        Some((complete::VARIABLE, &SHELLS)),
    )
    .expect("up to date");
}

#[test]
fn a_number_that_may_not_be_negative_is_named_with_what_is_allowed() {
    for (line, parts) in [
        (
            "obstacle add --id 1 --at 0,0,1 --radius -1",
            ["--radius <M>", "-1 is below zero: use 0 or more"],
        ),
        (
            "ref circle --speed -1",
            ["--speed <TIMES>", "-1 is not above zero"],
        ),
        (
            "ref circle --repeat -1",
            ["--repeat <N>", "-1 is not in 1..=10000"],
        ),
        (
            "replay run.mcap --speed -1",
            ["--speed <TIMES>", "between 0.1 and 4"],
        ),
        ("echo --count -1", ["--count <N>", "invalid value '-1'"]),
    ] {
        let words = ["cdcrctl"].into_iter().chain(line.split(' '));
        let refused = Arguments::try_parse_from(words).unwrap_err().to_string();
        for part in parts {
            assert!(refused.contains(part), "{line}: {refused}");
        }
    }
}

#[test]
fn every_command_shows_an_example() {
    fn check(command: &clap::Command) {
        let help = command.get_after_help().map(ToString::to_string);
        let help = help.unwrap_or_default();
        assert!(help.contains("Example"), "{}", command.get_name());
        command.get_subcommands().for_each(check);
    }
    check(&Arguments::command());
}

#[test]
fn negative_vectors_are_values_and_not_options() {
    let line = "cdcrctl ref line --start -0.1,0,0.8 --velocity -0.01,0,0";
    let parsed = Arguments::try_parse_from(line.split(' ')).expect("legal");
    let CtlCommand::Ref(RefOptions {
        curve: Curve::Line(line),
    }) = parsed.task
    else {
        panic!("a line");
    };
    assert_eq!(line.start, Some([-0.1, 0.0, 0.8]));
}

/// The options of all commands, with their helps.
fn options(command: &clap::Command, found: &mut Vec<(String, String)>) {
    let arguments = command.get_arguments();
    found.extend(arguments.map(|of| {
        let help = of.get_help().map(ToString::to_string);
        (of.get_id().to_string(), help.unwrap_or_default())
    }));
    command
        .get_subcommands()
        .for_each(|command| options(command, found));
}

#[test]
fn helps_state_the_numbers_that_apply() {
    let (window_s, around_s) = (WINDOW_NS as f64 * 1e-9, AROUND_S.end());
    let [end_mm, way_mm] = [ENDED_OFF_M, PASSED_OFF_M].map(|off_m| 1e3 * off_m);
    let helps = [
        (
            "wait",
            format!("above {REST_RAD_S} rad/s, averaged over {window_s} s"),
        ),
        ("before", format!("0 to {around_s} s")),
        ("after", format!("0 to {around_s} s")),
        ("far", format!("faster than {SPEED_M_S_MAX} m/s")),
        ("speed", format!("in m/s, at most {SPEED_M_S_MAX}")),
        (
            "max_error",
            format!("{end_mm} mm at the end and {way_mm} mm (estimated) on the way"),
        ),
    ];
    let command = Arguments::command();
    let mut found = Vec::new();
    options(&command, &mut found);
    for (option, text) in helps {
        let of_option = found.iter().filter(|(id, _)| id == option);
        assert!(
            of_option.clone().any(|(_, help)| help.contains(&text)),
            "--{option}: {text}"
        );
    }
    let incidents = command
        .find_subcommand("incidents")
        .and_then(|of| of.get_after_help());
    let text = format!("keeps {INCIDENTS_MAX} incidents");
    assert!(
        incidents.is_some_and(|help| help.to_string().contains(&text)),
        "{text}"
    );
}
