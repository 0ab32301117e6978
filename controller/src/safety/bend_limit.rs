use std::f64::consts::PI;
use std::fmt;

use crate::robot::{Configuration, Robot};

/// A bend this far beyond its limit is not yet a fault \[rad\].
pub const BEND_TOLERANCE_RAD: f64 = 0.05;
/// Time over which measured bends are averaged \[s\].
const AVERAGE_S: f64 = 0.1;
/// Longest time between two measurements that counts \[s\]: after a pause, one of them is not yet the average.
const GAP_MAX_S: f64 = 0.01;

/// Supervision of the measured bends against the limits of their sections. Noise of the sensors is averaged.
#[derive(Debug, Clone, Copy)]
pub struct BendLimitWatch {
    /// Noise of a measured bend that is not a fault \[rad\].
    noise_rad: f64,
    measured: Configuration,
    average: Configuration,
    /// Duration of the measurements \[s\].
    seen_s: f64,
    last_ns: Option<u64>,
}

impl BendLimitWatch {
    /// Measured bends of a robot at `at` may be up to `noise_rad` \[rad\] beside the true ones.
    pub fn new(noise_rad: f64, at: Configuration) -> Self {
        Self {
            noise_rad,
            measured: at,
            average: at,
            seen_s: 0.0,
            last_ns: None,
        }
    }

    /// Takes a measurement that is newer than all before.
    pub fn measured(&mut self, measured: &Configuration, measured_ns: u64) {
        let last_ns = self.last_ns.replace(measured_ns).unwrap_or(measured_ns);
        let elapsed_s = (measured_ns.saturating_sub(last_ns) as f64 * 1e-9).min(GAP_MAX_S);
        self.seen_s += elapsed_s;
        let most_s = self.seen_s.min(AVERAGE_S + elapsed_s);
        let gain = if most_s > 0.0 {
            elapsed_s / most_s
        } else {
            1.0
        };
        self.measured = *measured;
        let pairs = self.average.as_mut_slice().iter_mut();
        for (average, measured) in pairs.zip(measured.as_slice()) {
            *average += gain * (measured - *average);
        }
    }

    /// Whether a measured bend is beyond its limit: on average by more than [`BEND_TOLERANCE_RAD`], or by as much plus the noise now.
    pub fn is_broken(&self, robot: &Robot) -> bool {
        let has_average = self.seen_s >= AVERAGE_S;
        is_beyond(robot, &self.measured, self.noise_rad)
            || has_average && Self::is_beyond(robot, &self.average)
    }

    /// Whether a bend without noise is beyond its limit by more than [`BEND_TOLERANCE_RAD`].
    pub fn is_beyond(robot: &Robot, at: &Configuration) -> bool {
        is_beyond(robot, at, 0.0)
    }
}

/// The section whose bend is farthest beyond its limit, in words for the person who has to correct it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarthestBend {
    /// Section, from 0 at the base.
    pub section: usize,
    /// Its bend \[rad\].
    pub bend_rad: f64,
    /// Its limit \[rad\].
    pub limit_rad: f64,
}

impl FarthestBend {
    /// At the `measured` bends, or, where the measurement does not have them, at the estimated ones. `None` if every section is inside its
    /// limit.
    pub fn find(
        robot: &Robot,
        measured: Option<Configuration>,
        estimate: &Configuration,
    ) -> Option<Self> {
        let at = measured.as_ref().unwrap_or(estimate);
        let sections = robot.sections().iter().enumerate();
        let bends = sections.map(|(section, limits)| Self {
            section,
            bend_rad: at.bend_rad(section),
            limit_rad: limits.bend_max_rad,
        });
        bends
            .filter(|bend| bend.beyond_rad() > 0.0)
            .max_by(|one, other| one.beyond_rad().total_cmp(&other.beyond_rad()))
    }

    fn beyond_rad(&self) -> f64 {
        self.bend_rad - self.limit_rad
    }
}

impl fmt::Display for FarthestBend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            section,
            bend_rad,
            limit_rad,
        } = self;
        write!(
            f,
            "section {} bends by {bend_rad:.4} rad, its bend_max_rad is {limit_rad}",
            section + 1
        )?;
        if *bend_rad > PI {
            f.write_str(" (a driver measures bends in rad and lengths in m, from the base on)")?;
        }
        Ok(())
    }
}

fn is_beyond(robot: &Robot, at: &Configuration, noise_rad: f64) -> bool {
    let mut sections = robot.sections().iter().enumerate();
    sections
        .any(|(j, section)| at.bend_rad(j) > section.bend_max_rad + BEND_TOLERANCE_RAD + noise_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    #[test]
    fn the_bend_farthest_beyond_its_limit_is_named() {
        let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
        let limit_rad = robot.sections()[0].bend_max_rad;
        let bent = |bends_rad: [f64; 2]| {
            Configuration::from_slice(&[bends_rad[0], 0.0, 0.0, bends_rad[1]]).unwrap()
        };
        let [inside, estimate] = [bent([limit_rad, 0.1]), bent([limit_rad + 0.1, 180.0])];
        assert_eq!(FarthestBend::find(&robot, Some(inside), &estimate), None);
        // Only a tip is measured, and the second section is estimated in degrees.
        let farthest = FarthestBend::find(&robot, None, &estimate).unwrap();
        assert_eq!((farthest.section, farthest.bend_rad), (1, 180.0));
        let text = farthest.to_string();
        assert!(
            text.starts_with("section 2 bends by 180.0000 rad, its bend_max_rad is ")
                && text.contains("in rad"),
            "{text}"
        );
    }
}
