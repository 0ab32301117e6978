//! Rates that the robot may have: finite, in the box, bends inside their limits, cables neither too fast nor too far.

use crate::robot::{BendRates, Configuration, Robot};

/// Which limits changed a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LimitsHit {
    /// A rate was cut.
    pub rate: bool,
    /// A bend was kept inside its limit.
    pub bend: bool,
    /// All rates were scaled down to the cable speed limit.
    pub cable_speed: bool,
    /// All rates were scaled down to keep every cable's stroke.
    pub cable_stroke: bool,
    /// A rate was kept within the largest acceleration.
    pub acceleration: bool,
    /// The wish, or the state that it starts from, was not finite, and the rates became zero.
    pub non_finite: bool,
}

/// A command inside every limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limited {
    /// The rates \[rad/s\].
    pub rates: BendRates,
    /// What had to be changed.
    pub hit: LimitsHit,
}

/// The nearest command inside every limit: rates in the box, each bend at most its section's limit
/// one period later (a bend beyond it may only shrink), cables at most at their speed limit and, one
/// period later, at most their stroke away from their lengths at the straight robot (a cable beyond it
/// may only come back). Zero rates where wish or state are not finite.
///
/// The command may turn along a limit, and lead back from beyond one: it is for a robot that moves. For one that
/// comes to rest there is [`shorten`].
pub fn limit(robot: &Robot, at: &Configuration, wish: &BendRates, period_s: f64) -> Limited {
    if !(wish.is_finite() && at.is_finite()) {
        return non_finite(robot);
    }
    let mut rates = *wish;
    let mut hit = LimitsHit {
        rate: clamp_rates(robot, &mut rates),
        ..LimitsHit::default()
    };
    hit.bend = keep_bends(robot, at, &mut rates, period_s);
    // Keeping a bend that is beyond its limit inside asks for a rate of its own.
    hit.rate |= clamp_rates(robot, &mut rates);
    // What the box took away from that may have been what kept the bend inside.
    hit.bend |= shorten_to_bends(robot, at, &mut rates, period_s);
    hit.cable_speed = slow_cables(robot, &mut rates);
    hit.cable_stroke = keep_strokes(robot, at, &mut rates, period_s);
    Limited { rates, hit }
}

/// A command inside every limit for a robot that comes to rest: each section's rates are those of `ramp`, or shorter in
/// the same direction. So no component is larger than in the ramp, and zero rates stay zero wherever the robot is: a
/// measurement beyond a limit never makes a resting robot move. Zero rates where ramp or state are not finite.
pub fn shorten(robot: &Robot, at: &Configuration, ramp: &BendRates, period_s: f64) -> Limited {
    if !(ramp.is_finite() && at.is_finite()) {
        return non_finite(robot);
    }
    let mut rates = *ramp;
    let hit = LimitsHit {
        rate: clamp_rates(robot, &mut rates),
        bend: shorten_to_bends(robot, at, &mut rates, period_s),
        cable_speed: slow_cables(robot, &mut rates),
        cable_stroke: keep_strokes(robot, at, &mut rates, period_s),
        ..LimitsHit::default()
    };
    Limited { rates, hit }
}

impl LimitsHit {
    /// What either of them changed.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            rate: self.rate | other.rate,
            bend: self.bend | other.bend,
            cable_speed: self.cable_speed | other.cable_speed,
            cable_stroke: self.cable_stroke | other.cable_stroke,
            acceleration: self.acceleration | other.acceleration,
            non_finite: self.non_finite | other.non_finite,
        }
    }
}

/// `wish`, each component no farther from the previous command than `change_rad_s` = acceleration · period. To slow
/// down is always allowed, by any amount: a component may lie anywhere between zero and its previous value, and
/// `change_rad_s` beyond either. Says whether something was cut.
pub fn accelerate(previous: &BendRates, wish: &BendRates, change_rad_s: f64) -> (BendRates, bool) {
    let mut rates = *wish;
    let mut cut = false;
    for (rate, previous) in rates.as_mut_slice().iter_mut().zip(previous.as_slice()) {
        let allowed = rate.clamp(
            previous.min(0.0) - change_rad_s,
            previous.max(0.0) + change_rad_s,
        );
        cut |= allowed != *rate;
        *rate = allowed;
    }
    (rates, cut)
}

/// `rates`, scaled down together until each component is within [`accelerate`]'s bounds: the direction, and with it
/// what the limits and the clearance guard made sure of, stays.
pub fn shorten_to_acceleration(
    previous: &BendRates,
    rates: &BendRates,
    change_rad_s: f64,
) -> (BendRates, bool) {
    let mut factor = 1.0_f64;
    for (rate, previous) in rates.as_slice().iter().zip(previous.as_slice()) {
        let most = if *rate < 0.0 {
            change_rad_s - previous.min(0.0)
        } else {
            change_rad_s + previous.max(0.0)
        };
        if rate.abs() > most {
            factor = factor.min(most / rate.abs());
        }
    }
    let mut shortened = *rates;
    if factor < 1.0 {
        scale(&mut shortened, factor);
    }
    (shortened, factor < 1.0)
}

fn non_finite(robot: &Robot) -> Limited {
    Limited {
        rates: BendRates::zero(robot.section_count()),
        hit: LimitsHit {
            non_finite: true,
            ..LimitsHit::default()
        },
    }
}

fn clamp_rates(robot: &Robot, rates: &mut BendRates) -> bool {
    let mut changed = false;
    let pairs = rates.as_mut_slice().chunks_exact_mut(2);
    for (pair, section) in pairs.zip(robot.sections()) {
        for rate in pair {
            let limited = rate.clamp(-section.rate_max_rad_s, section.rate_max_rad_s);
            changed |= limited.to_bits() != rate.to_bits();
            *rate = limited;
        }
    }
    changed
}

fn keep_bends(robot: &Robot, at: &Configuration, rates: &mut BendRates, period_s: f64) -> bool {
    let mut changed = false;
    let pairs = rates.as_mut_slice().chunks_exact_mut(2);
    let bends = at.as_slice().chunks_exact(2);
    for ((rate, bend), section) in pairs.zip(bends).zip(robot.sections()) {
        let target = [bend[0] + period_s * rate[0], bend[1] + period_s * rate[1]];
        let size = target[0].hypot(target[1]);
        if size > section.bend_max_rad {
            let shrink = section.bend_max_rad / size;
            rate[0] = (target[0] * shrink - bend[0]) / period_s;
            rate[1] = (target[1] * shrink - bend[1]) / period_s;
            changed = true;
        }
    }
    changed
}

/// Shortens the rates of each section, in their direction, until its bend one period later is inside its limit; a
/// bend beyond it may stay as large as it is. Shorter rates stay in the box.
fn shorten_to_bends(
    robot: &Robot,
    at: &Configuration,
    rates: &mut BendRates,
    period_s: f64,
) -> bool {
    let mut changed = false;
    let pairs = rates.as_mut_slice().chunks_exact_mut(2);
    let bends = at.as_slice().chunks_exact(2);
    for ((rate, bend), section) in pairs.zip(bends).zip(robot.sections()) {
        let way = [period_s * rate[0], period_s * rate[1]];
        let radius = section.bend_max_rad.max(bend[0].hypot(bend[1]));
        if (bend[0] + way[0]).hypot(bend[1] + way[1]) <= radius {
            continue;
        }
        // Where the way leaves the disc: |bend + part · way| = radius.
        let way_2 = way[0] * way[0] + way[1] * way[1];
        let outwards = bend[0] * way[0] + bend[1] * way[1];
        let room = (radius * radius - bend[0] * bend[0] - bend[1] * bend[1]).max(0.0);
        let part = ((outwards * outwards + way_2 * room).sqrt() - outwards) / way_2;
        let part = part.clamp(0.0, 1.0);
        rate[0] *= part;
        rate[1] *= part;
        changed = true;
    }
    changed
}

fn slow_cables(robot: &Robot, rates: &mut BendRates) -> bool {
    let speeds = robot.cable_speeds(rates);
    let fastest = speeds
        .iter()
        .fold(0.0_f64, |fastest, speed| fastest.max(speed.abs()));
    let too_fast = fastest > robot.cable_speed_max_m_s();
    if too_fast {
        scale(rates, robot.cable_speed_max_m_s() / fastest);
    }
    too_fast
}

/// Strokes are linear in the bends, so one factor for all rates tells how far everything may go.
fn keep_strokes(robot: &Robot, at: &Configuration, rates: &mut BendRates, period_s: f64) -> bool {
    let max_m = robot.cable_stroke_max_m();
    let strokes_m = robot.cable_strokes(at);
    let speeds_m_s = robot.cable_speeds(rates);
    let mut factor = 1.0_f64;
    for (stroke_m, speed_m_s) in strokes_m.iter().zip(speeds_m_s) {
        let change_m = period_s * speed_m_s;
        let (least_m, most_m) = (stroke_m.min(-max_m), stroke_m.max(max_m));
        let next_m = stroke_m + change_m;
        if next_m > most_m {
            factor = factor.min((most_m - stroke_m) / change_m);
        } else if next_m < least_m {
            factor = factor.min((least_m - stroke_m) / change_m);
        }
    }
    let too_far = factor < 1.0;
    if too_far {
        scale(rates, factor);
    }
    too_far
}

fn scale(rates: &mut BendRates, factor: f64) {
    for rate in rates.as_mut_slice() {
        *rate *= factor;
    }
}

/// The next rates on the way to rest: every component shrinks by the same factor, so the direction is
/// kept, and the fastest one loses at most `deceleration_rad_s2 · period_s`.
pub fn ramp_to_zero(previous: &BendRates, deceleration_rad_s2: f64, period_s: f64) -> BendRates {
    let mut rates = *previous;
    let fastest = rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |fastest, rate| fastest.max(rate.abs()));
    let left = fastest - deceleration_rad_s2 * period_s;
    // What rounding leaves of the last step is rest, too.
    scale(
        &mut rates,
        if left > 1e-9 * fastest {
            left / fastest
        } else {
            0.0
        },
    );
    rates
}

/// Rates on the straight line to the straight robot, the fastest component at `rate_rad_s`; zero on arrival. Where a
/// section's rate, a cable's speed or the acceleration (`change_rad_s` from the `previous` command) does not allow that,
/// all of them are slower, so that the limits do not bend the line.
pub fn homing_rates(
    robot: &Robot,
    at: &Configuration,
    previous: &BendRates,
    rate_rad_s: f64,
    change_rad_s: f64,
    period_s: f64,
) -> BendRates {
    let mut rates = BendRates::zero(at.section_count());
    let sections = robot.sections().iter();
    let fastest_rad_s = sections.flat_map(|section| [rate_rad_s.min(section.rate_max_rad_s); 2]);
    let duration_s = at
        .as_slice()
        .iter()
        .zip(fastest_rad_s)
        .fold(period_s, |longest, (bend, rate)| {
            longest.max(bend.abs() / rate)
        });
    for (rate, bend) in rates.as_mut_slice().iter_mut().zip(at.as_slice()) {
        *rate = -bend / duration_s;
    }
    slow_cables(robot, &mut rates);
    shorten_to_acceleration(previous, &rates, change_rad_s).0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::RobotParameters;

    const PERIOD_S: f64 = 0.005;

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(2)).expect("the paper's robot")
    }

    fn rates(values: [f64; 4]) -> BendRates {
        BendRates::from_slice(&values).expect("two sections")
    }

    fn at(values: [f64; 4]) -> Configuration {
        Configuration::from_slice(&values).expect("two sections")
    }

    #[test]
    fn a_bend_that_the_box_would_let_out_is_shortened_onto_its_limit() {
        let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
        // Along the border, keeping the bend inside asks for more than 2 rad/s in one component.
        let (mut over, mut cut) = (0.0_f64, 0);
        for step in 0..20_000 {
            let angle = f64::from(step) * 1e-3;
            for inside in [0.0, 1e-9, 1e-3, 0.02] {
                let size = 2.8 - inside;
                let at = [size * angle.cos(), size * angle.sin()];
                let at = Configuration::from_slice(&at).unwrap();
                for wish in [[2.0, 2.0], [-2.0, 2.0], [1.3, -2.0], [50.0, -3.0]] {
                    let wish = BendRates::from_slice(&wish).unwrap();
                    let limited = limit(&robot, &at, &wish, 0.005);
                    let target = at.advanced(&limited.rates, 0.005);
                    over = over.max(target.bend_rad(0) - 2.8);
                    let rates = limited.rates.as_slice();
                    assert!(rates.iter().all(|rate| rate.abs() <= 2.0), "{rates:?}");
                    cut += u32::from(limited.hit.bend);
                }
            }
        }
        assert!(over <= 1e-12, "{over} rad beyond the limit");
        assert!(cut > 1000, "{cut} cases at the limit");
    }

    proptest! {
        /// Rest is rest: wherever the robot is measured, beyond its limits, too, no component of a shortened ramp is
        /// larger than the ramp's, and zero rates are zero to the bit.
        #[test]
        fn a_ramp_is_only_shortened_and_rest_stays_rest(
            bends in prop::array::uniform4(-7.0..7.0_f64),
            ramp in prop::array::uniform4(-4.0..4.0_f64),
            stroke_m in 0.001..0.1_f64,
            speed_m_s in 0.001..0.1_f64,
        ) {
            let mut parameters = RobotParameters::paper(2);
            parameters.cable_stroke_max_m = stroke_m;
            parameters.cable_speed_max_m_s = speed_m_s;
            let robot = Robot::new(&parameters).expect("legal");
            let shortened = shorten(&robot, &at(bends), &rates(ramp), PERIOD_S).rates;
            for (rate, ramp) in shortened.as_slice().iter().zip(ramp) {
                prop_assert!(rate.abs() <= ramp.abs() && rate * ramp >= 0.0, "{rate} of {ramp}");
            }
            let rest = shorten(&robot, &at(bends), &BendRates::zero(2), PERIOD_S);
            prop_assert_eq!((rest.rates, rest.hit), (BendRates::zero(2), LimitsHit::default()));
            // Inside the limits nothing is lost that a limit does not ask for.
            let inside = at(bends).bend_rad(0).max(at(bends).bend_rad(1)) < 2.0;
            if inside && stroke_m > 0.09 && speed_m_s > 0.095 && ramp.iter().all(|rate| rate.abs() < 1.0) {
                prop_assert_eq!(shortened, rates(ramp));
            }
        }
    }

    proptest! {
        /// No component grows faster than the acceleration allows; slowing down is free; zero is always allowed.
        #[test]
        fn speed_grows_by_the_acceleration_at_most(
            previous in prop::array::uniform4(-3.0..3.0_f64),
            wish in prop::array::uniform4(-3.0..3.0_f64),
            change_rad_s in 0.0..1.0_f64,
        ) {
            let inside = |rates: &BendRates| {
                let pairs = rates.as_slice().iter().zip(previous);
                pairs.into_iter().all(|(rate, previous)| {
                    let most = if rate * previous > 0.0 { previous.abs() } else { 0.0 };
                    rate.abs() <= (most + change_rad_s) * (1.0 + 1e-12)
                })
            };
            let (clamped, cut) = accelerate(&rates(previous), &rates(wish), change_rad_s);
            prop_assert!(inside(&clamped), "{clamped:?}");
            prop_assert_eq!(cut, clamped != rates(wish));
            let (scaled, cut) = shorten_to_acceleration(&rates(previous), &rates(wish), change_rad_s);
            prop_assert!(inside(&scaled), "{scaled:?}");
            prop_assert_eq!(cut, !inside(&rates(wish)) || scaled != rates(wish));
            for (scaled, wish) in scaled.as_slice().iter().zip(wish) {
                prop_assert!(scaled.abs() <= wish.abs() && scaled * wish >= 0.0);
            }
            let slower = rates(previous.map(|rate| 0.3 * rate));
            prop_assert_eq!(accelerate(&rates(previous), &slower, change_rad_s), (slower, false));
        }
    }

    #[test]
    fn a_legal_wish_passes_unchanged() {
        let wish = rates([0.1, -0.2, 0.3, 0.4]);
        let limited = limit(&robot(), &at([0.1; 4]), &wish, PERIOD_S);
        assert_eq!((limited.rates, limited.hit), (wish, LimitsHit::default()));
    }

    #[test]
    fn rates_and_non_finite_wishes_are_cut() {
        let limited = limit(
            &robot(),
            &at([0.0; 4]),
            &rates([9.0, 0.0, -9.0, 0.0]),
            PERIOD_S,
        );
        assert!(limited.hit.rate);
        assert!(
            limited
                .rates
                .as_slice()
                .iter()
                .all(|rate| rate.abs() <= 2.0)
        );
        let limited = limit(
            &robot(),
            &at([0.0; 4]),
            &rates([f64::NAN, 0.0, 1.0, 0.0]),
            PERIOD_S,
        );
        assert!(limited.hit.non_finite);
        assert_eq!(limited.rates, BendRates::zero(2));
    }

    #[test]
    fn a_bend_never_leaves_its_limit_and_returns_when_it_is_beyond() {
        let robot = robot();
        let mut bend = at([2.79, 0.0, 0.0, -2.79]);
        for _ in 0..20 {
            let limited = limit(&robot, &bend, &rates([2.0, 2.0, 2.0, -2.0]), PERIOD_S);
            bend = bend.advanced(&limited.rates, PERIOD_S);
            assert!(bend.bend_rad(0) <= 2.8 + 1e-12 && bend.bend_rad(1) <= 2.8 + 1e-12);
        }
        let beyond = at([2.9, 0.0, 0.0, 0.0]);
        let limited = limit(&robot, &beyond, &rates([2.0, 0.0, 0.0, 0.0]), PERIOD_S);
        assert!(limited.hit.bend && limited.rates.as_slice()[0] < 0.0);
    }

    #[test]
    fn cables_keep_their_speed_limit() {
        let mut parameters = RobotParameters::paper(2);
        parameters.cable_speed_max_m_s = 0.01;
        let robot = Robot::new(&parameters).expect("legal");
        let limited = limit(
            &robot,
            &at([0.0; 4]),
            &rates([2.0, 0.0, 2.0, 0.0]),
            PERIOD_S,
        );
        let speeds = robot.cable_speeds(&limited.rates);
        assert!(limited.hit.cable_speed);
        assert!(speeds.iter().all(|speed| speed.abs() <= 0.01 + 1e-15));
    }

    #[test]
    fn no_cable_leaves_its_stroke_and_one_beyond_it_comes_back() {
        let mut parameters = RobotParameters::paper(2);
        parameters.cable_stroke_max_m = 0.02;
        let robot = Robot::new(&parameters).expect("legal");
        let farthest_m = |bend: &Configuration| {
            let strokes_m = robot.cable_strokes(bend);
            strokes_m.iter().fold(0.0_f64, |most, m| most.max(m.abs()))
        };
        let (mut bend, mut hits) = (at([0.0; 4]), 0);
        for step in 0..400 {
            let turn = f64::from(step).sin();
            let wish = rates([2.0, 0.3 * turn, 1.5, -turn]);
            let limited = limit(&robot, &bend, &wish, PERIOD_S);
            hits += u32::from(limited.hit.cable_stroke);
            bend = bend.advanced(&limited.rates, PERIOD_S);
            assert!(farthest_m(&bend) <= 0.02 + 1e-15, "{}", farthest_m(&bend));
        }
        assert!(hits > 100, "{hits}");
        let beyond = at([1.8, 0.0, 0.0, 0.0]);
        let out = limit(&robot, &beyond, &rates([1.0, 0.0, 0.0, 0.0]), PERIOD_S);
        assert!(out.hit.cable_stroke);
        assert_eq!(out.rates, BendRates::zero(2));
        let wish = rates([-1.0, 0.0, 0.0, 0.0]);
        let back = limit(&robot, &beyond, &wish, PERIOD_S);
        assert_eq!((back.rates, back.hit), (wish, LimitsHit::default()));
    }

    #[test]
    fn ramps_end_at_zero_and_keep_the_direction() {
        let mut now = rates([1.0, -0.5, 0.0, 0.25]);
        let mut cycles = 0;
        while now.as_slice().iter().any(|rate| *rate != 0.0) {
            now = ramp_to_zero(&now, 40.0, PERIOD_S);
            cycles += 1;
            let [a, b, _, d] = [0, 1, 2, 3].map(|i| now.as_slice()[i]);
            assert!((b + 0.5 * a).abs() < 1e-12 && (d - 0.25 * a).abs() < 1e-12);
        }
        assert_eq!(cycles, 5);
    }

    #[test]
    fn homing_arrives_exactly_once_near() {
        let (robot, rest, free) = (robot(), BendRates::zero(2), f64::INFINITY);
        let mut bend = at([1.0, -0.5, 0.0, 0.25]);
        for _ in 0..1001 {
            let rates = homing_rates(&robot, &bend, &rest, 0.5, free, PERIOD_S);
            bend = bend.advanced(&rates, PERIOD_S);
        }
        assert!(bend.as_slice().iter().all(|b| b.abs() < 1e-12), "{bend:?}");
        let end = homing_rates(&robot, &at([0.0; 4]), &rest, 0.5, free, PERIOD_S);
        assert_eq!(end, rest);
    }

    #[test]
    fn no_limit_bends_the_straight_line_home() {
        let mut parameters = RobotParameters::paper(2);
        parameters.sections[1].rate_max_rad_s = 0.3;
        let slow_section = Robot::new(&parameters).expect("a slow section");
        parameters.cable_speed_max_m_s = 0.004;
        let slow_cables = Robot::new(&parameters).expect("slow cables");
        let begin = at([1.0, -0.5, 0.8, 0.25]);
        for (robot, acceleration_rad_s2) in
            [(&slow_section, 1e9), (&slow_cables, 1e9), (&robot(), 3.0)]
        {
            let change = acceleration_rad_s2 * PERIOD_S;
            let (mut bend, mut rates) = (begin, BendRates::zero(2));
            for _ in 0..2000 {
                let wish = homing_rates(robot, &bend, &rates, 2.0, change, PERIOD_S);
                rates = limit(robot, &bend, &accelerate(&rates, &wish, change).0, PERIOD_S).rates;
                bend = bend.advanced(&rates, PERIOD_S);
                let left = bend.as_slice()[0];
                for (bend, begin) in bend.as_slice().iter().zip(begin.as_slice()) {
                    assert!(
                        (bend - begin * left).abs() < 1e-12,
                        "{bend} beside the line"
                    );
                }
            }
            assert!(bend.as_slice().iter().all(|b| b.abs() < 1e-12), "{bend:?}");
        }
    }
}
