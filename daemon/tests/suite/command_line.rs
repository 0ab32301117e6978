//! The command line of `cdcrd`, without starting the daemon. (This test also makes cargo build the binary for
//! the tests of the whole system.)
use std::process::{Command, Output};

use cdcr_daemon::config::DEFAULT_TEXT;
use cdcr_scratch::Scratch;

/// `cdcrd` with no variables of ours except `environment`.
fn cdcrd_in(environment: &[(&str, &str)], arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrd"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("CDCR_") {
            command.env_remove(name);
        }
    }
    command.envs(environment.iter().copied());
    command.args(arguments).output().expect("cdcrd runs")
}

pub(crate) fn cdcrd(arguments: &[&str]) -> Output {
    cdcrd_in(&[], arguments)
}

fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Output of a successful call.
fn printed(output: &Output) -> String {
    assert!(output.status.success(), "{}", text_of(&output.stderr));
    text_of(&output.stdout)
}

/// Error of a call that fails because of its configuration.
fn refused(output: &Output) -> String {
    let text = text_of(&output.stderr);
    assert_eq!(output.status.code(), Some(78), "{text}");
    text
}

#[test]
fn options_win_over_defaults_and_are_checked() {
    assert_eq!(printed(&cdcrd(&["config", "default"])), DEFAULT_TEXT);
    let good = cdcrd(&[
        "check", "--robot", "trunk", "--prefix", "lab_", "--root", "/tmp/lab",
    ]);
    let text = printed(&good);
    for part in [
        "trunk (simulated)",
        "section 3 ",
        "kpso-refined",
        "lab_ in /tmp/lab",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let text = refused(&cdcrd(&["check", "--prefix", "a b"]));
    assert!(
        text.contains("--prefix: transport.prefix: invalid prefix \"a b\""),
        "{text}"
    );
}

#[test]
fn an_option_wins_over_a_variable_over_the_file_over_the_default() {
    let folder = Scratch::in_memory().unwrap();
    let file = folder.path().join("robot.toml");
    std::fs::write(&file, "[cycle]\n\nperiod_ms = 2.0\n").unwrap();
    let file = file.to_str().unwrap();
    let explain = ["config", "explain", "cycle.period_ms"];
    let with_file = [&explain[..], &["--config", file]].concat();
    let with_option = [&with_file[..], &["--set", "cycle.period_ms=4"]].concat();
    // An empty variable counts as not set.
    let variable = [("CDCR_CYCLE_PERIOD_MS", "3"), ("CDCR_CYCLE_MISS_LIMIT", "")];
    for (output, value, origin) in [
        (cdcrd(&explain), "5.0", "default".to_owned()),
        (cdcrd(&with_file), "2.0", format!("{file}, line 3")),
        (
            cdcrd_in(&[("CDCR_CONFIG", file)], &explain),
            "2.0",
            format!("{file}, line 3"),
        ),
        (
            cdcrd_in(&variable, &with_file),
            "3.0",
            "CDCR_CYCLE_PERIOD_MS".to_owned(),
        ),
        (cdcrd_in(&variable, &with_option), "4.0", "--set".to_owned()),
    ] {
        let text = printed(&output);
        let expected = format!("\n  value     {value}\n  from      {origin}\n");
        assert!(text.contains(&expected), "{expected}{text}");
    }
    let text = printed(&cdcrd_in(
        &variable,
        &["check", "--config", file, "--set", "robot.name=trunk"],
    ));
    for line in [
        "  cycle.period_ms = 3.0  (CDCR_CYCLE_PERIOD_MS)",
        "  robot.name = \"trunk\"  (--set)",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}: {text}");
    }
}

#[test]
fn short_variables_are_below_every_option() {
    let environment = [("CDCR_ROBOT", "one"), ("CDCR_PREFIX", "lab_")];
    let text = printed(&cdcrd_in(&environment, &["check"]));
    assert!(
        text.contains("robot.name = \"one\"  (CDCR_ROBOT)"),
        "{text}"
    );
    assert!(text.contains("(CDCR_PREFIX)"), "{text}");
    let text = printed(&cdcrd_in(
        &environment,
        &["check", "--set", "robot.name=two"],
    ));
    assert!(text.contains("robot.name = \"two\"  (--set)"), "{text}");
    let text = printed(&cdcrd_in(&environment, &["check", "--robot", "three"]));
    assert!(text.contains("robot.name = \"three\"  (--robot)"), "{text}");
}

#[test]
fn what_is_no_text_is_refused() {
    use std::os::unix::ffi::OsStrExt;
    let root = std::ffi::OsStr::from_bytes(b"/tmp/\xff");
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrd"));
    command.arg("check").arg("--root").arg(root);
    let text = refused(&command.output().unwrap());
    assert!(text.contains("--root: transport.root: "), "{text}");
    assert!(text.contains("not UTF-8 text"), "{text}");
}

/// An unset variable of a script must not lead to the default root.
#[test]
fn an_empty_root_is_refused() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrd"));
    let output = command.args(["check", "--root", ""]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(
        text.contains("a value is required for '--root <DIR>'"),
        "{text}"
    );
}

#[test]
fn mistakes_name_their_place_and_the_nearest_key() {
    let text = refused(&cdcrd(&["check", "--set", "cycle.period=2"]));
    assert!(
        text.contains("--set: unknown key cycle.period: did you mean cycle.period_ms?"),
        "{text}"
    );
    let environment = [("CDCR_CYCLE_PERIOD_MS", "0.05")];
    let text = refused(&cdcrd_in(&environment, &["check"]));
    assert!(
        text.contains("CDCR_CYCLE_PERIOD_MS: cycle.period_ms: 0.05 is out of range"),
        "{text}"
    );
    let text = refused(&cdcrd(&["config", "explain", "period_ms"]));
    assert!(text.contains("did you mean cycle.period_ms?"), "{text}");
    let text = refused(&cdcrd(&["check", "--config", "/no/such.toml"]));
    assert!(
        text.contains("/no/such.toml") && text.contains("config default"),
        "{text}"
    );
    let usage = cdcrd(&["check", "--set", "cycle.period_ms"]);
    assert_eq!(usage.status.code(), Some(2));
    assert!(text_of(&usage.stderr).contains("for example cycle.period_ms=2"));
}

#[test]
fn a_doubtful_configuration_and_a_misspelt_variable_are_warned_of() {
    let output = cdcrd_in(
        &[("CDCR_CYCLE_PERIOD", "2"), ("CDCR_TEST_SECONDS", "1")],
        &["check", "--set", "link.command_valid_ms=2"],
    );
    let text = printed(&output);
    assert!(
        text.contains("warning: link.command_valid_ms = 2"),
        "{text}"
    );
    for (budget_ms, is_warned_of) in [("0.001", true), ("0.05", false), ("0", false)] {
        let output = cdcrd(&["check", "--set", &format!("cycle.budget_ms={budget_ms}")]);
        let warning = "warning: cycle.budget_ms = 0.001 is too short";
        let text = printed(&output);
        assert_eq!(text.contains(warning), is_warned_of, "{text}");
    }
    let log = text_of(&output.stderr);
    assert!(
        log.contains("CDCR_CYCLE_PERIOD sets nothing: did you mean CDCR_CYCLE_PERIOD_MS?"),
        "{log}"
    );
    assert!(!log.contains("CDCR_TEST"), "{log}");
    for (interface, is_warned_of) in [("position", true), ("velocity", false)] {
        let interface = format!("link.interface={interface}");
        let driver = ["check", "--set", "link.kind=driver", "--set", &interface];
        let output = cdcrd(&[&driver[..], &["--set", "link.measurement_timeout_ms=250"]].concat());
        let text = printed(&output);
        let warning = "warning: link.measurement_timeout_ms = 250: a position driver that hangs";
        assert_eq!(text.contains(warning), is_warned_of, "{text}");
    }
}

#[test]
fn a_daemon_that_may_open_too_few_files_names_the_limit() {
    let folder = Scratch::in_memory().unwrap();
    let output = Command::new("sh")
        .args(["-c", "ulimit -n 40 && exec \"$0\" run --root \"$1\""])
        .arg(env!("CARGO_BIN_EXE_cdcrd"))
        .arg(folder.path().join("root"))
        .env("CDCR_PREFIX", folder.prefix())
        .output()
        .expect("sh runs");
    let text = text_of(&output.stderr);
    assert_eq!(output.status.code(), Some(71), "{text}");
    assert!(text.contains("can open only 40 files"), "{text}");
    assert!(text.contains("ulimit -n 1024"), "{text}");
    assert!(!folder.path().join("root").exists());
}

#[test]
fn the_schema_is_json() {
    let text = printed(&cdcrd(&["config", "schema"]));
    let schema: serde_json::Value = serde_json::from_str(&text).unwrap();
    let period = &schema["properties"]["cycle"]["properties"]["period_ms"];
    assert_eq!(period["minimum"], 0.1);
    assert_eq!(period["maximum"], 100.0);
    assert_eq!(period["default"], 5.0);
    assert_eq!(
        period["description"],
        "Period of the control loop, 0.1 to 100 ms, and at least twice gather_lead_ms."
    );
}

#[test]
fn help_shows_an_example() {
    for command in [
        &["--help"][..],
        &["run", "--help"],
        &["bare", "--help"],
        &["check", "--help"],
        &["config", "default", "--help"],
        &["config", "schema", "--help"],
        &["config", "explain", "--help"],
    ] {
        let text = printed(&cdcrd(command));
        assert!(text.contains("Example:"), "{command:?}: {text}");
    }
}
