use cdcr_controller::nmpc::RateWeight;

use super::error::Result;
use super::{Config, LinkKind, Origins, RealtimeMode, Validated, keys, rules};

/// A typed configuration before validation, with the origins of its values.
#[derive(Debug, Clone, Default)]
pub struct ConfigDraft {
    pub config: Config,
    pub origins: Origins,
}

impl ConfigDraft {
    /// Values as they were set. An automatic rate weight is replaced by the value in force for the robot, and
    /// then counts as a default, even if "auto" was written.
    pub(super) fn new(mut config: Config, mut origins: Origins) -> Self {
        let weight = &mut config.controller.rate_weight;
        if *weight == RateWeight::Auto {
            *weight = RateWeight::auto(config.link.is_ideal());
            origins.0.remove("controller.rate_weight");
        }
        Self { config, origins }
    }

    /// Validates every value and every rule between values.
    pub fn validate(self) -> Result<Validated> {
        let (mut config, origins) = (self.config, self.origins);
        rules::check(&config, &origins)?;
        let is_driver = config.link.kind == LinkKind::Driver;
        let mode = &mut config.realtime.mode;
        *mode = match *mode {
            RealtimeMode::Auto if is_driver => RealtimeMode::Require,
            RealtimeMode::Auto => RealtimeMode::Prefer,
            set => set,
        };
        let timeout_ms = &mut config.obstacles.source_timeout_ms;
        if *timeout_ms == -1.0 {
            *timeout_ms = if is_driver { 500.0 } else { 0.0 };
        }
        let robot = config.robot.robot(&origins)?;
        Ok(Validated {
            flaws: config.link.flaws(&origins)?,
            truth: config.link.truth(&robot, &origins)?,
            initial: config.link.initial(&robot, &origins)?,
            location: config.transport.location(&origins)?,
            group_id: config.transport.group_id(&origins)?,
            robot,
            config,
        })
    }

    /// The values that were set and differ from the default: key, value as TOML, origin.
    pub fn changed(&self) -> Vec<(&'static str, String, String)> {
        let values = keys::values(&self.config);
        let changed = keys::settable().filter_map(|(key, default)| {
            let (value, origin) = (keys::value(&values, key)?, self.origins.get(key)?);
            (value != default).then(|| (key, keys::text(value), origin.to_owned()))
        });
        changed.collect()
    }
}
