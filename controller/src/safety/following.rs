//! Supervision of the following error: does the robot execute its commands?

mod cause;

use crate::robot::{BendRates, CABLES_MAX, COORDINATES_MAX, Configuration, Robot, SECTIONS_MAX};

pub use cause::FollowingCause;

/// Number of commanded configurations stored over the lag.
const PAST_MAX: usize = 32;
/// Time constant with which the expected position of a speed-controlled robot returns to the measured one
/// \[s\]: small speed errors accumulate, and the controller compensates for them.
const FORGETTING_S: f64 = 1.0;

/// Thresholds of the following error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FollowingRules {
    /// A larger following error of a section is a warning \[rad\].
    pub warning_rad: f64,
    /// A larger one is a fault \[rad\].
    pub fault_rad: f64,
    /// Largest permitted lag of the robot behind its commands \[s\].
    pub lag_s: f64,
}

/// Difference between measured and expected configuration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FollowingError {
    /// By section \[rad\].
    pub bend_rad: [f64; SECTIONS_MAX],
    /// By cable \[m\]: positive where it is longer than commanded. Where lengths are measured and positions obeyed, also by what the three
    /// cables of a section differ by together, which is not an error of a bend.
    pub cable_m: [f64; CABLES_MAX],
}

impl FollowingError {
    /// Error of the section with the largest error \[rad\].
    pub fn largest_rad(&self) -> f64 {
        self.largest().1
    }

    /// That section, 1 next to the base, and its error \[rad\]; 0 where no section has one.
    pub fn largest(&self) -> (u32, f64) {
        let sections = (1..).zip(self.bend_rad);
        sections.fold(
            (0, 0.0),
            |most, section| {
                if section.1 > most.1 { section } else { most }
            },
        )
    }
}

/// Smallest and largest value of each component.
type ComponentRange = (Configuration, Configuration);

/// A measurement of a robot that executes its commands.
#[derive(Debug, Clone, Copy)]
struct FollowedAt {
    at: Configuration,
    /// The robot completes its commands at the commanded value plus the first to the second of these. Speeds: their integral
    /// has returned to measurements that lag, so the motion of the lag is still to come. Positions: the error remains.
    beside: ComponentRange,
}

/// Compares measurements with the commands of the last [`lag_s`](FollowingRules::lag_s). A robot with a lag
/// or delay up to `lag_s` may be anywhere between the smallest and the largest commanded value of that time;
/// a component of the bend vector inside that range has no error.
///
/// For a robot that obeys positions, the commanded value is the commanded position. For one that obeys
/// speeds, it is the integral of the speeds, which returns to the measured value with a time constant of one
/// second.
///
/// In a [latched](Self::latch) mode the expected position does not return: it is where the last command left the robot,
/// however long the robot rests there.
#[derive(Debug, Clone)]
pub struct FollowingWatch {
    rules: FollowingRules,
    obeys_positions: bool,
    commanded: Configuration,
    /// Commanded value of each component \[rad\], and the time until which it was commanded \[s\]. Stored by
    /// component, because robots with few sections then read less memory.
    past_rad: [[f64; PAST_MAX]; COORDINATES_MAX],
    until_s: [f64; PAST_MAX],
    newest: usize,
    /// Time since control began \[s\].
    now_s: f64,
    /// Time since the last measurement \[s\].
    unmeasured_s: f64,
    /// In a latched mode: smallest and largest value of each component where the robot may rest. Motors may have stopped at
    /// once, also those of a driver that fell silent, or complete their motion.
    latched: Option<ComponentRange>,
    /// The last measurement in control, unless its error was a fault.
    followed: Option<FollowedAt>,
    error: FollowingError,
}

impl FollowingWatch {
    /// Supervision of a robot that starts at `at`.
    pub fn new(rules: FollowingRules, obeys_positions: bool, at: Configuration) -> Self {
        Self {
            rules,
            obeys_positions,
            commanded: at,
            past_rad: core::array::from_fn(|i| {
                [at.as_slice().get(i).copied().unwrap_or(0.0); PAST_MAX]
            }),
            until_s: [0.0; PAST_MAX],
            newest: 0,
            now_s: 0.0,
            unmeasured_s: 0.0,
            latched: None,
            followed: None,
            error: FollowingError::default(),
        }
    }

    /// Restarts: the robot is at its expected position.
    pub fn begin(&mut self, at: Configuration) {
        *self = Self::new(self.rules, self.obeys_positions, at);
    }

    /// Restarts while the robot still moves to `at`: the commanded values of the lag are shifted along.
    pub fn begin_moving(&mut self, at: Configuration) {
        let from = core::mem::replace(&mut self.commanded, at);
        let ends = at.as_slice().iter().zip(from.as_slice());
        for (past_rad, (to, from)) in self.past_rad.iter_mut().zip(ends) {
            for past_rad in past_rad {
                *past_rad += to - from;
            }
        }
        self.error = FollowingError::default();
    }

    /// The robot is in a latched mode.
    pub fn is_latched(&self) -> bool {
        self.latched.is_some()
    }

    /// Whether the robot is in a latched mode from now on.
    pub fn latch(&mut self, is_latched: bool) {
        if is_latched != self.latched.is_some() {
            self.latched = is_latched.then(|| self.commanded_range());
            if let (Some(range), Some(followed)) = (&mut self.latched, &self.followed) {
                widen(range, &followed.at);
            }
            self.widen_latched();
        }
    }

    /// Widens the range of a latched mode by where the commands so far lead.
    fn widen_latched(&mut self) {
        let Some(range) = &mut self.latched else {
            return;
        };
        widen(range, &self.commanded);
        if let Some(FollowedAt { beside, .. }) = &self.followed {
            for by in [&beside.0, &beside.1] {
                widen(range, &sum(&self.commanded, 1.0, by));
            }
        }
    }

    /// Thresholds of warning and fault.
    pub fn rules(&self) -> &FollowingRules {
        &self.rules
    }

    /// The robot was commanded to move at `rates` for `moving_s` of the last `elapsed_s`.
    pub fn commanded(&mut self, rates: &BendRates, moving_s: f64, elapsed_s: f64) {
        let stored_s = self.now_s - self.until_s[self.newest];
        if (stored_s + elapsed_s) * (PAST_MAX - 1) as f64 >= self.rules.lag_s {
            self.newest = (self.newest + 1) % PAST_MAX;
            self.until_s[self.newest] = self.now_s;
            for (past_rad, commanded) in self.past_rad.iter_mut().zip(self.commanded.as_slice()) {
                past_rad[self.newest] = *commanded;
            }
        }
        self.commanded = self.commanded.advanced(rates, moving_s);
        self.widen_latched();
        self.unmeasured_s += elapsed_s;
        self.now_s += elapsed_s;
    }

    /// Evaluates a measurement.
    pub fn measured(&mut self, robot: &Robot, measured: &Configuration) -> &FollowingError {
        if !self.obeys_positions && self.latched.is_none() {
            let gain = self.unmeasured_s / (self.unmeasured_s + FORGETTING_S);
            self.draw_to(measured, gain);
        }
        self.unmeasured_s = 0.0;
        let (least, most) = self.latched.unwrap_or_else(|| self.commanded_range());
        let mut off = *measured;
        let range = least.as_slice().iter().zip(most.as_slice());
        for (off, (least, most)) in off.as_mut_slice().iter_mut().zip(range) {
            *off = (*off - most).max(0.0) + (*off - least).min(0.0);
        }
        // Strokes are linear: a difference of bends gives one of lengths.
        self.error = FollowingError {
            bend_rad: core::array::from_fn(|j| off.bend_rad(j)),
            cable_m: robot.cable_strokes(&off),
        };
        if self.latched.is_none() {
            let beside = if self.obeys_positions {
                (off, off)
            } else {
                (sum(measured, -1.0, &most), sum(measured, -1.0, &least))
            };
            self.followed = (!self.is_broken()).then_some(FollowedAt {
                at: *measured,
                beside,
            });
        }
        &self.error
    }

    /// The lengths of the measurement evaluated last. Motors that obey positions take up a common mode that differs from the commanded
    /// one: it is part of the cables' errors.
    pub fn measured_lengths(&mut self, robot: &Robot, lengths_m: &[f64; CABLES_MAX]) {
        if self.obeys_positions {
            let (sections, _) = self.error.cable_m.as_chunks_mut::<3>();
            for (cables_m, common_m) in sections.iter_mut().zip(robot.common_errors_m(lengths_m)) {
                *cables_m = cables_m.map(|error_m| error_m + common_m);
            }
        }
    }

    /// A measurement without bends, to which the last error does not apply.
    pub fn unmeasured(&mut self) {
        self.error = FollowingError::default();
    }

    /// Error at the last measurement.
    pub fn error(&self) -> &FollowingError {
        &self.error
    }

    /// Whether the error exceeds the threshold of a fault.
    pub fn is_broken(&self) -> bool {
        self.error.largest_rad() > self.rules.fault_rad
    }

    /// Smallest and largest commanded value of each component within the lag.
    fn commanded_range(&self) -> ComponentRange {
        let since_s = self.now_s - self.rules.lag_s;
        let (mut least, mut most) = (self.commanded, self.commanded);
        let range = least.as_mut_slice().iter_mut().zip(most.as_mut_slice());
        for ((least, most), past_rad) in range.zip(&self.past_rad) {
            for (past_rad, until_s) in past_rad.iter().zip(&self.until_s) {
                if *until_s >= since_s {
                    *least = least.min(*past_rad);
                    *most = most.max(*past_rad);
                }
            }
        }
        (least, most)
    }

    fn draw_to(&mut self, measured: &Configuration, gain: f64) {
        let pairs = self.commanded.as_mut_slice().iter_mut();
        for (commanded, measured) in pairs.zip(measured.as_slice()) {
            *commanded += gain * (measured - *commanded);
        }
    }
}

/// Widens a range by a configuration.
fn widen((least, most): &mut ComponentRange, by: &Configuration) {
    let range = least.as_mut_slice().iter_mut().zip(most.as_mut_slice());
    for ((least, most), value) in range.zip(by.as_slice()) {
        *least = least.min(*value);
        *most = most.max(*value);
    }
}

/// One configuration and the multiple of another.
fn sum(one: &Configuration, factor: f64, other: &Configuration) -> Configuration {
    let mut sum = *one;
    for (sum, other) in sum.as_mut_slice().iter_mut().zip(other.as_slice()) {
        *sum += factor * other;
    }
    sum
}

#[cfg(test)]
mod tests;
