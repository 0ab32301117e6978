//! The inputs and the output of the safety checks of one command.

use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, Obstacle, Robot};

use super::clearance::{ClearanceGuard, Guarded};
use super::stopping::{Stopping, fastest, shortened_to};
use super::{Limited, Limits, LimitsHit};

/// Motors that lag behind their commands.
#[derive(Debug, Clone, Copy)]
pub struct Lag<'a> {
    /// Configuration at the end of their delay, where the next command begins to act
    /// ([`Estimator::delayed`](crate::estimator::Estimator::delayed)).
    pub delayed: &'a Configuration,
    /// Time after which the commands so far have led the robot from there to [`Situation::at`], nearly
    /// ([`Actuator::time_constant_s`](crate::estimator::Actuator::time_constant_s)) \[s\].
    pub time_constant_s: f64,
}

/// The inputs of the safety checks of one command.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a> {
    /// Model of the robot.
    pub robot: &'a Robot,
    /// Configuration to which the commands so far lead.
    pub at: &'a Configuration,
    /// Motors that lag behind their commands; `None`: the robot is at `at`.
    pub lag: Option<Lag<'a>>,
    /// Commanded configuration of the motors, if it differs: for position commands, or for motors whose
    /// cables have play. Limits and clearance must hold there, too.
    pub commanded: Option<&'a Configuration>,
    /// Play between motors and cables, and its present state; `None` or a play of 0 means no play.
    pub slack: Option<&'a Slack>,
    /// Previous command.
    pub previous: &'a BendRates,
    /// Obstacles at the time when the robot is at `at`.
    pub obstacles: &'a [Obstacle],
    /// Safe distance D \[m\].
    pub safe_distance_m: f64,
    /// Uncertainty of the tip position against the bends \[m\], 0 or more. The body counts as thicker by a
    /// part of it in each section ([`Robot::enlarged`],
    /// [`Estimator::tip_margin_m`](crate::estimator::Estimator::tip_margin_m)).
    pub tip_offset_m: f64,
    /// Largest increase of a rate \[rad/s²\]; infinite: no limit.
    pub acceleration_rad_s2: f64,
    /// Period T of the cycle \[s\].
    pub period_s: f64,
    /// Time for which the robot executes a command when no other follows \[s\], at least a period.
    pub moving_s: f64,
    /// Deceleration of the fastest component after that \[rad/s²\]; infinite: the robot stops at once.
    pub deceleration_rad_s2: f64,
    /// Whether the robot comes to rest: rates are then only shortened.
    pub comes_to_rest: bool,
}

impl<'a> Situation<'a> {
    pub(super) fn stopping(&self) -> Stopping {
        Stopping {
            moving_s: self.moving_s.max(self.period_s),
            deceleration_rad_s2: self.deceleration_rad_s2,
        }
    }

    /// Limits for rates whose components exceed neither `fastest_rad_s` nor their own limit.
    pub(super) fn limits(&self, fastest_rad_s: f64) -> Limits<'a> {
        let sections = self.robot.sections().iter();
        let limit_rad_s = sections.fold(0.0_f64, |most, section| most.max(section.rate_max_rad_s));
        let path_s = self.stopping().path(fastest_rad_s.min(limit_rad_s)).path_s;
        Limits::new(self.robot, self.at, path_s)
            .with_commanded(self.commanded)
            .with_stopping(self.stopping())
    }

    /// The same limits with that of the acceleration.
    pub(super) fn limits_moving(&self, fastest_rad_s: f64) -> Limits<'a> {
        let change_rad_s = self.acceleration_rad_s2 * self.period_s;
        self.limits(fastest_rad_s)
            .with_acceleration(self.previous, change_rad_s)
    }

    /// The permitted rates nearest to `desired`.
    pub(super) fn limited(&self, desired: &BendRates) -> Limited {
        let limited = self.limits_moving(fastest(desired)).nearest(desired);
        Limited {
            // The projection satisfies that except for rounding.
            rates: shortened_to(limited.rates, fastest(desired)),
            ..limited
        }
    }

    /// The play, if it is not zero.
    pub(super) fn play(&self) -> Option<&'a Slack> {
        self.slack.filter(|slack| slack.play_m() > 0.0)
    }

    /// Command of a robot that comes to rest: `ramp` is only shortened.
    pub(super) fn shortened(&self, ramp: &BendRates) -> SafeCommand {
        let limited = self.limits(fastest(ramp)).shorten(ramp);
        let guard = ClearanceGuard {
            slack: self.play(),
            ..self.guard()
        };
        SafeCommand::new(limited, guard.scale_down(&limited.rates))
    }

    /// `rates` in place of `safe`, shortened by limits and guard; rest if they then violate `holds`.
    pub(super) fn repaired(
        &self,
        safe: &SafeCommand,
        rates: &BendRates,
        holds: impl Fn(&BendRates) -> bool,
    ) -> SafeCommand {
        let limited = self.limits(fastest(rates)).shorten(rates);
        let guarded = self.guard().shorten(&limited.rates).rates;
        SafeCommand {
            rates: if holds(&guarded) {
                guarded
            } else {
                BendRates::zero(self.robot.section_count())
            },
            limits_hit: safe.limits_hit.or(limited.hit),
            clearance_hit: true,
            ..*safe
        }
    }

    /// The guard for a robot without play.
    pub(super) fn guard(&self) -> ClearanceGuard<'a> {
        ClearanceGuard {
            robot: self.robot,
            at: self.at,
            commanded: self.commanded,
            slack: None,
            obstacles: self.obstacles,
            safe_distance_m: self.safe_distance_m,
            period_s: self.period_s,
            stopping: self.stopping(),
        }
    }
}

/// A command that satisfies all limits and the clearance rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafeCommand {
    /// Rates to command, after limits and clearance guard \[rad/s\].
    pub rates: BendRates,
    /// The limits that changed them.
    pub limits_hit: LimitsHit,
    /// Whether the clearance guard changed them.
    pub clearance_hit: bool,
    /// Smallest present clearance of the body, thickened by the uncertainty of the tip, to any obstacle
    /// \[m\]: negative inside an obstacle, infinite without obstacles, NaN when the state is not finite.
    pub clearance_m: f64,
}

impl SafeCommand {
    pub(super) fn new(limited: Limited, guarded: Guarded) -> Self {
        Self {
            rates: guarded.rates,
            limits_hit: limited.hit,
            clearance_hit: guarded.hit,
            clearance_m: guarded.clearance_m,
        }
    }
}
