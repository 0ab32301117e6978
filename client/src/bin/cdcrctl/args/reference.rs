use std::path::PathBuf;
use std::time::Duration;

use cdcr_client::FigurePlane;
use cdcr_shared_types::codes::Interpolation;
use cdcr_shared_types::limits::SECTIONS_MAX;
use clap::{Args, Subcommand};

use crate::value::{self, Vector};

#[derive(Debug, Args)]
pub(crate) struct RefOptions {
    #[command(subcommand)]
    pub(crate) curve: Curve,
}

/// Which reference.
#[derive(Debug, Subcommand)]
pub(crate) enum Curve {
    /// The paper's spiral, Eq. 8
    #[command(after_help = "Example:\n  cdcrctl ref spiral --duration 10s --track")]
    Spiral(SpiralOptions),
    /// The paper's line, Eq. 9
    #[command(after_help = "Example:\n  cdcrctl ref line --axis 0,0,1 --track")]
    Line(LineOptions),
    /// The paper's circle, §4.3
    #[command(after_help = "Example:\n  cdcrctl ref circle --radius 0.1 --rate 2 --track")]
    Circle(CircleOptions),
    /// A helix around an axis, back and forth
    #[command(
        after_help = "Example:\n  cdcrctl ref helix --turns 2 --rise 0.05 --speed 0.2 --repeat 2 --track"
    )]
    Helix(HelixOptions),
    /// A Lissajous figure of two sine waves, by default a figure eight
    #[command(
        after_help = "Example:\n  cdcrctl ref lissajous --ratio 3:2 --plane xz --speed 0.1 --dry-run"
    )]
    Lissajous(LissajousOptions),
    /// A rose, r = cos(k φ)
    #[command(after_help = "Example:\n  cdcrctl ref rose --petals 3 --speed 0.1 --track")]
    Rose(RoseOptions),
    /// A regular polygon with sharp corners
    #[command(after_help = "Example:\n  cdcrctl ref polygon --corners 3 --radius 0.05 --track")]
    Polygon(PolygonOptions),
    /// A CSV file with the columns `t_s,x_m,y_m,z_m[,qx,qy,qz,qw]`
    ///
    /// With an orientation qx,qy,qz,qw, a unit quaternion, the tip also turns, weighted by the
    /// orientation weight of the daemon.
    #[command(
        after_help = "Examples:\n  cdcrctl ref file path.csv --interpolation linear --track\n  cdcrctl ref file path.csv --speed 0.5 --scale 0.8 --repeat 2 --dry-run"
    )]
    File(FileOptions),
    /// The same columns from the standard input, read to the end and checked before anything is sent
    #[command(after_help = "Example:\n  make_path.py | cdcrctl ref stdin --track")]
    Stdin(StdinOptions),
}

/// How any reference is fed.
#[derive(Debug, Args)]
pub(crate) struct FeedArguments {
    /// Request tracking as soon as the first chunk is sent
    #[arg(long, group = "computed_or_tracked")]
    pub(crate) track: bool,
    /// First move the tip to the first point along a straight line, from rest to rest, as cdcrctl goto; with --dry-run, compute that
    /// way, too
    #[arg(long, requires = "computed_or_tracked")]
    pub(crate) blend: bool,
    /// Move nothing: report the smallest tip error that the robot can achieve, the rate, acceleration, cable stroke and
    /// clearance that it needs, and the direct path to the first point; fail when a point is missed by more than --max-error (1 mm if not given)
    #[arg(long, group = "computed_or_tracked")]
    pub(crate) dry_run: bool,
    /// Interpolation between the points in the daemon: straight lines or a smooth cubic curve
    #[arg(long, value_parser = value::interpolation(), default_value = Interpolation::Cubic.text())]
    pub(crate) interpolation: Interpolation,
    /// Largest allowed tip error, such as 2mm or 0.002m, after the tip has arrived: estimated and, with a tip sensor, measured with its
    /// noise. Default: 20 mm at the end and 50 mm (estimated) on the way. The limit on the way is not checked while an obstacle is near the
    /// body, until the tip has returned to the reference. With this option, the command also fails if nothing was tracked. It fails before
    /// the motion if the robot cannot reach a point within this error (default for this check: 1 mm), or if with --track the reference is
    /// too fast for the robot
    #[arg(long, value_name = "LENGTH", value_parser = value::length_m)]
    pub(crate) max_error: Option<f64>,
    /// Delay from this command to the first point
    #[arg(long, value_name = "TIME", default_value = "300ms", value_parser = value::duration)]
    pub(crate) lead: Duration,
    /// Time between two points of a curve
    #[arg(long, value_name = "TIME", default_value = "5ms", value_parser = value::duration)]
    pub(crate) step: Duration,
}

/// Which robot a curve of the paper is made for, and how it is sent.
#[derive(Debug, Args)]
pub(crate) struct CurveArguments {
    /// Number of sections of the robot that the curve is for [default: the daemon's robot]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=SECTIONS_MAX as i64), allow_negative_numbers = true)]
    pub(crate) sections: Option<u32>,
    /// Duration of the curve [default: as in the paper]
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::CURVE_S))]
    pub(crate) duration: Option<Duration>,
    #[command(flatten)]
    pub(crate) change: ChangeArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

/// How a curve or a file is changed before it is sent. Its first point stays where it is.
#[derive(Debug, Args)]
pub(crate) struct ChangeArguments {
    /// Speed factor
    #[arg(long, value_name = "TIMES", value_parser = value::positive, default_value = "1", allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// Number of passes; an open curve is followed to its end, back to its start, and so on
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), default_value_t = 1, allow_negative_numbers = true)]
    pub(crate) repeat: u32,
    /// Scale factor, about the first point
    #[arg(long, value_name = "TIMES", value_parser = value::positive, default_value = "1", allow_negative_numbers = true)]
    pub(crate) scale: f64,
    /// Axes of the base frame for its x and y, from its first point
    #[arg(long, value_parser = value::plane(), default_value = "xy")]
    pub(crate) plane: FigurePlane,
}

#[derive(Debug, Args)]
pub(crate) struct SpiralOptions {
    /// First value of the parameter t, in degrees [default: 5]
    #[arg(long, value_name = "DEG", value_parser = value::not_negative, allow_negative_numbers = true)]
    pub(crate) start: Option<f64>,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
}

#[derive(Debug, Args)]
pub(crate) struct LineOptions {
    /// First point, in m [default: tip of the straight robot]
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) start: Option<Vector>,
    /// Velocity, in m/s
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0.03,0,-0.01", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// Direction of the tip axis, for example 0,0,1 as in the paper [default: any]. Weighted by the
    /// orientation weight of the daemon
    #[arg(long, value_name = "X,Y,Z", value_parser = value::direction, allow_hyphen_values = true)]
    pub(crate) axis: Option<Vector>,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
}

#[derive(Debug, Args)]
pub(crate) struct CircleOptions {
    /// Radius in m [default: 0.16986 for a last section of 0.3 m]
    #[arg(long, value_name = "M", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) radius: Option<f64>,
    /// Height in m [default: 0.22137 above a last section of 0.3 m]
    #[arg(long, value_name = "M", value_parser = value::number, allow_hyphen_values = true)]
    pub(crate) height: Option<f64>,
    /// Angular rate, in rad/s; negative: clockwise
    #[arg(long, value_name = "RAD/S", value_parser = value::number, default_value = "1", allow_hyphen_values = true)]
    pub(crate) rate: f64,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
}

/// Where a figure is, how large, and how fast.
#[derive(Debug, Args)]
pub(crate) struct FigureArguments {
    /// Centre, in m [default: on the axis, at 85 % of the robot's length]
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) centre: Option<Vector>,
    /// Distance from the centre to the outermost points in m, along each axis for lissajous [default: 10 % of the robot's length]
    #[arg(long, value_name = "M", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) radius: Option<f64>,
    /// Plane of the figure, two axes of the base frame; a helix rises along the third
    #[arg(long, value_parser = value::plane(), default_value = "xy")]
    pub(crate) plane: FigurePlane,
    /// Constant speed of the tip, in m/s, at most 2
    #[arg(long, value_name = "M/S", value_parser = value::speed, default_value = "0.05", allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// Number of passes
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), default_value_t = 1, allow_negative_numbers = true)]
    pub(crate) repeat: u32,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

#[derive(Debug, Args)]
pub(crate) struct HelixOptions {
    /// Number of turns from end to end
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100), default_value_t = 3, allow_negative_numbers = true)]
    pub(crate) turns: u32,
    /// Rise from end to end, in m; negative: downwards [default: the radius]
    #[arg(long, value_name = "M", value_parser = value::number, allow_hyphen_values = true)]
    pub(crate) rise: Option<f64>,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

/// Options of Lissajous' figures.
#[derive(Debug, Args)]
pub(crate) struct LissajousOptions {
    /// Waves per round along the first and the second axis, 1 to 100
    #[arg(long, value_name = "A:B", value_parser = value::ratio, default_value = "1:2")]
    pub(crate) ratio: value::Ratio,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

#[derive(Debug, Args)]
pub(crate) struct RoseOptions {
    /// Parameter k: k petals if odd, 2 k if even
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=100), default_value_t = 5, allow_negative_numbers = true)]
    pub(crate) petals: u32,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

#[derive(Debug, Args)]
pub(crate) struct PolygonOptions {
    /// Number of corners
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=100), default_value_t = 4, allow_negative_numbers = true)]
    pub(crate) corners: u32,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

/// Options of the standard input.
#[derive(Debug, Args)]
pub(crate) struct StdinOptions {
    #[command(flatten)]
    pub(crate) change: ChangeArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

#[derive(Debug, Args)]
pub(crate) struct FileOptions {
    /// CSV file. Its rows are sent as they are, unless --speed, --scale, --plane or --repeat change them; time counts from the first row
    pub(crate) path: PathBuf,
    #[command(flatten)]
    pub(crate) change: ChangeArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}
