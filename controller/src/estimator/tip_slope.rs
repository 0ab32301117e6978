use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Standard deviation of the model's error of a tip motion, as a share of that motion: about the accuracy of a robot's
/// lengths and angles.
const SLOPE_PRIOR: f64 = 0.05;
/// Limit of the slope (Frobenius norm).
const SLOPE_MAX: f64 = 0.2;
/// Time constant with which the slope is forgotten (s), because it varies with the bends.
const FORGETTING_TIME_S: f64 = 10.0;
/// Random walk of the offset beside the slope (m/√s).
const RANDOM_WALK_M_SQRT_S: f64 = 3e-4;
/// Standard deviation of the offset before any measurement (m).
const PRIOR_M: f64 = 0.05;
/// An innovation beyond this many standard deviations is attributed to another cause: an added load, or cables in their
/// play.
const OUTLIER_DEVIATIONS: f64 = 3.0;
/// Below about this speed of the tip (m/s) the slope is not applied: a motion commanded within the play of the cables
/// does not move the tip.
pub(super) const REST_SPEED_M_S: f64 = 5e-3;

/// Change of the tip offset along the path of the tip: sections 5 % longer than configured place the tip 5 % farther
/// away. A Kalman filter of the offset and of its derivative by position. All coordinates share one covariance, because
/// they have the same noise.
#[derive(Debug, Clone)]
pub(super) struct TipSlope {
    offset_m: Vector3<f64>,
    slope: Matrix3<f64>,
    /// Of one coordinate of the offset and of its derivatives.
    covariance: Matrix4<f64>,
    /// Tip position from the bends at the last measurement (m).
    model_tip_m: Option<Vector3<f64>>,
    noise_m: f64,
    /// Prior standard deviation of a derivative; 0: the offset is the same everywhere.
    deviation: f64,
}

impl TipSlope {
    /// A filter without measurements. `noise_m` is the standard deviation of a measured coordinate.
    pub(super) fn new(noise_m: f64) -> Self {
        Self::with_deviation(noise_m, SLOPE_PRIOR)
    }

    /// A filter that takes the offset as the same everywhere.
    pub(super) fn none(noise_m: f64) -> Self {
        Self::with_deviation(noise_m, 0.0)
    }

    /// The same filter without measurements.
    pub(super) fn forgotten(&self) -> Self {
        Self::with_deviation(self.noise_m, self.deviation)
    }

    fn with_deviation(noise_m: f64, deviation: f64) -> Self {
        let deviations = Vector4::new(PRIOR_M, deviation, deviation, deviation);
        Self {
            offset_m: Vector3::zeros(),
            slope: Matrix3::zeros(),
            covariance: Matrix4::from_diagonal(&deviations.map(|deviation| deviation * deviation)),
            model_tip_m: None,
            noise_m,
            deviation,
        }
    }

    pub(super) fn noise_m(&self) -> f64 {
        self.noise_m
    }

    /// Standard deviation of a coordinate of the offset at its last measurement (m); 0 before the first.
    pub(super) fn deviation_m(&self) -> f64 {
        if self.model_tip_m.is_some() {
            self.covariance[(0, 0)].max(0.0).sqrt()
        } else {
            0.0
        }
    }

    /// Change of the offset while the tip moves by `by_m` (m).
    pub(super) fn change_m(&self, by_m: &Vector3<f64>) -> Vector3<f64> {
        self.slope * by_m
    }

    /// As [`Self::change_m`], for a motion within `elapsed_s` (s); zero at rest.
    pub(super) fn change_in_m(&self, by_m: &Vector3<f64>, elapsed_s: f64) -> Vector3<f64> {
        let (motion_m, rest_m) = (by_m.norm(), REST_SPEED_M_S * elapsed_s);
        if motion_m > rest_m {
            self.change_m(by_m) * (1.0 - rest_m / motion_m)
        } else {
            Vector3::zeros()
        }
    }

    /// Takes a measurement: the offset `measured_offset_m` of the tip from its position `model_tip_m` by the bends, `since_s` (s)
    /// after the previous one.
    pub(super) fn learn(
        &mut self,
        measured_offset_m: &Vector3<f64>,
        model_tip_m: &Vector3<f64>,
        since_s: f64,
    ) {
        self.predict(model_tip_m, since_s);
        let noise_m2 = self.noise_m * self.noise_m;
        let with_offset: Vector4<f64> = self.covariance.column(0).into();
        let expected_m2 = with_offset[0] + noise_m2;
        let mut gain = with_offset / expected_m2;
        let innovation_m = measured_offset_m - self.offset_m;
        let is_outlier =
            innovation_m.norm_squared() > OUTLIER_DEVIATIONS * OUTLIER_DEVIATIONS * expected_m2;
        if is_outlier {
            gain.fixed_rows_mut::<3>(1).fill(0.0);
        }
        self.offset_m += gain[0] * innovation_m;
        self.slope += innovation_m * gain.fixed_rows::<3>(1).transpose();
        self.slope *= (SLOPE_MAX / self.slope.norm()).min(1.0);
        // Joseph's form, valid for any gain.
        let mut left = Matrix4::identity();
        let first = left.column(0) - gain;
        left.set_column(0, &first);
        self.covariance =
            left * self.covariance * left.transpose() + noise_m2 * gain * gain.transpose();
    }

    /// Revises the tip position from the bends by `by_m` (m) while the tip stays.
    pub(super) fn revise_model_tip(&mut self, by_m: &Vector3<f64>) {
        self.offset_m -= by_m;
        self.model_tip_m = self.model_tip_m.map(|model_tip_m| model_tip_m + by_m);
    }

    /// Predicts the offset for a tip at `model_tip_m`, `since_s` (s) later.
    fn predict(&mut self, model_tip_m: &Vector3<f64>, since_s: f64) {
        let before_m = self.model_tip_m.replace(*model_tip_m);
        let by_m = before_m.map_or_else(Vector3::zeros, |before_m| model_tip_m - before_m);
        self.offset_m += self.change_m(&by_m);
        let mut along = Matrix4::identity();
        along.fixed_view_mut::<1, 3>(0, 1).tr_copy_from(&by_m);
        let kept = (-since_s / FORGETTING_TIME_S).exp();
        self.slope *= kept;
        let forgotten = Matrix4::from_diagonal(&Vector4::new(1.0, kept, kept, kept));
        let along = forgotten * along;
        let prior_growth = (1.0 - kept * kept) * self.deviation * self.deviation;
        let random_walk_m2 = RANDOM_WALK_M_SQRT_S * RANDOM_WALK_M_SQRT_S * since_s;
        self.covariance = along * self.covariance * along.transpose()
            + Matrix4::from_diagonal(&Vector4::new(
                random_walk_m2,
                prior_growth,
                prior_growth,
                prior_growth,
            ));
    }
}
