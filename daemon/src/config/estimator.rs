table! {
    /// How the configuration of the robot is estimated.
    pub struct EstimatorConfig {
        /// By how much the estimate follows later what is measured, {range}; 0: at once. Three filters of first order, each with a third of it as
        /// time constant: twice as long, noise of the sensors changes the rates a sixth as much. At least four times the lag of the motors
        /// that [actuator] does not know, or the loop may oscillate. The ideal simulated robot is measured exactly, and believed at once.
        time_constant_ms: f64 = 180.0, in 0.0..=10_000.0;
        /// Noise of a measured coordinate of the tip, {range}: standard deviation. What the estimate makes of a tip that alone is measured
        /// depends on it. Beside bends or cables, a quarter of it is what the tip may be beside without being corrected. cdcrctl calibrate
        /// noise measures it.
        tip_noise_m: f64 = 3e-4, in 1e-6..=0.1;
    }
}
