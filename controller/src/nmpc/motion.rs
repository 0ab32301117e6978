//! Dynamics over the horizon (Eq. 4), in either choice of coordinates.

use nalgebra::Vector3;

use super::{Coordinates, Horizon};
use crate::optimizer::Bounds;
use crate::robot::{
    BendRates, COORDINATES_MAX, Configuration, Jacobian, Robot, SECTIONS_MAX, rotate_wide,
};
use crate::wide::{Aligned, Wide};

/// Below this bend a section counts as straight: its direction is undefined \[rad\].
const STRAIGHT_RAD: f64 = 1e-9;

/// The start of a horizon, and the dynamics of the controls.
///
/// A control is a rate (u̇, v̇) with bend vectors and a rate (θ̇, φ̇) with bend angles, constant over a
/// block. At the start θ ≥ 0 and φ is the direction of the bend. A straight section takes the direction of
/// its last rates. At rest it takes the direction in which the tip approaches the goal, or else x.
#[derive(Debug, Clone)]
pub(super) struct Motion<'a> {
    coordinates: Coordinates,
    horizon: &'a Horizon,
    width: usize,
    period_s: f64,
    start_rad: [f64; COORDINATES_MAX],
    /// (θ, cos φ, sin φ) of each section.
    polar: [[f64; 3]; SECTIONS_MAX],
}

/// The bend vectors of W rollouts, and (θ, cos φ, sin φ) of P sections: none with bend vectors, all with bend
/// angles.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Bends<const W: usize, const P: usize> {
    pub bend_rad: [Wide<W>; COORDINATES_MAX],
    polar: [[Wide<W>; 3]; P],
}

/// Sections with angles when the coordinates are bend vectors.
pub(super) const VECTORS: usize = 0;
/// Sections with angles when the coordinates are bend angles.
pub(super) const ANGLES: usize = SECTIONS_MAX;

/// The bends of one rollout, in either choice of coordinates.
pub(super) type Bent = Bends<1, ANGLES>;

impl Bent {
    /// The bend vectors alone.
    pub(super) fn scalar(&self) -> [f64; COORDINATES_MAX] {
        self.bend_rad.map(|bend| bend.0[0])
    }
}

impl<'a> Motion<'a> {
    pub(super) fn new(
        robot: &Robot,
        period_s: f64,
        coordinates: Coordinates,
        horizon: &'a Horizon,
        at: &Configuration,
        previous_rates: &BendRates,
        goal_m: Option<Vector3<f64>>,
    ) -> Self {
        let mut start_rad = [0.0; COORDINATES_MAX];
        for (start, bend) in start_rad.iter_mut().zip(at.as_slice()) {
            *start = *bend;
        }
        let mut polar = [[0.0, 1.0, 0.0]; SECTIONS_MAX];
        if coordinates == Coordinates::BendAngles {
            let towards = directions_to(robot, at, goal_m);
            for (section, polar) in polar[..robot.section_count()].iter_mut().enumerate() {
                let rates = previous_rates.section(section);
                *polar = polar_of(at.section(section), rates, towards[section]);
            }
        }
        Self {
            coordinates,
            horizon,
            width: robot.coordinate_count(),
            period_s,
            start_rad,
            polar,
        }
    }

    /// The configuration at the start.
    pub(super) fn start_shape(&self) -> Configuration {
        Configuration::padded(self.start_rad, self.width / 2)
    }

    /// The bends at the start \[rad\].
    pub(super) fn start_rad(&self) -> [f64; COORDINATES_MAX] {
        self.start_rad
    }

    /// The configuration of a rollout.
    pub(super) fn shape(&self, bends: &Bent) -> Configuration {
        Configuration::padded(bends.scalar(), self.width / 2)
    }

    pub(super) fn coordinates(&self) -> Coordinates {
        self.coordinates
    }

    /// Number of coordinates 2n.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn period_s(&self) -> f64 {
        self.period_s
    }

    pub(super) fn horizon(&self) -> &Horizon {
        self.horizon
    }

    /// W rollouts at the start.
    #[inline(always)]
    pub(super) fn start<const W: usize, const P: usize>(&self) -> Bends<W, P> {
        self.start_of(self.width)
    }

    /// The same by a caller that knows the width.
    #[inline(always)]
    pub(super) fn start_of<const W: usize, const P: usize>(&self, width: usize) -> Bends<W, P> {
        let zero = Wide::splat(0.0);
        let mut bends = Bends {
            bend_rad: [zero; COORDINATES_MAX],
            polar: [[zero; 3]; P],
        };
        for i in 0..width {
            bends.bend_rad[i] = Wide::splat(self.start_rad[i]);
        }
        for section in 0..P.min(width / 2) {
            for i in 0..3 {
                bends.polar[section][i] = Wide::splat(self.polar[section][i]);
            }
        }
        bends
    }

    /// Advances the rollouts by one period with the controls of the block of `step`; in angles for P > 0.
    #[inline(always)]
    pub(super) fn advance<const W: usize, const P: usize>(
        &self,
        bends: &mut Bends<W, P>,
        z: &impl Fn(usize) -> Wide<W>,
        step: usize,
    ) {
        self.advance_of(self.width, bends, z, step);
    }

    /// The same by a caller that knows the width.
    #[inline(always)]
    pub(super) fn advance_of<const W: usize, const P: usize>(
        &self,
        width: usize,
        bends: &mut Bends<W, P>,
        z: &impl Fn(usize) -> Wide<W>,
        step: usize,
    ) {
        if P == VECTORS {
            return self.advance_vectors(width, &mut bends.bend_rad, z, step);
        }
        let first = self.horizon.block_of(step) * width;
        for section in 0..width / 2 {
            let [theta, cos, sin] = &mut bends.polar[section];
            *theta = *theta + z(first + 2 * section) * self.period_s;
            let turn = z(first + 2 * section + 1) * self.period_s;
            [*cos, *sin] = rotate_wide([*cos, *sin], turn);
            bends.bend_rad[2 * section] = *theta * *cos;
            bends.bend_rad[2 * section + 1] = *theta * *sin;
        }
    }

    #[inline(always)]
    fn advance_vectors<const W: usize>(
        &self,
        width: usize,
        bend_rad: &mut [Wide<W>; COORDINATES_MAX],
        z: &impl Fn(usize) -> Wide<W>,
        step: usize,
    ) {
        let first = self.horizon.block_of(step) * width;
        for i in 0..width {
            bend_rad[i] = bend_rad[i] + z(first + i) * self.period_s;
        }
    }

    /// Writes the bend vectors of W rollouts at the start, up to the length of `bend_rad`.
    #[inline(always)]
    pub(super) fn start_in<const W: usize>(&self, bend_rad: &mut [Aligned<W>]) {
        for (bend, start) in bend_rad.iter_mut().zip(&self.start_rad[..self.width]) {
            bend.0 = Wide::splat(*start);
        }
    }

    /// Returns a function that advances component i of the bend vectors by one period and returns it. Call it
    /// once for each component.
    #[inline(always)]
    pub(super) fn advance_component<const W: usize>(
        &self,
        bend_rad: &mut [Aligned<W>],
        z: &impl Fn(usize) -> Wide<W>,
        step: usize,
    ) -> impl FnMut(usize) -> Wide<W> {
        let first = self.horizon.block_of(step) * self.width;
        move |i| {
            let moved = bend_rad[i].0 + z(first + i) * self.period_s;
            bend_rad[i].0 = moved;
            moved
        }
    }

    /// Advances one rollout by one period, in the coordinates of the settings.
    pub(super) fn advance_one(&self, bent: &mut Bent, z: &[f64], step: usize) {
        let control = |i: usize| Wide([z[i]]);
        match self.coordinates {
            Coordinates::BendAngles => self.advance(bent, &control, step),
            Coordinates::BendVector => {
                self.advance_vectors(self.width, &mut bent.bend_rad, &control, step);
            }
        }
    }

    /// Converts derivatives with respect to bend vectors, (∂u, ∂v) of each section, to derivatives with
    /// respect to the coordinates of the controls at `bends`.
    pub(super) fn to_control_derivatives(
        &self,
        bends: &Bent,
        derivatives: &mut [f64; COORDINATES_MAX],
    ) {
        if self.coordinates == Coordinates::BendVector {
            return;
        }
        let (pairs, _) = derivatives.as_chunks_mut::<2>();
        for (pair, polar) in pairs.iter_mut().zip(&bends.polar) {
            let [theta, cos, sin] = polar.map(|value| value.0[0]);
            let [by_u, by_v] = *pair;
            *pair = [cos * by_u + sin * by_v, theta * (cos * by_v - sin * by_u)];
        }
    }

    /// Change of each section's bend \[rad\] for a change of the coordinates, to first order.
    pub(super) fn bend_changes_rad(&self, bends: &Bent, change: &[f64]) -> [f64; SECTIONS_MAX] {
        let mut changes_rad = [0.0; SECTIONS_MAX];
        let pairs = change.as_chunks::<2>().0.iter().zip(&bends.polar);
        for (target, ([first, second], polar)) in changes_rad.iter_mut().zip(pairs) {
            let across = match self.coordinates {
                Coordinates::BendVector => *second,
                Coordinates::BendAngles => polar[0].0[0] * second,
            };
            *target = (first * first + across * across).sqrt();
        }
        changes_rad
    }

    /// Converts bend rates to the controls of one block at the start. A straight section loses the component
    /// perpendicular to its direction.
    pub(super) fn controls_of(&self, rates: &[f64], controls: &mut [f64]) {
        controls.copy_from_slice(rates);
        if self.coordinates == Coordinates::BendVector {
            return;
        }
        let (pairs, _) = controls.as_chunks_mut::<2>();
        for (pair, [theta, cos, sin]) in pairs.iter_mut().zip(self.polar) {
            let [u, v] = *pair;
            let across = cos * v - sin * u;
            let turning = if theta > STRAIGHT_RAD {
                across / theta
            } else {
                0.0
            };
            *pair = [cos * u + sin * v, turning];
        }
    }

    /// Sets the box of the controls. Bend vectors: the rate limit of each section. Bend angles: the same
    /// limit for θ̇, and for φ̇ the limit divided by max(θ, 1 rad), so that θ φ̇ at the start stays within
    /// it.
    pub(super) fn set_bounds(&self, robot: &Robot, bounds: &mut Bounds) {
        let angles = self.coordinates == Coordinates::BendAngles;
        let sections = robot.sections().iter().zip(&self.polar);
        let half_widths = sections.flat_map(|(section, [theta, ..])| {
            let most = section.rate_max_rad_s;
            [most, if angles { most / theta.max(1.0) } else { most }]
        });
        bounds.set_symmetric(half_widths, self.horizon.blocks());
    }

    /// Upper bound of the norm of each section's bend rate over the horizon \[rad/s\].
    pub(super) fn fastest_rad_s(&self, bounds: &Bounds) -> [f64; SECTIONS_MAX] {
        let horizon_s = self.period_s * self.horizon.steps() as f64;
        let mut fastest = [0.0; SECTIONS_MAX];
        for (section, fastest) in fastest[..self.width / 2].iter_mut().enumerate() {
            let [first, second] = [0, 1].map(|i| bounds.upper()[2 * section + i]);
            let arm = match self.coordinates {
                Coordinates::BendVector => 1.0,
                Coordinates::BendAngles => self.polar[section][0] + first * horizon_s,
            };
            *fastest = first.hypot(arm * second);
        }
        fastest
    }

    /// Upper bound of the change of each section's bend vector by any plan \[rad\].
    pub(super) fn bend_change_max_rad(&self, robot: &Robot) -> [f64; SECTIONS_MAX] {
        let horizon_s = self.period_s * self.horizon.steps() as f64;
        let mut most = [0.0; SECTIONS_MAX];
        for (most, section) in most.iter_mut().zip(robot.sections()) {
            // φ̇ turns the bend. Its limit decreases as 1/θ from 1 rad on (`set_bounds`), so this bound holds
            // for every θ.
            let along = section.rate_max_rad_s * horizon_s;
            *most = along.hypot(along * (1.0 + along));
        }
        most
    }

    /// The bend rates that give the same bends after one period as the first block of `plan`. With bend
    /// angles, each section is scaled down to its rate limit.
    pub(super) fn first_rates(&self, robot: &Robot, plan: &[f64]) -> Option<BendRates> {
        if self.coordinates == Coordinates::BendVector {
            return BendRates::from_slice(&plan[..self.width]);
        }
        let mut bends: Bent = self.start();
        self.advance_one(&mut bends, plan, 0);
        let mut rates = BendRates::from_slice(&self.start_rad[..self.width])?;
        for (rate, bend) in rates.as_mut_slice().iter_mut().zip(bends.scalar()) {
            *rate = (bend - *rate) / self.period_s;
        }
        let (pairs, _) = rates.as_mut_slice().as_chunks_mut::<2>();
        for (pair, section) in pairs.iter_mut().zip(robot.sections()) {
            let fastest = pair[0].abs().max(pair[1].abs());
            if fastest > section.rate_max_rad_s {
                *pair = pair.map(|rate| rate * (section.rate_max_rad_s / fastest));
            }
        }
        Some(rates)
    }

    /// Negates θ̇ in a plan for sections that passed through straight since it was made, `elapsed_periods` of
    /// `previous_rates` ago: their angle φ has changed by π.
    pub(super) fn continue_through_straight(
        &self,
        plan: &mut [f64],
        previous_rates: &BendRates,
        elapsed_periods: u64,
    ) {
        if self.coordinates == Coordinates::BendVector {
            return;
        }
        let elapsed_s = elapsed_periods as f64 * self.period_s;
        for section in 0..self.width / 2 {
            let ([u, v], rates) = (
                [self.start_rad[2 * section], self.start_rad[2 * section + 1]],
                previous_rates.section(section),
            );
            let before = [u - elapsed_s * rates[0], v - elapsed_s * rates[1]];
            let [_, cos, sin] = self.polar[section];
            let [_, cos_before, sin_before] = polar_of(before, rates, [cos, sin]);
            if cos * cos_before + sin * sin_before < 0.0 {
                for block in plan.chunks_exact_mut(self.width) {
                    block[2 * section] = -block[2 * section];
                }
            }
        }
    }
}

/// (θ, cos φ, sin φ) of one section. If it is straight, φ is the direction of its rates, or `otherwise`
/// without rates.
fn polar_of(bend: [f64; 2], rates: [f64; 2], otherwise: [f64; 2]) -> [f64; 3] {
    let (theta, direction) = unit(bend);
    let [cos, sin] = direction.or(unit(rates).1).unwrap_or(otherwise);
    [theta, cos, sin]
}

/// Length and direction; no direction if the length is at most [`STRAIGHT_RAD`].
fn unit([x, y]: [f64; 2]) -> (f64, Option<[f64; 2]>) {
    let length = (x * x + y * y).sqrt();
    let direction = (length > STRAIGHT_RAD).then(|| [x / length, y / length]);
    (length, direction)
}

/// For each section, the direction of the bend that moves the tip towards the goal fastest, to first order; x
/// if none does.
fn directions_to(
    robot: &Robot,
    at: &Configuration,
    goal_m: Option<Vector3<f64>>,
) -> [[f64; 2]; SECTIONS_MAX] {
    let mut towards = [[1.0, 0.0]; SECTIONS_MAX];
    let Some(goal_m) = goal_m else {
        return towards;
    };
    let mut jacobian = Jacobian::default();
    let tip = robot.tip_jacobian(at, &mut jacobian);
    let wanted_m = goal_m - tip.position_m;
    let (pairs, _) = jacobian.columns().as_chunks::<2>();
    for (towards, pair) in towards.iter_mut().zip(pairs) {
        let along = pair.map(|column| Vector3::new(column[0], column[1], column[2]).dot(&wanted_m));
        *towards = unit(along).1.unwrap_or(*towards);
    }
    towards
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nmpc::NmpcSettings;
    use crate::robot::RobotParameters;

    const PERIOD_S: f64 = 0.005;

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(2)).expect("the paper's robot")
    }

    fn motion<'a>(horizon: &'a Horizon, at: &Configuration, rates: &BendRates) -> Motion<'a> {
        Motion::new(
            &robot(),
            PERIOD_S,
            Coordinates::BendAngles,
            horizon,
            at,
            rates,
            None,
        )
    }

    #[test]
    fn bend_angles_move_as_the_paper_integrates_them() {
        let horizon = Horizon::new(&NmpcSettings::default(), 2);
        let (theta, phi) = ([0.3, 1.2], [2.0, -1.0]);
        let at = Configuration::from_bend_angles(&[[theta[0], phi[0]], [theta[1], phi[1]]]);
        let motion = motion(&horizon, &at, &BendRates::zero(2));
        let z = [0.5, -1.5, -0.7, 20.0, 0.1, 0.2, 0.3, 0.4];
        let mut bends: Bent = motion.start();
        for step in 0..2 {
            motion.advance_one(&mut bends, &z, step);
        }
        for section in 0..2 {
            let moved = |i: usize| PERIOD_S * (z[2 * section + i] + z[4 + 2 * section + i]);
            let (theta, phi) = (theta[section] + moved(0), phi[section] + moved(1));
            let bend = bends.scalar();
            assert!((bend[2 * section] - theta * phi.cos()).abs() < 1e-15);
            assert!((bend[2 * section + 1] - theta * phi.sin()).abs() < 1e-15);
        }
    }

    #[test]
    fn controls_and_rates_are_inverse_to_first_order() {
        let horizon = Horizon::new(&NmpcSettings::default(), 2);
        let at = Configuration::from_bend_angles(&[[0.3, 2.0], [1.2, -1.0]]);
        let motion = motion(&horizon, &at, &BendRates::zero(2));
        let rates = [1e-4, -2e-4, 3e-4, 1e-4];
        let mut plan = [0.0; 8];
        motion.controls_of(&rates, &mut plan[..4]);
        let back = motion.first_rates(&robot(), &plan).expect("two sections");
        for (back, rate) in back.as_slice().iter().zip(rates) {
            assert!((back - rate).abs() < 1e-8, "{back} {rate}");
        }
    }

    #[test]
    fn a_plan_goes_on_through_straight() {
        // θ decreased at 0.4 rad/s through zero, so it now increases on the other side.
        let horizon = Horizon::new(&NmpcSettings::default(), 2);
        let rates = BendRates::from_slice(&[-0.4, 0.0, 0.1, 0.0]).expect("two sections");
        let at = Configuration::from_slice(&[-0.001, 0.0, 0.5, 0.0]).expect("two sections");
        let motion = motion(&horizon, &at, &rates);
        let mut plan = [-0.4, 0.0, 0.1, 0.0];
        motion.continue_through_straight(&mut plan, &rates, 1);
        assert_eq!(plan, [0.4, 0.0, 0.1, 0.0]);
        let kept = motion.first_rates(&robot(), &plan).expect("two sections");
        assert!((kept.as_slice()[0] + 0.4).abs() < 1e-12);
    }
}
