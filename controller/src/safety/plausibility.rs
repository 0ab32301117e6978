use crate::estimator::Measurement;
use crate::robot::{BendRates, CABLES_MAX, COORDINATES_MAX, Configuration, Robot};

/// Limits of plausible measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlausibilityRules {
    /// Permitted distance of a bend component from the range reachable at its largest rate \[rad\].
    pub jump_rad: f64,
    /// Number of consecutive jumps that is a fault.
    pub jump_limit: u32,
    /// A component whose bits do not change while its net commanded motion exceeds this is frozen \[rad\].
    pub frozen_rad: f64,
}

/// Result of the check of one measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plausibility {
    /// Plausible.
    Good,
    /// Faster than the robot can move: to be ignored.
    Jump,
    /// Last of a series of jumps: to be ignored, and a fault.
    Lost,
    /// A channel did not change although it should have: a fault.
    Frozen {
        /// Its number in the measurement: of a bend component or of a cable; 0 for a tip.
        channel: usize,
    },
}

/// Compares each measurement with earlier ones of its kind.
///
/// It detects a sensor that lost its count, a swapped cable, or a driver that repeats old values with new
/// time stamps. Nothing else detects these: the values are finite, fresh and within the limits.
#[derive(Debug, Clone)]
pub struct MeasurementWatch {
    rules: PlausibilityRules,
    /// Range of the bends and of the tip position.
    bends: Option<Track>,
    tip: Option<Track>,
    jumps: u32,
    /// Net commanded motion of each bend component since the start: the sum of rate · time \[rad\].
    commanded_rad: [f64; COORDINATES_MAX],
    still: Option<Still>,
}

/// A point that follows the measurements no faster than the robot can move.
///
/// The true value moves no faster either. While each measurement is within ε of the truth, the point is, too,
/// and a measurement is never farther than 2ε from the point: noise does not accumulate. A value that moves
/// too fast leaves the point behind until the distance counts as a jump.
#[derive(Debug, Clone, Copy)]
struct Track {
    /// Bend components \[rad\], or the coordinates of the tip \[m\].
    point: [f64; COORDINATES_MAX],
    measured_ns: u64,
}

/// The last good measurement, and the time of the last change of each of its channels.
#[derive(Debug, Clone, Copy)]
struct Still {
    measurement: Measurement,
    /// Commanded motion of each channel at its last change \[rad\].
    changed_at_rad: [f64; CABLES_MAX],
}

impl MeasurementWatch {
    /// A watch without measurements.
    pub fn new(rules: PlausibilityRules) -> Self {
        Self {
            rules,
            bends: None,
            tip: None,
            jumps: 0,
            commanded_rad: [0.0; COORDINATES_MAX],
            still: None,
        }
    }

    /// Limits that a measurement has to keep.
    pub fn rules(&self) -> &PlausibilityRules {
        &self.rules
    }

    /// Adds the commanded motion: `rates` for `elapsed_s`.
    pub fn commanded(&mut self, rates: &BendRates, elapsed_s: f64) {
        for (motion_rad, rate) in self.commanded_rad.iter_mut().zip(rates.as_slice()) {
            *motion_rad += rate * elapsed_s;
        }
    }

    /// Checks a measurement that is newer than all before. The caller ignores jumps.
    ///
    /// A fault is reported once. After a series of jumps it is unknown which values were right, so the next
    /// measurement is accepted; the robot is at rest by then, and a reset is an operator's decision.
    pub fn check(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        measured_ns: u64,
    ) -> Plausibility {
        if !self.follow(robot, measurement, measured_ns) {
            self.jumps = self.jumps.saturating_add(1);
            if self.jumps < self.rules.jump_limit {
                return Plausibility::Jump;
            }
            *self = Self::new(self.rules);
            return Plausibility::Lost;
        }
        self.jumps = 0;
        match self.frozen_channel(robot, measurement) {
            Some(channel) => Plausibility::Frozen { channel },
            None => Plausibility::Good,
        }
    }

    /// Updates the track with the measurement. Returns false for a jump.
    fn follow(&mut self, robot: &Robot, measurement: &Measurement, measured_ns: u64) -> bool {
        let jump_rad = self.rules.jump_rad;
        let rate_of = |k: usize| robot.sections()[k / 2].rate_max_rad_s;
        match measurement {
            Measurement::Configuration(bends) => {
                let bends = bends.as_slice();
                follow(&mut self.bends, bends, measured_ns, jump_rad, rate_of)
            }
            Measurement::CableLengths(lengths) => {
                let bends = robot.bend_from_cable_lengths(lengths);
                let bends = bends.as_slice();
                follow(&mut self.bends, bends, measured_ns, jump_rad, rate_of)
            }
            Measurement::TipPosition(tip_m) => {
                let (speed_m_s, jump_m) = (tip_speed_m_s(robot), jump_rad * hanging_m(robot, 0));
                let tip_m = tip_m.as_slice();
                follow(&mut self.tip, tip_m, measured_ns, jump_m, |_| speed_m_s)
            }
        }
    }

    /// The channel that should have changed the most, and did not. Stores the measurement.
    fn frozen_channel(&mut self, robot: &Robot, measurement: &Measurement) -> Option<usize> {
        let motions_rad = channel_motions_rad(robot, measurement, &self.commanded_rad);
        let mut still = Still {
            measurement: *measurement,
            changed_at_rad: motions_rad,
        };
        let (mut frozen, mut farthest_rad) = (None, self.rules.frozen_rad);
        if let Some(before) = &self.still {
            for (channel, motion_rad) in motions_rad.iter().enumerate() {
                if is_same(&before.measurement, measurement, channel) {
                    still.changed_at_rad[channel] = before.changed_at_rad[channel];
                    let moved_rad = (motion_rad - before.changed_at_rad[channel]).abs();
                    if moved_rad > farthest_rad {
                        (frozen, farthest_rad) = (Some(channel), moved_rad);
                    }
                }
            }
        }
        if frozen.is_some() {
            // Reported once: a robot at rest does not change, and could never prove that its sensor works.
            still.changed_at_rad = motions_rad;
        }
        self.still = Some(still);
        match measurement {
            Measurement::TipPosition(_) => frozen.map(|_| 0),
            _ => frozen,
        }
    }
}

/// Moves the track towards `values`, each component by its largest rate at most. Returns false and moves
/// nothing if a value is more than `tolerance` beyond that, or NaN. The first values are accepted.
fn follow(
    track: &mut Option<Track>,
    values: &[f64],
    measured_ns: u64,
    tolerance: f64,
    rate_of: impl Fn(usize) -> f64,
) -> bool {
    let Some(before) = track else {
        let mut point = [0.0; COORDINATES_MAX];
        for (point, value) in point.iter_mut().zip(values) {
            *point = *value;
        }
        *track = Some(Track { point, measured_ns });
        return true;
    };
    let elapsed_s = measured_ns.saturating_sub(before.measured_ns) as f64 * 1e-9;
    let mut point = before.point;
    for (k, (point, value)) in point.iter_mut().zip(values).enumerate() {
        let (gap, reach) = (value - *point, rate_of(k) * elapsed_s);
        if gap.is_nan() || gap.abs() > tolerance + reach {
            return false;
        }
        *point += gap.clamp(-reach, reach);
    }
    *before = Track { point, measured_ns };
    true
}

/// Commanded motion of each channel of a measurement \[rad\]: of a bend component its own; of a cable its
/// motion divided by its distance from the backbone; of a tip, which moves with all components, those of all
/// components.
fn channel_motions_rad(
    robot: &Robot,
    measurement: &Measurement,
    commanded_rad: &[f64; COORDINATES_MAX],
) -> [f64; CABLES_MAX] {
    let commanded = Configuration::padded(*commanded_rad, robot.section_count());
    if let Measurement::CableLengths(_) = measurement {
        // Strokes are linear in the bends.
        let mut motions = robot.cable_strokes(&commanded);
        let (cables, _) = motions.as_chunks_mut::<3>();
        for (cables, section) in cables.iter_mut().zip(robot.sections()) {
            *cables = cables.map(|stroke_m| stroke_m / section.cable_radius_m);
        }
        return motions;
    }
    let mut motions_rad = [0.0; CABLES_MAX];
    for (motion_rad, commanded_rad) in motions_rad.iter_mut().zip(commanded.as_slice()) {
        *motion_rad = *commanded_rad;
    }
    motions_rad
}

/// Whether a channel is unchanged. A tip position counts as a whole: its one value is in every channel.
fn is_same(before: &Measurement, now: &Measurement, channel: usize) -> bool {
    match (before, now) {
        (Measurement::Configuration(before), Measurement::Configuration(now)) => {
            before.as_slice().get(channel) == now.as_slice().get(channel)
        }
        (Measurement::CableLengths(before), Measurement::CableLengths(now)) => {
            before.get(channel) == now.get(channel)
        }
        (Measurement::TipPosition(before), Measurement::TipPosition(now)) => before == now,
        _ => false,
    }
}

/// Length from the base of section `j` to the tip \[m\]: a change δ of its bend moves the tip by at most δ
/// times this length, because it turns everything after it by at most δ.
fn hanging_m(robot: &Robot, j: usize) -> f64 {
    robot.sections()[j..].iter().map(|s| s.length_m).sum()
}

/// Upper bound of the speed of the tip \[m/s\]: all components at their largest rates, each with its largest
/// effect on the tip. The two components of a section give √2.
fn tip_speed_m_s(robot: &Robot) -> f64 {
    let sections = robot.sections().iter().enumerate();
    let speeds = sections.map(|(j, section)| section.rate_max_rad_s * hanging_m(robot, j));
    core::f64::consts::SQRT_2 * speeds.sum::<f64>()
}

#[cfg(test)]
mod tests;
