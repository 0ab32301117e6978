//! Motors that rested, because their command had run out: the estimate loses motion that was commanded meanwhile, where measurements show it.

use core::ops::Range;

use super::actuator::added;
use super::{Estimator, Measurement};
use crate::robot::{COORDINATES_MAX, Configuration, Robot};

/// Distance between the places of motors that obeyed and of motors that rested which a measurement tells apart in spite of its noise \[rad\].
const VISIBLE_RAD: f64 = 0.01;

/// The same of averaged measurements: a third of the noise remains.
const VISIBLE_AVERAGED_RAD: f64 = VISIBLE_RAD / 3.0;

/// A measurement shows a stated rest if it is as far along the way from the place of motors that obeyed to that of motors that rested, as shares of
/// this way. How far it is beside the way does not count: that is an error of the estimate from before the rest.
pub(super) const SHOWN: Range<f64> = 0.7..1.4;

/// Motion still under way that a stated rest may take without a measurement that shows as much \[rad\]. Without this allowance a true
/// statement counts too late behind motors of a long lag: beside an obstacle the robot comes too near.
pub(super) const UNSEEN_RAD: f64 = 0.1;

/// Motors that have moved by less in this time before a measurement (rad, s) have lost nothing in a silence.
const IDLE: (f64, f64) = (1e-4, 0.5);

/// Why motors may have rested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestCause {
    /// Their driver was silent.
    Silence,
    /// Their driver states it.
    Stated,
    /// It states that a rest went on whose motion the estimate has lost.
    GoesOn,
}

impl Estimator {
    /// The motors may not have obeyed what was commanded between these ages (s, before the time of the last prediction), for this cause: the
    /// estimate loses that motion, if the `measurement` made `age_s` ago does not contradict it. After a silence, and where a lost rest went on, it
    /// contradicts it where the motors are nearer to their place if they obeyed, and noise does not hide this; it must show a rest that is only
    /// stated, and much motion under way only as far as it shows as much. A tip shows neither. The first rest is tried alone, then together with each of the others,
    /// of which noise, or what was still under way, has hidden each alone. Returns whether motion is lost. Take the measurement with [`Self::correct`] afterwards: what it shows alone is adopted without filtering, because when exactly
    /// the motors rested is not known.
    pub fn rested(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        age_s: f64,
        rests_s: &[Range<f64>],
        cause: RestCause,
    ) -> bool {
        let Some(measured) = measurement.configuration(robot) else {
            return false;
        };
        self.resting.clone_from(&self.motors);
        let mut lost_rad = [0.0; COORDINATES_MAX];
        for ages_s in rests_s {
            let more_rad = self.resting.rested(ages_s);
            for (lost_rad, more_rad) in lost_rad.iter_mut().zip(more_rad) {
                *lost_rad += more_rad;
            }
            let evidence = self.evidence(&measured, age_s, &lost_rad);
            if evidence.supports(cause, self.unshown_rad) {
                self.lose(&lost_rad, &evidence, cause);
                return true;
            }
        }
        false
    }

    /// What a measurement shows of motors that have lost this motion.
    fn evidence(
        &self,
        measured: &Configuration,
        age_s: f64,
        lost_rad: &[f64; COORDINATES_MAX],
    ) -> Evidence {
        let motions = [&self.motors, &self.resting].map(|motors| motors.remaining_motion(age_s));
        let obeyed = motions[0].start_from(self.motors());
        let rested = motions[1].start_from(&added(self.motors(), lost_rad, -1.0));
        let averaged = added(&obeyed, self.beside.as_slice(), 1.0);
        let [obeyed_end, rested_end] = motions.map(|motion| motion.end_from(measured));
        let mut way_rad = [0.0; COORDINATES_MAX];
        let ends = rested.as_slice().iter().zip(obeyed.as_slice());
        for (way_rad, (rested, obeyed)) in way_rad.iter_mut().zip(ends) {
            *way_rad = rested - obeyed;
        }
        Evidence {
            way_rad,
            lost_rad: norm_rad(lost_rad),
            seen_rad: obeyed.distance_rad(&rested),
            unseen_rad: obeyed_end.distance_rad(&rested_end),
            share: way_share(&obeyed, &rested, measured),
            averaged_share: way_share(&obeyed, &rested, &averaged),
        }
    }

    fn lose(&mut self, lost_rad: &[f64; COORDINATES_MAX], evidence: &Evidence, cause: RestCause) {
        core::mem::swap(&mut self.motors, &mut self.resting);
        self.unshown_rad = match cause {
            RestCause::GoesOn if !evidence.is_shown() => self.unshown_rad + evidence.lost_rad,
            _ => evidence.unseen_rad,
        };
        for led in self.stages.iter_mut().chain([&mut self.measured]) {
            *led = added(led, lost_rad, -1.0);
        }
        // A part that no measurement shows leaves the filters on: a statement without end would switch them off.
        let is_silence = cause == RestCause::Silence && !self.is_idle();
        if evidence.is_visible() || is_silence {
            self.uncorrected_s = None;
            self.forget_beside();
        } else if evidence.is_shown() {
            // The measurement is filtered: what else it shows stays beside the estimate, such as a push.
            for beside in self.beside_last.iter_mut().chain([&mut self.beside]) {
                *beside = added(beside, &evidence.way_rad, -1.0);
            }
        }
        self.commanded = self.motors.cables_commanded(self.motors());
    }

    /// The noise of one measurement would move the estimate of a robot at rest.
    fn is_idle(&self) -> bool {
        let (most_rad, since_s) = IDLE;
        let motion = self.motors.remaining_motion(since_s);
        motion.start_from(self.motors()).distance_rad(self.motors()) < most_rad
    }
}

/// Comparison of a measurement with the places of motors that obeyed and of motors that rested.
#[derive(Debug)]
struct Evidence {
    /// Way from the place of motors that obeyed to that of motors that rested \[rad\].
    way_rad: [f64; COORDINATES_MAX],
    /// Motion that was lost in the rest \[rad\].
    lost_rad: f64,
    /// Distance of both places \[rad\].
    seen_rad: f64,
    /// Distance of both places to which the motors are led from the measurement \[rad\].
    unseen_rad: f64,
    /// Place of the measurement on the way from the first to the second.
    share: f64,
    /// The same of the [average](Estimator::measured_beside) of the measurements before.
    averaged_share: f64,
}

impl Evidence {
    fn supports(&self, cause: RestCause, unshown_rad: f64) -> bool {
        match cause {
            RestCause::Silence => !self.contradicts(),
            RestCause::Stated => self.is_shown(),
            // Together with what was taken before: parts too small to be seen are not contradicted either.
            RestCause::GoesOn => {
                let all_rad = unshown_rad + self.lost_rad;
                self.is_shown() || !self.contradicts() && all_rad <= UNSEEN_RAD
            }
        }
    }

    fn is_visible(&self) -> bool {
        self.seen_rad > VISIBLE_RAD
    }

    fn contradicts(&self) -> bool {
        self.is_visible() && self.share < 0.5
    }

    /// By this measurement, or by the average, which shows less of the motion under way.
    fn is_shown(&self) -> bool {
        let allowed_rad = self.seen_rad.max(UNSEEN_RAD);
        let alone =
            self.is_visible() && SHOWN.contains(&self.share) && self.unseen_rad <= allowed_rad;
        let is_visible_averaged = self.seen_rad > VISIBLE_AVERAGED_RAD;
        let averaged = is_visible_averaged && SHOWN.contains(&self.averaged_share);
        alone || averaged && self.unseen_rad <= self.seen_rad
    }
}

fn norm_rad(bends_rad: &[f64]) -> f64 {
    bends_rad.iter().map(|rad| rad * rad).sum::<f64>().sqrt()
}

/// How far `at` is along the way from `from` to `to`, as a share of this way; 0 without a way.
fn way_share(from: &Configuration, to: &Configuration, at: &Configuration) -> f64 {
    let (mut along, mut way) = (0.0, 0.0);
    let pairs = from.as_slice().iter().zip(to.as_slice());
    for ((from, to), at) in pairs.zip(at.as_slice()) {
        along += (at - from) * (to - from);
        way += (to - from) * (to - from);
    }
    if way > 0.0 { along / way } else { 0.0 }
}
