use crate::robot::{BendRates, COORDINATES_MAX, Configuration};

/// How the motors follow a command: after a pure delay, as a first-order system. The same for motors that obey positions,
/// `q̇ = (q_c(t − delay) − q) / time_constant`, and for those that obey speeds, whose speed does so (docs/model.md §8).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Actuator {
    /// From the release of a command until the motors begin to follow it \[s\], 0 to 0.3.
    pub delay_s: f64,
    /// Time constant \[s\], 0 to 0.3.
    pub time_constant_s: f64,
}

impl Actuator {
    /// Motors that do at once what they are told.
    pub const IDEAL: Self = Self {
        delay_s: 0.0,
        time_constant_s: 0.0,
    };

    /// By how much a robot that moves evenly is behind its commands \[s\].
    pub fn lead_s(&self) -> f64 {
        self.delay_s + self.time_constant_s
    }
}

/// How far the motors are behind their commands, now and a while ago.
#[derive(Debug, Clone)]
pub(super) struct ActuatorModel {
    actuator: Actuator,
    /// The last moves, newest at `newest`.
    moves: Box<[Move]>,
    newest: usize,
}

/// Rates that were commanded for a time.
#[derive(Debug, Clone, Copy)]
struct Move {
    rates: BendRates,
    duration_s: f64,
    /// How far motors without delay are behind at its end \[rad\].
    behind_rad: [f64; COORDINATES_MAX],
}

impl Move {
    fn rest(section_count: usize) -> Self {
        Self {
            rates: BendRates::zero(section_count),
            duration_s: 0.0,
            behind_rad: [0.0; COORDINATES_MAX],
        }
    }
}

/// Moves that are remembered: 0.64 s at 5 ms. Of an older measurement only so much is made up for.
const MOVES_MAX: usize = 128;

impl ActuatorModel {
    /// Motors at rest at their command.
    pub(super) fn new(actuator: Actuator, section_count: usize) -> Self {
        Self {
            actuator,
            moves: vec![Move::rest(section_count); MOVES_MAX].into_boxed_slice(),
            newest: 0,
        }
    }

    /// The motors are at rest at their command. Allocates nothing.
    pub(super) fn begin(&mut self) {
        let section_count = self.moves[self.newest].rates.section_count();
        self.moves.fill(Move::rest(section_count));
    }

    /// `rates` were commanded for `duration_s`.
    pub(super) fn command(&mut self, rates: &BendRates, duration_s: f64) {
        let behind_rad = self.behind_after(rates, &self.moves[self.newest], duration_s);
        self.newest = (self.newest + 1) % MOVES_MAX;
        self.moves[self.newest] = Move {
            rates: *rates,
            duration_s,
            behind_rad,
        };
    }

    /// From where the motors were `age_s` ago to where the commands up to now lead them: what was commanded since (age + delay),
    /// and what they were behind then.
    pub(super) fn way_left(&self, age_s: f64) -> WayLeft {
        let mut left_s = age_s + self.actuator.delay_s;
        let mut way_rad = [0.0; COORDINATES_MAX];
        for back in 0..MOVES_MAX {
            let past = self.back(back);
            let part_s = past.duration_s.min(left_s);
            if back + 1 == MOVES_MAX || part_s < past.duration_s || left_s <= 0.0 {
                // The time lies in this move.
                let is_oldest = back + 1 == MOVES_MAX;
                let behind_rad = if part_s > 0.0 && !is_oldest {
                    let began = self.back(back + 1);
                    self.behind_after(&past.rates, began, past.duration_s - part_s)
                } else {
                    past.behind_rad
                };
                add(&mut way_rad, past.rates.as_slice(), part_s);
                add(&mut way_rad, &behind_rad, 1.0);
                break;
            }
            add(&mut way_rad, past.rates.as_slice(), part_s);
            left_s -= part_s;
        }
        WayLeft(way_rad)
    }

    fn back(&self, back: usize) -> &Move {
        &self.moves[(self.newest + 2 * MOVES_MAX - back) % MOVES_MAX]
    }

    /// How far the motors are behind `duration_s` after the end of `before`, at `rates`: b' = u − b / time constant.
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

/// A way in bend vectors \[rad\].
#[derive(Debug, Clone, Copy)]
pub(super) struct WayLeft([f64; COORDINATES_MAX]);

impl WayLeft {
    /// Where it leads from `at`.
    pub(super) fn from(&self, at: &Configuration) -> Configuration {
        self.added(at, 1.0)
    }

    /// Where it began, if it leads to `at`.
    pub(super) fn back_from(&self, at: &Configuration) -> Configuration {
        self.added(at, -1.0)
    }

    fn added(&self, at: &Configuration, sign: f64) -> Configuration {
        let mut moved = *at;
        add(moved.as_mut_slice(), &self.0, sign);
        moved
    }
}

/// Adds `factor` times `what`, as far as both go.
fn add(to: &mut [f64], what: &[f64], factor: f64) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;

    fn actuator(delay_s: f64, time_constant_s: f64) -> Actuator {
        Actuator {
            delay_s,
            time_constant_s,
        }
    }

    fn rates(u: f64) -> BendRates {
        BendRates::from_slice(&[u, 0.0]).unwrap()
    }

    /// The differential equation in steps of 10 µs beside the recursion, at ages between the moves, too.
    #[test]
    fn the_way_left_is_that_of_the_differential_equation() {
        const STEP_S: f64 = 1e-5;
        for (delay_s, time_constant_s) in [(0.0, 0.0), (0.012, 0.0), (0.0, 0.03), (0.0125, 0.02)] {
            let actuator = Actuator {
                delay_s,
                time_constant_s,
            };
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
                let leads_to = model.way_left(age_s).from(&at).as_slice()[0];
                assert!(
                    (leads_to - commanded).abs() < 3e-5,
                    "{actuator:?} {age_s}: {leads_to} {commanded}"
                );
                let back = model.way_left(age_s).back_from(&at).as_slice()[0];
                assert!((back + leads_to - 2.0 * then).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn of_more_than_is_remembered_only_that_is_made_up_for() {
        let mut model = ActuatorModel::new(Actuator::IDEAL, 1);
        for _ in 0..1000 {
            model.command(&rates(1.0), 0.005);
        }
        let at = Configuration::straight(1);
        let moved = model.way_left(10.0).from(&at).as_slice()[0];
        assert!((moved - 128.0 * 0.005).abs() < 1e-12, "{moved}");
        // Of a lag, too, what is remembered: the rates have turned since.
        let mut model = ActuatorModel::new(actuator(0.2, 0.1), 1);
        for cycle in 0..1000 {
            model.command(&rates(if cycle < 950 { 1.0 } else { -1.0 }), 0.001);
        }
        let moved = model.way_left(0.0).from(&at).as_slice()[0];
        assert!((moved - (0.1 + 0.078 - 0.05)).abs() < 1e-3, "{moved}");
    }
}
