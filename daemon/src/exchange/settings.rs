use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::codes::Outcome;

use crate::config::{Config, ns};
use crate::convert;
use crate::handover::{ChangedSettings, RuntimeSettings};

/// The settings in force, which clients may change.
#[derive(Debug)]
pub(super) struct SettingsInForce {
    pub(super) settings: RuntimeSettings,
    /// Grows with each change.
    pub(super) revision: u64,
    /// Period of the cycle: the longest allowed solve \[ns\].
    period_ns: u64,
    /// Safe distance of the configuration read last: the smallest that clients may set \[m\].
    pub(super) safe_distance_min_m: f64,
    /// Safe distance last set by a client, wider than the configured one \[m\]; 0: none.
    safe_distance_set_m: f64,
}

impl SettingsInForce {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            settings: RuntimeSettings::new(config),
            revision: 0,
            period_ns: ns(config.cycle.period_ms),
            safe_distance_min_m: config.controller.safe_distance_m,
            safe_distance_set_m: 0.0,
        }
    }

    /// Clients can neither reduce the safe distance below the configured one, nor let a solve take longer
    /// than a period.
    pub(super) fn change(&mut self, wanted: &SolverSettings) -> Outcome {
        match convert::settings_from_wire(wanted, self.period_ns) {
            Ok(settings) if settings.nmpc.safe_distance_m < self.safe_distance_min_m => {
                Outcome::OutOfRange
            }
            Ok(settings) => {
                let safe_distance_m = settings.nmpc.safe_distance_m;
                // Clients send all settings, including those that they do not change.
                if safe_distance_m != self.settings.nmpc.safe_distance_m {
                    let is_wider = safe_distance_m > self.safe_distance_min_m;
                    self.safe_distance_set_m = if is_wider { safe_distance_m } else { 0.0 };
                }
                self.take(settings);
                Outcome::Accepted
            }
            Err(outcome) => outcome,
        }
    }

    /// Applies the changes of the configuration to the settings of the clients; if the combination is
    /// invalid, only the configuration applies. A larger safe distance set by a client remains in either
    /// case.
    pub(super) fn reload(&mut self, changed: &ChangedSettings) {
        let together = convert::with_changes(&self.settings, changed);
        let go_together = together.nmpc.validate().is_ok();
        self.safe_distance_min_m = changed.after.nmpc.safe_distance_m;
        let mut settings = if go_together { together } else { changed.after };
        let safe_distance_m = &mut settings.nmpc.safe_distance_m;
        *safe_distance_m = safe_distance_m.max(self.safe_distance_set_m);
        self.take(settings);
    }

    /// Puts validated settings into force.
    fn take(&mut self, settings: RuntimeSettings) {
        self.settings = settings;
        self.revision += 1;
    }
}
