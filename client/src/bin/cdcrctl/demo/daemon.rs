use std::fs::{self, DirBuilder, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use cdcr_client::Connection;
use cdcr_shared_types::Location;
use cdcr_shared_types::codes::Mode;
use rustix::process::{Pid, Signal, kill_process};

use crate::interrupt::Interrupt;

/// How long the daemon may take to run.
const START_TIMEOUT: Duration = Duration::from_secs(10);
/// How long it may take to end.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);
/// Where iceoryx2 keeps shared memory.
const SHARED_MEMORY: &str = "/dev/shm";
/// Name of the demo's robot.
const ROBOT: &str = "demo";

/// A daemon of our own in a private place. Dropping it stops it and removes every trace.
pub(super) struct DemoDaemon {
    child: Child,
    place: PrivatePlace,
}

impl DemoDaemon {
    /// Starts the `cdcrd` that lies beside this program.
    pub(super) fn start(config: &str) -> anyhow::Result<Self> {
        let program = beside_ourselves("cdcrd")?;
        let place = PrivatePlace::make()?;
        fs::write(place.config(), config).context("cannot write the demo's configuration")?;
        let log = File::create(place.log()).context("cannot write the daemon's log")?;
        let child = Command::new(&program)
            // Whatever ends us, SIGKILL too, ends the daemon.
            .args(["run", "--end-with-parent", &std::process::id().to_string()])
            .arg("--config")
            .arg(place.config())
            .args(["--robot", ROBOT, "--prefix", place.location.prefix()])
            .arg("--root")
            .arg(place.location.root())
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            // Ctrl-C reaches us alone; we stop the daemon in order.
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        Ok(Self { child, place })
    }

    /// Waits until the daemon controls its robot. `None`: interrupted.
    pub(super) fn connect(&mut self, interrupt: &Interrupt) -> anyhow::Result<Option<Connection>> {
        let deadline = Instant::now() + START_TIMEOUT;
        let mut last = "it did not begin to control its robot".to_owned();
        while Instant::now() < deadline {
            if interrupt.is_raised() {
                return Ok(None);
            }
            if let Some(code) = self.child.try_wait()? {
                bail!(
                    "the demo's daemon ended at once ({code}){}",
                    self.last_words()
                );
            }
            match Connection::open(&self.place.location, ROBOT) {
                Ok(connection) if is_running(&connection) => return Ok(Some(connection)),
                Ok(_) => {}
                Err(cause) => last = cause.to_string(),
            }
            thread::sleep(Duration::from_millis(20));
        }
        Err(anyhow!(
            "the demo's daemon was not ready within {} s: {last}{}",
            START_TIMEOUT.as_secs(),
            self.last_words()
        ))
    }

    /// What the daemon said, for an error message.
    pub(super) fn last_words(&self) -> String {
        let log = fs::read_to_string(self.place.log()).unwrap_or_default();
        match log.trim() {
            "" => "; the daemon said nothing".to_owned(),
            log => format!("; the daemon said:\n{log}"),
        }
    }

    /// Ends the daemon and waits for it.
    pub(super) fn stop(&mut self) -> anyhow::Result<()> {
        if self.child.try_wait()?.is_some() {
            return Ok(());
        }
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::TERM).context("cannot stop the demo's daemon")?;
        let deadline = Instant::now() + STOP_TIMEOUT;
        while Instant::now() < deadline {
            if self.child.try_wait()?.is_some() {
                return Ok(());
            }
            thread::sleep(Duration::from_millis(5));
        }
        self.child.kill()?;
        self.child.wait()?;
        bail!(
            "the demo's daemon did not end within {} s of SIGTERM and was killed{}",
            STOP_TIMEOUT.as_secs(),
            self.last_words()
        )
    }
}

impl Drop for DemoDaemon {
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            eprintln!("warning: {error:#}");
        }
    }
}

fn is_running(connection: &Connection) -> bool {
    connection
        .status(Duration::from_secs(1))
        .is_ok_and(|status| status.mode != Mode::Starting.code())
}

/// A program in the folder of this one.
fn beside_ourselves(name: &str) -> anyhow::Result<PathBuf> {
    let ourselves = std::env::current_exe().context("cannot tell where cdcrctl lies")?;
    let program = ourselves.with_file_name(name);
    if !program.exists() {
        bail!(
            "{} does not exist: the demo needs {name} beside cdcrctl; build both with \
             cargo build --release",
            program.display()
        );
    }
    Ok(program)
}

/// A prefix and a folder that nobody else uses. Dropping it removes what they hold.
struct PrivatePlace {
    folder: PathBuf,
    location: Location,
}

impl PrivatePlace {
    fn make() -> anyhow::Result<Self> {
        let random = RandomState::new().build_hasher().finish() as u32;
        let name = format!("cdcr-demo-{}-{random:08x}", std::process::id());
        let folder = std::env::temp_dir().join(&name);
        let root = folder.join("root");
        let location = Location::new(&format!("{name}_"), &root)
            .context("the demo's folder lies in TMPDIR: set TMPDIR to a shorter absolute path")?;
        DirBuilder::new()
            .mode(0o700)
            .create(&folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Self { folder, location })
    }

    fn config(&self) -> PathBuf {
        self.folder.join("demo.toml")
    }

    fn log(&self) -> PathBuf {
        self.folder.join("cdcrd.log")
    }
}

impl Drop for PrivatePlace {
    fn drop(&mut self) {
        let swept = sweep(Path::new(SHARED_MEMORY), &self.location.file_prefix());
        if let Err(error) = swept.and_then(|()| fs::remove_dir_all(&self.folder)) {
            eprintln!("warning: cannot remove {}: {error}", self.folder.display());
        }
    }
}

/// Removes the files whose names begin with `prefix`: a killed daemon leaves some.
fn sweep(folder: &Path, prefix: &str) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(prefix) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_private_place_is_private_and_leaves_nothing() {
        let place = PrivatePlace::make().expect("a folder");
        let other = PrivatePlace::make().expect("another folder");
        assert_ne!(place.location, other.location);
        fs::write(place.config(), "x").expect("written");
        let stray = Path::new(SHARED_MEMORY).join(format!("{}x", place.location.file_prefix()));
        fs::write(&stray, "x").expect("written");
        let folder = place.folder.clone();
        drop(place);
        assert!(!folder.exists() && !stray.exists());
        assert!(other.folder.exists());
    }
}
