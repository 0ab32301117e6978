//! `SIGHUP`: the configuration is read again while the loop runs.
//!
//! The caretaker does it, because a file may take long. What the solver is set to goes to the exchange; everything else needs a
//! restart.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rtrb::Producer;

use crate::config::{Config, ConfigError, Validated, changed_keys};
use crate::handover::Settings;

/// Reads the configuration, from where it was read at the start.
pub type ReadConfig = Box<dyn Fn() -> Result<Validated, ConfigError> + Send>;

/// Reads the configuration again when it is asked to.
pub(crate) struct Reload {
    asked: Arc<AtomicBool>,
    read: ReadConfig,
    /// What the daemon was started with.
    started: Config,
    settings: Producer<Settings>,
}

impl fmt::Debug for Reload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reload").finish_non_exhaustive()
    }
}

impl Reload {
    /// Of a daemon that was `started` with this configuration. `asked` is set by the signal, `settings` lead to the exchange.
    pub(crate) fn new(
        asked: Arc<AtomicBool>,
        read: ReadConfig,
        started: &Config,
        settings: Producer<Settings>,
    ) -> Self {
        Self {
            asked,
            read,
            started: started.clone(),
            settings,
        }
    }

    /// Reads the configuration if somebody has asked for it since the last call.
    pub(crate) fn look(&mut self) {
        if self.asked.swap(false, Ordering::Relaxed)
            && let Err(reason) = self.read_again()
        {
            tracing::error!(
                "SIGHUP: the configuration is not taken over, nothing changes: {reason}"
            );
        }
    }

    fn read_again(&mut self) -> Result<(), String> {
        let config = (self.read)().map_err(|error| error.to_string())?.config;
        let (least_m, wanted_m) = (
            self.started.controller.safe_distance_m,
            config.controller.safe_distance_m,
        );
        if wanted_m < least_m {
            return Err(format!(
                "controller.safe_distance_m = {wanted_m} is below {least_m}, with which the daemon was started: restart it"
            ));
        }
        self.settings
            .push(Settings::new(&config))
            .map_err(|_| "the exchange thread has not taken the settings before".to_owned())?;
        let changed = changed_keys(&self.started, &config);
        let (now, later): (Vec<_>, Vec<_>) = changed.into_iter().partition(|key| is_solvers(key));
        tracing::info!(
            "SIGHUP: the solver has the settings of the configuration; other than at the start: {}",
            listed(&now)
        );
        if !later.is_empty() {
            tracing::warn!("SIGHUP: in force only after a restart: {}", listed(&later));
        }
        Ok(())
    }
}

/// Whether a running daemon takes the key over.
fn is_solvers(key: &str) -> bool {
    key.starts_with("controller.") || key == "cycle.budget_ms"
}

fn listed(keys: &[String]) -> String {
    if keys.is_empty() {
        "nothing".to_owned()
    } else {
        keys.join(", ")
    }
}
