table! {
    /// What counts as a fault of the robot, its sensors or its surroundings.
    pub struct SafetyConfig {
        /// A smaller clearance between body and obstacles than this is a fault, {range}; 0: contact.
        clearance_fault_m: f64 = 0.0, in -10.0..=10.0;
        /// A measured component of the bend vector may be this far ahead of where its largest rate can have brought it,
        /// {range}. Granted once, not anew for each measurement; noise of up to half of it never counts. A
        /// coordinate of a tip position: this times the length of the robot. What is farther ahead is implausible, and
        /// left out.
        measurement_jump_rad: f64 = 0.2, in 1e-6..=1e3;
        /// So many implausible measurements in a row are a fault, {range}.
        measurement_jump_limit: u32 = 3, in 1.0..=1e6;
        /// A bend component or cable whose measurement does not change in any bit while it is commanded to move this far,
        /// net, is frozen, and a fault, {range}. (A cable: this times its distance from the backbone; a tip
        /// position: while any component is.) More than the sensor resolves, and more than the robot is commanded to move
        /// while a measurement is under way.
        measurement_frozen_rad: f64 = 0.2, in 1e-6..=1e3;
        /// Following error: how far a section is measured from where it was commanded to be in the last following_lag_ms. Above
        /// this it is a warning, {range}. Not evaluated while only the tip is measured.
        following_warning_rad: f64 = 0.1, in 1e-6..=1e3, "at most safety.following_fault_rad";
        /// Above this it is a fault, {range}, and at least following_warning_rad.
        following_fault_rad: f64 = 0.3, in 1e-6..=1e3, "at least safety.following_warning_rad";
        /// How far the motors may lag behind their commands without an error, {range}.
        following_lag_ms: f64 = 100.0, in 0.0..=10_000.0;
        /// The mean length of a section's three cables may change by this since control began, {range}; 0: by any amount. Bends change it
        /// as far as the cables' angles are off, a cable that broke and cables that went slack do more; beyond it is a fault. Only where cable lengths are measured.
        cable_common_m: f64 = 0.010, in 0.0..=1.0;
    }
}
