use nalgebra::Vector3;

use super::tip_slope::{REST_SPEED_M_S, TipSlope};

/// Time constant with which the offset follows the measurements (s). From 0.3 mm of noise in each coordinate, measured
/// at 100 Hz, 0.1 mm remains.
const TIME_CONSTANT_S: f64 = 0.1;
/// Time constant at rest if the play of the cables is known: a motor that reverses because of noise crosses the whole
/// play.
const TIME_CONSTANT_WITH_PLAY_S: f64 = 0.2;
/// Share of the robot's length beyond which a measured offset is rejected: either the model or the sensor is wrong, and
/// following the sensor would not help. A sensor in a wrong frame is believed so far. Over their whole range of bends, robots
/// of one to three sections with the errors of the project's tests (5 % in lengths with a load, play of 0.5 mm, `sloppy`)
/// have up to 0.073; 10 % in lengths gives 0.1, and cables that are 1 mm too long 0.115.
const OFFSET_MAX_SHARE: f64 = 1.0 / 9.0;

/// And never farther than this \[m\], whatever the robot's length.
const OFFSET_MAX_M: f64 = 0.1;

/// Largest offset of a measured tip from its bends that is followed (m), of a robot of this length.
pub fn tip_offset_max_m(reach_m: f64) -> f64 {
    OFFSET_MAX_M.min(OFFSET_MAX_SHARE * reach_m)
}

/// After so many larger ones in a row the margin covers them: fewer may be an error of the sensor.
pub const FAR_LIMIT: u32 = 3;
/// Largest rate (m/s) at which the offset follows the measurements beside its slope, and with it the tip. If the axes of
/// the sensor are swapped, turned or mirrored, each motion of the tip moves the measured offset farther from the one
/// followed: without this limit, such a tip was moved at 0.9 m/s where 0.1 m/s was asked.
const FOLLOWING_RATE_M_S: f64 = 0.1;
/// A tip that was lost, too far aside [`FAR_LIMIT`] times in a row, is followed again after so much time with near
/// positions (s), after twice as much each further time. The sensor of a wrong frame is near at times.
const WAIT_S: f64 = 0.32;
/// Number of losses after which that time grows no more: 20 s.
const LOSSES_MAX: i32 = 7;

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

/// Why a measured tip is not followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TipRefusal {
    /// It is farther than [`tip_offset_max_m`] from the place given by the bends, or not finite.
    Far,
    /// It was, three times in a row, and has not been near for long enough since.
    WasFar,
    /// It has the bits of the last one: the sensor may have stopped.
    Repeats,
}

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
    /// Largest offset that is followed (m); infinite before the first measurement.
    largest_m: f64,
    /// The last measured position (m).
    measured_m: Vector3<f64>,
    /// Time since the last tip position (s), at most the time constant.
    since_measured_s: f64,
    /// Interval between the last two tip positions (s).
    interval_s: f64,
    /// The filtered offset if its rate had no limit (m): the tip may be there.
    unlimited_m: Vector3<f64>,
    /// Number of measured offsets beyond the largest, in a row, until the offset has reached a smaller one.
    far_count: u32,
    /// The last of them (m), or the one measured since, until the offset has reached it.
    far_m: f64,
    /// The same number until one is smaller.
    far_in_a_row: u32,
    /// How often the tip was lost since control began or another sensor came.
    losses: i32,
    /// Time with near positions that is missing before the tip is followed again (s).
    wait_s: f64,
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
            largest_m: f64::INFINITY,
            measured_m: Vector3::repeat(f64::NAN),
            since_measured_s: 0.0,
            interval_s: TIME_CONSTANT_S,
            unlimited_m: Vector3::zeros(),
            far_count: 0,
            far_m: 0.0,
            far_in_a_row: 0,
            losses: 0,
            wait_s: 0.0,
        }
    }

    /// Restarts control: the next position counts as new. The offset is kept, because it is an error of the model.
    pub(super) fn begin(&mut self) {
        *self = Self {
            offset_m: self.offset_m,
            filtered_m: self.filtered_m,
            unlimited_m: self.unlimited_m,
            largest_m: self.largest_m,
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

    /// Upper bound on the tip's distance from the position given by the bends (m): the offset, or where it would be
    /// without a limit of its rate, plus its uncertainty. Of a tip that is too far aside to be followed, the measured
    /// distance.
    pub(super) fn margin_m(&self) -> f64 {
        let mut offset_m = self.offset_m.norm();
        if self.unlimited_m != self.filtered_m {
            offset_m = offset_m.max(self.unlimited_m.norm());
        }
        let margin_m = offset_m + MARGIN_DEVIATIONS * self.slope.deviation_m();
        if self.is_far() {
            margin_m.max(self.far_m + MARGIN_DEVIATIONS * self.slope.noise_m())
        } else {
            margin_m
        }
    }

    fn is_far(&self) -> bool {
        self.far_count >= FAR_LIMIT
    }

    /// Another sensor: it is followed at once, wherever the last one was lost.
    pub(super) fn trust(&mut self) {
        (self.far_in_a_row, self.losses, self.wait_s) = (0, 0, 0.0);
    }

    /// Takes an offset beyond the largest.
    fn take_far(&mut self, away_m: f64) {
        self.far_count = (self.far_count + 1).min(FAR_LIMIT);
        self.far_m = away_m;
        self.far_in_a_row += 1;
        if self.far_in_a_row >= FAR_LIMIT {
            if self.wait_s == 0.0 {
                self.losses = (self.losses + 1).min(LOSSES_MAX);
            }
            self.far_in_a_row = 0;
            self.wait_s = WAIT_S * f64::powi(2.0, self.losses - 1);
            self.since_measured_s = 0.0;
        }
    }

    /// Takes a near offset; true while the tip is not followed again. The margin covers it meanwhile.
    fn waits(&mut self, away_m: f64) -> bool {
        self.far_in_a_row = 0;
        if self.wait_s == 0.0 {
            return false;
        }
        self.wait_s = (self.wait_s - core::mem::take(&mut self.since_measured_s)).max(0.0);
        self.far_m = away_m;
        true
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
        if self.since_measured_s < SILENCE_RATIO * self.interval_s && self.wait_s == 0.0 {
            let change_m = self.slope.change_in_m(&(model_tip_m - before_m), elapsed_s);
            self.filtered_m += change_m;
            self.unlimited_m += change_m;
            self.offset_m = (self.offset_m + change_m).cap_magnitude(self.largest_m);
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
            self.unlimited_m -= by_m;
            self.offset_m = (self.offset_m - by_m).cap_magnitude(self.largest_m);
            self.slope.revise_model_tip(&by_m);
        }
    }

    /// Takes a tip measured at `measured_m` while the bends placed it at `model_tip_m`. Following a sensor that has
    /// stopped would move the robot away from its reference.
    ///
    /// `reach_m`: length of the robot. `has_play`: the cables have a known play.
    pub(super) fn correct(
        &mut self,
        measured_m: &Vector3<f64>,
        model_tip_m: &Vector3<f64>,
        reach_m: f64,
        has_play: bool,
    ) -> Result<(), TipRefusal> {
        let measured_offset_m = measured_m - model_tip_m;
        let is_news = core::mem::replace(&mut self.measured_m, *measured_m) != *measured_m;
        if !is_news {
            return Err(TipRefusal::Repeats);
        }
        let away_m = measured_offset_m.norm();
        self.largest_m = tip_offset_max_m(reach_m);
        let is_near = away_m <= self.largest_m;
        // No body reaches half as far again as its model: there the sensor is wrong.
        if !is_near && measured_m.norm() < 1.5 * reach_m {
            self.take_far(away_m);
        }
        if !is_near {
            return Err(TipRefusal::Far);
        }
        if self.waits(away_m) {
            return Err(TipRefusal::WasFar);
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
        self.filtered_m += gain * ahead_m.cap_magnitude(FOLLOWING_RATE_M_S * time_constant_s);
        self.unlimited_m += gain * (measured_offset_m - self.unlimited_m);
        // A tip that was too far aside: the margin must not shrink before the offset has reached it.
        self.far_m = away_m;
        let behind_m = (measured_offset_m - self.filtered_m).norm();
        if !self.is_far() || behind_m < 2.0 * MARGIN_DEVIATIONS * self.slope.noise_m() {
            self.far_count = 0;
        }
        let innovation_m = self.filtered_m - self.offset_m;
        let distance_m = innovation_m.norm();
        let dead_zone_m = dead_zone * self.slope.noise_m();
        if distance_m > dead_zone_m {
            let moved_m = self.offset_m + innovation_m * (1.0 - dead_zone_m / distance_m);
            self.offset_m = moved_m.cap_magnitude(self.largest_m);
        }
        self.since_measured_s = 0.0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH_M: f64 = 0.9;

    /// An offset after positions of a sensor, one every `interval_s`, so far beside the model's tip.
    fn measured(offset: &mut TipOffset, interval_s: f64, aside_m: &[f64]) -> Vec<bool> {
        let model_tip_m = Vector3::new(0.0, 0.0, REACH_M);
        let take = |aside_m: &f64| {
            offset.predict(interval_s);
            offset.update_model_tip(&model_tip_m);
            // No two in a row have the same bits.
            let turn_m = if offset.measured_m.y == 0.0 {
                1e-9
            } else {
                0.0
            };
            let measured_m = model_tip_m + Vector3::new(*aside_m, turn_m, 0.0);
            let taken = offset.correct(&measured_m, &model_tip_m, REACH_M, false);
            taken.is_ok()
        };
        aside_m.iter().map(take).collect()
    }

    #[test]
    fn the_margin_covers_at_once_what_the_offset_reaches_later() {
        for interval_s in [0.005, 0.04, 0.1] {
            let mut offset = TipOffset::new(3e-4);
            let gain = interval_s / (interval_s + TIME_CONSTANT_S);
            let mut unlimited_m = 0.0;
            for _ in 0..20 {
                measured(&mut offset, interval_s, &[0.08]);
                unlimited_m += gain.min(0.5) * (0.08 - unlimited_m);
                let [followed_m, margin_m] = [offset.offset_m().norm(), offset.margin_m()];
                assert!(margin_m > unlimited_m - 1e-3, "{interval_s}: {margin_m}");
                assert!(followed_m <= 20.0 * 0.1 * interval_s, "{followed_m}");
            }
        }
    }

    /// A small robot believes a sensor no farther than its own size allows, a large one no farther than 0.1 m; the offset follows within.
    #[test]
    fn the_largest_offset_is_a_share_of_the_length() {
        let small = [(0.1, true), (0.105, true), (0.12, false), (0.5, false)];
        let large = [(0.01, true), (0.024, true), (0.026, false), (0.1, false)];
        let robots = [(0.05, small), (0.3, small), (0.9, small), (4.0, large)];
        for (reach_m, shares) in robots {
            for (share, expected) in shares {
                let mut offset = TipOffset::new(1e-4 * reach_m);
                let model_tip_m = Vector3::new(0.0, 0.0, reach_m);
                let mut used = true;
                for step in 0..200 {
                    offset.predict(0.1);
                    offset.update_model_tip(&model_tip_m);
                    // No two in a row have the same bits.
                    let aside_m = Vector3::new(share * reach_m, 1e-9 * f64::from(step % 2), 0.0);
                    let measured_m = model_tip_m + aside_m;
                    let taken = offset.correct(&measured_m, &model_tip_m, reach_m, false);
                    used &= taken.is_ok();
                }
                assert_eq!(used, expected, "{share} of {reach_m} m");
                let reached = if expected { share } else { 0.0 };
                let offset_share = offset.offset_m().norm() / reach_m;
                assert!((offset_share - reached).abs() < 1e-3, "{offset_share}");
                // What is not followed makes the body thicker.
                assert!(offset.margin_m() > 0.99 * share * reach_m);
            }
        }
    }

    #[test]
    fn a_tip_is_lost_by_three_far_positions_in_a_row_and_by_no_outlier() {
        let mut offset = TipOffset::new(3e-4);
        for _ in 0..100 {
            // While the offset follows a step, too.
            let used = measured(&mut offset, 0.1, &[0.08, 0.12, 0.08, 0.12, 0.12, 0.08]);
            assert_eq!(used, [true, false, true, false, false, true]);
        }
        // Three losses: each wait is twice as long, and begins again only by three far ones.
        for wait in [4, 7, 13] {
            assert_eq!(measured(&mut offset, 0.1, &[0.12; 3]), [false; 3]);
            measured(&mut offset, 0.1, &[0.01, 0.12, 0.12]);
            let used = measured(&mut offset, 0.1, &vec![0.01; wait]);
            assert_eq!(
                used.iter().position(|used| *used),
                Some(wait - 1),
                "{used:?}"
            );
        }
        assert_eq!(measured(&mut offset, 0.1, &[0.12; 3]), [false; 3]);
        offset.trust();
        assert_eq!(measured(&mut offset, 0.1, &[0.01]), [true]);
    }
}
