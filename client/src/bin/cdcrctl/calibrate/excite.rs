use core::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, TAU};
use std::io::Write;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use cdcr_client::model::robot_of;
use cdcr_client::{Connection, Trajectory};
use cdcr_controller::robot::{Configuration, Robot, SectionParameters};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::RequestKind;
use nalgebra::Vector3;

use super::bends::check_bends;
use super::record::{OR, Rows, check_sensors, print_rows};
use super::resting::{Sensors, rests};
use crate::args::{ExciteOptions, Target};
use crate::done::Done;
use crate::dry_run::{self, Demands, newest, robot_and_pose};
use crate::feed::{MISSED_M, follow, go_options, within};
use crate::files::check_new;
use crate::standing::{check_stands, distance_m};
use crate::wait;

/// Default bounds as shares of the robot's limits: bends, rates.
const ROBOT_SHARE: (f64, f64) = (0.9, 0.5);
/// Share of the bounds that the ideal robot may use; the rest is for deviations of the real robot.
const IDEAL_SHARE: f64 = 0.95;
/// Attempts with a smaller and slower path, and the minimum reduction of each.
const TRIES: u32 = 12;
const SMALLER: f64 = 0.97;
/// Factor of the size where a slower path is as fast, because the robot jumps from one pose into another.
const SMALLER_FOR_JUMP: f64 = 0.85;
/// Attempts with a faster path, and a path with less than this share of a rate that was asked for is made faster.
const FASTER_TRIES: u32 = 8;
const FAST_ENOUGH: f64 = 0.95;
/// A path with less than this share of the allowed rate is noted.
const FAST: f64 = 0.8;
/// Minimum duration of a round \[s\], and minimum number of rounds: fewer do not reach all sides of the
/// robot.
const ROUND_MIN_S: f64 = 15.0;
const ROUNDS_MIN: f64 = 1.0;
/// Frequencies per round: across the robot in two directions, and along it; of two sections the direction, the first bend, how far
/// the directions are apart, and the second bend. They differ, so that many combinations occur.
const TURNS: [f64; 4] = [1.0, 1.25, 1.55, 1.8];
/// Time for fading in and out \[s\], or a quarter of the path if that is less.
const FADE_S: f64 = 5.0;
/// Shares of the robot length: largest sideways motion, middle height, and height variation.
const SIDE: f64 = 0.444;
const MIDDLE: f64 = 0.556;
const HEIGHT: f64 = 0.222;
/// Two sections reach most points in two poses, and a path of the tip leads from one into the other by a jump. So their bends are
/// chosen: as shares of the largest one, the middle and its variation; and how far their directions are apart at most \[rad\].
const BEND: f64 = 0.4;
const BEND_SWING: f64 = 0.17;
const APART_RAD: f64 = FRAC_PI_2;
/// Time for which the end point is kept, so that the tip comes to rest there \[s\].
const KEPT_S: f64 = 1.0;
/// A robot with smaller bends counts as straight \[rad\]: it started at home.
const STRAIGHT_RAD: f64 = 0.02;
/// Timeout for the return at the end.
const END: Duration = Duration::from_secs(60);
/// A tip farther than this from its start has not returned \[m\].
const BACK_M: f64 = 5e-3;
/// Steps for measuring the length of the path.
const STEPS: u32 = 10_000;

pub(super) fn run(target: &Target, options: &ExciteOptions) -> anyhow::Result<Done> {
    let output = &options.record.output;
    if !options.dry_run {
        check_new(output, OR)?;
    }
    let connection = target.connect()?;
    let before = rests(&mut connection.telemetry()?)?;
    check_sensors(Sensors::from_record(&before))?;
    let bounds = Bounds::new(&robot_of(&before.robot)?, options);
    check_bends(&before, bounds.bend_rad)?;
    let (excitation, demands) = plan(&connection, &before, bounds, options)?;
    if let Some(note) = slow_note(demands.bend_and_rate().1, bounds) {
        tell!("{note}");
    }
    if options.dry_run {
        demands.print(excitation.name())?;
        excitation.print()?;
        return Ok(Done::Good);
    }
    check_stands(&connection, &before)?;
    let mut rows = Rows::create(output, &newest(&connection)?)?;
    let followed = follow(&connection, &excitation, go_options(), |record| {
        rows.take(record)?;
        check_bends(record, bounds.bend_rad)
    });
    let written = rows.finish();
    let (done, _) = followed.with_context(|| match &written {
        Ok(rows) => format!("{}: {rows} rows until then", output.display()),
        Err(_) => format!("{}: not all rows until then", output.display()),
    })?;
    let written = written?;
    if done == Done::Interrupted {
        return Ok(done);
    }
    print_rows(output, written, excitation.duration_s())?;
    // Homing ends closer to straight than a tip reference can, for a robot that deviates from its model.
    let is_straight = excitation.begins_straight();
    let end = if is_straight {
        RequestKind::Home
    } else {
        RequestKind::Hold
    };
    let done = wait::run(target, end, END)?;
    if done == Done::Good {
        let left_m = distance_m(newest(&connection)?.tip_position_m, before.tip_position_m);
        let left_mm = 1e3 * left_m;
        ensure!(
            is_straight || left_m <= BACK_M,
            "the tip is at rest {left_mm:.1} mm from its start"
        );
        writeln!(
            std::io::stdout(),
            "the tip is {left_mm:.1} mm from its start"
        )?;
    }
    Ok(done)
}

/// Bounds of the path: the options, or a share of the robot's limits.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    bend_rad: f64,
    rate_rad_s: f64,
    /// True if the path is to have the rate, instead of a round each [`ROUND_MIN_S`].
    is_rate_asked: bool,
}

impl Bounds {
    fn new(robot: &Robot, options: &ExciteOptions) -> Self {
        let sections = robot.sections();
        let least = |of: fn(&SectionParameters) -> f64| {
            let values = sections.iter().map(of);
            values.fold(f64::INFINITY, f64::min)
        };
        let bend_rad = ROBOT_SHARE.0 * least(|section| section.bend_max_rad);
        let rate_rad_s = ROBOT_SHARE.1 * least(|section| section.rate_max_rad_s);
        Self {
            bend_rad: options.bend_max.unwrap_or(bend_rad),
            rate_rad_s: options.rate_max.unwrap_or(rate_rad_s),
            is_rate_asked: options.rate_max.is_some(),
        }
    }

    /// Shares of the ideal robot's part of the bounds: the inverse of the use of bends and rates.
    fn shares(self, demands: &Demands) -> (f64, f64) {
        let (bend_rad, rate_rad_s) = demands.bend_and_rate();
        (
            IDEAL_SHARE * self.bend_rad / bend_rad,
            IDEAL_SHARE * self.rate_rad_s / rate_rad_s,
        )
    }
}

/// What makes a path faster that is slower than allowed.
fn slow_note(rate_rad_s: f64, bounds: Bounds) -> Option<String> {
    let most_rad_s = bounds.rate_rad_s;
    let why = if bounds.is_rate_asked {
        "limits or obstacles prevent a faster path, which would miss its points or bend too far; a larger --bend-max or another --seed may help"
            .to_owned()
    } else {
        format!(
            "a round takes {ROUND_MIN_S:.0} s, which suits the geometry; --rate-max {most_rad_s:.3} makes it as fast as is allowed, for delay, time \
             constant and play of the motors"
        )
    };
    (rate_rad_s < FAST * most_rad_s).then(|| {
        format!(
            "note: the path bends at up to {rate_rad_s:.3} rad/s of {most_rad_s:.3} rad/s: {why}"
        )
    })
}

/// The largest path that the ideal robot follows within `bounds`, and the fastest if a rate was asked for.
fn plan(
    connection: &Connection,
    record: &Telemetry,
    bounds: Bounds,
    options: &ExciteOptions,
) -> anyhow::Result<(Excitation, Demands)> {
    let mut excitation = Excitation::new(record, options)?;
    let allowed_m = excitation.missed_m();
    let asked_s = options.record.duration.as_secs_f64();
    let mut missed = String::new();
    let mut jump_rad_s = f64::INFINITY;
    for _ in 0..TRIES {
        ensure!(
            excitation.rounds >= ROUNDS_MIN,
            too_short(asked_s, bounds, excitation.moving_s / excitation.rounds)
        );
        let demands = dry_run::compute(connection, &excitation, &go_options())?;
        let (_, rate_rad_s) = demands.bend_and_rate();
        let (bend_share, rate_share) = bounds.shares(&demands);
        let miss = demands.miss(allowed_m);
        if bend_share >= 1.0 && rate_share >= 1.0 && miss.is_none() {
            ensure!(
                asked_s >= ROUND_MIN_S,
                too_short(asked_s, bounds, ROUND_MIN_S)
            );
            return faster(connection, excitation, demands, bounds);
        }
        if bend_share < 1.0 || miss.is_some() {
            excitation.size *= bend_share.min(SMALLER);
        }
        if rate_share < 1.0 {
            let is_jump = rate_rad_s > jump_rad_s;
            let share = excitation.calm(rate_share.min(SMALLER), is_jump);
            // Between the same rate again, and one that has changed with the path.
            jump_rad_s = 0.5 * (1.0 + share) * rate_rad_s;
        }
        missed = miss.map_or_else(String::new, |(cause, _)| format!(" ({cause})"));
    }
    bail!(
        "no path within {:.3} rad and {:.3} rad/s and clear of obstacles was found{missed}; nothing moved: use a longer \
         --duration, another --seed or other limits, or move the robot by other means during cdcrctl calibrate record",
        bounds.bend_rad,
        bounds.rate_rad_s
    )
}

/// The same path, as fast as a rate that was asked for and the robot's limits permit.
fn faster(
    connection: &Connection,
    mut excitation: Excitation,
    mut demands: Demands,
    bounds: Bounds,
) -> anyhow::Result<(Excitation, Demands)> {
    let (mut too_fast, mut size) = (f64::INFINITY, excitation.size);
    for _ in 0..FASTER_TRIES {
        let (_, share) = bounds.shares(&demands);
        if !bounds.is_rate_asked || share * FAST_ENOUGH < 1.0 {
            break;
        }
        let between = (0.5 * (excitation.rounds + too_fast)).min(share * excitation.rounds);
        let tried = Excitation {
            rounds: between,
            size,
            ..excitation.clone()
        };
        let needed = dry_run::compute(connection, &tried, &go_options())?;
        let (bend_share, rate_share) = bounds.shares(&needed);
        if needed.miss(tried.missed_m()).is_some() || rate_share < 1.0 {
            too_fast = between;
        } else if bend_share < 1.0 {
            // More rounds come nearer to the largest bend.
            size *= bend_share.min(SMALLER);
        } else {
            (excitation, demands) = (tried, needed);
        }
    }
    Ok((excitation, demands))
}

/// At one round, the rates are inverse to the duration; a tenth more is for the next attempts.
fn too_short(asked_s: f64, bounds: Bounds, round_s: f64) -> String {
    let rate = if bounds.is_rate_asked {
        format!("--rate-max {:.3}", bounds.rate_rad_s)
    } else {
        "a round of this robot".to_owned()
    };
    format!(
        "{asked_s:.1} s is too short for {rate}; nothing moved: use --duration {:.0}s or longer",
        (1.1 * round_s).ceil()
    )
}

/// A path of the tip to all sides, near and far, that starts and ends at rest: where it began, or bent if two sections
/// began straight.
#[derive(Clone)]
struct Excitation {
    robot: Robot,
    start: Configuration,
    start_m: Vector3<f64>,
    /// Offset of the tip from the model at the start \[m\].
    offset_m: Vector3<f64>,
    moving_s: f64,
    /// Relative size, at most 1.
    size: f64,
    rounds: f64,
    /// Initial phase of each direction \[turns\].
    phases: [f64; 4],
}

impl Excitation {
    fn new(record: &Telemetry, options: &ExciteOptions) -> anyhow::Result<Self> {
        let (robot, start) = robot_and_pose(record)?;
        let moving_s = options.record.duration.as_secs_f64().max(ROUND_MIN_S);
        // Multiples of an irrational number: different seeds have different phases.
        let golden = 0.618_033_988_749_895 * options.seed as f64;
        Ok(Self {
            start,
            start_m: record.tip_position_m.into(),
            offset_m: record.tip_offset_m.into(),
            moving_s,
            size: 1.0,
            rounds: moving_s / ROUND_MIN_S,
            phases: [0.0, 1.0, 2.0, 3.0].map(|i| (i * golden).fract()),
            robot,
        })
    }

    /// Largest distance allowed between tip and path \[m\]. The tip of a single section is on a surface, so
    /// with a tip offset it cannot reach all points. It need not, because the bends determine the result.
    fn missed_m(&self) -> f64 {
        let has_one_section = self.robot.section_count() == 1;
        MISSED_M + f64::from(u8::from(has_one_section)) * self.offset_m.norm()
    }

    fn begins_straight(&self) -> bool {
        self.start
            .as_slice()
            .iter()
            .all(|rad| rad.abs() < STRAIGHT_RAD)
    }

    /// Makes the path slower by `share`, or smaller where that does not help. Returns the factor.
    fn calm(&mut self, share: f64, is_jump: bool) -> f64 {
        let is_slowest = self.has_two_sections() && share * self.rounds < ROUNDS_MIN;
        if is_jump || is_slowest {
            self.size *= SMALLER_FOR_JUMP;
            return SMALLER_FOR_JUMP;
        }
        self.rounds *= share;
        share
    }

    fn has_two_sections(&self) -> bool {
        self.robot.section_count() == 2
    }

    /// Angles of the sways \[rad\], and the amplitude of the fade.
    fn sway(&self, time_s: f64) -> ([f64; 4], f64) {
        let time_s = time_s.clamp(0.0, self.moving_s);
        let left_s = self.moving_s - time_s;
        let fade_s = FADE_S.min(0.25 * self.moving_s);
        // On its way back to straight the tip of two sections would lead them into another pose: the robot homes from where it is.
        let ends_bent = self.has_two_sections() && self.begins_straight();
        let (edge_s, swayed_s) = if ends_bent {
            let left = (left_s / fade_s).min(1.0);
            // The integral of the smooth step below: the sways slow down to rest.
            let slowed = left.powi(4) * (2.5 - 3.0 * left + left * left);
            (
                time_s,
                time_s.min(self.moving_s - fade_s) + fade_s * (0.5 - slowed),
            )
        } else {
            (time_s.min(left_s), time_s)
        };
        let edge = (edge_s / fade_s).min(1.0);
        // Smooth in position, speed and acceleration.
        let swell = edge.powi(3) * (10.0 - 15.0 * edge + 6.0 * edge * edge);
        let turns = self.rounds * swayed_s / self.moving_s;
        let angle = |i: usize| TAU * (turns * TURNS[i] + self.phases[i]);
        (core::array::from_fn(angle), swell)
    }

    fn tip_m(&self, time_s: f64) -> Vector3<f64> {
        let (angles_rad, swell) = self.sway(time_s);
        let [x, y, z, w] = angles_rad.map(f64::sin);
        let bends = match self.robot.sections() {
            // The tip of a single section is on a surface.
            [section] => {
                let bend_rad = self.size * section.bend_max_rad * FRAC_1_SQRT_2;
                vec![bend_rad * x, bend_rad * y]
            }
            [first, second] => {
                let apart_rad = APART_RAD * z;
                let bends =
                    [(first, y, 0.0), (second, w, apart_rad)].map(|(section, swing, apart_rad)| {
                        let bend_rad =
                            self.size * section.bend_max_rad * (BEND + BEND_SWING * swing);
                        let (sin, cos) = (angles_rad[0] + apart_rad).sin_cos();
                        [bend_rad * cos, bend_rad * sin]
                    });
                bends.concat()
            }
            _ => {
                let side = self.size * SIDE;
                let height = 1.0 - self.size * (1.0 - MIDDLE - HEIGHT * z);
                let goal_m = self.robot.reach_m() * Vector3::new(side * x, side * y, height);
                return self.start_m.lerp(&goal_m, swell);
            }
        };
        let mut here = self.start;
        for (bend, goal_rad) in here.as_mut_slice().iter_mut().zip(bends) {
            *bend += swell * (goal_rad - *bend);
        }
        self.robot.tip_position(&here) + self.offset_m
    }

    fn print(&self) -> anyhow::Result<()> {
        let step_s = self.duration_s() / f64::from(STEPS);
        let points = (0..=STEPS).map(|k| self.position_m(f64::from(k) * step_s));
        let points: Vec<_> = points.collect();
        let pairs = points.windows(2);
        let length_m: f64 = pairs.map(|pair| distance_m(pair[0], pair[1])).sum();
        let length = format!("{length_m:.2} m of the tip in {:.1} s", self.duration_s());
        writeln!(std::io::stdout(), "  {:<14}{length}", "length")?;
        Ok(())
    }
}

impl Trajectory for Excitation {
    fn name(&self) -> &'static str {
        "exciting path"
    }

    fn duration_s(&self) -> f64 {
        self.moving_s + KEPT_S
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        within(self.tip_m(time_s).into(), self.robot.reach_m())
    }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use super::*;

    fn excitation(sections: usize, seed: f64) -> Excitation {
        let robot = Robot::new(&RobotParameters::paper(sections)).expect("a robot");
        let start = Configuration::from_bend_angles(&vec![[0.3, 1.0]; sections]);
        Excitation {
            start_m: robot.tip_position(&start),
            start,
            offset_m: Vector3::zeros(),
            moving_s: 30.0,
            size: 1.0,
            rounds: 2.0,
            phases: [0.0, seed, 2.0 * seed, 3.0 * seed],
            robot,
        }
    }

    #[test]
    fn a_slow_path_is_noted_with_what_makes_it_faster() {
        let bounds = |is_rate_asked| Bounds {
            bend_rad: 1.0,
            rate_rad_s: 1.0,
            is_rate_asked,
        };
        assert_eq!(slow_note(0.81, bounds(false)), None);
        let note = slow_note(0.25, bounds(false)).expect("slow");
        assert!(
            note.contains("at up to 0.250 rad/s of 1.000 rad/s"),
            "{note}"
        );
        assert!(note.contains("--rate-max 1.000 makes it as fast"), "{note}");
        let note = slow_note(0.25, bounds(true)).expect("slow");
        assert!(note.contains("--bend-max"), "{note}");
    }

    #[test]
    fn it_begins_and_ends_at_rest_where_the_tip_is_and_goes_to_all_sides() {
        for sections in 1..=6 {
            let path = excitation(sections, 0.6);
            let start_m = path.start_m.into();
            let reach_m = path.robot.reach_m();
            for end_s in [0.0, 1e-3, 30.0 - 1e-3, 30.0, path.duration_s()] {
                assert!(distance_m(path.position_m(end_s), start_m) < 1e-6 * reach_m);
            }
            let points = (0..3000).map(|k| path.position_m(0.01 * f64::from(k)));
            let (mut least_m, mut most_m) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
            for point_m in points {
                assert!(distance_m(point_m, [0.0; 3]) <= reach_m);
                for axis in 0..3 {
                    least_m[axis] = least_m[axis].min(point_m[axis]);
                    most_m[axis] = most_m[axis].max(point_m[axis]);
                }
            }
            for axis in 0..2 {
                assert!(least_m[axis] < -0.4 * reach_m && most_m[axis] > 0.4 * reach_m);
            }
            let other = excitation(sections, 0.2);
            assert!(distance_m(path.position_m(9.0), other.position_m(9.0)) > 0.01 * reach_m);
        }
    }
}
