//! The search for the largest component compared with a scan.

use core::f64::consts::PI;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;
use crate::robot::{Configuration, Robot, RobotParameters};

const PERIOD_S: f64 = 0.005;
/// Fastest components that the scan tries.
const SCANNED: u32 = 400;
/// Steps of the golden section beside the best of them.
const REFINED: u32 = 40;

/// A robot beside its limits, which comes to rest after its command.
struct Moment {
    robot: Robot,
    at: Configuration,
    commanded: Option<Configuration>,
    previous: BendRates,
    desired: BendRates,
    change_rad_s: f64,
    stopping: Stopping,
}

impl Moment {
    fn random(seed: u64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let sections = between(1.0, 7.0) as usize;
        let mut parameters = RobotParameters::paper(sections);
        let is_papers = between(0.0, 1.0) < 0.4;
        for section in &mut parameters.sections {
            if !is_papers {
                section.length_m = between(0.05, 0.4);
                section.cable_radius_m = between(0.003, 0.03);
                section.cable_offset_rad = between(-PI, PI);
                section.bend_max_rad = between(0.8, PI);
                section.rate_max_rad_s = between(0.3, 5.0);
            }
        }
        let mut one_of = |values: &[f64]| values[between(0.0, values.len() as f64) as usize];
        let bent = one_of(&[0.1, 0.7, 1.02]);
        parameters.cable_speed_max_m_s = one_of(&[0.02, 0.1, 0.5]);
        let moving_s = PERIOD_S * one_of(&[1.0, 3.0, 5.0]);
        let deceleration_rad_s2 = one_of(&[20.0, 40.0, 200.0]);
        let acceleration_rad_s2 = one_of(&[20.0, 40.0, 200.0, f64::INFINITY]);
        let desired_share = one_of(&[0.05, 0.5, 1.0, 1.3]);
        let previous_share = one_of(&[0.0, 0.3, 0.7, 1.0]);
        let mut bends = Vec::new();
        for section in &parameters.sections {
            let bend_rad = bent * section.bend_max_rad * between(0.0, 1.0);
            let (sin, cos) = between(-PI, PI).sin_cos();
            bends.extend([bend_rad * cos, bend_rad * sin]);
        }
        let at = Configuration::from_slice(&bends).expect("a shape");
        let robot = Robot::new(&parameters).expect("legal");
        let strokes_m = robot.cable_strokes(&at);
        let farthest_m = strokes_m.iter().fold(0.0_f64, |most, m| most.max(m.abs()));
        parameters.cable_stroke_max_m = (farthest_m * between(0.98, 2.0)).max(2e-3);
        let robot = Robot::new(&parameters).expect("legal");
        let commanded = (between(0.0, 1.0) < 0.3).then(|| {
            let mut commanded = at;
            for bend in commanded.as_mut_slice() {
                *bend += between(-0.05, 0.05);
            }
            commanded
        });
        let mut rates = |share: f64| {
            let mut rates = BendRates::zero(sections);
            for (i, rate) in rates.as_mut_slice().iter_mut().enumerate() {
                *rate = share * parameters.sections[i / 2].rate_max_rad_s * between(-1.0, 1.0);
            }
            rates
        };
        Self {
            previous: rates(previous_share),
            desired: rates(desired_share),
            robot,
            at,
            commanded,
            change_rad_s: acceleration_rad_s2 * PERIOD_S,
            stopping: Stopping {
                moving_s,
                deceleration_rad_s2,
            },
        }
    }

    fn limits(&self) -> Limits<'_> {
        let path = self.stopping.path(fastest(&self.desired));
        Limits::new(&self.robot, &self.at, path.path_s)
            .with_commanded(self.commanded.as_ref())
            .with_stopping(self.stopping)
            .with_acceleration(&self.previous, self.change_rad_s)
    }

    /// The distance of the rates that are found.
    fn found(&self) -> f64 {
        let found = self.limits().nearest(&self.desired).rates;
        square_between(&found, &self.desired).sqrt()
    }

    /// The distance of the nearest rates of which no component is faster.
    fn distance(&self, fastest_rad_s: f64) -> f64 {
        let limits = self.limits().for_fastest(fastest_rad_s);
        let mut region = Region::EMPTY;
        limits.fill(&mut region, fastest_rad_s);
        let nearest = limits.nearest_in(&mut region, &self.desired);
        nearest.map_or(f64::INFINITY, |rates| {
            square_between(&rates, &self.desired).sqrt()
        })
    }

    /// The least of those.
    fn scanned(&self) -> f64 {
        let most_rad_s = fastest(&self.desired);
        let at = |step: f64| self.distance(most_rad_s * step / f64::from(SCANNED));
        let steps = (1..=SCANNED).map(f64::from);
        let best = steps
            .map(|step| (at(step), step))
            .min_by(|one, other| one.0.total_cmp(&other.0));
        let (least, best) = best.unwrap_or((f64::INFINITY, 1.0));
        let (mut low, mut high) = (best - 1.0, (best + 1.0).min(f64::from(SCANNED)));
        let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
        for _ in 0..REFINED {
            let (left, right) = (high - golden * (high - low), low + golden * (high - low));
            if at(left) < at(right) {
                high = right;
            } else {
                low = left;
            }
        }
        least.min(at(0.5 * (low + high)))
    }
}

/// Its rates are as near to the desired ones as the best that the scan finds.
#[test]
fn the_search_finds_what_a_scan_finds() {
    let is_whole = std::env::var_os("CDCR_WHOLE").is_some();
    let seeds = if is_whole { 2000 } else { 200 };
    let (mut cut, mut farthest) = (0, (0.0, 0));
    for seed in 0..seeds {
        let moment = Moment::random(seed);
        let least = moment.scanned();
        if least > 1e-4 {
            cut += 1;
            let farther = moment.found() / least - 1.0;
            if farther > farthest.0 {
                farthest = (farther, seed);
            }
        }
    }
    println!(
        "{cut} cut; farther by {:.1e} at most, moment {}",
        farthest.0, farthest.1
    );
    assert!(cut > 100 && farthest.0 <= 1e-5);
}

/// The distance over the fastest component has more than one minimum (docs/model.md §7). Two of three sections are a hundredth of a radian from their limit: slow
/// rates have room enough there, fast ones of the first section pay for themselves.
#[test]
fn the_distance_has_two_minima() {
    let robot = Robot::new(&RobotParameters::paper(3)).expect("the paper's robot");
    let bent_rad = robot.sections()[1].bend_max_rad - 0.01;
    let desired = BendRates::from_slice(&[2.0, 0.0, 2.0, 0.0, 2.0, 0.0]).expect("three sections");
    let moment = Moment {
        at: Configuration::from_slice(&[0.0, 0.0, bent_rad, 0.0, bent_rad, 0.0]).expect("a shape"),
        commanded: None,
        previous: desired,
        desired,
        change_rad_s: f64::INFINITY,
        stopping: Stopping {
            moving_s: PERIOD_S,
            deceleration_rad_s2: 20.0,
        },
        robot,
    };
    let fastest_rad_s: Vec<f64> = (20..=200).map(|step| 0.01 * f64::from(step)).collect();
    let distances: Vec<f64> = fastest_rad_s.iter().map(|f| moment.distance(*f)).collect();
    let is_least = |i: &usize| distances[i - 1] > distances[*i] && distances[*i] < distances[i + 1];
    let minima: Vec<f64> = (1..distances.len() - 1)
        .filter(is_least)
        .map(|i| fastest_rad_s[i])
        .collect();
    let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
    let found = moment.found();
    println!("minima at {minima:?} rad/s; {found} rad/s away, {least} of the scan");
    assert_eq!(minima.len(), 2);
    assert!(found <= least);
}
