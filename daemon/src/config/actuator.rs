use cdcr_controller::estimator::Actuator;

table! {
    /// How the robot's motors follow their commands, and the cables the motors.
    pub struct ActuatorConfig {
        /// From the release of a command until the motors begin to follow it, {range}.
        delay_ms: f64 = 0.0, in 0.0..=300.0;
        /// Time constant of their lag, of first order, {range}.
        time_constant_ms: f64 = 0.0, in 0.0..=300.0;
        /// Play between each motor and its cable, {range}: so far a motor that turns round goes before its cable comes along. Configure what
        /// you measure. With a fifth more than the true play a robot with a tip sensor still rests, with more than a third it swings.
        play_m: f64 = 0.0, in 0.0..=0.01;
    }
}

impl ActuatorConfig {
    /// By how much a robot that moves evenly is behind its commands \[ms\].
    pub fn lead_ms(&self) -> f64 {
        self.delay_ms + self.time_constant_ms
    }

    /// The model of them.
    pub fn model(&self) -> Actuator {
        Actuator {
            delay_s: self.delay_ms * 1e-3,
            time_constant_s: self.time_constant_ms * 1e-3,
            play_m: self.play_m,
        }
    }
}
