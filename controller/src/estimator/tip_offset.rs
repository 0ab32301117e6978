use nalgebra::Vector3;

use super::tip_slope::{REST_SPEED_M_S, TipSlope};

/// Time constant with which the offset follows the measurements (s). From 0.3 mm of noise in each coordinate, measured
/// at 100 Hz, 0.1 mm remains.
const TIME_CONSTANT_S: f64 = 0.1;
/// Time constant at rest if the play of the cables is known: a motor that reverses because of noise crosses the whole
/// play.
const TIME_CONSTANT_WITH_PLAY_S: f64 = 0.2;
/// A larger measured offset (m) is rejected: either the model or the sensor is wrong, and following the sensor would
/// not help.
const OFFSET_MAX_M: f64 = 0.1;
/// After so many larger ones in a row the margin covers them: fewer may be an error of the sensor.
const FAR_LIMIT: u32 = 3;
/// Largest rate (m/s) at which the offset follows the measurements beside its slope, and with it the tip. If the axes of
/// the sensor are swapped, turned or mirrored, each motion of the tip moves the measured offset farther from the one
/// followed: without this limit, such a tip was moved at 0.9 m/s where 0.1 m/s was asked.
const FOLLOWING_RATE_M_S: f64 = 0.1;
/// A tip that was too far aside is followed again after so many near positions in a row; twice as many each further
/// time. The sensor of a wrong frame is near at times.
const NEAR_LIMIT: u32 = 64;
/// Number of times after which the number grows no more.
const LOSSES_MAX: u32 = 10;

/// A sensor counts as silent after this multiple of the interval between its last two positions.
const SILENCE_RATIO: f64 = 1.5;

/// Dead zone of the offset, as a share of the noise of a measured coordinate. Without it, noise moves the tip without
/// end, and a robot with more play than configured oscillates: by 4 mm at 0.5 mm of play (docs/robustness.md).
const DEAD_ZONE: f64 = 0.25;
/// Dead zone at rest if the play of the cables is known: the play then absorbs no noise.
const DEAD_ZONE_WITH_PLAY: f64 = 0.6;

/// Number of standard deviations of the offset's uncertainty in the margin. In 1 of 740 measurements, the tip is
/// farther aside in the direction of an obstacle.
const MARGIN_DEVIATIONS: f64 = 3.0;

/// Offset of the measured tip from the tip of the measured bends: errors of lengths and radii, sag, a load. It changes
/// as the robot bends; this slope is learnt, too ([`TipSlope`]), so that the offset does not lag during motion.
#[derive(Debug, Clone)]
pub(super) struct TipOffset {
    offset_m: Vector3<f64>,
    /// Filtered offset (m). `offset_m` follows it with a dead zone.
    filtered_m: Vector3<f64>,
    slope: TipSlope,
    /// Present tip position from the bends (m); `None`: control has restarted.
    model_tip_m: Option<Vector3<f64>>,
    /// True if that position is changing.
    is_moving: bool,
    /// Time since that position was set (s).
    since_model_tip_s: f64,
    /// The last measured position (m).
    measured_m: Vector3<f64>,
    /// Time since the last tip position (s), at most the time constant.
    since_measured_s: f64,
    /// Interval between the last two tip positions (s).
    interval_s: f64,
    /// Number of measured offsets, in a row, beyond the largest or too far from the one followed to be reached at once.
    far_count: u32,
    /// The last of them (m), or the one measured since, until the offset has reached it.
    far_m: f64,
    /// How often the tip was lost since control began: measured too far aside, [`FAR_LIMIT`] times in a row.
    losses: u32,
    /// Number of near positions in a row that are still missing before the tip is followed again.
    near_missing: u32,
}

impl TipOffset {
    /// An offset without measurements. `noise_m` is the standard deviation of a measured coordinate.
    pub(super) fn new(noise_m: f64) -> Self {
        Self::with_slope(TipSlope::new(noise_m))
    }

    /// The same without a slope.
    pub(super) fn without_slope(&self) -> Self {
        Self::with_slope(TipSlope::none(self.slope.noise_m()))
    }

    fn with_slope(slope: TipSlope) -> Self {
        Self {
            offset_m: Vector3::zeros(),
            filtered_m: Vector3::zeros(),
            slope,
            model_tip_m: None,
            is_moving: false,
            since_model_tip_s: 0.0,
            measured_m: Vector3::repeat(f64::NAN),
            since_measured_s: 0.0,
            interval_s: TIME_CONSTANT_S,
            far_count: 0,
            far_m: 0.0,
            losses: 0,
            near_missing: 0,
        }
    }

    /// Restarts control: the next position counts as new. The offset is kept, because it is an error of the model.
    pub(super) fn begin(&mut self) {
        *self = Self {
            offset_m: self.offset_m,
            filtered_m: self.filtered_m,
            far_count: self.far_count,
            far_m: self.far_m,
            slope: self.slope.clone(),
            ..self.forgotten()
        };
    }

    /// The same without measurements.
    pub(super) fn forgotten(&self) -> Self {
        Self::with_slope(self.slope.forgotten())
    }

    pub(super) fn offset_m(&self) -> Vector3<f64> {
        self.offset_m
    }

    /// Upper bound on the tip's distance from the position given by the bends (m): the offset plus its uncertainty. Of
    /// a tip that is too far aside to be followed, the measured distance.
    pub(super) fn margin_m(&self) -> f64 {
        let margin_m = self.offset_m.norm() + MARGIN_DEVIATIONS * self.slope.deviation_m();
        if self.is_far() {
            margin_m.max(self.far_m + MARGIN_DEVIATIONS * self.slope.noise_m())
        } else {
            margin_m
        }
    }

    fn is_far(&self) -> bool {
        self.far_count >= FAR_LIMIT
    }

    fn count_far(&mut self, away_m: f64) {
        self.far_count = (self.far_count + 1).min(FAR_LIMIT);
        self.far_m = away_m;
    }

    /// Another sensor: it is followed at once, wherever the last one was lost.
    pub(super) fn trust(&mut self) {
        (self.losses, self.near_missing) = (0, 0);
    }

    /// The tip was measured too far aside.
    fn lose(&mut self) {
        self.losses += u32::from(self.near_missing == 0 && self.losses < LOSSES_MAX);
        self.near_missing = NEAR_LIMIT << (self.losses - 1);
    }

    pub(super) fn predict(&mut self, elapsed_s: f64) {
        self.since_measured_s = (self.since_measured_s + elapsed_s).min(TIME_CONSTANT_S);
        self.since_model_tip_s += elapsed_s;
    }

    /// True if a tip was measured since control restarted.
    pub(super) fn is_measured(&self) -> bool {
        self.model_tip_m.is_some()
    }

    /// Sets the present tip position from the bends (m). The offset follows its slope, unless the sensor is silent.
    pub(super) fn update_model_tip(&mut self, model_tip_m: &Vector3<f64>) {
        let elapsed_s = core::mem::take(&mut self.since_model_tip_s);
        let Some(before_m) = self.model_tip_m.replace(*model_tip_m) else {
            return;
        };
        if elapsed_s > 0.0 {
            self.is_moving = (model_tip_m - before_m).norm() > REST_SPEED_M_S * elapsed_s;
        }
        if self.since_measured_s < SILENCE_RATIO * self.interval_s {
            let change_m = self.slope.change_in_m(&(model_tip_m - before_m), elapsed_s);
            self.filtered_m += change_m;
            self.offset_m = (self.offset_m + change_m).cap_magnitude(OFFSET_MAX_M);
        }
    }

    /// True if the tip position from the bends is changing.
    pub(super) fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// Revises the tip position from the bends to `model_tip_m` (m) while the tip stays: the offset changes by the
    /// difference.
    pub(super) fn revise_model_tip(&mut self, model_tip_m: &Vector3<f64>) {
        if let Some(before_m) = self.model_tip_m.replace(*model_tip_m) {
            let by_m = model_tip_m - before_m;
            self.filtered_m -= by_m;
            self.offset_m = (self.offset_m - by_m).cap_magnitude(OFFSET_MAX_M);
            self.slope.revise_model_tip(&by_m);
        }
    }

    /// Takes a tip measured at `measured_m` while the bends placed it at `model_tip_m`. Returns false if it is rejected:
    /// farther aside than the largest offset, not long enough near again, or bit-identical to the last position. Following
    /// a sensor that has stopped would move the robot away from its reference.
    ///
    /// `reach_m`: length of the robot. `has_play`: the cables have a known play.
    pub(super) fn correct(
        &mut self,
        measured_m: &Vector3<f64>,
        model_tip_m: &Vector3<f64>,
        reach_m: f64,
        has_play: bool,
    ) -> bool {
        let measured_offset_m = measured_m - model_tip_m;
        let is_news = core::mem::replace(&mut self.measured_m, *measured_m) != *measured_m;
        if !is_news {
            return false;
        }
        let away_m = measured_offset_m.norm();
        // No body reaches half as far again as its model: there the sensor is wrong.
        if away_m > OFFSET_MAX_M && measured_m.norm() < 1.5 * reach_m {
            self.count_far(away_m);
            if self.is_far() {
                self.lose();
            }
        }
        let is_near = away_m <= OFFSET_MAX_M;
        if !is_near {
            return false;
        }
        if self.near_missing > 0 {
            // The margin covers it meanwhile.
            self.near_missing -= 1;
            self.far_m = away_m;
            return false;
        }
        // After a pause of the sensor, its next position has no more weight than the previous one, so that the offset
        // does not jump.
        let since_s = self.since_measured_s.min(self.interval_s);
        self.interval_s = self.since_measured_s;
        self.slope.learn(&measured_offset_m, model_tip_m, since_s);
        // Offset from the present tip position.
        let since_m = self.model_tip_m.map(|now_m| now_m - model_tip_m);
        let measured_offset_m =
            measured_offset_m + self.slope.change_m(&since_m.unwrap_or_default());
        let (time_constant_s, dead_zone) = if has_play && !self.is_moving {
            (TIME_CONSTANT_WITH_PLAY_S, DEAD_ZONE_WITH_PLAY)
        } else {
            (TIME_CONSTANT_S, DEAD_ZONE)
        };
        let gain = since_s / (since_s + time_constant_s);
        let ahead_m = measured_offset_m - self.filtered_m;
        let followed_m = ahead_m.cap_magnitude(FOLLOWING_RATE_M_S * time_constant_s);
        self.filtered_m += gain * followed_m;
        // The margin covers a tip that is not followed at once, and does not shrink before the offset has reached it.
        let behind_m = (measured_offset_m - self.filtered_m).norm();
        if followed_m != ahead_m {
            self.count_far(away_m);
        } else if !self.is_far() || behind_m < 2.0 * MARGIN_DEVIATIONS * self.slope.noise_m() {
            self.far_count = 0;
        }
        self.far_m = away_m;
        let innovation_m = self.filtered_m - self.offset_m;
        let distance_m = innovation_m.norm();
        let dead_zone_m = dead_zone * self.slope.noise_m();
        if distance_m > dead_zone_m {
            let moved_m = self.offset_m + innovation_m * (1.0 - dead_zone_m / distance_m);
            self.offset_m = moved_m.cap_magnitude(OFFSET_MAX_M);
        }
        self.since_measured_s = 0.0;
        true
    }
}
