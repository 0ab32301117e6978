//! A daemon under a service manager.

use std::path::Path;
use std::process::Stdio;

use cdcr_testbed::subject::service_manager::ServiceManager;
use rustix::process::Signal;

use crate::{Place, Running, wait_until};

/// A daemon whose service manager expects a watchdog message five times a second.
#[derive(Debug)]
pub struct Managed {
    pub daemon: Running,
    manager: ServiceManager,
    pub place: Place,
}

impl Managed {
    pub fn start() -> Self {
        Self::start_onto(Stdio::null())
    }

    /// Starts the daemon with this standard error.
    pub fn start_onto(stderr: impl Into<Stdio>) -> Self {
        let place = Place::new();
        let manager = listen(place.folder(), "notify");
        let configuration = place.write("robot.toml", "[cycle]\nmiss_limit = 1000000\n");
        let mut command = place.command("cdcrd");
        command
            .args(["run", "--config"])
            .arg(configuration)
            .env("WATCHDOG_USEC", "200000")
            .env_remove("WATCHDOG_PID")
            .env("RUST_LOG", "debug")
            .stdout(Stdio::null())
            .stderr(stderr);
        Self {
            daemon: Running::start(manager.manage(&mut command)),
            manager,
            place,
        }
    }

    /// All received lines, up to a line that starts with `what`.
    pub fn hear_until(&self, what: &str) -> Vec<String> {
        let mut heard = Vec::new();
        wait_until(what, || {
            heard.extend(heard_by(&self.manager));
            heard.iter().any(|line| line.starts_with(what))
        });
        heard
    }

    /// Number of watchdog messages since the last call.
    pub fn fed(&self) -> usize {
        let heard = heard_by(&self.manager);
        heard.iter().filter(|line| *line == "WATCHDOG=1").count()
    }

    pub fn end(&mut self) {
        self.daemon.signal(Signal::TERM);
        assert!(self.daemon.wait(String::new).success());
    }
}

pub fn listen(folder: &Path, name: &str) -> ServiceManager {
    ServiceManager::listen(folder.join(name)).unwrap()
}

/// The lines received since the last call.
pub fn heard_by(manager: &ServiceManager) -> Vec<String> {
    let messages = std::iter::from_fn(|| Some(manager.hear()).filter(|lines| !lines.is_empty()));
    messages.flatten().collect()
}
