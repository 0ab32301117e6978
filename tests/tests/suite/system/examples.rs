//! Every example of the help pages, and of the guides for `cdcrctl`, runs in a shell unchanged.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::proc_stat::has_bit;
use cdcr_tests::{
    Daemon, Place, Program, STALL_TOLERANT, binary, text, until_undisturbed, wait_status,
    wait_until,
};
use rustix::process::Signal;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Each program and command with a manual page, as words.
fn commands() -> Vec<Vec<String>> {
    let pages = fs::read_dir(root().join("packaging/generated/man")).unwrap();
    let names = pages.map(|page| page.unwrap().file_name().into_string().unwrap());
    let names = names.filter(|name| {
        ["cdcrctl", "cdcrd"]
            .iter()
            .any(|ours| name.starts_with(ours))
    });
    let words = names.map(|name| {
        let name = name.trim_end_matches(".1").trim_end_matches(".8");
        name.split('-').map(str::to_owned).collect()
    });
    words.collect()
}

/// The examples of a help page: lines that begin with the program, up to two spaces before a comment.
fn of_help(place: &Place, command: &[String]) -> Vec<String> {
    let program = &command[0];
    let output = place
        .command(program)
        .args(&command[1..])
        .arg("--help")
        .output()
        .unwrap();
    let help = text(&output);
    let (_, help) = help.split_once("\nExample").unwrap_or_default();
    let lines = help
        .lines()
        .map(|line| line.trim_start_matches(['s', ':', ' ']));
    let examples = lines.filter(|line| line.starts_with(&format!("{program} ")));
    examples
        .map(|line| line.split("  ").next().unwrap_or(line).to_owned())
        .collect()
}

/// The lines of a guide's command blocks that call the program as this user.
fn of_guide(path: &Path) -> Vec<String> {
    let guide = fs::read_to_string(path).unwrap();
    let blocks = guide.split("```").skip(1).step_by(2);
    let blocks = blocks.filter_map(|block| block.strip_prefix("sh\n"));
    let lines = blocks.flat_map(|block| {
        let block = block.replace("\\\n", " ").replace("./target/release/", "");
        let lines = block
            .lines()
            .map(|line| line.split(" #").next().unwrap_or(line).trim().to_owned());
        lines.collect::<Vec<_>>()
    });
    lines.filter(|line| line.starts_with("cdcrctl ")).collect()
}

/// A shell at the daemon's place that runs `line`, and waits for its background processes.
pub(super) fn shell(place: &Place, line: &str) -> Program {
    let programs = binary("cdcrctl");
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{path}", programs.parent().unwrap().display());
    let mut command = std::process::Command::new("sh");
    for (name, value) in place.command("cdcrctl").get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    let command = command.args(["-c", &format!("{line}\nstatus=$?; wait; exit $status")]);
    Program::start(command.env("PATH", path).current_dir(place.folder()))
}

/// Whether a process has a handler for `SIGINT`, see `proc_pid_status(5)`.
fn catches_interrupt(process: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    has_bit(&status, "SigCgt", Signal::INT.as_raw().cast_unsigned() - 1)
}

/// Runs an example in a suitable state: a robot that holds, or is stopped for a reset, and no obstacle.
fn run(daemon: &Daemon, line: &str) -> Result<(), String> {
    let place = daemon.place();
    let connection = daemon.connect();
    wait_status(&connection, |status| status.lease_holder == 0);
    if line.starts_with("cdcrctl reset") {
        place.cdcrctl(&["stop"]);
    }
    if line.starts_with("cdcrctl obstacle remove") {
        for id in ["1", "2"] {
            let far = ["--at", "0.9,0.9,0.1", "--radius", "0.01"];
            place.cdcrctl(&[&["obstacle", "add", "--id", id][..], &far].concat());
        }
    }
    let goes_on = ["--watch", "--follow", "telemetry --rate", "--udp"];
    let mut program = if goes_on.iter().any(|option| line.contains(option)) {
        let program = shell(place, &format!("exec {line}"));
        // Repeated, because a library may install a handler for a moment while it connects.
        let mut looks = 0;
        wait_until("it can be interrupted", || {
            looks = if catches_interrupt(program.id()) {
                looks + 1
            } else {
                0
            };
            looks >= 20
        });
        program.signal(Signal::INT);
        program
    } else {
        shell(place, line)
    };
    let output = program.output();
    place.cdcrctl(&["obstacle", "clear"]);
    let status = connection.status(cdcr_tests::TIMEOUT).unwrap();
    if Mode::is_latched(status.mode) {
        place.cdcrctl(&["reset"]);
    }
    println!("$ {line}\n{}", text(&output));
    if output.status.success() {
        return Ok(());
    }
    Err(format!("{line}: {}\n{}", output.status, text(&output)))
}

/// Number of parallel robots for the examples.
const SIDE_BY_SIDE: usize = 8;

#[test]
fn every_example_works_as_typed() {
    let place = Place::new();
    let place = &place;
    let of_helps = commands()
        .into_iter()
        .flat_map(|command| of_help(place, &command));
    let guides = fs::read_dir(root().join("docs")).unwrap();
    let guides = guides
        .map(|entry| entry.unwrap().path())
        .chain([root().join("README.md")]);
    let guides = guides.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    // The tutorial has its own test, because each line needs those before it.
    let guides = guides.filter(|path| !path.ends_with("tutorial.md"));
    let of_guides = guides.flat_map(|path| of_guide(&path));
    let examples: BTreeSet<String> = of_helps.chain(of_guides).collect();
    assert!(examples.len() > 40, "{examples:#?}");
    // Left out: lines that take a minute, have their own tests, or need another place.
    let is_left_out = |line: &&String| {
        let of_their_own = [
            "cdcrd run",
            "cdcrd bare",
            "cdcrd doctor",
            "cdcrctl plant",
            "cdcrctl calibrate",
            "cdcrctl record",
            "cdcrctl scope",
            "cdcrctl top",
        ];
        of_their_own.iter().any(|command| line.contains(command)) || line.contains("--root")
    };
    let examples: Vec<_> = examples.iter().filter(|line| !is_left_out(line)).collect();
    // Each thread has its own daemon. Neighbours in the list take similar times, so they are distributed.
    let examples = &examples;
    std::thread::scope(|scope| {
        for first in 0..SIDE_BY_SIDE {
            scope
                .spawn(move || run_all(examples.iter().copied().skip(first).step_by(SIDE_BY_SIDE)));
        }
    });
}

fn run_all<'a>(examples: impl Iterator<Item = &'a String>) {
    let daemon = Daemon::start(STALL_TOLERANT);
    let folder = daemon.place().folder();
    fs::create_dir(folder.join("configs")).unwrap();
    for (from, file) in [
        ("configs/path.csv", "path.csv"),
        ("configs/path.csv", "configs/path.csv"),
        ("configs/scene.json", "configs/scene.json"),
    ] {
        fs::copy(root().join(from), folder.join(file)).unwrap();
    }
    // Files that the examples read; those that record have other tests. There is an obstacle, so that it can
    // be sent again.
    let obstacle = "cdcrctl obstacle add --id 9 --at 0.5,0,0.5 --radius 0.01";
    daemon.place().checked(obstacle, 0, &[]);
    daemon
        .place()
        .checked("cdcrctl record -o recorded --duration 300ms", 0, &[]);
    let recorded = folder.join("recorded");
    for example in examples {
        let is_recording = |word: &&str| Path::new(word).extension().is_some_and(|of| of == "mcap");
        for file in example.split(' ').filter(is_recording) {
            fs::copy(&recorded, folder.join(file)).unwrap();
        }
        // If the machine stalls for longer than the lead of a reference, the robot does not reach its end.
        until_undisturbed(example, || {
            let tried = run(&daemon, example);
            tried.inspect_err(|error| println!("{error}")).ok()
        });
    }
}
