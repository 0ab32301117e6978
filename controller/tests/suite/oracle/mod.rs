//! The safety checks against an independent oracle. It has its own kinematics, distances, limits, stopping
//! path and quadratic program, based only on docs/model.md and the documentation of
//! [`safe_command`](cdcr_controller::safety::safe_command).
//!
//! A moment is a robot, its surroundings and desired rates, generated from a seed that a failed test prints.

mod body;
mod loops;
mod moment;
mod qp;
mod rule;

use cdcr_controller::estimator::Slack;
use cdcr_controller::safety::SafeCommand;
use loops::Scene;
use moment::{Moment, stands};
use qp::Motion;
use rule::{Margins, ROUNDING, moved, norm};

use crate::number;

/// Largest share of commands that may be at rest although the oracle finds a motion. The first is for few
/// commands (the test's 300 moments have 2, and one more may), the second for many.
const STANDS_MAX: [f64; 2] = [3.0 / 300.0, 0.0005];
/// Seeds of the closed loops; those with lost commands first.
const LOOPS: [u64; 12] = [6, 3, 0, 1, 2, 4, 5, 7, 8, 9, 10, 11];

/// Decelerations for the comparison of the nearest rates inside the limits (rad/s²): infinite, where the
/// limits are convex, and that of a daemon.
const DECELERATIONS_RAD_S2: [f64; 2] = [f64::INFINITY, 40.0];

/// Counts over many commands.
struct Account {
    commands: u32,
    /// Commands changed by the guard.
    changed: u32,
    /// Commands that should not be at rest; those of them at rest; and those of them for which the oracle
    /// finds a motion.
    asked: u32,
    stand: u32,
    stand_needlessly: u32,
    /// Those for which a motion is allowed only by rounding, or by the motion of obstacles in a period.
    stand_unsure: u32,
    /// Commands that violate a rule.
    broken: u32,
    least: Margins,
}

impl Account {
    const NEW: Self = Self {
        commands: 0,
        changed: 0,
        asked: 0,
        stand: 0,
        stand_needlessly: 0,
        stand_unsure: 0,
        broken: 0,
        least: Margins::ALL,
    };

    /// Checks the command of a moment, identified by `name`, against every rule.
    fn take(&mut self, name: &str, moment: &Moment, command: &SafeCommand) {
        let rates = command.rates.as_slice();
        let margins = moment.margins(rates);
        self.commands += 1;
        self.changed += u32::from(command.clearance_hit);
        self.least = self.least.least(margins);
        let off_m = command.clearance_m - moment.clearance_m();
        // Comparisons with margins do not detect NaN.
        let is_finite = command.rates.as_slice().iter().all(|rate| rate.is_finite());
        let is_right =
            off_m.abs() <= ROUNDING || off_m.is_nan() && command.clearance_m == f64::INFINITY;
        if !margins.hold() || !is_finite || !is_right {
            self.broken += 1;
            println!("{name}: {margins:?}, clearance {off_m:e} m off");
        }
    }

    /// Searches for a motion where the command is at rest.
    fn ask(&mut self, name: &str, moment: &Moment, command: &SafeCommand) {
        let rates = command.rates.as_slice();
        self.asked += 1;
        if moment.comes_to_rest || !stands(rates, &moment.desired_rates) {
            return;
        }
        let desired_rates = moment.limited_rates();
        if norm(&desired_rates) > 1e-3 && stands(rates, &desired_rates) {
            self.stand += 1;
            // Relative to the limits without obstacles, which `the_limits_give_the_nearest_rates` compares
            // with the oracle's own.
            let mut free = moment.clone();
            free.balls.clear();
            let free = free.command();
            match moment.way_out(&[desired_rates.as_slice(), free.rates.as_slice()]) {
                Some(Motion::Sure(out)) => {
                    self.stand_needlessly += 1;
                    let share = norm(&out) / norm(&desired_rates);
                    println!(
                        "{name}: stands still, {share:.2} of the desired rates holds every rule"
                    );
                }
                Some(Motion::Unsure) => self.stand_unsure += 1,
                None => {}
            }
        }
    }

    fn check(&self) {
        println!(
            "{} commands, {} changed by the guard, {} break a rule; least {:?}",
            self.commands, self.changed, self.broken, self.least
        );
        println!(
            "{} asked, {} of them stand still, {} without need; {} where rounding or what obstacles move in a period would let them move",
            self.asked, self.stand, self.stand_needlessly, self.stand_unsure
        );
        assert_eq!(self.broken, 0);
        let [of_few, of_many] = STANDS_MAX.map(|share| share * f64::from(self.asked));
        assert!(f64::from(self.stand_needlessly) <= of_few.min(of_many.max(3.0)));
    }
}

/// Check of the oracle: the desired rates violate each of the rules.
#[test]
fn desired_rates_break_every_rule() {
    let mut worst = Margins::ALL;
    for seed in 0..300 {
        let moment = Moment::random(seed);
        worst = worst.least(moment.margins(&moment.desired_rates));
    }
    for margin in worst.rules() {
        assert!(margin < -1e-3, "{worst:?}");
    }
}

/// The seeds of a test.
fn seeds(count: &str, otherwise: u64) -> core::ops::Range<u64> {
    let first = number("CDCR_ORACLE_FIRST", 0);
    first..first + number(count, otherwise)
}

/// Whether a test runs completely, so that its minimum counts apply.
fn is_whole(count: &str) -> bool {
    ["CDCR_ORACLE_FIRST", count]
        .iter()
        .all(|name| std::env::var_os(name).is_none())
}

/// The moments of a test, with names.
fn moments(count: &str, otherwise: u64) -> impl Iterator<Item = (String, Moment)> {
    seeds(count, otherwise).map(|seed| (format!("moment {seed}"), Moment::random(seed)))
}

#[test]
fn no_moment_breaks_a_rule() {
    let mut account = Account::NEW;
    for (name, moment) in moments("CDCR_ORACLE_MOMENTS", crate::repetitions(300, 2000).into()) {
        account.take(&name, &moment, &moment.command());
    }
    account.check();
}

/// A play of 0 changes no bit. With play in the cables, the rules of robots without play still apply: they
/// concern the moving robot, wherever the cables are in their play. Only a ramp continues along a path on
/// which the cables have continued.
#[test]
fn no_moment_with_play_breaks_a_rule() {
    let (mut account, mut by_play) = (Account::NEW, 0);
    let count = crate::repetitions(500, 1000).into();
    for seed in seeds("CDCR_ORACLE_MOMENTS", count) {
        let (name, moment) = (format!("moment {seed}"), Moment::random(seed));
        let command = moment.command();
        let none = Slack::new(0.0, *Moment::slack(seed, 1e-3).slack_m());
        let same = moment.command_with(Some(&none));
        assert_eq!(same, command, "{name}");
        let slack = Moment::slack(seed, 1e-3);
        if !moment.comes_to_rest {
            let played = moment.command_with(Some(&slack));
            by_play += u32::from(played.rates != command.rates);
            account.take(&name, &moment, &played);
        }
    }
    account.check();
    assert!(
        by_play > 10 || !is_whole("CDCR_ORACLE_MOMENTS"),
        "{by_play}"
    );
}

/// Without obstacles, a command is the nearest one inside every limit. The oracle's candidates satisfy every
/// limit to the bit, and none is faster than desired; none is nearer. Commands stay a rounding inside their
/// limits (10⁻¹¹ m and rad). Over a path of a millisecond, with a cable 3 mm from the backbone, that is 3 ·
/// 10⁻⁶ rad/s.
#[test]
fn the_limits_give_the_nearest_rates() {
    for deceleration_rad_s2 in DECELERATIONS_RAD_S2 {
        let (mut compared, mut cut) = (0, 0);
        for (name, mut moment) in moments("CDCR_ORACLE_LIMITS", 300) {
            moment.balls.clear();
            moment.comes_to_rest = false;
            moment.deceleration_rad_s2 = deceleration_rad_s2;
            let distance = |rates: &[f64]| norm(&moved(rates, &moment.desired_rates, -1.0));
            let candidates = moment.limited_candidates();
            let holding = candidates.iter().filter(|rates| moment.is_inside(rates));
            let best = holding
                .map(|rates| distance(rates))
                .fold(f64::INFINITY, f64::min);
            if best == f64::INFINITY {
                continue;
            }
            let found = distance(moment.command().rates.as_slice());
            compared += 1;
            cut += u32::from(best > 1e-3);
            assert!(
                found <= best + 1e-5,
                "{name}: {found} rad/s instead of {best}"
            );
        }
        println!("{deceleration_rad_s2} rad/s²: {compared} compared, {cut} of them cut");
        let is_enough = compared > 150 && cut > 50;
        assert!(
            is_enough || !is_whole("CDCR_ORACLE_LIMITS"),
            "{compared}, {cut}"
        );
    }
}

/// Regressions: the solution of a linearisation counted as the longest possible one, so no time was left to
/// find a motion. The feasible share of a solution lay between those tried. No slow motion was tried, which
/// is checked faster and deviates less, nor another one among many obstacles.
#[test]
fn moments_that_stood_without_need_move() {
    for seed in [
        2380, 20_296, 50_480, 51_110, 74_675, 80_708, 80_882, 91_426, 93_258, 3031, 3056, 6703,
        19_734, 20_746, 30_569, 35_646, 37_165, 39_737, 42_985, 48_762, 70_287, 75_519, 76_458,
    ] {
        let moment = Moment::random(seed);
        let command = moment.command();
        assert!(moment.hold(command.rates.as_slice()), "moment {seed}");
        let is_still = stands(command.rates.as_slice(), &moment.desired_rates);
        assert!(!is_still, "moment {seed}");
    }
}

/// Regressions: the first row of a section and an obstacle, around the resting robot, allowed the rates that
/// violated the rule. It counted as the only one, and the rates were scaled down to a thousandth. Slow rates
/// were computed twice, whatever the result.
#[test]
fn loops_that_stood_without_need_move() {
    let mut account = Account::NEW;
    for (seed, cycles) in [(234, 9), (590, 49), (1035, 20), (2202, 10), (3557, 47)] {
        Scene::random(seed).first(cycles).run(&mut account);
    }
    account.check();
    assert_eq!(account.stand_needlessly, 0);
}

#[test]
fn few_moments_stand_still_without_need() {
    let mut account = Account::NEW;
    let count = crate::repetitions(300, 8_000).into();
    for (name, moment) in moments("CDCR_ORACLE_STANDS", count) {
        account.ask(&name, &moment, &moment.command());
    }
    account.check();
}

#[test]
fn no_closed_loop_breaks_a_rule() {
    let mut account = Account::NEW;
    let loops = if is_whole("CDCR_ORACLE_LOOPS") {
        crate::cases(2, &LOOPS).to_vec()
    } else {
        seeds("CDCR_ORACLE_LOOPS", LOOPS.len() as u64).collect()
    };
    for seed in loops {
        Scene::random(seed).run(&mut account);
    }
    account.check();
}
