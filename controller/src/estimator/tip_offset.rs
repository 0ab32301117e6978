use nalgebra::Vector3;

use super::tip_slope::{STILL_M_S, TipSlope};

/// How slowly the offset follows what is measured (s): of 0.3 mm of noise in each coordinate, measured at 100 Hz, 0.1 mm is left.
const TIME_CONSTANT_S: f64 = 0.1;
/// The same at rest, where the play of the cables is known: a motor that turns round for noise runs through all of the play.
const TIME_CONSTANT_WITH_PLAY_S: f64 = 0.2;
/// A tip that is measured farther beside (m) is not believed: either the model or the sensor is wrong, and following it no help.
const OFFSET_MAX_M: f64 = 0.1;

/// Positions that come this much later than the interval between the last two are a sensor that says nothing.
const SILENT: f64 = 1.5;

/// Part of the noise of a measured coordinate that the offset may be beside what was learnt. Without it, noise leads the tip about for ever,
/// and a robot whose cables have more play than is known swings: by 4 mm at 0.5 mm of play (docs/robustness.md).
const STILL: f64 = 0.25;
/// The same at rest, where the play of the cables is known: it swallows nothing of the noise then.
const STILL_WITH_PLAY: f64 = 0.6;

/// So many standard deviations of what is known of the offset the body keeps beside it: in 1 of 740 measurements the tip is farther beside along
/// the way to an obstacle.
const MARGIN_DEVIATIONS: f64 = 3.0;

/// What the measured tip is beside the one that the measured bends give: errors of lengths and radii, sag, a load. It changes as
/// the robot bends, which is learnt, too ([`TipSlope`]), so that it is not late along a way.
#[derive(Debug, Clone)]
pub(super) struct TipOffset {
    offset_m: Vector3<f64>,
    /// The same as it was learnt: the offset follows it at the end of a line of this length (m).
    learnt_m: Vector3<f64>,
    slope: TipSlope,
    /// Where the bends place the tip now (m); none: control began anew.
    placed_m: Option<Vector3<f64>>,
    /// Whether it is on its way there.
    is_moving: bool,
    /// Since that (s).
    unplaced_s: f64,
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
        Self::with_slope(TipSlope::new(noise_m))
    }

    /// The same with one that does not go along with the tip.
    pub(super) fn without_slope(&self) -> Self {
        Self::with_slope(TipSlope::none(self.slope.noise_m()))
    }

    fn with_slope(slope: TipSlope) -> Self {
        Self {
            offset_m: Vector3::zeros(),
            learnt_m: Vector3::zeros(),
            slope,
            placed_m: None,
            is_moving: false,
            unplaced_s: 0.0,
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
            slope: self.slope.clone(),
            ..self.forgotten()
        };
    }

    /// The same where nothing was learnt.
    pub(super) fn forgotten(&self) -> Self {
        Self::with_slope(self.slope.forgotten())
    }

    pub(super) fn offset_m(&self) -> Vector3<f64> {
        self.offset_m
    }

    /// How far the tip may be beside where the bends place it (m): by the offset, and by what is not known of that.
    pub(super) fn margin_m(&self) -> f64 {
        self.offset_m.norm() + MARGIN_DEVIATIONS * self.slope.deviation_m()
    }

    pub(super) fn predict(&mut self, elapsed_s: f64) {
        self.unmeasured_s = (self.unmeasured_s + elapsed_s).min(TIME_CONSTANT_S);
        self.unplaced_s += elapsed_s;
    }

    /// Whether a tip was measured since control began.
    pub(super) fn is_measured(&self) -> bool {
        self.placed_m.is_some()
    }

    /// The bends place the tip at `placed_m` (m) now. The offset goes along, unless the sensor is silent.
    pub(super) fn follow(&mut self, placed_m: &Vector3<f64>) {
        let elapsed_s = core::mem::take(&mut self.unplaced_s);
        let Some(before_m) = self.placed_m.replace(*placed_m) else {
            return;
        };
        if elapsed_s > 0.0 {
            self.is_moving = (placed_m - before_m).norm() > STILL_M_S * elapsed_s;
        }
        if self.unmeasured_s < SILENT * self.interval_s {
            let change_m = self.slope.change_in_m(&(placed_m - before_m), elapsed_s);
            self.learnt_m += change_m;
            self.offset_m = (self.offset_m + change_m).cap_magnitude(OFFSET_MAX_M);
        }
    }

    /// Whether the bends place the tip elsewhere all the time.
    pub(super) fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// The tip stays where it is, but the bends are taken to place it at `placed_m` (m): what it is beside them is less by that.
    pub(super) fn place(&mut self, placed_m: &Vector3<f64>) {
        if let Some(before_m) = self.placed_m.replace(*placed_m) {
            let by_m = placed_m - before_m;
            self.learnt_m -= by_m;
            self.offset_m = (self.offset_m - by_m).cap_magnitude(OFFSET_MAX_M);
            self.slope.place(&by_m);
        }
    }

    /// The tip was measured at `measured_m`, and the bends placed it at `placed_m` then. Whether that was believed: not what is farther
    /// beside than the largest offset, nor what is the last position in every bit. A sensor that stands still while the robot
    /// moves would lead it away from its reference, and away from where the sensor says it is.
    /// `has_play`: cables with a play that is known.
    pub(super) fn correct(
        &mut self,
        measured_m: &Vector3<f64>,
        placed_m: &Vector3<f64>,
        has_play: bool,
    ) -> bool {
        let beside_m = measured_m - placed_m;
        let is_news = core::mem::replace(&mut self.measured_m, *measured_m) != *measured_m;
        let is_near = beside_m.norm() <= OFFSET_MAX_M;
        if !is_news || !is_near {
            return false;
        }
        // A pause of the sensor does not make its next position count for more than the one before: the offset must not jump.
        let since_s = self.unmeasured_s.min(self.interval_s);
        self.interval_s = self.unmeasured_s;
        self.slope.learn(&beside_m, placed_m, since_s);
        // How far it is beside where it is placed now.
        let since_m = self.placed_m.map(|now_m| now_m - placed_m);
        let beside_m = beside_m + self.slope.change_m(&since_m.unwrap_or_default());
        let (time_constant_s, still) = if has_play && !self.is_moving {
            (TIME_CONSTANT_WITH_PLAY_S, STILL_WITH_PLAY)
        } else {
            (TIME_CONSTANT_S, STILL)
        };
        let gain = since_s / (since_s + time_constant_s);
        self.learnt_m += gain * (beside_m - self.learnt_m);
        let missing_m = self.learnt_m - self.offset_m;
        let far_m = missing_m.norm();
        let still_m = still * self.slope.noise_m();
        if far_m > still_m {
            let moved_m = self.offset_m + missing_m * (1.0 - still_m / far_m);
            self.offset_m = moved_m.cap_magnitude(OFFSET_MAX_M);
        }
        self.unmeasured_s = 0.0;
        true
    }
}
