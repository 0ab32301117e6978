use std::path::PathBuf;
use std::time::Duration;

use cdcr_client::FigurePlane;
use cdcr_shared_types::codes::Interpolation;
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
    /// A screw line around an axis, there and back again
    #[command(
        after_help = "Example:\n  cdcrctl ref helix --turns 2 --rise 0.05 --speed 0.2 --repeat 2 --track"
    )]
    Helix(HelixOptions),
    /// Two sine waves across each other: a figure eight by default
    #[command(
        after_help = "Example:\n  cdcrctl ref lissajous --ratio 3:2 --plane xz --speed 0.1 --dry-run"
    )]
    Lissajous(LissajousOptions),
    /// A rose, r = cos(k φ), through its centre again and again
    #[command(after_help = "Example:\n  cdcrctl ref rose --petals 3 --speed 0.1 --track")]
    Rose(RoseOptions),
    /// A regular polygon, corners and all
    #[command(after_help = "Example:\n  cdcrctl ref polygon --corners 3 --radius 0.05 --track")]
    Polygon(PolygonOptions),
    /// A CSV file with the columns `t_s,x_m,y_m,z_m[,qx,qy,qz,qw]`
    ///
    /// With the orientation qx,qy,qz,qw, a unit quaternion, the tip turns, too, as much as the
    /// orientation weight of the daemon asks for.
    #[command(
        after_help = "Examples:\n  cdcrctl ref file path.csv --interpolation linear --track\n  cdcrctl ref file path.csv --speed 0.5 --scale 0.8 --repeat 2 --dry-run"
    )]
    File(FileOptions),
    /// The same from the standard input: it is read to its end and checked before anything is sent
    #[command(after_help = "Example:\n  make_path.py | cdcrctl ref stdin --track")]
    Stdin(StdinOptions),
}

/// How any reference is fed.
#[derive(Debug, Args)]
pub(crate) struct FeedArguments {
    /// Ask for tracking as soon as the first chunk is in
    #[arg(long)]
    pub(crate) track: bool,
    /// Go to the first point before, straight from where the tip is, from rest to rest, as cdcrctl goto does
    #[arg(long, requires = "track")]
    pub(crate) blend: bool,
    /// Move nothing: say how near the robot comes to the reference, and what rate, acceleration, cable stroke and
    /// clearance it takes, and the direct way to its first point; fail when a point is missed by more than --max-error, 1 mm without it
    #[arg(long, conflicts_with = "track")]
    pub(crate) dry_run: bool,
    /// How the daemon interpolates between the points: straight lines, or a smooth cubic curve
    #[arg(long, value_parser = value::interpolation(), default_value = Interpolation::Cubic.text())]
    pub(crate) interpolation: Interpolation,
    /// Largest error of the tip: fail when it is larger in any cycle after the approach, as estimated or by a sensor of the tip, noise
    /// included, or nothing was tracked; with its unit, 2mm or 0.002m. A point that no bend of the robot comes so near to, 1 mm without
    /// this option, is refused before anything moves
    #[arg(long, value_name = "LENGTH", value_parser = value::length_m)]
    pub(crate) max_error: Option<f64>,
    /// Time from now until the reference begins
    #[arg(long, value_name = "TIME", default_value = "300ms", value_parser = value::duration)]
    pub(crate) lead: Duration,
    /// Time between two points of a curve
    #[arg(long, value_name = "TIME", default_value = "5ms", value_parser = value::duration)]
    pub(crate) step: Duration,
}

/// Which robot a curve of the paper is made for, and how it is sent.
#[derive(Debug, Args)]
pub(crate) struct CurveArguments {
    /// Sections that the curve is made for [default: those of the daemon's robot]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=6), allow_negative_numbers = true)]
    pub(crate) sections: Option<u32>,
    /// How long it lasts [default: as in the paper]
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
    /// How many times as fast as it is
    #[arg(long, value_name = "TIMES", value_parser = value::positive, default_value = "1", allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// How often it is gone through: there and back, unless it ends where it begins
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), default_value_t = 1, allow_negative_numbers = true)]
    pub(crate) repeat: u32,
    /// How many times as large, about its first point
    #[arg(long, value_name = "TIMES", value_parser = value::positive, default_value = "1", allow_negative_numbers = true)]
    pub(crate) scale: f64,
    /// Two axes of the base frame that its x and y go along from its first point on
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
    /// Where it begins, in m [default: tip of the straight robot]
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) start: Option<Vector>,
    /// How fast it goes, in m/s
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0.03,0,-0.01", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// Direction that the tip axis keeps, for example 0,0,1 as in the paper [default: any]. The daemon turns the tip
    /// that way, too, as much as its orientation weight asks for
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
    /// How fast it goes round, in rad/s; negative: clockwise
    #[arg(long, value_name = "RAD/S", value_parser = value::number, default_value = "1", allow_hyphen_values = true)]
    pub(crate) rate: f64,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
}

/// Where a figure is, how large, and how fast.
#[derive(Debug, Args)]
pub(crate) struct FigureArguments {
    /// Its centre, in m [default: on the axis, at 85 % of the robot's length]
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) centre: Option<Vector>,
    /// From its centre to its outermost points in m, along each axis for lissajous [default: 10 % of the robot's length]
    #[arg(long, value_name = "M", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) radius: Option<f64>,
    /// Two axes of the base frame that it is drawn in; a helix rises along the third
    #[arg(long, value_parser = value::plane(), default_value = "xy")]
    pub(crate) plane: FigurePlane,
    /// How fast the tip goes, in m/s, the same everywhere
    #[arg(long, value_name = "M/S", value_parser = value::positive, default_value = "0.05", allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// How often it is gone through
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), default_value_t = 1, allow_negative_numbers = true)]
    pub(crate) repeat: u32,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

#[derive(Debug, Args)]
pub(crate) struct HelixOptions {
    /// Turns from end to end
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100), default_value_t = 3, allow_negative_numbers = true)]
    pub(crate) turns: u32,
    /// From end to end, in m; negative: the other way [default: the radius]
    #[arg(long, value_name = "M", value_parser = value::number, allow_hyphen_values = true)]
    pub(crate) rise: Option<f64>,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

/// Options of Lissajous' figures.
#[derive(Debug, Args)]
pub(crate) struct LissajousOptions {
    /// Waves along the first axis and along the second in a round, 1 to 100
    #[arg(long, value_name = "A:B", value_parser = value::ratio, default_value = "1:2")]
    pub(crate) ratio: value::Ratio,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

#[derive(Debug, Args)]
pub(crate) struct RoseOptions {
    /// k: so many petals where it is odd, twice as many where it is even
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=100), default_value_t = 5, allow_negative_numbers = true)]
    pub(crate) petals: u32,
    #[command(flatten)]
    pub(crate) figure: FigureArguments,
}

#[derive(Debug, Args)]
pub(crate) struct PolygonOptions {
    /// How many corners it has
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
    /// The CSV file; its rows are sent as they are, time counts from the first row
    pub(crate) path: PathBuf,
    #[command(flatten)]
    pub(crate) change: ChangeArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}
