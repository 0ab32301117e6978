//! Shared memory that is full, in a place of its own: a private mount of /dev/shm that is as small as it takes.

use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::Mode;
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{Place, Program, binary, text, wait_until};
use rustix::process::Signal;

/// Of the default configuration \[s\].
const PERIOD_S: f64 = 0.005;
/// At most, between two statuses of a daemon that has time.
const STATUS_PERIOD: Duration = Duration::from_millis(100);

/// A private `/dev/shm` of `kilobytes`, for as long as this lives.
struct SmallMemory {
    holder: Child,
    place: Place,
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

impl SmallMemory {
    /// None: the system does not let us; it is said why.
    fn new(kilobytes: u32) -> Option<Self> {
        Self::mounted(&format!("size={kilobytes}k"))
    }

    /// With these options of the mount.
    fn mounted(options: &str) -> Option<Self> {
        let mount = format!("mount -t tmpfs -o {options} tmpfs /dev/shm && echo ready && exec cat");
        let mut command = Command::new("unshare");
        if !is_root() {
            command.arg("--map-root-user");
        }
        let holder = command
            .args(["--mount", "sh", "-c", &mount])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut holder = match holder {
            Ok(holder) => holder,
            Err(cause) => {
                skip(Need::UtilLinux, format!("no unshare: {cause}"));
                return None;
            }
        };
        let mut line = String::new();
        let printed = holder.stdout.as_mut().unwrap();
        let _ = BufReader::new(printed).read_line(&mut line);
        let memory = Self {
            holder,
            place: Place::new(),
        };
        if line.trim() == "ready" {
            return Some(memory);
        }
        skip(
            Need::Mount,
            "the system grants no private mount of /dev/shm",
        );
        None
    }

    /// A program that sees this memory.
    fn command(&self, program: &Path) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--target", &self.holder.id().to_string(), "--mount"]);
        if !is_root() {
            command.args(["--user", "--preserve-credentials"]);
        }
        let location = self.place.location();
        command
            .arg("--")
            .arg(program)
            .env_remove("CDCR_CONFIG")
            .env("CDCR_PREFIX", location.prefix())
            .env("CDCR_ROOT", location.root())
            .stdin(Stdio::null());
        command
    }

    fn daemon(&self, configuration: &str) -> Command {
        let path = self.place.write("robot.toml", configuration);
        let mut command = self.command(&binary("cdcrd"));
        command.args(["run", "--config"]).arg(path);
        command
    }

    fn cdcrctl(&self, arguments: &[&str]) -> Output {
        let mut command = self.command(&binary("cdcrctl"));
        command.args(arguments).output().unwrap()
    }

    fn shell(&self, script: &str) -> Output {
        let mut command = self.command(Path::new("sh"));
        command.args(["-c", script]).output().unwrap()
    }

    /// Takes all that is left but `kilobytes`.
    fn fill(&self, kilobytes: u32) {
        let script = format!(
            "rm -f /dev/shm/fill; free=$(df -k --output=avail /dev/shm | tail -1)\n\
             head -c $(( (free - {kilobytes}) * 1024 )) /dev/zero > /dev/shm/fill"
        );
        let output = self.shell(&script);
        assert!(output.status.success(), "{}", text(&output));
    }

    /// Takes all files that are left but `files`.
    fn fill_files(&self, files: u32) {
        // The daemon may still remove what the client before left: twice the same, then there is no more.
        let script = format!(
            "mkdir -p /dev/shm/fill; cd /dev/shm/fill; name=0; calm=0\n\
             while [ $calm -lt 3 ]; do\n\
             if [ $(stat -f -c %d .) -eq {files} ]; then calm=$((calm + 1)); sleep 0.2; continue; fi\n\
             calm=0; rm -f $(ls | head -{files})\n\
             while [ $(stat -f -c %d .) -gt {files} ]; do : > $name.$$; name=$((name + 1)); done; done"
        );
        let output = self.shell(&script);
        assert!(output.status.success(), "{}", text(&output));
    }

    /// Releases that have passed by the newest status, taken and skipped, and when it was asked for.
    fn releases(&self) -> Option<(u64, Instant)> {
        let asked = Instant::now();
        let status = self.status()?;
        let count = |name: &str| status[name].as_u64();
        Some((count("cycles")? + count("skipped_periods")?, asked))
    }

    fn status(&self) -> Option<serde_json::Value> {
        let output = self.cdcrctl(&["status", "--format", "json"]);
        output
            .status
            .success()
            .then(|| serde_json::from_slice(&output.stdout).unwrap())
    }
}

impl Drop for SmallMemory {
    fn drop(&mut self) {
        let _ = self.holder.kill();
        let _ = self.holder.wait();
    }
}

#[test]
fn a_daemon_that_has_no_room_is_refused_with_what_it_needs() {
    // Too small by little and by much; the default of many containers is large enough.
    for kilobytes in [16, 1_000, 30_000] {
        let Some(memory) = SmallMemory::new(kilobytes) else {
            return;
        };
        let output = memory.daemon("").output().unwrap();
        assert_eq!(
            output.status.code(),
            Some(71),
            "{:?} {}",
            output.status,
            text(&output)
        );
        for part in [
            "/dev/shm",
            "is full",
            "MB are free",
            "remount,size=",
            "--shm-size=",
            "cdcrd doctor",
        ] {
            assert!(text(&output).contains(part), "{part}: {}", text(&output));
        }
        let left = memory.shell("find /dev/shm -type f");
        assert_eq!(text(&left), "", "nothing stays behind");
    }
}

/// A daemon in a memory that is filled up behind it.
fn assert_survives_full_memory(realtime: &str) {
    let Some(memory) = SmallMemory::new(64_000) else {
        return;
    };
    let configuration =
        format!("[cycle]\nmiss_limit = 1000000\n[realtime]\nmode = \"{realtime}\"\n");
    let mut daemon = Program::start(&mut memory.daemon(&configuration));
    wait_until("the daemon is up", || memory.status().is_some());
    let (releases_before, _) = memory.releases().unwrap();
    let answered = Instant::now();
    // Little enough that each client gets stuck somewhere else on its way in.
    for kilobytes in [0, 8, 24, 40, 200] {
        memory.fill(kilobytes);
        for arguments in [
            &["ref", "line", "--track"][..],
            &["echo", "telemetry", "--count", "1"],
        ] {
            let output = memory.cdcrctl(arguments);
            let got_in = output.status.success();
            assert!(!got_in || kilobytes > 8, "{arguments:?}: {}", text(&output));
            println!(
                "{kilobytes} kB left, cdcrctl {}: exit {:?}, signal {:?}, {:?}",
                arguments[0],
                output.status.code(),
                output.status.signal(),
                text(&output).lines().next().unwrap_or_default()
            );
            // It ends by itself, and says why.
            assert_eq!(output.status.signal(), None, "{arguments:?}");
            assert!(got_in || text(&output).starts_with("error: "));
            assert!(daemon.runs(), "the daemon died of a client without room");
        }
        // The daemon publishes a few statuses with what is left.
        std::thread::sleep(2 * STATUS_PERIOD);
    }
    memory.shell("rm /dev/shm/fill");
    wait_until("there is room again", || memory.status().is_some());
    let status = memory.status().unwrap();
    assert_eq!(
        status["mode"].as_str(),
        Some(Mode::Holding.text()),
        "{status}"
    );
    // The loop went on all the while: the status may be behind, but no more than by the half of what has passed.
    let (releases, asked) = memory.releases().unwrap();
    let passed_s = asked.duration_since(answered).as_secs_f64();
    let counted_s = (releases - releases_before) as f64 * PERIOD_S;
    assert!(
        counted_s > 0.5 * passed_s,
        "{counted_s} s of cycles in {passed_s} s"
    );
    daemon.signal(Signal::TERM);
    let output = daemon.output();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
}

#[test]
fn a_stop_gets_through_to_a_daemon_without_room_for_clients() {
    let Some(memory) = SmallMemory::new(64_000) else {
        return;
    };
    let mut daemon = Program::start(&mut memory.daemon("[cycle]\nmiss_limit = 1000000\n"));
    wait_until("the daemon is up", || memory.status().is_some());
    memory.fill(0);
    let output = memory.cdcrctl(&["stop"]);
    // Nobody could answer, so nobody says that it is done.
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    for part in ["not confirmed", "SIGUSR1", "is full"] {
        assert!(text(&output).contains(part), "{part}: {}", text(&output));
    }
    let other = memory.cdcrctl(&["hold"]);
    assert!(text(&other).contains("is full"), "{}", text(&other));
    memory.shell("rm /dev/shm/fill");
    wait_until("it is stopped", || {
        let status = memory.status();
        status.is_some_and(|status| status["mode"].as_str() == Some(Mode::Stopped.text()))
    });
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.output().status.code(), Some(0));
}

#[test]
fn too_few_inodes_are_told_at_the_start_and_to_clients_and_a_stop_gets_through() {
    for inodes in [8, 30, 50] {
        let Some(memory) = SmallMemory::mounted(&format!("size=64000k,nr_inodes={inodes}")) else {
            return;
        };
        let output = memory.daemon("").output().unwrap();
        assert_eq!(output.status.code(), Some(71), "{}", text(&output));
        assert!(text(&output).contains("nr_inodes="), "{}", text(&output));
    }
    let Some(memory) = SmallMemory::mounted("size=64000k,nr_inodes=400") else {
        return;
    };
    let mut daemon = Program::start(&mut memory.daemon("[cycle]\nmiss_limit = 1000000\n"));
    wait_until("the daemon is up", || memory.status().is_some());
    // Without any, and where each client gets stuck somewhere else on its way in.
    for files in [0, 3, 6, 8, 12, 16] {
        memory.fill_files(files);
        for request in ["status", "reset", "stop"] {
            let output = memory.cdcrctl(&[request]);
            let printed = text(&output);
            println!("{files} files left, cdcrctl {request}: {printed}");
            let got_in = output.status.success();
            assert!(!got_in || files > 8, "{request}: {printed}");
            assert!(got_in || printed.contains("nr_inodes="), "{printed}");
            let is_vague = printed.contains("internal") || printed.contains("held up");
            assert!(!is_vague, "{printed}");
            if request == "stop" && !got_in {
                assert!(printed.contains("SIGUSR1"), "{printed}");
            }
        }
        assert!(daemon.runs());
    }
    memory.shell("rm -r /dev/shm/fill");
    wait_until("it is stopped", || {
        let status = memory.status();
        status.is_some_and(|status| status["mode"].as_str() == Some(Mode::Stopped.text()))
    });
    daemon.signal(Signal::TERM);
    assert_eq!(daemon.output().status.code(), Some(0));
}

#[test]
fn memory_that_fills_up_later_keeps_clients_out_and_the_daemon_running() {
    assert_survives_full_memory("off");
}

#[test]
fn memory_that_fills_up_later_does_not_matter_to_locked_memory_either() {
    assert_survives_full_memory("prefer");
}
