//! Child programs: their output is kept, and no program outlives this process. Daemons run in a private
//! [`PrivatePlace`].
//!
//! Invariant: nothing here knows a client, a robot or a benchmark, so that the demo of `cdcrctl` can use it.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    reason = "a library of this workspace: a comment that repeats a name helps nobody"
)]

mod daemon;
mod folder;
mod place;

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use cdcr_scratch::Scratch;
use rustix::process::{
    Pid, Signal, WaitId, WaitIdOptions, kill_process, kill_process_group, waitid,
};

pub use daemon::PlacedDaemon;
pub use folder::{check_writable, fill_folder, output_folder};
pub use place::{PREFIX, PrivatePlace, ROOT, cdcrd_in, in_public_memory};

/// Interval between checks whether a program has ended.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Time for the threads of a process that has ended to leave the kernel.
const THREADS_END: Duration = Duration::from_millis(5);
/// Time limit for a program to end after SIGTERM.
const END_TIMEOUT: Duration = Duration::from_secs(5);

/// A running program. Dropping it ends the program and removes its output files.
#[derive(Debug)]
pub struct Process {
    name: &'static str,
    child: Child,
    /// Exit status, once known: from then on another process may get the id.
    ended: Option<ExitStatus>,
    folder: Scratch,
}

impl Process {
    /// Starts the program in its own process group, so that Ctrl-C reaches only this process, which ends the
    /// program in order. Output goes to files, so the program never waits for a reader.
    pub fn start(name: &'static str, command: Command) -> Result<Self> {
        Self::start_in(folder()?, name, command)
    }

    /// As [`Self::start`], with a folder whose path is in the command. The folder is removed with the
    /// process.
    pub fn start_in(folder: Scratch, name: &'static str, mut command: Command) -> Result<Self> {
        let file = |what: &str| {
            File::create(folder.path().join(what)).with_context(|| {
                format!(
                    "cannot write into {}: set TMPDIR to a folder with free space",
                    folder.path().display()
                )
            })
        };
        let child = command
            .stdin(Stdio::null())
            .stdout(file(STDOUT)?)
            .stderr(file(STDERR)?)
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {name}"))?;
        Ok(Self {
            name,
            child,
            ended: None,
            folder,
        })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Whether the program has ended by itself. If so, kills the rest of its process group.
    pub fn has_ended(&mut self) -> Result<bool> {
        Ok(self.poll()?.is_some())
    }

    /// Waits until the program ends by itself, and returns its standard output. Fails after `limit` or when
    /// `check` fails.
    pub fn wait(&mut self, limit: Duration, check: impl Fn() -> Result<()>) -> Result<String> {
        let Some(status) = self.ended_within(limit, check)? else {
            let seconds = limit.as_secs();
            bail!(
                "{} did not end within {seconds} s{}",
                self.name,
                self.output_tail()
            );
        };
        let words = || self.output_tail();
        ensure!(
            status.success(),
            "{} failed: {status}{}",
            self.name,
            words()
        );
        fs::read_to_string(self.folder().join(STDOUT))
            .with_context(|| format!("what {} wrote", self.name))
    }

    /// Ends the program with SIGTERM, or SIGKILL after the time limit. Also kills the rest of its process
    /// group, even if the program ended by itself.
    pub fn end(&mut self) -> Result<()> {
        if self.has_ended()? {
            return Ok(());
        }
        let process = Pid::from_child(&self.child);
        let asked = kill_process(process, Signal::TERM);
        asked.with_context(|| format!("SIGTERM to {}", self.name))?;
        if self.ended_within(END_TIMEOUT, || Ok(()))?.is_some() {
            return Ok(());
        }
        // The process has not been waited for, so the id is still its own.
        let _ = kill_process_group(process, Signal::KILL);
        self.child.kill()?;
        has_ended(&self.child, WaitIdOptions::empty())?;
        self.ended = Some(reap(&mut self.child)?);
        let seconds = END_TIMEOUT.as_secs();
        let (name, words) = (self.name, self.output_tail());
        bail!("{name} did not end within {seconds} s of SIGTERM and was killed{words}")
    }

    /// What it printed, as the end of an error message: standard error, or the begin of standard output.
    pub fn output_tail(&self) -> String {
        // Some programs report errors on standard output.
        let words = match self.written(STDERR) {
            errors if errors.trim().is_empty() => self.written(STDOUT).chars().take(2000).collect(),
            errors => errors,
        };
        match words.trim() {
            "" => "; it printed nothing".to_owned(),
            words => format!("; its output:\n{words}"),
        }
    }

    /// The standard error output.
    pub fn stderr(&self) -> String {
        self.written(STDERR)
    }

    fn written(&self, file: &str) -> String {
        fs::read_to_string(self.folder().join(file)).unwrap_or_default()
    }

    /// Exit status, if the program has ended. Kills the rest of its process group first.
    fn poll(&mut self) -> Result<Option<ExitStatus>> {
        if self.ended.is_none() && has_ended(&self.child, WaitIdOptions::NOHANG)? {
            // The process has not been waited for, so the id is still its own.
            let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
            self.ended = Some(reap(&mut self.child)?);
        }
        Ok(self.ended)
    }

    fn ended_within(
        &mut self,
        limit: Duration,
        check: impl Fn() -> Result<()>,
    ) -> Result<Option<ExitStatus>> {
        let deadline = Instant::now() + limit;
        loop {
            check()?;
            let status = self.poll()?;
            if status.is_some() || Instant::now() >= deadline {
                return Ok(status);
            }
            thread::sleep(POLL_INTERVAL);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            // `eprintln!` would panic when standard error is closed.
            let _ = writeln!(io::stderr(), "warning: {error:#}");
        }
    }
}

/// Whether a child has ended; with [`WaitIdOptions::empty`], after its end. It stays a zombie.
///
/// # Errors
/// Those of the system, of a child that was reaped.
pub fn has_ended(child: &Child, options: WaitIdOptions) -> io::Result<bool> {
    let options = options | WaitIdOptions::EXITED | WaitIdOptions::NOWAIT;
    Ok(waitid(WaitId::Pid(Pid::from_child(child)), options)?.is_some())
}

/// Reaps a child that [has ended](has_ended), a moment later.
///
/// Whoever reaps a process while its last threads leave the kernel waits for them in a busy loop, on Linux 6.18. Without forced pre-emption
/// that loop was seen to keep all ordinary threads off its core, those threads too, for up to two minutes.
///
/// # Errors
/// Those of the system.
pub fn reap(child: &mut Child) -> io::Result<ExitStatus> {
    thread::sleep(THREADS_END);
    child.wait()
}

/// Names of the output files.
const STDOUT: &str = "stdout";
const STDERR: &str = "stderr";

/// Creates a folder for the files of a program.
pub fn folder() -> Result<Scratch> {
    Scratch::temporary()
        .context("a folder for temporary files: set TMPDIR to one that can be written")
}

/// Path of a program of this project: in the folder of the current program or, for a test, in the folder
/// above.
pub fn program(name: &str) -> Result<PathBuf> {
    let ourselves =
        std::env::current_exe().context("cannot determine the folder of this program")?;
    let beside = ourselves.with_file_name(name);
    let tests = ourselves.parent().filter(|folder| folder.ends_with("deps"));
    let above = tests.map(|folder| folder.with_file_name(name));
    let mut found = [Some(beside.clone()), above].into_iter().flatten();
    found.find(|path| path.is_file()).with_context(|| {
        format!(
            "{} does not exist: {} needs {name} beside itself; build both with cargo build --release",
            beside.display(),
            ourselves.file_name().unwrap_or_default().display()
        )
    })
}

/// Finds a program by its name in `PATH`.
pub fn on_path(name: &str) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders)
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
}

/// A command whose process gets SIGTERM when the thread that starts it ends, for any reason. Without
/// `setpriv` (util-linux), only dropping the [`Process`] ends it.
pub fn that_ends_with_us(program: &Path) -> Command {
    match on_path("setpriv") {
        Some(setpriv) => {
            let mut command = Command::new(setpriv);
            command.args(["--pdeathsig", "TERM", "--"]).arg(program);
            command
        }
        None => Command::new(program),
    }
}

#[cfg(test)]
mod tests {
    use cdcr_test_skip::{Need, skip};
    use rustix::process::test_kill_process;

    use super::*;

    const TIMEOUT: Duration = Duration::from_secs(30);

    fn shell(script: &str) -> Process {
        let mut command = that_ends_with_us(&on_path("sh").unwrap());
        command.args(["-c", script]);
        Process::start("sh", command).unwrap()
    }

    fn until_it_speaks(process: &Process) {
        let reported = process.folder().join(STDOUT);
        let deadline = Instant::now() + TIMEOUT;
        while fs::read_to_string(&reported).unwrap().is_empty() {
            assert!(Instant::now() < deadline, "it says nothing");
            thread::sleep(POLL_INTERVAL);
        }
    }

    #[test]
    fn the_output_of_a_program_is_kept() {
        assert_eq!(
            shell("echo one; echo two >&2")
                .wait(TIMEOUT, || Ok(()))
                .unwrap(),
            "one\n"
        );
        for (script, words) in [
            ("echo one; echo why >&2; exit 3", "its output:\nwhy"),
            ("echo one; exit 3", "its output:\none"),
            ("exit 3", "it printed nothing"),
        ] {
            let error = shell(script).wait(TIMEOUT, || Ok(())).unwrap_err();
            let expected = format!("sh failed: exit status: 3; {words}");
            assert_eq!(error.to_string(), expected);
        }
        let error = shell("sleep 100")
            .wait(Duration::ZERO, || Ok(()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("did not end within 0 s"), "{error}");
    }

    #[test]
    fn a_dropped_program_has_ended_and_its_folder_is_gone() {
        let process = shell("exec sleep 100");
        let (id, folder) = (Pid::from_child(&process.child), process.folder().to_owned());
        assert!(test_kill_process(id).is_ok() && folder.exists());
        drop(process);
        assert!(test_kill_process(id).is_err() && !folder.exists());
    }

    #[test]
    fn what_a_program_leaves_in_its_group_ends_when_it_has_ended() {
        let mut process = shell("sleep 100 & echo $!");
        let left = process.wait(TIMEOUT, || Ok(())).unwrap();
        let stat = Path::new("/proc").join(left.trim()).join("stat");
        let deadline = Instant::now() + TIMEOUT;
        // The process is gone, or is a zombie that its new parent has not waited for.
        while fs::read_to_string(&stat).is_ok_and(|stat| !stat.contains(") Z ")) {
            assert!(Instant::now() < deadline, "{left} still runs");
            thread::sleep(POLL_INTERVAL);
        }
        process.end().unwrap();
    }

    #[test]
    fn a_program_ends_with_the_thread_that_started_it() {
        if on_path("setpriv").is_none() {
            skip(Need::UtilLinux, "there is no setpriv");
            return;
        }
        // The thread returns the process instead of dropping it.
        let starter = thread::spawn(|| {
            let process = shell("echo on; exec sleep 100");
            until_it_speaks(&process);
            process
        });
        let error = starter
            .join()
            .unwrap()
            .wait(TIMEOUT, || Ok(()))
            .unwrap_err();
        assert!(error.to_string().contains("signal: 15"), "{error}");
    }

    #[test]
    fn a_program_that_does_not_want_to_end_is_killed() {
        let mut process = shell("trap '' TERM; echo on; while :; do sleep 100; done");
        until_it_speaks(&process);
        let error = process.end().unwrap_err().to_string();
        assert!(error.contains("was killed"), "{error}");
        assert!(process.has_ended().unwrap());
    }
}
