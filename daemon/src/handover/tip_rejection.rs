use std::fmt;

use cdcr_controller::estimator::{Measurement, tip_offset_max_m};
use cdcr_controller::robot::Robot;

use super::CycleRecord;

/// Why a tip measured beside bends or cables is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TipCause {
    /// Farther from where the bends place it than is followed.
    Far,
    /// It was, and has not been near for long enough since.
    WasFar,
    /// Faster than the robot can move.
    Jumps,
    /// The last of many jumps in a row.
    Jumped,
    /// The same bits while the robot moved.
    Frozen,
}

impl TipCause {
    /// Whether the sensor is not used again before a reset, or before another sensor comes.
    pub fn lasts(self) -> bool {
        matches!(self, Self::Jumped | Self::Frozen)
    }

    fn advice(self) -> &'static str {
        match self {
            Self::Far => {
                "Usual causes: (1) the frame of the sensor is not that of the base: compare origin and axes with the robot straight \
                 and bent (docs/drivers.md, Frames); (2) the sensor sends millimetres: send metres; (3) order or sign of the cables is wrong: docs/drivers.md, The first motion; \
                 (4) lengths or cable radii of the configuration are wrong: cdcrctl calibrate geometry; \
                 (5) the encoders have lost their zero: docs/drivers.md, Zero; (6) the sensor sees something else than the tip"
            }
            Self::WasFar => "It is used again after 0.32 to 20 s within the limit",
            Self::Jumps => {
                "It moved faster than the robot can: look for reflections and a lost line of sight"
            }
            Self::Jumped => {
                "It moved faster than the robot can many times in a row: look for reflections and a lost line of sight. It is used again only after \
                 cdcrctl stop and reset, or after the program of the sensor is restarted"
            }
            Self::Frozen => {
                "Its value did not change while the robot moved: check that the sensor measures. It is used again only after cdcrctl stop and reset, \
                 or after the program of the sensor is restarted"
            }
        }
    }
}

/// How far a tip that is not used is measured from where the bends place it, for the person who has to correct it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipRejection {
    pub cause: TipCause,
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
            cause: record.tip_unused?,
            away_m: (tip_m - robot.tip_position(&record.present)).norm(),
            limit_m: tip_offset_max_m(robot.reach_m()),
        })
    }

    /// Whether it is a line of the log after `before`, the rejection of the cycle before.
    pub fn is_news(&self, before: Option<&Self>) -> bool {
        before.is_none_or(|before| self.cause.lasts() && before.cause != self.cause)
    }
}

impl fmt::Display for TipRejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [away_mm, limit_mm] = [1e3 * self.away_m, 1e3 * self.limit_m];
        let limit = format!("{limit_mm:.1} mm, a ninth of the robot's length and at most 100 mm");
        let was_far = matches!(self.cause, TipCause::Far | TipCause::WasFar);
        let limit = match (self.away_m > self.limit_m, was_far) {
            (true, _) => format!("; the limit is {limit}"),
            (false, true) => format!(", after it was beyond the limit of {limit}"),
            (false, false) => format!(", which is within the limit of {limit}"),
        };
        write!(
            f,
            "the measured tip is not used, {away_mm:.1} mm from where the bends place it{limit}. {}",
            self.cause.advice()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rejection(cause: TipCause) -> TipRejection {
        TipRejection {
            cause,
            away_m: 0.05,
            limit_m: 0.0333,
        }
    }

    #[test]
    fn the_values_and_what_fits_the_cause_are_named() {
        let text = |cause| rejection(cause).to_string();
        let far = text(TipCause::Far);
        for part in [
            "50.0 mm from where",
            "the limit is 33.3 mm",
            "frame",
            "calibrate geometry",
            "zero",
        ] {
            assert!(far.contains(part), "{far}");
        }
        // Also beyond the limit, a tip may be rejected for another cause.
        for (cause, part) in [
            (TipCause::Jumps, "reflections"),
            (TipCause::Frozen, "reset"),
        ] {
            let text = text(cause);
            assert!(text.contains(part) && !text.contains("calibrate"), "{text}");
        }
    }

    #[test]
    fn a_tip_that_is_near_again_is_not_called_too_far() {
        let near = |cause| {
            let rejection = TipRejection {
                limit_m: 0.06,
                ..rejection(cause)
            };
            rejection.to_string()
        };
        let text = near(TipCause::WasFar);
        assert!(
            text.contains(
                "50.0 mm from where the bends place it, after it was beyond the limit of 60.0 mm"
            ),
            "{text}"
        );
        let text = near(TipCause::Frozen);
        assert!(
            text.contains("which is within the limit of 60.0 mm"),
            "{text}"
        );
        let text = rejection(TipCause::WasFar).to_string();
        assert!(text.contains("; the limit is 33.3 mm"), "{text}");
    }

    #[test]
    fn a_rejection_is_logged_where_it_begins_and_where_it_lasts() {
        use TipCause::{Far, Jumped, Jumps};
        for (before, now, is_logged) in [
            (None, Far, true),
            (Some(Far), Far, false),
            (Some(Far), Jumps, false),
            (Some(Jumps), Jumped, true),
            (Some(Jumped), Jumped, false),
        ] {
            let before = before.map(rejection);
            let is_news = rejection(now).is_news(before.as_ref());
            assert_eq!(is_news, is_logged, "{before:?} {now:?}");
        }
    }
}
