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
    /// Move the robot so that a calibration can tell all, and record it, from rest to rest where it began
    #[command(
        after_help = "Examples:\n  cdcrctl calibrate excite -o moved.csv --dry-run\n  \
        cdcrctl calibrate excite -o moved.csv --bend-max 1.0\n\n\
        The tip goes to all sides, near and far, as far and as fast as the bounds allow: large bends tell most. Known obstacles are kept \
        clear of; where they are in the way, the path is smaller, or refused. The robot has to rest (cdcrctl home --wait), with cable lengths and tip measured. Where anything goes \
        wrong, Ctrl-C included, it holds, and the rows until then are kept."
    )]
    Excite(ExciteOptions),
    /// Record measured cables and tips while something else moves the robot
    #[command(after_help = "Example:\n  cdcrctl calibrate record -o moved.csv\n\n\
        It moves nothing itself: feed references meanwhile that bend every section in every direction. Refused where cable lengths and \
        tip are not both measured. A row is written for each measured tip, with the cables at that time. Ctrl-C ends it, too.")]
    Record(RecordOptions),
    /// Estimate lengths, cables, base and sensor from a recording, and print them as a configuration
    #[command(after_help = "Examples:\n  cdcrctl calibrate geometry moved.csv\n  \
        cdcrctl calibrate geometry moved.csv --config robot.toml --hold base\n  \
        cdcrctl calibrate geometry moved.mcap       what cdcrctl record made meanwhile\n\n\
        A recording (MCAP) says which robot it is of. Columns of a CSV, in any order: t_s, cable_1_m … three for each section, base first, x_m, y_m, z_m of the tip, and \
        perhaps its unit quaternion qx, qy, qz, qw, base to tip. What these data cannot tell is held as configured, and named. A fifth of \
        the rows is held out and only checked.")]
    Geometry(GeometryOptions),
    /// Measure the noise of cables and tip while the robot rests
    #[command(
        after_help = "Example:\n  cdcrctl hold --wait && cdcrctl calibrate noise\n\n\
        Refused while the robot moves. Prints standard deviation, quantisation step, rate and age of what is measured, and the keys of the \
        configuration that depend on them."
    )]
    Noise(NoiseOptions),
}

/// Options of `calibrate record`.
#[derive(Debug, Args)]
pub(crate) struct RecordOptions {
    /// File to write; it must not exist
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) output: PathBuf,
    /// How long to record
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = value::duration_in(value::CURVE_S))]
    pub(crate) duration: Duration,
}

/// Options of `calibrate excite`.
#[derive(Debug, Args)]
pub(crate) struct ExciteOptions {
    #[command(flatten)]
    pub(crate) record: RecordOptions,
    /// Largest bend of each section, in rad [default: nine tenths of what the robot may]
    #[arg(long, value_name = "RAD", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) bend_max: Option<f64>,
    /// Largest rate of each bend, in rad/s [default: half of what the robot may]
    #[arg(long, value_name = "RAD/S", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate_max: Option<f64>,
    /// Another path for each
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        allow_negative_numbers = true
    )]
    pub(crate) seed: u64,
    /// Move and write nothing: say whether all of the path can be reached, how long it is, and what it asks of the robot
    #[arg(long)]
    pub(crate) dry_run: bool,
}

/// Options of `calibrate geometry`.
#[derive(Debug, Args)]
pub(crate) struct GeometryOptions {
    /// Rows as CSV, or a recording (MCAP)
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) file: PathBuf,
    /// Configuration of the robot that was recorded [default: of a recording its own robot, of a CSV the daemon's]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) config: Option<PathBuf>,
    /// What is right as it is configured, and not estimated
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    pub(crate) hold: Vec<Hold>,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

/// Options of `calibrate noise`.
#[derive(Debug, Args)]
pub(crate) struct NoiseOptions {
    /// How long to measure
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(0.5..=600.0))]
    pub(crate) duration: Duration,
    /// How to print
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
