use std::fmt;

use cdcr_controller::estimator::{Measurement, tip_offset_max_m};
use cdcr_controller::robot::Robot;

use super::CycleRecord;

/// How far a tip that is not used is measured from where the bends place it, for the person who has to correct it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipRejection {
    /// \[m\]
    pub away_m: f64,
    /// The largest distance that is followed \[m\].
    pub limit_m: f64,
}

impl TipRejection {
    /// Of a record with a rejected tip.
    pub fn find(robot: &Robot, record: &CycleRecord) -> Option<Self> {
        let tip = record.tip_measurement.map(|timed| timed.measurement);
        let Some(Measurement::TipPosition(tip_m)) = tip else {
            return None;
        };
        Some(Self {
            away_m: (tip_m - robot.tip_position(&record.present)).norm(),
            limit_m: tip_offset_max_m(robot.reach_m()),
        })
    }
}

impl fmt::Display for TipRejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [away_mm, limit_mm] = [1e3 * self.away_m, 1e3 * self.limit_m];
        write!(
            f,
            "the measured tip is not used, {away_mm:.1} mm from where the bends place it; the limit is {limit_mm:.1} mm, a ninth of the robot's length and at most 100 mm. "
        )?;
        if self.away_m > self.limit_m {
            write!(
                f,
                "Usual causes: (1) the frame of the sensor is not that of the base: compare origin and axes with the robot straight \
                 and bent (docs/drivers.md, Frames); (2) the sensor sends millimetres: send metres; (3) lengths or cable radii of the configuration are wrong: cdcrctl calibrate geometry; \
                 (4) the encoders have lost their zero: docs/drivers.md, Zero; (5) the sensor sees something else than the tip"
            )
        } else {
            write!(
                f,
                "Usual causes: (1) it jumps: look for reflections and lost sights; (2) it is frozen, with the same bits again: check that the sensor measures; \
                 (3) it was beyond the limit before: it is used again after some time. After many jumps or a freeze it is used again only after cdcrctl stop and reset, or from a sensor that is started again"
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_and_the_causes_that_fit_them_are_named() {
        let limit_m = 0.0333;
        let far = TipRejection {
            away_m: 0.05,
            limit_m,
        }
        .to_string();
        for part in [
            "50.0 mm from where",
            "the limit is 33.3 mm",
            "frame",
            "calibrate geometry",
            "zero",
        ] {
            assert!(far.contains(part), "{far}");
        }
        let near = TipRejection {
            away_m: 0.02,
            limit_m,
        }
        .to_string();
        assert!(
            near.contains("20.0 mm") && near.contains("frozen"),
            "{near}"
        );
        assert!(!near.contains("calibrate"), "{near}");
    }
}
