use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::codes::Outcome;

use crate::config::{Config, ns};
use crate::convert;
use crate::handover::{ChangedSettings, Settings};

/// The settings in force, which clients may change.
#[derive(Debug)]
pub(super) struct SettingsInForce {
    pub(super) settings: Settings,
    /// Grows with each change.
    pub(super) revision: u64,
    /// Of the cycle: no solve may take longer \[ns\].
    period_ns: u64,
    /// The least safe distance that clients may set: the configured one \[m\].
    safe_distance_min_m: f64,
    /// The safe distance that a client set last; 0: none has \[m\].
    safe_distance_set_m: f64,
}

impl SettingsInForce {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            settings: Settings::new(config),
            revision: 0,
            period_ns: ns(config.cycle.period_ms),
            safe_distance_min_m: config.controller.safe_distance_m,
            safe_distance_set_m: 0.0,
        }
    }

    /// Nobody who is connected may let the body come nearer than the configuration does, or a solve take longer than a period.
    pub(super) fn change(&mut self, wanted: &SolverSettings) -> Outcome {
        match convert::settings_from_wire(wanted, self.period_ns) {
            Ok(settings) if settings.nmpc.safe_distance_m < self.safe_distance_min_m => {
                Outcome::OutOfRange
            }
            Ok(settings) => {
                let safe_distance_m = settings.nmpc.safe_distance_m;
                // Clients send all settings, also those that they leave as they are.
                if safe_distance_m != self.settings.nmpc.safe_distance_m {
                    self.safe_distance_set_m = safe_distance_m;
                }
                self.take(settings);
                Outcome::Accepted
            }
            Err(outcome) => outcome,
        }
    }

    /// What has changed in the configuration comes into force, beside what clients have set; where the two do not go together,
    /// the configuration alone does. A safe distance that a client set wider stays in either case.
    pub(super) fn reload(&mut self, changed: &ChangedSettings) {
        let together = convert::with_changes(&self.settings, changed);
        let go_together = together.nmpc.validate().is_ok();
        let mut settings = if go_together { together } else { changed.after };
        let safe_distance_m = &mut settings.nmpc.safe_distance_m;
        *safe_distance_m = safe_distance_m.max(self.safe_distance_set_m);
        self.take(settings);
    }

    /// Checked settings come into force.
    fn take(&mut self, settings: Settings) {
        self.settings = settings;
        self.revision += 1;
    }
}
