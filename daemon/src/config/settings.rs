use cdcr_controller::nmpc::RateWeight;

use super::{Config, ConfigError, Origin, Origins, Validated, keys, rules};

/// A typed configuration before validation, with the origins of its values.
#[derive(Debug, Clone, Default)]
pub struct ConfigDraft {
    pub config: Config,
    pub origins: Origins,
}

impl From<Config> for ConfigDraft {
    fn from(config: Config) -> Self {
        Self::new(config, Origins::default())
    }
}

impl ConfigDraft {
    /// Values as they were set. An automatic rate weight is replaced by the value in force for the robot, and
    /// then counts as a default, even if "auto" was written.
    pub(super) fn new(mut config: Config, mut origins: Origins) -> Self {
        let weight = &mut config.controller.rate_weight;
        if *weight == RateWeight::Auto {
            *weight = RateWeight::auto(config.link.is_ideal());
            origins.forget("controller.rate_weight");
        }
        Self { config, origins }
    }

    /// Validates every value and every rule between values.
    pub fn validate(self) -> Result<Validated, ConfigError> {
        let Self {
            mut config,
            origins,
        } = self;
        rules::check(&config, &origins)?;
        let robot = config.robot.robot(&origins)?;
        let flaws = config.link.flaws(&origins)?;
        let truth = config.link.truth(&robot, &origins)?;
        let initial = config.link.initial(&robot, &origins)?;
        let kind = config.link.kind;
        config.realtime.mode = config.realtime.mode.resolved_for(kind);
        config.obstacles.source_timeout_ms = config.obstacles.source_timeout_ms(kind);
        let location = config.transport.location(&origins)?;
        let group_id = config.transport.group_id(&origins)?;
        Ok(Validated {
            config,
            robot,
            truth,
            flaws,
            initial,
            location,
            group_id,
        })
    }

    /// The values that were set and differ from the default: key, value as TOML, origin as text.
    pub fn changed(&self) -> Vec<(&'static str, String, String)> {
        let values = keys::values(&self.config);
        let changed = keys::settable().filter_map(|(key, default)| {
            let (value, origin) = (keys::value(&values, key)?, self.origins.get(key));
            let is_changed = value != default && origin != Origin::Default;
            is_changed.then(|| (key, keys::text(value), origin.to_string()))
        });
        changed.collect()
    }
}
