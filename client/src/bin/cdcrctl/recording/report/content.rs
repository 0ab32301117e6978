use std::collections::BTreeMap;

use anyhow::Context;
use cdcr_client::model::robot_of;
use cdcr_client::{obstacles, text};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::codes::{LateCause, Mode, ObstacleShape, RobotLink, SolverStatus, timing};
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_shared_types::{Obstacle, Telemetry};
use serde_json::{Map, Value, json};

use super::columns::{Columns, Merge};
use super::happened::Happened;
use super::histogram::Histogram;
use crate::recording::file::{RecordedMessage, Recording};
use crate::tip_error::TipError;

/// Columns of the curves: more than a screen has, and few enough for a page below 5 MB with six sections.
const COLUMNS: usize = 4096;
/// Columns of the obstacles, which take more space.
const SCENES: usize = 512;
/// Maximum number of listed late cycles, the worst first.
const WORST_MAX: usize = 50;

/// Content of the page, collected from the messages in one pass.
#[derive(Debug, Default)]
pub(super) struct Content {
    cycles: Option<Cycles>,
    robot_name: String,
    /// Kind of link: a driver, or simulated.
    link: &'static str,
    daemon: String,
}

/// Data of the cycles, from the first record on.
#[derive(Debug)]
struct Cycles {
    first: Box<Telemetry>,
    last_ns: u64,
    count: u64,
    robot: Robot,
    samples: Columns<ColumnSample>,
    scenes: Columns<ColumnScene>,
    modes: BTreeMap<u32, u64>,
    misses: BTreeMap<u32, u64>,
    late_starts: u64,
    skipped_periods: u64,
    error: TipError,
    /// Least clearance and its time \[m, s\].
    least_clearance: Option<(f64, f64)>,
    wake: Histogram,
    solve: Histogram,
    response: Histogram,
    happened: Happened,
    /// Late cycles by response time \[ns\], the worst first.
    worst: Vec<(u64, Value)>,
}

#[derive(Debug)]
struct ColumnSample {
    /// Time of its first cycle.
    time_s: f64,
    mode: u32,
    bend_rad: [f64; COORDINATES_MAX],
    tip_m: [f64; 3],
    reference_m: [f64; 3],
    /// Minimum and maximum of each series over its cycles; NaN for missing values.
    extremes: Vec<[f64; 2]>,
    misses: u32,
}

impl Merge for ColumnSample {
    fn merge(&mut self, later: Self) {
        for (mine, its) in self.extremes.iter_mut().zip(later.extremes) {
            *mine = [mine[0].min(its[0]), mine[1].max(its[1])];
        }
        self.misses += later.misses;
    }
}

/// The obstacles in the first cycle of a column.
#[derive(Debug)]
struct ColumnScene {
    time_s: f64,
    obstacles: Vec<Obstacle>,
}

impl Merge for ColumnScene {
    fn merge(&mut self, _: Self) {}
}

impl Content {
    pub(super) fn take(&mut self, message: &RecordedMessage) -> anyhow::Result<()> {
        match message {
            RecordedMessage::Telemetry(record) => {
                if self.cycles.is_none() {
                    self.cycles = Some(Cycles::begin(record)?);
                }
                if let Some(cycles) = &mut self.cycles {
                    cycles.take(record);
                }
            }
            RecordedMessage::Status(status) => {
                self.robot_name = text(&status.robot_name);
                self.link = RobotLink::text_of(status.link);
                self.daemon = text(&status.build);
            }
            _ => {}
        }
        Ok(())
    }

    pub(super) fn cycles(&self) -> u64 {
        self.cycles.as_ref().map_or(0, |cycles| cycles.count)
    }

    /// All content for the script of the page; `file` is the name of the recording.
    ///
    /// # Errors
    /// When there is no cycle.
    pub(super) fn json(&self, recording: &Recording, file: &str) -> anyhow::Result<Value> {
        let cycles = self.cycles.as_ref();
        let cycles = cycles.with_context(|| format!("{file} contains no cycle"))?;
        let mut json = cycles.json();
        json["file"] = json!(file);
        json["robot"] = json!(self.robot_name);
        json["link"] = json!(self.link);
        json["daemon"] = json!(self.daemon);
        json["is_cut"] = json!(recording.is_cut());
        json["made_by"] = json!(concat!("cdcrctl ", env!("CARGO_PKG_VERSION")));
        Ok(json)
    }
}

impl Cycles {
    fn begin(record: &Telemetry) -> anyhow::Result<Self> {
        let from_ns = record.release_ns;
        Ok(Self {
            first: Box::new(*record),
            last_ns: from_ns,
            count: 0,
            robot: robot_of(&record.robot).context("the robot of the recording")?,
            samples: Columns::new(COLUMNS, from_ns, record.period_ns),
            scenes: Columns::new(SCENES, from_ns, record.period_ns),
            modes: BTreeMap::new(),
            misses: BTreeMap::new(),
            late_starts: 0,
            skipped_periods: 0,
            error: TipError::default(),
            least_clearance: None,
            wake: Histogram::default(),
            solve: Histogram::default(),
            response: Histogram::default(),
            happened: Happened::default(),
            worst: Vec::new(),
        })
    }

    fn take(&mut self, record: &Telemetry) {
        let time_s = record.release_ns.saturating_sub(self.first.release_ns) as f64 * 1e-9;
        self.count += 1;
        self.last_ns = self.last_ns.max(record.release_ns);
        *self.modes.entry(record.mode).or_default() += 1;
        self.error.take(record);
        self.happened.take(record, time_s);
        let clearance_m = record.clearance_m;
        let least_m = self.least_clearance.map_or(f64::INFINITY, |(m, _)| m);
        if clearance_m < least_m {
            self.least_clearance = Some((clearance_m, time_s));
        }
        self.take_timing(record, time_s);
        let series = self.series(record);
        let sample = ColumnSample {
            time_s,
            mode: record.mode,
            bend_rad: record.present_rad,
            tip_m: record.tip_position_m,
            reference_m: if record.position_error_m.is_finite() {
                record.reference.position_m
            } else {
                [f64::NAN; 3]
            },
            extremes: series.iter().map(|(_, value)| [*value; 2]).collect(),
            misses: u32::from(record.timing_flags & timing::DEADLINE_MISS != 0),
        };
        self.samples.take(record.release_ns, sample);
        let obstacles = obstacles(record).to_vec();
        self.scenes
            .take(record.release_ns, ColumnScene { time_s, obstacles });
    }

    fn take_timing(&mut self, record: &Telemetry, time_s: f64) {
        let [wake_ns, solve_ns, response_ns] = latencies_ns(record);
        self.wake.take(wake_ns);
        self.response.take(response_ns);
        let has_solved = record.report.status != SolverStatus::Idle.code();
        if has_solved {
            self.solve.take(solve_ns);
        }
        self.late_starts += u64::from(record.timing_flags & timing::LATE_START != 0);
        self.skipped_periods += u64::from(record.skipped_periods);
        if record.timing_flags & timing::DEADLINE_MISS == 0 {
            return;
        }
        let cause = record.scheduling.late_cause;
        *self.misses.entry(cause).or_default() += 1;
        let place = self
            .worst
            .partition_point(|(worse_ns, _)| *worse_ns >= response_ns);
        if place < WORST_MAX {
            let [wake_us, solve_us, response_us] =
                [wake_ns, solve_ns, response_ns].map(|ns| ns as f64 * 1e-3);
            let row = json!({
                "t_s": time_s, "cycle": record.cycle, "cause": LateCause::text_of(cause),
                "wake_us": wake_us, "solve_us": has_solved.then_some(solve_us), "response_us": response_us,
            });
            self.worst.insert(place, (response_ns, row));
            self.worst.truncate(WORST_MAX);
        }
    }

    /// The curves over time, always in the same order; NaN for missing values.
    fn series(&self, record: &Telemetry) -> Vec<(String, f64)> {
        let is_tracking = record.mode == Mode::Tracking.code();
        let only = |is: bool, value: f64| {
            if is && value.is_finite() {
                value
            } else {
                f64::NAN
            }
        };
        let [wake_us, solve_us, response_us] = latencies_ns(record).map(|ns| ns as f64 * 1e-3);
        let has_solved = record.report.status != SolverStatus::Idle.code();
        let mut series = vec![
            (
                "error_mm".to_owned(),
                only(is_tracking, 1e3 * record.position_error_m),
            ),
            (
                "measured_mm".to_owned(),
                only(
                    is_tracking,
                    1e3 * self.error.measured_now_m().unwrap_or(f64::NAN),
                ),
            ),
            (
                "clearance_mm".to_owned(),
                only(true, 1e3 * record.clearance_m),
            ),
            ("wake_us".to_owned(), wake_us),
            ("solve_us".to_owned(), only(has_solved, solve_us)),
            ("response_us".to_owned(), response_us),
        ];
        let coordinates = self.robot.coordinate_count();
        let rates = &record.command.bend_rate_rad_s[..coordinates];
        series.extend((0..).zip(rates).map(|(i, rate)| {
            let axis = ["u", "v"][i % 2];
            (format!("rate_rad_s.{}.{axis}", i / 2 + 1), *rate)
        }));
        let bent = Configuration::from_slice(&record.commanded_rad[..coordinates]);
        let strokes_m = bent.map(|bent| self.robot.cable_strokes(&bent));
        let cables = 0..self.robot.cable_count();
        series.extend(cables.map(|i| {
            let stroke_m = strokes_m.map_or(f64::NAN, |strokes_m| strokes_m[i]);
            (
                format!("stroke_mm.{}.{}", i / 3 + 1, i % 3 + 1),
                1e3 * stroke_m,
            )
        }));
        series
    }

    fn json(&self) -> Value {
        let first = &self.first;
        let ms = |ns: u64| ns as f64 * 1e-6;
        let counts = |counts: &BTreeMap<u32, u64>, text: fn(u32) -> &'static str| -> Map<_, _> {
            let named = counts.iter();
            named
                .map(|(code, count)| (text(*code).to_owned(), json!(count)))
                .collect()
        };
        let section = |section: &cdcr_controller::robot::SectionParameters| {
            json!({
                "length_m": section.length_m,
                "cable_radius_m": section.cable_radius_m,
                "cable_offset_rad": section.cable_offset_rad,
                "body_radius_m": section.body_radius_m,
                "rate_max_rad_s": section.rate_max_rad_s,
            })
        };
        let error = self.error.mean_max_final_m();
        let (events, events_left_out) = self.happened.json();
        json!({
            "cycles": self.count,
            "duration_s": (self.last_ns - first.release_ns) as f64 * 1e-9,
            "period_ms": ms(first.period_ns),
            "deadline_ms": ms(first.deadline_ns),
            "late_start_ms": ms(first.late_start_ns),
            "safe_distance_mm": 1e3 * first.settings.safe_distance_m,
            "stroke_max_mm": finite(1e3 * self.robot.cable_stroke_max_m()),
            "sections": self.robot.sections().iter().map(section).collect::<Vec<_>>(),
            "modes": counts(&self.modes, Mode::text_of),
            "deadline_misses": counts(&self.misses, LateCause::text_of),
            "late_starts": self.late_starts,
            "skipped_periods": self.skipped_periods,
            "error_mm": error.map(|error| error.map(|m| 1e3 * m)),
            "measured_mm": self.error.measured_mean_max_m().map(|(error, _)| error.map(|m| 1e3 * m)),
            "strays": self.error.strays(),
            "is_by_model": self.error.unused_percent().is_some() || self.error.is_by_model(first),
            "unused_percent": self.error.unused_percent(),
            "least_clearance": self.least_clearance.map(|(m, t_s)| json!({"mm": 1e3 * m, "t_s": t_s})),
            "mode_names": Mode::ALL.iter().map(|mode| mode.text()).collect::<Vec<_>>(),
            "curves": self.curves(),
            "scenes": self.scenes(),
            "latencies": {"wake": self.wake.json(), "solve": self.solve.json(), "response": self.response.json()},
            "events": events,
            "events_left_out": events_left_out,
            "worst": self.worst.iter().map(|(_, row)| row).collect::<Vec<_>>(),
        })
    }

    /// The columns, as one list per quantity.
    fn curves(&self) -> Value {
        let coordinates = self.robot.coordinate_count();
        let all = |value: &dyn Fn(&ColumnSample) -> Value| -> Value {
            self.samples.iter().map(value).collect()
        };
        let names = self.series(&self.first).into_iter().map(|(name, _)| name);
        let series = names.enumerate().map(|(k, name)| {
            let [low, high] = [0, 1].map(|end| all(&|sample| finite(sample.extremes[k][end])));
            // With one cycle per column, both are equal.
            let ends = if low == high {
                json!([high])
            } else {
                json!([low, high])
            };
            (name, ends)
        });
        let list = |values: &[f64]| json!(values.iter().copied().map(finite).collect::<Vec<_>>());
        json!({
            "width_s": self.samples.width_ns() as f64 * 1e-9,
            "t_s": all(&|sample| json!((1e4 * sample.time_s).round() * 1e-4)),
            "mode": all(&|sample| json!(sample.mode)),
            "misses": all(&|sample| json!(sample.misses)),
            "bend_rad": all(&|sample| list(&sample.bend_rad[..coordinates])),
            "tip_mm": all(&|sample| list(&sample.tip_m.map(|m| 1e3 * m))),
            "reference_mm": all(&|sample| list(&sample.reference_m.map(|m| 1e3 * m))),
            "series": series.collect::<Map<_, _>>(),
        })
    }

    /// The obstacles after each change: id, radius, one end, and for a capsule the other end \[mm\].
    fn scenes(&self) -> Value {
        let mut shown = Vec::<Value>::new();
        for scene in self.scenes.iter() {
            let solid = |obstacle: &Obstacle| {
                let mut row = vec![json!(obstacle.id), finite(1e3 * obstacle.radius_m)];
                row.extend(obstacle.start_m.map(|m| finite(1e3 * m)));
                if obstacle.shape == ObstacleShape::Capsule.code() {
                    row.extend(obstacle.end_m.map(|m| finite(1e3 * m)));
                }
                json!(row)
            };
            let solids: Value = scene.obstacles.iter().map(solid).collect();
            if shown.last().is_none_or(|before| before["solids"] != solids) {
                shown.push(json!({"t_s": scene.time_s, "solids": solids}));
            }
        }
        json!(shown)
    }
}

/// Wake-up latency, solve time, response time.
fn latencies_ns(record: &Telemetry) -> [u64; 3] {
    [
        record.start_ns.saturating_sub(record.due_ns),
        record.solve_end_ns.saturating_sub(record.solve_start_ns),
        record.handed_over_ns.saturating_sub(record.due_ns),
    ]
}

/// Rounds to five digits, enough for a plot. Null for a value that is not finite.
fn finite(value: f64) -> Value {
    let short = format!("{value:.4e}").parse::<f64>();
    short.map_or(Value::Null, |short| json!(short))
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::limits::{OBSTACLES_MAX, SECTIONS_MAX};

    use super::*;
    use crate::dry_run::tests::robot;

    /// A cycle of the largest robot with the maximum number of obstacles, all moving.
    fn record(cycle: u64) -> Telemetry {
        let mut record = Telemetry {
            cycle,
            release_ns: 5_000_000 * cycle,
            period_ns: 5_000_000,
            mode: Mode::Tracking.code(),
            obstacle_count: OBSTACLES_MAX as u32,
            robot: robot(SECTIONS_MAX as u32),
            ..Telemetry::default()
        };
        let noise = |k: usize| (cycle as f64 * 12.9898 + k as f64 * 78.233).sin();
        record.present_rad = core::array::from_fn(noise);
        record.commanded_rad = core::array::from_fn(noise);
        record.command.bend_rate_rad_s = core::array::from_fn(noise);
        record.tip_position_m = core::array::from_fn(noise);
        record.reference.position_m = core::array::from_fn(noise);
        record.position_error_m = noise(20).abs();
        record.clearance_m = noise(21);
        for (k, obstacle) in record.obstacles.iter_mut().enumerate() {
            obstacle.start_m = [noise(k), noise(k + 1), noise(k + 2)];
        }
        record
    }

    #[test]
    fn a_page_of_five_minutes_of_the_largest_robot_is_below_5_mb() {
        let mut content = Content::default();
        for cycle in 0..60_000 {
            let message = RecordedMessage::Telemetry(Box::new(record(cycle)));
            content.take(&message).expect("a robot");
        }
        let json = content.cycles.expect("cycles").json();
        let columns = json["curves"]["t_s"].as_array().map_or(0, Vec::len);
        assert!((COLUMNS / 2..=COLUMNS).contains(&columns), "{columns}");
        assert_eq!(json["cycles"], 60_000);
        let bytes = json.to_string().len();
        assert!(bytes < 4_900_000, "{bytes} bytes");
    }

    #[test]
    fn a_column_has_the_extremes_of_its_cycles() {
        let mut content = Content::default();
        for cycle in 0..3 * COLUMNS as u64 {
            let mut record = record(cycle);
            record.clearance_m = if cycle == 5000 { -0.01 } else { 0.02 };
            record.position_error_m = if cycle < 100 { f64::NAN } else { 1e-3 };
            let message = RecordedMessage::Telemetry(Box::new(record));
            content.take(&message).expect("a robot");
        }
        let json = content.cycles.expect("cycles").json();
        let [low, high] = [0, 1].map(|end| {
            let clearances = json["curves"]["series"]["clearance_mm"][end].as_array();
            clearances.expect("columns").clone()
        });
        assert_eq!(low.iter().filter(|mm| **mm == json!(-10.0)).count(), 1);
        assert!(high.iter().all(|mm| *mm == json!(20.0)));
        assert_eq!(json["least_clearance"], json!({"mm": -10.0, "t_s": 25.0}));
        // A missing value is null, not zero.
        assert_eq!(json["curves"]["series"]["error_mm"][0][0], Value::Null);
    }
}
