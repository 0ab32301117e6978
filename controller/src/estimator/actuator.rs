use core::ops::Range;

use super::slack::{PlayWindow, Slack};
use crate::robot::{BendRates, COORDINATES_MAX, Configuration, Robot};

/// Dynamics of the motors: a pure delay and a first-order lag, with play between motors and cables. Valid for
/// position-controlled motors, `q̇ = (q_c(t − delay) − q) / time_constant`, and for speed-controlled ones, whose speed
/// follows the same equation (docs/model.md §6).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Actuator {
    /// Time from the release of a command until the motors begin to follow it \[s\], at most [`Self::TIME_MAX_S`].
    pub delay_s: f64,
    /// Time constant \[s\], at most [`Self::TIME_MAX_S`].
    pub time_constant_s: f64,
    /// Travel of a reversing motor before its cable follows \[m\], at most [`Self::PLAY_MAX_M`].
    pub play_m: f64,
}

impl Actuator {
    /// Largest delay and largest time constant \[s\].
    pub const TIME_MAX_S: f64 = 0.3;
    /// Largest play \[m\].
    pub const PLAY_MAX_M: f64 = 0.01;

    /// Motors that follow every command at once.
    pub const IDEAL: Self = Self {
        delay_s: 0.0,
        time_constant_s: 0.0,
        play_m: 0.0,
    };

    /// Lag behind the commands of a robot that moves at constant rates \[s\].
    pub fn lead_s(&self) -> f64 {
        self.delay_s + self.time_constant_s
    }
}

/// Lag of the motors behind their commands, now and in the recent past.
#[derive(Debug)]
pub(super) struct ActuatorModel {
    actuator: Actuator,
    /// The last moves; the newest is at `newest`.
    moves: Box<[Move]>,
    newest: usize,
    play: Option<PlayModel>,
}

impl Clone for ActuatorModel {
    fn clone(&self) -> Self {
        Self {
            actuator: self.actuator,
            moves: self.moves.clone(),
            newest: self.newest,
            play: self.play.clone(),
        }
    }

    /// Does not allocate.
    fn clone_from(&mut self, source: &Self) {
        self.actuator = source.actuator;
        self.moves.copy_from_slice(&source.moves);
        self.newest = source.newest;
        self.play.clone_from(&source.play);
    }
}

/// Play of the cables.
#[derive(Debug, Clone)]
struct PlayModel {
    robot: Robot,
    /// State of the play for motors without delay.
    motors: Slack,
    /// State of the play when the motors have reached the commanded configuration.
    commanded: Slack,
    /// Motion of the motors by measurements that is withheld from the cables: the cables rest within a band.
    band: Slack,
    /// The part of the play that the motors cross.
    window: PlayWindow,
}

/// Width of the band as a share of the play. Motors that reverse because of noise cross the whole play. As they do not
/// take all cables along at once, the tip would move more than the noise.
const BAND_SHARE: f64 = 0.1;
/// Share of the play that the motors cross at rest while the tip is measured. A share above the real play would move
/// the robot past its target at every reversal, without end. The tip sensor corrects a share that is too low.
const PLAY_SHARE_AT_REST: f64 = 0.75;

/// Rates commanded for a duration.
#[derive(Debug, Clone, Copy)]
struct Move {
    rates: BendRates,
    duration_s: f64,
    /// Share of the duration for which the motors obeyed; the rates are the mean ones.
    obeyed: f64,
    /// Lag of motors without delay at the end of this move \[rad\].
    behind_rad: [f64; COORDINATES_MAX],
    /// Bends of the cables minus those of motors without delay, at the end of this move \[rad\].
    slack_rad: [f64; COORDINATES_MAX],
}

impl Move {
    fn rest(section_count: usize) -> Self {
        Self {
            rates: BendRates::zero(section_count),
            duration_s: 0.0,
            obeyed: 1.0,
            behind_rad: [0.0; COORDINATES_MAX],
            slack_rad: [0.0; COORDINATES_MAX],
        }
    }
}

/// Number of moves kept: 0.64 s at 5 ms. For an older measurement, only the motion of this time is added.
const MOVES_MAX: usize = 128;

impl ActuatorModel {
    /// Motors at rest at their command.
    pub(super) fn new(actuator: Actuator, section_count: usize) -> Self {
        Self {
            actuator,
            moves: vec![Move::rest(section_count); MOVES_MAX].into_boxed_slice(),
            newest: 0,
            play: None,
        }
    }

    /// Adds the play of the actuator between the motors and the cables of this robot.
    pub(super) fn with_play(mut self, robot: &Robot) -> Self {
        let middle = Slack::middle(self.actuator.play_m);
        self.play = (self.actuator.play_m > 0.0).then(|| PlayModel {
            robot: robot.clone(),
            motors: middle,
            commanded: middle,
            band: Slack::middle(BAND_SHARE * self.actuator.play_m),
            window: PlayWindow::WHOLE,
        });
        self
    }

    /// Configuration of the cables when the commands lead the motors to `at`.
    pub(super) fn cables_commanded(&self, at: &Configuration) -> Configuration {
        let mut cables = *at;
        if let Some(play) = &self.play {
            for slack in [&play.commanded, &play.band] {
                add(
                    cables.as_mut_slice(),
                    slack.bends(&play.robot).as_slice(),
                    1.0,
                );
            }
        }
        cables
    }

    /// Takes a correction of the motors' configuration from `from` to `to` by measurements: the cables follow only
    /// beyond the band.
    pub(super) fn hold_cables(&mut self, from: &Configuration, to: &Configuration) {
        if let Some(play) = &mut self.play {
            let moved = added(to, from.as_slice(), -1.0);
            play.band = play.band.moved(&play.robot, &moved);
        }
    }

    /// Resets the band and the window: the cables follow the measurements.
    pub(super) fn reset_band(&mut self) {
        if let Some(play) = &mut self.play {
            play.band = Slack::middle(play.band.play_m());
            play.window = PlayWindow::WHOLE;
        }
    }

    /// Switches between a robot that `rests` and one that moves, while its tip is measured. Returns true if this
    /// changes the estimated place of the cables.
    pub(super) fn set_rest(&mut self, rests: bool) -> bool {
        let Some(play) = &mut self.play else {
            return false;
        };
        let is_whole = play.window == PlayWindow::WHOLE;
        if rests {
            if is_whole {
                play.window = PlayWindow::around(&play.motors, PLAY_SHARE_AT_REST);
            }
            return false;
        }
        if !is_whole {
            let before = play.motors.bends(&play.robot);
            let window = core::mem::replace(&mut play.window, PlayWindow::WHOLE);
            play.motors = play.motors.widened(&window);
            play.commanded = play.commanded.widened(&window);
            let after = play.motors.bends(&play.robot);
            for past in &mut self.moves {
                add(&mut past.slack_rad, after.as_slice(), 1.0);
                add(&mut past.slack_rad, before.as_slice(), -1.0);
            }
        }
        !is_whole
    }

    /// State of the play at the commanded configuration; `None`: no play.
    pub(super) fn commanded_slack(&self) -> Option<&Slack> {
        self.play.as_ref().map(|play| &play.commanded)
    }

    /// Sets the motors at rest at their command, with the cables where this leads them; a restart moves none. Does not
    /// allocate.
    pub(super) fn begin(&mut self) {
        let section_count = self.moves[self.newest].rates.section_count();
        let mut rest = Move::rest(section_count);
        if let Some(play) = &mut self.play {
            play.motors = play.commanded;
            let slack = play.commanded.bends(&play.robot);
            add(&mut rest.slack_rad, slack.as_slice(), 1.0);
        }
        self.moves.fill(rest);
    }

    /// Replaces what was commanded between two ages by zero. Returns the motion that is lost \[rad\]. The play keeps
    /// the side to which that motion led. A rest may come in parts, each once.
    pub(super) fn rested(&mut self, ages_s: &Range<f64>) -> [f64; COORDINATES_MAX] {
        let (mut oldest, mut ended_s) = (0, 0.0);
        let mut lost_rad = [0.0; COORDINATES_MAX];
        for back in 0..MOVES_MAX - 1 {
            let past = self.back_mut(back);
            let (duration_s, obeyed) = (past.duration_s, past.obeyed);
            let rested_s = ages_s.end.min(ended_s + duration_s) - ages_s.start.max(ended_s);
            if rested_s > 0.0 && obeyed > 0.0 {
                past.obeyed = (obeyed - rested_s / duration_s).max(0.0);
                let left = past.obeyed / obeyed;
                add(
                    &mut lost_rad,
                    past.rates.as_slice(),
                    (1.0 - left) * duration_s,
                );
                for rate in past.rates.as_mut_slice() {
                    *rate *= left;
                }
                oldest = back + 1;
            }
            ended_s += duration_s;
        }
        for back in (0..oldest).rev() {
            let (past, before) = (self.back(back), self.back(back + 1));
            let behind_rad = self.behind_after(&past.rates, before, past.duration_s);
            self.back_mut(back).behind_rad = behind_rad;
        }
        lost_rad
    }

    /// Records `rates` commanded for `duration_s`.
    pub(super) fn command(&mut self, rates: &BendRates, duration_s: f64) {
        let before = &self.moves[self.newest];
        let behind_rad = self.behind_after(rates, before, duration_s);
        let mut slack_rad = [0.0; COORDINATES_MAX];
        if let Some(play) = &mut self.play {
            let rest = Configuration::straight(rates.section_count());
            let mut moved = rest.advanced(rates, duration_s);
            add(moved.as_mut_slice(), &before.behind_rad, 1.0);
            add(moved.as_mut_slice(), &behind_rad, -1.0);
            let window = &play.window;
            play.motors = play.motors.moved_within(&play.robot, &moved, window);
            // The lag is taken to be made up at constant rates, whatever the path of the commands: fast reversals do
            // not reach the cables.
            let left = added(&rest, &behind_rad, 1.0);
            play.commanded = play.motors.moved_within(&play.robot, &left, window);
            add(
                &mut slack_rad,
                play.motors.bends(&play.robot).as_slice(),
                1.0,
            );
        }
        self.newest = (self.newest + 1) % MOVES_MAX;
        self.moves[self.newest] = Move {
            rates: *rates,
            duration_s,
            obeyed: 1.0,
            behind_rad,
            slack_rad,
        };
    }

    /// Motion of the motors from their place `age_s` ago to the commanded configuration: the commands of the last age +
    /// delay, and the lag at that time.
    pub(super) fn remaining_motion(&self, age_s: f64) -> RemainingMotion {
        let mut left_s = age_s + self.actuator.delay_s;
        let mut motion_rad = [0.0; COORDINATES_MAX];
        let mut slack_rad = [0.0; COORDINATES_MAX];
        for back in 0..MOVES_MAX {
            let past = self.back(back);
            let part_s = past.duration_s.min(left_s);
            if back + 1 == MOVES_MAX || part_s < past.duration_s || left_s <= 0.0 {
                // The time falls into this move.
                let is_oldest = back + 1 == MOVES_MAX;
                let behind_rad = if part_s > 0.0 && !is_oldest {
                    let began = self.back(back + 1);
                    self.behind_after(&past.rates, began, past.duration_s - part_s)
                } else {
                    past.behind_rad
                };
                add(&mut motion_rad, past.rates.as_slice(), part_s);
                add(&mut motion_rad, &behind_rad, 1.0);
                if self.play.is_some() {
                    let began = self.back((back + 1).min(MOVES_MAX - 1));
                    let left = if past.duration_s > 0.0 {
                        part_s / past.duration_s
                    } else {
                        0.0
                    };
                    add(&mut slack_rad, &past.slack_rad, 1.0 - left);
                    add(&mut slack_rad, &began.slack_rad, left);
                }
                break;
            }
            add(&mut motion_rad, past.rates.as_slice(), part_s);
            left_s -= part_s;
        }
        if let Some(play) = &self.play {
            let band = play.band.bends(&play.robot);
            add(&mut slack_rad, band.as_slice(), 1.0);
        }
        RemainingMotion {
            motion_rad,
            slack_rad,
        }
    }

    /// Motion of the motors from their place at the end of the delay to the commanded configuration: their lag.
    pub(super) fn motion_after_delay(&self) -> RemainingMotion {
        self.remaining_motion(-self.actuator.delay_s)
    }

    fn back(&self, back: usize) -> &Move {
        &self.moves[(self.newest + MOVES_MAX - back) % MOVES_MAX]
    }

    fn back_mut(&mut self, back: usize) -> &mut Move {
        &mut self.moves[(self.newest + MOVES_MAX - back) % MOVES_MAX]
    }

    /// Lag of the motors `duration_s` after the end of `before`, at `rates`: b' = u − b / time constant.
    fn behind_after(
        &self,
        rates: &BendRates,
        before: &Move,
        duration_s: f64,
    ) -> [f64; COORDINATES_MAX] {
        let time_constant_s = self.actuator.time_constant_s;
        let mut behind_rad = [0.0; COORDINATES_MAX];
        if time_constant_s > 0.0 {
            let left = (-duration_s / time_constant_s).exp();
            add(&mut behind_rad, &before.behind_rad, left);
            add(
                &mut behind_rad,
                rates.as_slice(),
                time_constant_s * (1.0 - left),
            );
        }
        behind_rad
    }
}

/// A motion of the motors, in bend vectors.
#[derive(Debug, Clone, Copy)]
pub(super) struct RemainingMotion {
    motion_rad: [f64; COORDINATES_MAX],
    /// Bends of the cables minus those of the motors at its start \[rad\].
    slack_rad: [f64; COORDINATES_MAX],
}

impl RemainingMotion {
    /// The configuration at its end if it starts at `at`.
    pub(super) fn end_from(&self, at: &Configuration) -> Configuration {
        added(at, &self.motion_rad, 1.0)
    }

    /// The configuration at its start if it ends at `at`.
    pub(super) fn start_from(&self, at: &Configuration) -> Configuration {
        added(at, &self.motion_rad, -1.0)
    }

    /// Configuration of the cables at its start if the motors are at `begin`.
    pub(super) fn cables_at_start(&self, begin: &Configuration) -> Configuration {
        added(begin, &self.slack_rad, 1.0)
    }

    /// Configuration of the motors at its start if the cables are at `begin`.
    pub(super) fn motors_at_start(&self, begin: &Configuration) -> Configuration {
        added(begin, &self.slack_rad, -1.0)
    }
}

pub(super) fn added(at: &Configuration, what: &[f64], factor: f64) -> Configuration {
    let mut moved = *at;
    add(moved.as_mut_slice(), what, factor);
    moved
}

/// Adds `factor` times `what`, up to the shorter length.
fn add(to: &mut [f64], what: &[f64], factor: f64) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actuator(delay_s: f64, time_constant_s: f64) -> Actuator {
        Actuator {
            delay_s,
            time_constant_s,
            ..Actuator::IDEAL
        }
    }

    fn rates(u: f64) -> BendRates {
        BendRates::from_slice(&[u, 0.0]).unwrap()
    }

    /// As if zero had been commanded there, at ages inside the moves, too.
    #[test]
    fn motors_that_rested_are_where_zero_rates_lead_them() {
        let [mut rested, mut expected] =
            [(); 2].map(|()| ActuatorModel::new(actuator(0.01, 0.02), 1));
        for _ in 0..10 {
            rested.command(&rates(1.0), 0.005);
        }
        for (rate, duration_s) in [(1.0, 0.025), (0.0, 0.018), (1.0, 0.007)] {
            expected.command(&rates(rate), duration_s);
        }
        let lost_rad = rested.rested(&(0.007..0.025));
        assert!((lost_rad[0] - 0.018).abs() < 1e-12, "{lost_rad:?}");
        let [motion, of_zero] = [&rested, &expected].map(|model| model.remaining_motion(-0.01));
        let difference_rad = motion.motion_rad[0] - of_zero.motion_rad[0];
        assert!(difference_rad.abs() < 5e-4, "{difference_rad} rad");
    }

    /// The recursion against the differential equation in steps of 10 µs, at ages between the moves, too.
    #[test]
    fn remaining_motion_solves_the_differential_equation() {
        const STEP_S: f64 = 1e-5;
        for (delay_s, time_constant_s) in [(0.0, 0.0), (0.012, 0.0), (0.0, 0.03), (0.0125, 0.02)] {
            let actuator = actuator(delay_s, time_constant_s);
            let mut model = ActuatorModel::new(actuator, 1);
            let rate = |time_s: f64| {
                if time_s < 0.0 {
                    0.0
                } else {
                    (5.0 * (time_s / 0.005).floor() * 0.005).cos()
                }
            };
            let (mut commanded, mut delayed, mut motors) = (0.0, 0.0, 0.0_f64);
            let mut past = Vec::new();
            for cycle in 0..60 {
                for step in 0..500 {
                    let time_s = f64::from(cycle) * 0.005 + (f64::from(step) + 0.5) * STEP_S;
                    commanded += STEP_S * rate(time_s);
                    delayed += STEP_S * rate(time_s - delay_s);
                    motors = if time_constant_s > 0.0 {
                        motors + STEP_S / time_constant_s * (delayed - motors)
                    } else {
                        delayed
                    };
                    past.push(motors);
                }
                model.command(&rates(rate((f64::from(cycle) + 0.5) * 0.005)), 0.005);
            }
            for age_steps in [0, 100, 499, 500, 1234, 10_000] {
                let then = past[past.len() - 1 - age_steps];
                let age_s = age_steps as f64 * STEP_S;
                let at = Configuration::from_slice(&[then, 0.0]).unwrap();
                let leads_to = model.remaining_motion(age_s).end_from(&at).as_slice()[0];
                let error = (leads_to - commanded).abs();
                assert!(error < 3e-5, "{actuator:?} {age_s}: {error}");
                let back = model.remaining_motion(age_s).start_from(&at).as_slice()[0];
                assert!((back + leads_to - 2.0 * then).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn older_measurements_get_only_the_motion_kept() {
        let mut model = ActuatorModel::new(Actuator::IDEAL, 1);
        for _ in 0..1000 {
            model.command(&rates(1.0), 0.005);
        }
        let at = Configuration::straight(1);
        let moved = model.remaining_motion(10.0).end_from(&at).as_slice()[0];
        assert!((moved - 128.0 * 0.005).abs() < 1e-12, "{moved}");
        // The lag, too, is that of the moves kept.
        let mut model = ActuatorModel::new(actuator(0.2, 0.1), 1);
        for cycle in 0..1000 {
            model.command(&rates(if cycle < 950 { 1.0 } else { -1.0 }), 0.001);
        }
        let moved = model.remaining_motion(0.0).end_from(&at).as_slice()[0];
        assert!((moved - (0.1 + 0.078 - 0.05)).abs() < 1e-3, "{moved}");
    }
}
