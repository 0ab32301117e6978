use crate::estimator::Measurement;
use crate::robot::{BendRates, CABLES_MAX, COORDINATES_MAX, Configuration, Robot};

/// What a robot cannot do, so that its measurement must be wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlausibilityRules {
    /// A bend-vector component may be this far from where its largest rate can have brought it \[rad\].
    pub jump_rad: f64,
    /// So many jumps in a row are a fault.
    pub jump_limit: u32,
    /// A component that stays the same in every bit while it is commanded to move this far, net, is frozen
    /// \[rad\].
    pub frozen_rad: f64,
}

/// What the check of one measurement found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plausibility {
    /// The robot can be there.
    Good,
    /// No robot moves that fast: leave it out.
    Jump,
    /// The last of a series of jumps: leave it out, and a fault.
    Lost,
    /// It should have changed, and has not: a fault.
    Frozen,
}

/// Compares each measurement with those of its kind before.
///
/// A sensor that lost its count, a swapped cable or a driver that repeats old values with new stamps shows
/// here, and nowhere else: its numbers are finite, fresh and within the limits.
#[derive(Debug, Clone)]
pub struct MeasurementWatch {
    rules: PlausibilityRules,
    /// Where the bends, and the tip position, can have gone.
    bends: Option<Track>,
    tip: Option<Track>,
    jumps: u32,
    /// The way of every bend component since the beginning: the sum of rate · time, with its sign \[rad\].
    commanded_rad: [f64; COORDINATES_MAX],
    still: Option<Still>,
}

/// A point that follows the measurements, but no faster than the robot can.
///
/// The true value moves no faster either. So while each measurement is within ε of the truth, the point is,
/// too, and a measurement is never farther than 2ε from it, however often it changes: noise adds nothing up.
/// Behind what moves too fast the point falls back, until the distance is a jump.
#[derive(Debug, Clone, Copy)]
struct Track {
    /// Bend components \[rad\], or the coordinates of the tip \[m\].
    point: [f64; COORDINATES_MAX],
    measured_ns: u64,
}

/// The last good measurement, and since when each of its channels is the same.
#[derive(Debug, Clone, Copy)]
struct Still {
    measurement: Measurement,
    /// The commanded way of each channel when it last changed \[rad\].
    changed_at_rad: [f64; CABLES_MAX],
}

impl MeasurementWatch {
    /// Nothing was measured yet.
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

    /// What it checks by.
    pub fn rules(&self) -> &PlausibilityRules {
        &self.rules
    }

    /// The robot was commanded to move at `rates` for `elapsed_s`.
    pub fn commanded(&mut self, rates: &BendRates, elapsed_s: f64) {
        for (way_rad, rate) in self.commanded_rad.iter_mut().zip(rates.as_slice()) {
            *way_rad += rate * elapsed_s;
        }
    }

    /// Checks a measurement that is newer than every one before. The caller leaves out what jumps.
    ///
    /// A fault is said once. After a series of jumps nobody knows which side was right, so the next
    /// measurement is believed; the robot rests by then, and who resets it has looked.
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
        if self.is_frozen(robot, measurement) {
            return Plausibility::Frozen;
        }
        Plausibility::Good
    }

    /// Takes the measurement into its track, or says that it jumps.
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

    /// Whether a channel is the same though it should have moved. Keeps the measurement.
    fn is_frozen(&mut self, robot: &Robot, measurement: &Measurement) -> bool {
        let ways_rad = channel_ways_rad(robot, measurement, &self.commanded_rad);
        let mut still = Still {
            measurement: *measurement,
            changed_at_rad: ways_rad,
        };
        let mut is_frozen = false;
        if let Some(before) = &self.still {
            for (channel, way_rad) in ways_rad.iter().enumerate() {
                if is_same(&before.measurement, measurement, channel) {
                    still.changed_at_rad[channel] = before.changed_at_rad[channel];
                    let moved_rad = way_rad - before.changed_at_rad[channel];
                    is_frozen |= moved_rad.abs() > self.rules.frozen_rad;
                }
            }
        }
        if is_frozen {
            // Said once: a robot at rest does not change, and could never prove that it is measured again.
            still.changed_at_rad = ways_rad;
        }
        self.still = Some(still);
        is_frozen
    }
}

/// Moves the track towards `values`, each component by its largest rate at most. False, and nothing moved, where
/// one of them is more than `tolerance` farther than that, or not a number. The first values are believed.
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
        let (gap, way) = (value - *point, rate_of(k) * elapsed_s);
        if gap.is_nan() || gap.abs() > tolerance + way {
            return false;
        }
        *point += gap.clamp(-way, way);
    }
    *before = Track { point, measured_ns };
    true
}

/// The commanded way of every channel of such a measurement \[rad\]: of a bend component its own; of a cable
/// what moves it, over its distance from the backbone; of a tip, which moves with all, those of all components.
fn channel_ways_rad(
    robot: &Robot,
    measurement: &Measurement,
    commanded_rad: &[f64; COORDINATES_MAX],
) -> [f64; CABLES_MAX] {
    let commanded = Configuration::padded(*commanded_rad, robot.section_count());
    if let Measurement::CableLengths(_) = measurement {
        // Linear: a way of the bends gives a way of the cables.
        let mut ways = robot.cable_strokes(&commanded);
        let (cables, _) = ways.as_chunks_mut::<3>();
        for (cables, section) in cables.iter_mut().zip(robot.sections()) {
            *cables = cables.map(|way_m| way_m / section.cable_radius_m);
        }
        return ways;
    }
    let mut ways_rad = [0.0; CABLES_MAX];
    for (way_rad, commanded_rad) in ways_rad.iter_mut().zip(commanded.as_slice()) {
        *way_rad = *commanded_rad;
    }
    ways_rad
}

/// Whether a channel is what it was. A tip position counts as a whole: its one value is in every channel.
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

/// The length that hangs on the base of section `j` \[m\]: a bend of δ in it moves the tip by no more than δ times
/// that, because it turns all that follows by δ at most.
fn hanging_m(robot: &Robot, j: usize) -> f64 {
    robot.sections()[j..].iter().map(|s| s.length_m).sum()
}

/// A speed that the tip cannot exceed \[m/s\]: all components at their largest rates, and each moves the tip as
/// far as it can. The two components of a section make √2.
fn tip_speed_m_s(robot: &Robot) -> f64 {
    let sections = robot.sections().iter().enumerate();
    let speeds = sections.map(|(j, section)| section.rate_max_rad_s * hanging_m(robot, j));
    core::f64::consts::SQRT_2 * speeds.sum::<f64>()
}

#[cfg(test)]
mod tests;
