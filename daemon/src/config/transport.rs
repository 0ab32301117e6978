use std::path::PathBuf;

use cdcr_shared_types::{DEFAULT_PREFIX, Location, LocationError};
use serde::{Deserialize, Serialize};

use super::{ConfigError, Origins};

/// Where in shared memory daemon and clients meet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TransportConfig {
    /// Prefix of the shared-memory files.
    pub prefix: String,
    /// Root folder, in memory; empty: `/dev/shm/cdcr-<user id>`.
    pub root: String,
}

impl Default for TransportConfig {
    fn default() -> Self {
        Self {
            prefix: DEFAULT_PREFIX.to_owned(),
            root: String::new(),
        }
    }
}

impl TransportConfig {
    /// The place that prefix and root describe.
    pub(super) fn location(&self, origins: &Origins) -> Result<Location, ConfigError> {
        let root = if self.root.is_empty() {
            Location::default_root()
        } else {
            PathBuf::from(&self.root)
        };
        Location::new(&self.prefix, &root).map_err(|error| {
            let key = match error {
                LocationError::Prefix(_) => "transport.prefix",
                LocationError::Root(_) => "transport.root",
            };
            origins.error(&[key], &error.to_string())
        })
    }
}
