//! `SIGHUP`: reloads the configuration while the loop runs.
//!
//! A thread is started for each reload, because reading a file may take long, or hang on a lost network.
//! Settings of the solver go to the exchange; all others need a restart.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

use rtrb::Producer;

use crate::config::{Config, ConfigError, Validated, changed_keys};
use crate::handover::{ChangedSettings, RuntimeSettings};

/// Reads the configuration from the same place as at the start.
pub type ReadConfig = Box<dyn Fn() -> Result<Validated, ConfigError> + Send>;

/// The configuration is parsed on this stack.
const STACK_BYTES: usize = 1024 * 1024;

/// Reloads the configuration on request.
#[derive(Debug)]
pub(crate) struct Reload {
    asked: Arc<AtomicBool>,
    reader: Arc<Mutex<Reader>>,
    reading: Option<JoinHandle<()>>,
}

/// Reads the configuration and passes on its changes.
struct Reader {
    read: ReadConfig,
    /// The configuration at the start of the daemon.
    started: Config,
    /// The configuration applied last. Settings in force that differ from it were set by clients.
    last: Config,
    settings: Producer<ChangedSettings>,
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader").finish_non_exhaustive()
    }
}

impl Reload {
    /// For a daemon `started` with this configuration. The signal sets `asked`; `settings` leads to the
    /// exchange.
    pub(crate) fn new(
        asked: Arc<AtomicBool>,
        read: ReadConfig,
        started: &Config,
        settings: Producer<ChangedSettings>,
    ) -> Self {
        let reader = Reader {
            read,
            started: started.clone(),
            last: started.clone(),
            settings,
        };
        Self {
            asked,
            reader: Arc::new(Mutex::new(reader)),
            reading: None,
        }
    }

    /// The flag that requests a reload.
    pub(crate) fn asked(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.asked)
    }

    /// A reload was requested since the last [`Self::start_if_wanted`], and none is running.
    pub(crate) fn is_wanted(&self) -> bool {
        let is_being_read = |thread: &JoinHandle<()>| !thread.is_finished();
        self.asked.load(Ordering::Relaxed) && !self.reading.as_ref().is_some_and(is_being_read)
    }

    /// Starts a reload if it [is wanted](Self::is_wanted).
    pub(crate) fn start_if_wanted(&mut self) {
        if !self.is_wanted() {
            return;
        }
        self.asked.store(false, Ordering::Relaxed);
        let reader = Arc::clone(&self.reader);
        let thread = Builder::new()
            .name("cdcr-reload".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || {
                // Only one thread at a time is here; a panic has been reported.
                let mut reader = reader.lock().unwrap_or_else(PoisonError::into_inner);
                log_result(reader.read_again());
            });
        self.reading = thread
            .map_err(|error| log_result(Err(format!("the thread cdcr-reload: {error}"))))
            .ok();
    }
}

fn log_result(result: Result<(), String>) {
    if let Err(reason) = result {
        tracing::error!("SIGHUP: rejected the configuration, nothing changed: {reason}");
    }
}

impl Reader {
    fn read_again(&mut self) -> Result<(), String> {
        tracing::info!("SIGHUP: reloading the configuration");
        let config = (self.read)().map_err(|error| error.to_string())?.config;
        self.check(&config)?;
        let is_solvers = |key: &String| key.starts_with("controller.") || key == "cycle.budget_ms";
        let mut changed = changed_keys(&self.last, &config);
        changed.retain(is_solvers);
        let mut later = changed_keys(&self.started, &config);
        later.retain(|key| !is_solvers(key));
        if !changed.is_empty() {
            let changed = ChangedSettings {
                before: RuntimeSettings::new(&self.last),
                after: RuntimeSettings::new(&config),
            };
            self.settings.push(changed).map_err(|_| {
                "the exchange thread has not yet applied the previous settings".to_owned()
            })?;
        }
        self.last = config;
        tracing::info!("SIGHUP: applied keys: {}", listed(&changed));
        if !later.is_empty() {
            tracing::warn!("SIGHUP: keys that need a restart: {}", listed(&later));
        }
        Ok(())
    }

    /// Checks that the running daemon can use the settings of this configuration.
    fn check(&self, config: &Config) -> Result<(), String> {
        let (least_m, wanted_m) = (
            self.started.controller.safe_distance_m,
            config.controller.safe_distance_m,
        );
        if wanted_m < least_m {
            return Err(format!(
                "controller.safe_distance_m = {wanted_m} is below {least_m}, the value at the start of the daemon: restart it"
            ));
        }
        // The default of the rate weight depends on the robot.
        if config.link.is_ideal() != self.started.link.is_ideal() {
            return Err(
                "link.kind or link.simulated selects another robot than the running one: restart the daemon"
                    .to_owned(),
            );
        }
        Ok(())
    }
}

fn listed(keys: &[String]) -> String {
    if keys.is_empty() {
        "none".to_owned()
    } else {
        keys.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use rtrb::{Consumer, RingBuffer};

    use super::*;

    fn parsed(text: &str) -> Result<Validated, ConfigError> {
        Config::parse(text, Path::new("robot.toml"))
    }

    /// A reader of a file with each of `texts` in turn; the first is that of the start.
    fn reader(texts: &[&'static str]) -> (Reader, Consumer<ChangedSettings>) {
        let started = parsed(texts[0]).unwrap().config;
        let (send, next) = channel();
        for text in &texts[1..] {
            send.send(*text).unwrap();
        }
        let (settings, changed) = RingBuffer::new(4);
        let reader = Reader {
            read: Box::new(move || parsed(next.try_recv().unwrap())),
            last: started.clone(),
            started,
            settings,
        };
        (reader, changed)
    }

    #[test]
    fn only_what_has_changed_since_it_was_read_last_is_handed_on() {
        let seven = "[controller]\nhorizon_steps = 7\n";
        let (mut reader, mut changed) = reader(&["", "", seven, seven, ""]);
        reader.read_again().unwrap();
        assert!(changed.pop().is_err(), "a terminal hung up");
        reader.read_again().unwrap();
        let first = changed.pop().unwrap();
        assert_ne!(first.before.nmpc.horizon_steps, 7);
        assert_eq!(first.after.nmpc.horizon_steps, 7);
        reader.read_again().unwrap();
        assert!(changed.pop().is_err());
        reader.read_again().unwrap();
        let back = changed.pop().unwrap();
        assert_eq!((back.before, back.after), (first.after, first.before));
    }

    #[test]
    fn a_configuration_of_another_kind_of_robot_changes_nothing() {
        let driver = "[link]\nkind = \"driver\"\n[controller]\nhorizon_steps = 7\n";
        let (mut reader, mut changed) = reader(&["", driver, "[controller]\nhorizon_steps = 7\n"]);
        let refused = reader.read_again().unwrap_err();
        assert!(refused.contains("link.kind"), "{refused}");
        assert!(changed.pop().is_err());
        reader.read_again().unwrap();
        assert!(changed.pop().is_ok());
    }

    #[test]
    fn a_file_that_hangs_holds_nobody_up_and_is_not_read_twice_at_a_time() {
        let (begun, begins) = channel();
        let (go_on, may_go_on) = channel::<()>();
        let read = Box::new(move || {
            begun.send(()).unwrap();
            may_go_on.recv().unwrap();
            parsed("[controller]\nhorizon_steps = 7\n")
        });
        let (settings, mut changed) = RingBuffer::new(4);
        let asked = Arc::new(AtomicBool::new(true));
        let started = Config::default();
        let mut reload = Reload::new(Arc::clone(&asked), read, &started, settings);
        reload.start_if_wanted();
        begins.recv().unwrap();
        // The reload hangs. A request meanwhile is served afterwards.
        asked.store(true, Ordering::Relaxed);
        reload.start_if_wanted();
        assert!(begins.try_recv().is_err() && asked.load(Ordering::Relaxed));
        for _ in 0..2 {
            go_on.send(()).unwrap();
        }
        while begins.try_recv().is_err() {
            std::thread::sleep(Duration::from_millis(1));
            reload.start_if_wanted();
        }
        reload.reading.unwrap().join().unwrap();
        assert!(changed.pop().is_ok() && changed.pop().is_err());
    }
}
