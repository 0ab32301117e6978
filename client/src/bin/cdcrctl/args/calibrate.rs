use std::path::PathBuf;
use std::time::Duration;

use cdcr_controller::calibration::ParameterGroup;
use clap::builder::PossibleValue;
use clap::{Args, Subcommand, ValueEnum, ValueHint};

use super::Format;
use crate::value;

#[derive(Debug, Args)]
pub(crate) struct CalibrateOptions {
    #[command(subcommand)]
    pub(crate) action: CalibrateAction,
}

/// What to calibrate, or to record for it.
#[derive(Debug, Subcommand)]
pub(crate) enum CalibrateAction {
    /// Move the robot on a path that identifies all parameters, record it, and return to the start
    #[command(
        after_help = "Examples:\n  cdcrctl calibrate excite -o moved.csv --dry-run\n  \
        cdcrctl calibrate excite -o moved.csv --bend-max 1.0\n\n\
        The tip moves in all directions, as far as --bend-max allows within --duration: large bends give the best estimate. The path keeps clear of known \
        obstacles; where they are in the way, it is made smaller or rejected. The robot must be at rest (cdcrctl home --wait), with cable lengths and tip measured. On an \
        error or Ctrl-C the robot holds, and the rows written so far are kept."
    )]
    Excite(ExciteOptions),
    /// Record measured cables and tips while something else moves the robot
    #[command(after_help = "Example:\n  cdcrctl calibrate record -o moved.csv\n\n\
        Does not move the robot: meanwhile feed references that bend every section in every direction. Needs measured cable lengths and \
        a measured tip. Writes a row for each tip measurement, with the cables at that time. Ctrl-C ends it early.")]
    Record(RecordOptions),
    /// Estimate lengths, cables, base and tip sensor from a recording, and print them as a configuration
    #[command(after_help = "Examples:\n  cdcrctl calibrate geometry moved.csv\n  \
        cdcrctl calibrate geometry moved.csv --config robot.toml --hold base\n  \
        cdcrctl calibrate geometry moved.mcap       use a file of cdcrctl record\n\n\
        A recording (MCAP) includes its robot. Columns of a CSV, in any order: t_s, cable_1_m … three per section, base first, x_m, y_m, z_m of the tip, \
        optionally its unit quaternion qx, qy, qz, qw, base to tip. Parameters that the data do not identify keep their configured values and are listed. A fifth of \
        the rows is held out for validation.")]
    Geometry(GeometryOptions),
    /// Measure the noise of cables and tip while the robot is at rest
    #[command(
        after_help = "Example:\n  cdcrctl hold --wait && cdcrctl calibrate noise\n\n\
        Rejected while the robot moves. Prints standard deviation, quantisation step, rate and age of each measurement, and the \
        configuration keys that depend on them."
    )]
    Noise(NoiseOptions),
}

/// Options of `calibrate record`.
#[derive(Debug, Args)]
pub(crate) struct RecordOptions {
    /// Output file; it must not exist
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) output: PathBuf,
    /// Duration of the recording
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = value::duration_in(value::CURVE_S))]
    pub(crate) duration: Duration,
}

/// Options of `calibrate excite`.
#[derive(Debug, Args)]
pub(crate) struct ExciteOptions {
    #[command(flatten)]
    pub(crate) record: RecordOptions,
    /// Largest bend of each section, in rad [default: 90 % of the robot's limit]
    #[arg(long, value_name = "RAD", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) bend_max: Option<f64>,
    /// Bend rate limit of the path, in rad/s; if given, the path is made this fast where the robot can follow it [default: one round
    /// in 15 s, at most 50 % of the robot's limit]
    #[arg(long, value_name = "RAD/S", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate_max: Option<f64>,
    /// Seed of the path
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        allow_negative_numbers = true
    )]
    pub(crate) seed: u64,
    /// Move and write nothing: report whether the path is reachable, its length, and the rates and strokes it needs
    #[arg(long)]
    pub(crate) dry_run: bool,
}

/// Options of `calibrate geometry`.
#[derive(Debug, Args)]
pub(crate) struct GeometryOptions {
    /// CSV file, or a recording (MCAP)
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) file: PathBuf,
    /// Configuration of the recorded robot [default: the recording's own robot; for a CSV, the daemon's]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) config: Option<PathBuf>,
    /// Parameters to keep as configured
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    pub(crate) hold: Vec<Hold>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

/// Options of `calibrate noise`.
#[derive(Debug, Args)]
pub(crate) struct NoiseOptions {
    /// Duration of the measurement
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(0.5..=600.0))]
    pub(crate) duration: Duration,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

/// A group of parameters by its word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Hold(pub(crate) ParameterGroup);

impl ValueEnum for Hold {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [Hold; 6] = {
            let [a, b, c, d, e, f] = ParameterGroup::ALL;
            [Hold(a), Hold(b), Hold(c), Hold(d), Hold(e), Hold(f)]
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (word, help) = match self.0 {
            ParameterGroup::Base => ("base", "Pose of the base"),
            ParameterGroup::Sensor => ("sensor", "Pose of the sensor on the tip"),
            ParameterGroup::Zeros => ("zeros", "Zeros of the cables"),
            ParameterGroup::Angles => ("angles", "Angles of the cables"),
            ParameterGroup::Radii => ("radii", "Distances of the cables from the backbone"),
            ParameterGroup::Lengths => ("lengths", "Lengths of the sections"),
        };
        Some(PossibleValue::new(word).help(help))
    }
}
