use serde::{Deserialize, Serialize};

/// The reference and its lease.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ReferenceConfig {
    /// A lease that is not renewed for this long expires \[ms\].
    pub lease_ms: f64,
}

impl Default for ReferenceConfig {
    fn default() -> Self {
        Self { lease_ms: 500.0 }
    }
}
