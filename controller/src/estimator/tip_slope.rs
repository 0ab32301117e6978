use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// How much of a way of the tip the model may be off by: standard deviation. Lengths and angles of a robot are known to about that.
const SLOPE: f64 = 0.05;
/// No more is believed (Frobenius norm).
const SLOPE_MAX: f64 = 0.2;
/// What was learnt is forgotten with this time constant (s): the slope of a robot that bends is not the same everywhere.
const FORGOTTEN_S: f64 = 10.0;
/// What the offset changes by beside the slope (m/√s).
const WANDER_M: f64 = 3e-4;
/// Standard deviation of the offset before anything was measured (m).
const UNKNOWN_M: f64 = 0.05;
/// What is farther off than so many standard deviations comes from elsewhere: a load that was put on, or cables in their play.
const SURPRISE: f64 = 3.0;
/// Below about this speed of the tip (m/s) the slope changes nothing: a way that is commanded within the play of cables is none.
pub(super) const STILL_M_S: f64 = 5e-3;

/// How the offset of the tip changes along its way: sections 5 % longer than configured place it 5 % farther. A Kalman filter of
/// the offset and its derivative with respect to the place, which has one covariance, as each coordinate is measured with the same noise.
#[derive(Debug, Clone)]
pub(super) struct TipSlope {
    offset_m: Vector3<f64>,
    slope: Matrix3<f64>,
    /// Of one coordinate of the offset, and of its derivatives.
    covariance: Matrix4<f64>,
    /// Where the bends placed the tip when it was measured last (m).
    placed_m: Option<Vector3<f64>>,
    noise_m: f64,
    /// Standard deviation of a derivative of which nothing is known; 0: the offset is taken to be the same everywhere.
    deviation: f64,
}

impl TipSlope {
    /// Nothing was learnt. A measured coordinate is off by `noise_m`: standard deviation.
    pub(super) fn new(noise_m: f64) -> Self {
        Self::with_deviation(noise_m, SLOPE)
    }

    /// The same with an offset that is taken to be the same everywhere.
    pub(super) fn none(noise_m: f64) -> Self {
        Self::with_deviation(noise_m, 0.0)
    }

    /// The same where nothing was learnt.
    pub(super) fn forgotten(&self) -> Self {
        Self::with_deviation(self.noise_m, self.deviation)
    }

    fn with_deviation(noise_m: f64, deviation: f64) -> Self {
        let deviations = Vector4::new(UNKNOWN_M, deviation, deviation, deviation);
        Self {
            offset_m: Vector3::zeros(),
            slope: Matrix3::zeros(),
            covariance: Matrix4::from_diagonal(&deviations.map(|deviation| deviation * deviation)),
            placed_m: None,
            noise_m,
            deviation,
        }
    }

    pub(super) fn noise_m(&self) -> f64 {
        self.noise_m
    }

    /// Standard deviation of a coordinate of the offset at its last measurement (m); 0 before the first.
    pub(super) fn deviation_m(&self) -> f64 {
        if self.placed_m.is_some() {
            self.covariance[(0, 0)].max(0.0).sqrt()
        } else {
            0.0
        }
    }

    /// What the offset changes by while the tip goes by `by_m` (m).
    pub(super) fn change_m(&self, by_m: &Vector3<f64>) -> Vector3<f64> {
        self.slope * by_m
    }

    /// The same in a time of `elapsed_s` (s): nothing at rest.
    pub(super) fn change_in_m(&self, by_m: &Vector3<f64>, elapsed_s: f64) -> Vector3<f64> {
        let (way_m, still_m) = (by_m.norm(), STILL_M_S * elapsed_s);
        if way_m > still_m {
            self.change_m(by_m) * (1.0 - still_m / way_m)
        } else {
            Vector3::zeros()
        }
    }

    /// The tip was measured `beside_m` beside where the bends placed it, `placed_m`, `since_s` (s) after the measurement before.
    pub(super) fn learn(&mut self, beside_m: &Vector3<f64>, placed_m: &Vector3<f64>, since_s: f64) {
        self.predict(placed_m, since_s);
        let noise_m2 = self.noise_m * self.noise_m;
        let with_offset: Vector4<f64> = self.covariance.column(0).into();
        let expected_m2 = with_offset[0] + noise_m2;
        let mut gain = with_offset / expected_m2;
        let missing_m = beside_m - self.offset_m;
        let is_surprise = missing_m.norm_squared() > SURPRISE * SURPRISE * expected_m2;
        if is_surprise {
            gain.fixed_rows_mut::<3>(1).fill(0.0);
        }
        self.offset_m += gain[0] * missing_m;
        self.slope += missing_m * gain.fixed_rows::<3>(1).transpose();
        self.slope *= (SLOPE_MAX / self.slope.norm()).min(1.0);
        // Joseph's form, which holds for any gain.
        let mut left = Matrix4::identity();
        let first = left.column(0) - gain;
        left.set_column(0, &first);
        self.covariance =
            left * self.covariance * left.transpose() + noise_m2 * gain * gain.transpose();
    }

    /// The bends are taken to place the tip elsewhere, by `by_m` (m), and it stays.
    pub(super) fn place(&mut self, by_m: &Vector3<f64>) {
        self.offset_m -= by_m;
        self.placed_m = self.placed_m.map(|placed_m| placed_m + by_m);
    }

    /// To where the tip is placed now, `since_s` (s) later.
    fn predict(&mut self, placed_m: &Vector3<f64>, since_s: f64) {
        let before_m = self.placed_m.replace(*placed_m);
        let by_m = before_m.map_or_else(Vector3::zeros, |before_m| placed_m - before_m);
        self.offset_m += self.change_m(&by_m);
        let mut along = Matrix4::identity();
        along.fixed_view_mut::<1, 3>(0, 1).tr_copy_from(&by_m);
        let kept = (-since_s / FORGOTTEN_S).exp();
        self.slope *= kept;
        let forgotten = Matrix4::from_diagonal(&Vector4::new(1.0, kept, kept, kept));
        let along = forgotten * along;
        let anew = (1.0 - kept * kept) * self.deviation * self.deviation;
        let wandered_m2 = WANDER_M * WANDER_M * since_s;
        self.covariance = along * self.covariance * along.transpose()
            + Matrix4::from_diagonal(&Vector4::new(wandered_m2, anew, anew, anew));
    }
}
