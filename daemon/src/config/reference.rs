table! {
    /// The reference and its lease.
    pub struct ReferenceConfig {
        /// A reference lease that is not renewed for this long expires, and the robot holds, {range}.
        lease_ms: f64 = 500.0, in 20.0..=60_000.0;
    }
}
