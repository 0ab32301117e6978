//! The last word about obstacles: a command never brings the body nearer to one than is allowed.

use crate::robot::{
    BendRates, Body, COORDINATES_MAX, Configuration, Obstacle, Robot, SECTIONS_MAX,
};

use super::limit;

/// Obstacles that are watched one by one. When more than these are within reach in one period, the
/// robot stands still.
pub const NEAR_MAX: usize = 64;
/// Rounds of correction before the command is scaled instead.
const CORRECTIONS: usize = 4;
/// Halvings of the scale: the command is at most a thousandth shorter than it could be.
const HALVINGS: u32 = 10;
/// What a correction asks for beyond the allowed clearance \[m\], so that rounding does not undo it.
const MARGIN_M: f64 = 1e-9;

/// A command that keeps clear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guarded {
    /// The rates \[rad/s\].
    pub rates: BendRates,
    /// Whether they are not those that were asked for.
    pub hit: bool,
    /// Smallest clearance of the body to any obstacle, both as they are now \[m\]: negative inside an
    /// obstacle, infinite without obstacles, NaN when the state is not finite.
    pub clearance_m: f64,
}

/// Changes `rates`, which are inside the limits, as little as keeping clear of `obstacles` asks for.
///
/// Let c(s) be the clearance of the body to an obstacle one period later: of the body at
/// bend + s T q̇, to the obstacle moved on by its velocity. Standing still, s = 0, is the measure. The
/// rates that are returned have, for every obstacle,
///
/// ```text
/// c(1) ≥ min(D, c(0))        D = safe_distance_m, exact clearances, no tolerance
/// ```
///
/// So a body outside D never enters it by its own motion, and a body inside never comes nearer. The
/// rates stay inside the limits, and their norm is at most that of the wish, so a ramp to rest still ends
/// at rest. Where the wish breaks the rule, the smallest correction of the rates is tried first, which
/// slides along the obstacle; where that does not hold exactly, the wish is scaled down. Standing still
/// always holds.
///
/// What it cannot do: it looks at the end of one period and at nothing between or after; it does not
/// plan a way around; and it does not flee: an obstacle that runs into the standing robot does so.
///
/// Nothing allocates; the work is bounded, and a few comparisons where no obstacle is near. The same
/// inputs give the same bits.
pub fn guard(
    robot: &Robot,
    at: &Configuration,
    rates: &BendRates,
    obstacles: &[Obstacle],
    safe_distance_m: f64,
    period_s: f64,
) -> Guarded {
    let step = Step {
        robot,
        at,
        period_s,
    };
    guarded(&step, rates, obstacles, safe_distance_m, |near, step| {
        near.corrected(step, rates)
            .unwrap_or_else(|| near.scaled(step, rates))
    })
}

/// The same for a robot that comes to rest: `ramp` is only scaled down, so no component becomes larger.
pub fn guard_ramp(
    robot: &Robot,
    at: &Configuration,
    ramp: &BendRates,
    obstacles: &[Obstacle],
    safe_distance_m: f64,
    period_s: f64,
) -> Guarded {
    let step = Step {
        robot,
        at,
        period_s,
    };
    guarded(&step, ramp, obstacles, safe_distance_m, |near, step| {
        near.scaled(step, ramp)
    })
}

/// The rates where they hold the rule, and what `mend` makes of them elsewhere.
fn guarded(
    step: &Step<'_>,
    rates: &BendRates,
    obstacles: &[Obstacle],
    safe_distance_m: f64,
    mend: impl FnOnce(&Near, &Step<'_>) -> BendRates,
) -> Guarded {
    let unchanged = |clearance_m| Guarded {
        rates: *rates,
        hit: false,
        clearance_m,
    };
    if obstacles.is_empty() {
        return unchanged(f64::INFINITY);
    }
    let body = step.robot.body(step.at);
    let clearance_m = least_clearance_m(&body, obstacles);
    let allowed = match Near::find(step, &body, rates, obstacles, safe_distance_m) {
        Some(near) if near.holds(step, rates) => return unchanged(clearance_m),
        Some(near) => mend(&near, step),
        None => BendRates::zero(step.robot.section_count()),
    };
    Guarded {
        rates: allowed,
        hit: allowed != *rates,
        clearance_m,
    }
}

fn least_clearance_m(body: &Body, obstacles: &[Obstacle]) -> f64 {
    let mut least_m = f64::INFINITY;
    for obstacle in obstacles {
        if body.reaches(obstacle, least_m) {
            let clearance_m = body.clearance_m(obstacle);
            if clearance_m.is_nan() {
                return clearance_m;
            }
            least_m = least_m.min(clearance_m);
        }
    }
    least_m
}

/// One period of one robot.
struct Step<'a> {
    robot: &'a Robot,
    at: &'a Configuration,
    period_s: f64,
}

impl Step<'_> {
    fn body_after(&self, rates: &BendRates) -> Body {
        let next = self.at.advanced(rates, self.period_s);
        self.robot.body(&next)
    }

    /// What no point of the body can move by in this period \[m\], at these rates or any others inside
    /// the limits.
    fn travel_m(&self, rates: &BendRates) -> f64 {
        let mut change_rad = [0.0; SECTIONS_MAX];
        for (j, section) in self.robot.sections().iter().enumerate() {
            let [u, v] = rates.section(j);
            let largest = core::f64::consts::SQRT_2 * section.rate_max_rad_s;
            change_rad[j] = self.period_s * largest.max(u.hypot(v));
        }
        let travel_m = self.robot.travel_m(&change_rad);
        travel_m.into_iter().fold(0.0, f64::max)
    }
}

/// An obstacle where it is one period later, and the clearance that must be left to it.
#[derive(Clone, Copy)]
struct Watched {
    obstacle: Obstacle,
    floor_m: f64,
}

impl Watched {
    /// A NaN fails it.
    fn is_clear(&self, body: &Body) -> bool {
        body.clearance_m(&self.obstacle) >= self.floor_m
    }
}

/// The obstacles that the body can get too near to in this period.
struct Near {
    watched: [Option<Watched>; NEAR_MAX],
}

impl Near {
    /// `None` when there are more than fit.
    fn find(
        step: &Step<'_>,
        body: &Body,
        rates: &BendRates,
        obstacles: &[Obstacle],
        safe_distance_m: f64,
    ) -> Option<Self> {
        let reach_m = safe_distance_m + step.travel_m(rates);
        let mut near = Self {
            watched: [None; NEAR_MAX],
        };
        let mut slots = near.watched.iter_mut();
        for obstacle in obstacles {
            let obstacle = obstacle.moved(step.period_s);
            if body.reaches(&obstacle, reach_m) {
                // A NaN gives D here, which no NaN reaches.
                let floor_m = body.clearance_m(&obstacle).min(safe_distance_m);
                *slots.next()? = Some(Watched { obstacle, floor_m });
            }
        }
        Some(near)
    }

    fn watched(&self) -> impl Iterator<Item = &Watched> {
        self.watched.iter().map_while(Option::as_ref)
    }

    /// The rule, exactly.
    fn holds(&self, step: &Step<'_>, rates: &BendRates) -> bool {
        if self.watched[0].is_none() {
            return true;
        }
        let body = step.body_after(rates);
        self.watched().all(|watched| watched.is_clear(&body))
    }

    /// The nearest rates that keep clear, to first order, a few times over; none when they do not hold
    /// the rule exactly or would be faster than the wish.
    fn corrected(&self, step: &Step<'_>, wish: &BendRates) -> Option<BendRates> {
        let mut rates = *wish;
        for _ in 0..CORRECTIONS {
            self.push_out(step, &mut rates);
            rates = limit(step.robot, step.at, &rates, step.period_s).rates;
            if self.holds(step, &rates) {
                return (square(&rates) <= square(wish)).then_some(rates);
            }
        }
        None
    }

    /// One Gauss-Seidel sweep: for each obstacle that is too near, the smallest change of the rates that
    /// mends it where clearances are linear about the rates given.
    fn push_out(&self, step: &Step<'_>, rates: &mut BendRates) {
        let about = *rates;
        let next = step.at.advanced(&about, step.period_s);
        let body = step.robot.body(&next);
        for watched in self.watched() {
            let nearest = body.nearest(&watched.obstacle);
            if nearest.clearance_m >= watched.floor_m {
                continue;
            }
            let mut columns = [[0.0; 3]; COORDINATES_MAX];
            step.robot
                .body_point_jacobian(&next, nearest.section, nearest.s, &mut columns);
            let slope = columns.map(|[x, y, z]| {
                let d = &nearest.direction;
                step.period_s * (d.x * x + d.y * y + d.z * z)
            });
            let gained_m: f64 = changes(rates, &about)
                .zip(slope)
                .map(|(change, slope)| change * slope)
                .sum();
            let lack_m = watched.floor_m + MARGIN_M - nearest.clearance_m - gained_m;
            let size: f64 = slope.iter().map(|slope| slope * slope).sum();
            if lack_m > 0.0 && size > 0.0 {
                for (rate, slope) in rates.as_mut_slice().iter_mut().zip(slope) {
                    *rate += lack_m / size * slope;
                }
            }
        }
    }

    /// The wish, scaled down to where the rule holds.
    fn scaled(&self, step: &Step<'_>, wish: &BendRates) -> BendRates {
        let mut held = BendRates::zero(step.robot.section_count());
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            let mut rates = *wish;
            for rate in rates.as_mut_slice() {
                *rate *= middle;
            }
            if self.holds(step, &rates) {
                (low, held) = (middle, rates);
            } else {
                high = middle;
            }
        }
        held
    }
}

fn changes(to: &BendRates, from: &BendRates) -> impl Iterator<Item = f64> {
    to.as_slice()
        .iter()
        .zip(from.as_slice())
        .map(|(to, from)| to - from)
}

fn square(rates: &BendRates) -> f64 {
    rates.as_slice().iter().map(|rate| rate * rate).sum()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;
    use crate::robot::{RobotParameters, Shape};
    use nalgebra::Vector3;
    use proptest::prelude::*;

    const PERIOD_S: f64 = 0.005;

    /// A moment: a robot, its state, what it wants, and what is around it.
    #[derive(Debug)]
    struct Moment {
        robot: Robot,
        at: Configuration,
        wish: BendRates,
        obstacles: Vec<Obstacle>,
        safe_distance_m: f64,
    }

    impl Moment {
        fn guard(&self) -> Guarded {
            guard(
                &self.robot,
                &self.at,
                &self.wish,
                &self.obstacles,
                self.safe_distance_m,
                PERIOD_S,
            )
        }

        fn guard_ramp(&self) -> Guarded {
            guard_ramp(
                &self.robot,
                &self.at,
                &self.wish,
                &self.obstacles,
                self.safe_distance_m,
                PERIOD_S,
            )
        }

        fn clearance_after_m(&self, rates: &BendRates, obstacle: &Obstacle) -> f64 {
            let next = self.at.advanced(rates, PERIOD_S);
            self.robot.clearance_m(&next, &obstacle.moved(PERIOD_S))
        }

        /// The rule of [`guard`], without a tolerance.
        fn keeps(&self, rates: &BendRates) -> bool {
            let still = BendRates::zero(self.robot.section_count());
            self.obstacles.iter().all(|obstacle| {
                let standing_m = self.clearance_after_m(&still, obstacle);
                self.clearance_after_m(rates, obstacle) >= standing_m.min(self.safe_distance_m)
            })
        }
    }

    fn trunk(sections: usize) -> Robot {
        Robot::new(&RobotParameters::paper(sections)).unwrap()
    }

    fn ball(centre_m: Vector3<f64>, radius_m: f64) -> Obstacle {
        Obstacle::new(Shape::Sphere { centre_m }, radius_m, Vector3::zeros()).unwrap()
    }

    /// Obstacles beside a point of the body: in direction, at a distance from touching it deep to out of reach.
    fn obstacle() -> impl Strategy<Value = (usize, [f64; 9], bool)> {
        (
            0..3_usize,
            prop::array::uniform9(-1.0..1.0_f64),
            any::<bool>(),
        )
    }

    fn placed(robot: &Robot, at: &Configuration, numbers: (usize, [f64; 9], bool)) -> Obstacle {
        let (section, [s, x, y, z, apart, size, vx, vy, vz], is_capsule) = numbers;
        let section = section % robot.section_count();
        let radius_m = 0.02 + 0.02 * size;
        let side = Vector3::new(x, y, z)
            .try_normalize(1e-3)
            .unwrap_or(Vector3::x());
        let away_m = 0.015 + radius_m + 0.01 + 0.04 * apart;
        let centre_m = robot.body_point(at, section, 0.5 + 0.5 * s) + side * away_m;
        let velocity_m_s = Vector3::new(vx, vy, vz) * if x > 0.0 { 0.0 } else { 0.5 };
        let span_m = side.cross(&Vector3::new(vy, vz, vx)) * 0.2;
        let shape = if is_capsule {
            Shape::Capsule {
                start_m: centre_m - span_m,
                end_m: centre_m + span_m,
            }
        } else {
            Shape::Sphere { centre_m }
        };
        Obstacle::new(shape, radius_m, velocity_m_s).unwrap()
    }

    fn moments() -> impl Strategy<Value = Moment> {
        (
            1..=3_usize,
            prop::array::uniform6(-1.9..1.9_f64),
            prop::array::uniform6(-2.5..2.5_f64),
            prop::collection::vec(obstacle(), 1..6),
            0.0..0.03_f64,
        )
            .prop_map(|(sections, bends, rates, obstacles, safe_distance_m)| {
                let robot = trunk(sections);
                let at = Configuration::from_slice(&bends[..2 * sections]).unwrap();
                let wish = BendRates::from_slice(&rates[..2 * sections]).unwrap();
                let wish = limit(&robot, &at, &wish, PERIOD_S).rates;
                let place = |numbers| placed(&robot, &at, numbers);
                let obstacles = obstacles.into_iter().map(place).collect();
                Moment {
                    robot,
                    at,
                    wish,
                    obstacles,
                    safe_distance_m,
                }
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn what_leaves_keeps_clear_and_inside_the_limits(moment in moments()) {
            let guarded = moment.guard();
            prop_assert!(moment.keeps(&guarded.rates));
            let ramp = moment.guard_ramp();
            prop_assert!(moment.keeps(&ramp.rates));
            for (rate, wish) in ramp.rates.as_slice().iter().zip(moment.wish.as_slice()) {
                prop_assert!(rate.abs() <= wish.abs() && rate * wish >= 0.0);
            }
            prop_assert_eq!(guarded.hit, !moment.keeps(&moment.wish));
            let again = limit(&moment.robot, &moment.at, &guarded.rates, PERIOD_S);
            for (rate, limited) in guarded.rates.as_slice().iter().zip(again.rates.as_slice()) {
                prop_assert!((rate - limited).abs() < 1e-9);
            }
            prop_assert!(square(&guarded.rates) <= square(&moment.wish));
            let least_m = moment.obstacles.iter().map(|o| moment.robot.clearance_m(&moment.at, o));
            prop_assert_eq!(guarded.clearance_m, least_m.fold(f64::INFINITY, f64::min));
        }

        #[test]
        fn the_same_moment_gives_the_same_bits(moment in moments()) {
            let (once, again) = (moment.guard(), moment.guard());
            let bits = |guarded: &Guarded| guarded.rates.as_slice().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&once), bits(&again));
        }

        #[test]
        fn far_from_everything_nothing_changes(mut moment in moments(), away in 1.2..1000.0_f64) {
            moment.obstacles = vec![ball(Vector3::new(away, 0.0, 0.0), 0.05); 3];
            let guarded = moment.guard();
            prop_assert_eq!((guarded.rates, guarded.hit), (moment.wish, false));
        }
    }

    /// A robot that wants to bend towards a ball for a second.
    fn push(sections: usize, ball: &Obstacle, rates: &[f64]) -> (Vec<f64>, Configuration) {
        let robot = trunk(sections);
        let mut at = Configuration::straight(sections);
        let mut clearances_m = Vec::new();
        for _ in 0..200 {
            let wish = BendRates::from_slice(rates).unwrap();
            let guarded = guard(&robot, &at, &wish, &[ball.moved(0.0)], 0.01, PERIOD_S);
            at = at.advanced(&guarded.rates, PERIOD_S);
            clearances_m.push(robot.clearance_m(&at, ball));
        }
        (clearances_m, at)
    }

    #[test]
    fn head_on_the_body_comes_to_the_safe_distance_and_stays() {
        let (clearances_m, _) = push(1, &ball(Vector3::new(0.12, 0.0, 0.28), 0.02), &[1.0, 0.0]);
        let least_m = clearances_m.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(least_m >= 0.01, "{least_m}");
        let last_m = clearances_m[clearances_m.len() - 1];
        assert!(last_m < 0.0101, "it stops at the border: {last_m}");
    }

    #[test]
    fn at_an_angle_the_body_slides_along() {
        let obstacle = ball(Vector3::new(0.12, 0.02, 0.28), 0.02);
        let (clearances_m, at) = push(1, &obstacle, &[1.0, -0.3]);
        assert!(clearances_m.iter().all(|clearance_m| *clearance_m >= 0.01));
        assert!(at.as_slice()[1] < -0.25, "it goes on sideways: {at:?}");
    }

    #[test]
    fn what_appears_inside_the_safe_distance_never_gets_nearer_by_our_own_motion() {
        let robot = trunk(2);
        let mut at = Configuration::from_slice(&[0.5, 0.0, 0.2, 0.0]).unwrap();
        let tip_m = robot.tip_position(&at);
        let obstacle = ball(tip_m + Vector3::new(0.038, 0.0, 0.0), 0.02);
        let mut before_m = robot.clearance_m(&at, &obstacle);
        assert!(before_m < 0.01 && before_m > 0.0);
        for _ in 0..200 {
            let wish = BendRates::from_slice(&[1.0, 0.2, 1.0, -0.1]).unwrap();
            let guarded = guard(&robot, &at, &wish, &[obstacle], 0.01, PERIOD_S);
            at = at.advanced(&guarded.rates, PERIOD_S);
            let after_m = robot.clearance_m(&at, &obstacle);
            assert!(after_m >= before_m.min(0.01), "{after_m} after {before_m}");
            before_m = after_m;
        }
    }

    #[test]
    fn a_robot_at_rest_stays_at_rest_whatever_comes() {
        let robot = trunk(2);
        let at = Configuration::straight(2);
        let towards = Vector3::new(-1.0, 0.0, 0.0);
        let shape = Shape::Sphere {
            centre_m: Vector3::new(0.05, 0.0, 0.5),
        };
        let obstacle = Obstacle::new(shape, 0.02, towards).unwrap();
        let still = BendRates::zero(2);
        let guarded = guard(&robot, &at, &still, &[obstacle], 0.01, PERIOD_S);
        assert_eq!((guarded.rates, guarded.hit), (still, false));
        assert!((guarded.clearance_m - 0.015).abs() < 1e-15);
    }

    #[test]
    fn a_state_that_is_not_finite_and_too_many_obstacles_stand_still() {
        let robot = trunk(1);
        let wish = BendRates::from_slice(&[0.1, 0.0]).unwrap();
        let near = ball(Vector3::new(0.03, 0.0, 0.3), 0.01);
        let lost = Configuration::from_slice(&[f64::NAN, 0.0]).unwrap();
        let guarded = guard(&robot, &lost, &wish, &[near], 0.01, PERIOD_S);
        assert_eq!((guarded.rates, guarded.hit), (BendRates::zero(1), true));
        assert!(guarded.clearance_m.is_nan());
        let many = vec![near; NEAR_MAX + 1];
        let at = Configuration::straight(1);
        let guarded = guard(&robot, &at, &wish, &many, 0.01, PERIOD_S);
        assert_eq!((guarded.rates, guarded.hit), (BendRates::zero(1), true));
    }

    #[test]
    fn without_obstacles_there_is_no_clearance() {
        let wish = BendRates::from_slice(&[0.1, 0.0]).unwrap();
        let guarded = guard(
            &trunk(1),
            &Configuration::straight(1),
            &wish,
            &[],
            0.01,
            PERIOD_S,
        );
        assert_eq!(guarded.clearance_m, f64::INFINITY);
        assert!(!guarded.hit);
    }
}
