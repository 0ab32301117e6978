use serde::{Deserialize, Serialize};

cdcr_controller::parameters! {
    /// The reference and its lease.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(test, derive(schemars::JsonSchema))]
    #[serde(default, deny_unknown_fields)]
    pub struct ReferenceConfig {
        /// A reference lease that is not renewed for this long expires, and the robot holds, {range}.
        lease_ms: f64 = 500.0, in 20.0..=60_000.0;
    }
}
