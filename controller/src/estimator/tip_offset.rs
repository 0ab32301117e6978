use nalgebra::Vector3;

/// How slowly the offset follows what is measured (s): of 0.3 mm of noise in each coordinate, measured at 100 Hz, 0.1 mm is left.
const TIME_CONSTANT_S: f64 = 0.1;
/// It is never larger (m): a model that is farther off is wrong, and following it no help.
const OFFSET_MAX_M: f64 = 0.1;

/// What the measured tip is beside the one that the measured bends give: errors of lengths and radii, sag, a load. It changes slowly, as
/// the robot bends.
#[derive(Debug, Clone)]
pub(super) struct TipOffset {
    offset_m: Vector3<f64>,
    /// Since the last tip position (s).
    unmeasured_s: f64,
}

impl TipOffset {
    pub(super) fn new() -> Self {
        Self {
            offset_m: Vector3::zeros(),
            unmeasured_s: 0.0,
        }
    }

    pub(super) fn offset_m(&self) -> Vector3<f64> {
        self.offset_m
    }

    pub(super) fn predict(&mut self, elapsed_s: f64) {
        // A pause of the sensor does not make its next position count for more than one.
        self.unmeasured_s = (self.unmeasured_s + elapsed_s).min(TIME_CONSTANT_S);
    }

    /// The tip was measured so far beside (m). What is not finite changes nothing.
    pub(super) fn correct(&mut self, beside_m: Vector3<f64>) {
        let gain = self.unmeasured_s / (self.unmeasured_s + TIME_CONSTANT_S);
        let offset_m = self.offset_m + gain * (beside_m - self.offset_m);
        self.unmeasured_s = 0.0;
        if offset_m.iter().all(|coordinate_m| coordinate_m.is_finite()) {
            self.offset_m = offset_m.cap_magnitude(OFFSET_MAX_M);
        }
    }
}
