use nalgebra::Vector3;

/// How slowly the offset follows what is measured (s): of 0.3 mm of noise in each coordinate, measured at 100 Hz, 0.1 mm is left.
const TIME_CONSTANT_S: f64 = 0.1;
/// A tip that is measured farther beside (m) is not believed: either the model or the sensor is wrong, and following it no help.
const OFFSET_MAX_M: f64 = 0.1;

/// Part of the noise of a measured coordinate that the offset may be beside what was learnt. Without it, noise leads the tip about for ever,
/// and a robot whose cables have more play than is known swings: by 4 mm at 0.5 mm of play (docs/robustness.md).
const STILL: f64 = 0.25;

/// What the measured tip is beside the one that the measured bends give: errors of lengths and radii, sag, a load. It changes slowly, as
/// the robot bends.
#[derive(Debug, Clone)]
pub(super) struct TipOffset {
    offset_m: Vector3<f64>,
    /// The same as it was learnt: the offset follows it at the end of a line of this length (m).
    learnt_m: Vector3<f64>,
    still_m: f64,
    /// The last position that was measured (m).
    measured_m: Vector3<f64>,
    /// Since the last tip position (s).
    unmeasured_s: f64,
    /// The same when it was measured (s).
    interval_s: f64,
}

impl TipOffset {
    /// Nothing was learnt. A measured coordinate is off by `noise_m`: standard deviation.
    pub(super) fn new(noise_m: f64) -> Self {
        Self {
            offset_m: Vector3::zeros(),
            learnt_m: Vector3::zeros(),
            still_m: STILL * noise_m,
            measured_m: Vector3::repeat(f64::NAN),
            unmeasured_s: 0.0,
            interval_s: TIME_CONSTANT_S,
        }
    }

    /// Control begins anew: the next position is news. What was learnt stays, since it is the model that is off.
    pub(super) fn begin(&mut self) {
        *self = Self {
            offset_m: self.offset_m,
            learnt_m: self.learnt_m,
            ..self.forgotten()
        };
    }

    /// The same where nothing was learnt.
    pub(super) fn forgotten(&self) -> Self {
        Self {
            still_m: self.still_m,
            ..Self::new(0.0)
        }
    }

    pub(super) fn offset_m(&self) -> Vector3<f64> {
        self.offset_m
    }

    pub(super) fn predict(&mut self, elapsed_s: f64) {
        self.unmeasured_s = (self.unmeasured_s + elapsed_s).min(TIME_CONSTANT_S);
    }

    /// The tip was measured at `measured_m`, and the bends place it at `placed_m`. Whether that was believed: not what is farther
    /// beside than the largest offset, nor what is the last position in every bit. A sensor that stands still while the robot
    /// moves would lead it away from its reference, and away from where the sensor says it is.
    pub(super) fn correct(&mut self, measured_m: &Vector3<f64>, placed_m: &Vector3<f64>) -> bool {
        let beside_m = measured_m - placed_m;
        let is_news = core::mem::replace(&mut self.measured_m, *measured_m) != *measured_m;
        let is_near = beside_m.norm() <= OFFSET_MAX_M;
        if !is_news || !is_near {
            return false;
        }
        // A pause of the sensor does not make its next position count for more than the one before: the offset must not jump.
        let since_s = self.unmeasured_s.min(self.interval_s);
        self.interval_s = self.unmeasured_s;
        let gain = since_s / (since_s + TIME_CONSTANT_S);
        self.learnt_m += gain * (beside_m - self.learnt_m);
        let missing_m = self.learnt_m - self.offset_m;
        let far_m = missing_m.norm();
        if far_m > self.still_m {
            self.offset_m += missing_m * (1.0 - self.still_m / far_m);
        }
        self.unmeasured_s = 0.0;
        true
    }
}
