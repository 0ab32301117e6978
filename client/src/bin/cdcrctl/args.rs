use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use cdcr_client::Connection;
use cdcr_shared_types::{DEFAULT_PREFIX, Location};
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::settings::Change;
use crate::value::{self, Vector};

/// Feeds references to cdcrd, the controller of cable-driven continuum robots, asks it for things and
/// shows what it does.
#[derive(Debug, Parser)]
#[command(
    name = "cdcrctl",
    version,
    max_term_width = 100,
    after_help = "Examples:\n  \
        cdcrctl demo                     everything at once, with a daemon of its own\n  \
        cdcrctl ref spiral --track       feed the paper's spiral to a running daemon\n  \
        cdcrctl status\n\n\
        Exit codes: 0 good, 1 error, 2 wrong usage, 130 interrupted."
)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pub(crate) target: Target,
    #[command(subcommand)]
    pub(crate) task: Task,
}

/// Which daemon is meant.
#[derive(Debug, Args)]
pub(crate) struct Target {
    /// Prefix of the daemon's shared-memory files
    #[arg(long, global = true, env = "CDCR_PREFIX", default_value = DEFAULT_PREFIX, help_heading = "Which daemon")]
    prefix: String,
    /// Root path of the daemon's files [default: /dev/shm/cdcr-UID]
    #[arg(
        long,
        global = true,
        env = "CDCR_ROOT",
        value_name = "DIR",
        help_heading = "Which daemon"
    )]
    root: Option<PathBuf>,
    /// Name of the robot
    #[arg(
        long,
        global = true,
        env = "CDCR_ROBOT",
        default_value = "cdcr",
        help_heading = "Which daemon"
    )]
    robot: String,
}

impl Target {
    /// Connects to that daemon.
    pub(crate) fn connect(&self) -> anyhow::Result<Connection> {
        let (location, robot) = self.location()?;
        Ok(Connection::open(&location, robot)?)
    }

    /// Where it is, and the name of its robot.
    pub(crate) fn location(&self) -> anyhow::Result<(Location, &str)> {
        let root = self.root.clone().unwrap_or_else(Location::default_root);
        let location = Location::new(&self.prefix, &root).context("--prefix or --root")?;
        Ok((location, &self.robot))
    }
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(crate) enum Task {
    /// Run the paper's spiral with a daemon of its own and report error, timing and what limits it
    #[command(
        after_help = "Example:\n  cdcrctl demo --sections 3 --out demo-pictures\n\n\
        The demo starts its own cdcrd (found beside cdcrctl) on a private prefix, and removes all \
        traces; --prefix, --root and --robot have no effect on it. Before the spiral, cdcrd bare runs for \
        one second: the same loop without work shows what the machine alone does.\n\n\
        Fields of --format json, counted over the cycles that tracked:\n  \
        sections, duration_s, cycles, out\n  \
        mean_error_mm, max_error_mm           tip of the ideal simulated robot to the exact curve\n  \
        paper_mean_error_mm                   what the paper reports\n  \
        wake_us, solve_us, response_us        p50, p99 and max of each\n  \
        deadline_misses, late_starts          counts, each also per second (..._per_s)\n  \
        misses_by_cause                       deadline misses by what caused them\n  \
        skipped_periods                       releases that got no command\n  \
        lost_records                          telemetry records that did not arrive\n  \
        steal                                 steal_s of window_s that the hypervisor took from the core; or null\n  \
        realtime, realtime_missing            whether all was granted, and what was not\n  \
        baseline, baseline_error              cdcrd bare: duration_s, cycles, counts, causes, wake_us; or null\n                                        \
        and why there is none\n  \
        verdict.limited_by                    nothing, hypervisor, platform, other-task, no-real-time,\n                                        \
        page-faults, cdcr or unknown\n  \
        verdict.text, .next, .grant           one sentence, the command to run next, the command that\n                                        \
        grants real time; or null"
    )]
    Demo(DemoOptions),
    /// Feed a reference to the daemon, ahead of time
    #[command(after_help = "Example:\n  cdcrctl ref spiral --track")]
    Ref(RefOptions),
    /// Ask the daemon to follow the reference that a client feeds
    #[command(after_help = "Example:\n  cdcrctl ref spiral & cdcrctl track")]
    Track,
    /// Stop following and keep the position
    #[command(after_help = "Example:\n  cdcrctl hold")]
    Hold,
    /// Move to the straight configuration
    #[command(after_help = "Example:\n  cdcrctl home")]
    Home,
    /// Stop the robot and latch; only a reset lets it move again
    #[command(after_help = "Example:\n  cdcrctl stop && cdcrctl reset")]
    Stop,
    /// Leave stopped or faulted
    #[command(after_help = "Example:\n  cdcrctl reset")]
    Reset,
    /// Show the newest snapshot: mode, counters, latencies, robot, settings
    #[command(
        after_help = "Examples:\n  cdcrctl status\n  cdcrctl status --watch                once a second\n  \
        cdcrctl status --format json          everything, with all percentiles\n  \
        cdcrctl status --reset-statistics     begin the statistics anew, for all clients"
    )]
    Status(StatusOptions),
    /// Show the last bad cycles: late starts, deadline misses, skipped periods, beginnings of faults
    #[command(
        after_help = "Examples:\n  cdcrctl incidents\n  cdcrctl incidents --count 5 --format json     the newest 5, whole\n  \
        cdcrctl incidents --follow                    and each new one, until interrupted\n\n\
        The daemon keeps 64 of them. Cause is what made the cycle late; waited is how long its thread was \
        ready to run while another had the core; gap is the longest time between two looks at the clock \
        inside the solver; steal is what the hypervisor took from the machine about then."
    )]
    Incidents(IncidentsOptions),
    /// Show or change the settings of the solver while the daemon runs
    #[command(
        after_help = "Examples:\n  cdcrctl settings\n  cdcrctl settings set solver=gauss-newton horizon_steps=5\n  \
        cdcrctl settings show --format json"
    )]
    Settings(SettingsOptions),
    /// Print messages as they pass
    #[command(
        after_help = "Example:\n  cdcrctl echo telemetry --rate 10\n  cdcrctl echo command --count 1 --format json"
    )]
    Echo(EchoOptions),
    /// Add or remove obstacles that the body of the robot keeps away from
    #[command(
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl status                   how many are known, and the smallest clearance\n  \
        cdcrctl obstacle remove 1"
    )]
    Obstacle(ObstacleOptions),
}

/// How to print.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// For people
    Text,
    /// For programs
    Json,
}

/// Options of the demo.
#[derive(Debug, Args)]
pub(crate) struct DemoOptions {
    /// Sections of the robot: 1, 2 or 3, as in the paper
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=3))]
    pub(crate) sections: u32,
    /// How long the spiral lasts, 0.1 s to 20 s; the paper's lasts 4.97 s
    #[arg(long, value_name = "TIME", default_value = "4.97s", value_parser = value::demo_duration)]
    pub(crate) duration: Duration,
    /// How to print the report
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Write telemetry.csv, path.svg, shape.svg, error.svg and timing.svg into this folder
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Options of `ref`.
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
    /// A CSV file with the columns `t_s,x_m,y_m,z_m[,qx,qy,qz,qw]`
    ///
    /// With the orientation qx,qy,qz,qw, a unit quaternion, the tip turns, too, as much as the
    /// orientation weight of the daemon asks for.
    #[command(after_help = "Example:\n  cdcrctl ref file path.csv --interpolation linear --track")]
    File(FileOptions),
}

/// How any reference is fed.
#[derive(Debug, Args)]
pub(crate) struct FeedArguments {
    /// Ask for tracking as soon as the first chunk is in
    #[arg(long)]
    pub(crate) track: bool,
    /// How the daemon interpolates between the points
    #[arg(long, value_enum, default_value = "cubic")]
    pub(crate) interpolation: Between,
    /// How long after now the reference begins
    #[arg(long, value_name = "TIME", default_value = "300ms", value_parser = value::duration)]
    pub(crate) lead: Duration,
    /// Time between two points of a curve
    #[arg(long, value_name = "TIME", default_value = "5ms", value_parser = value::duration)]
    pub(crate) step: Duration,
}

/// Which robot a curve is made for.
#[derive(Debug, Args)]
pub(crate) struct CurveArguments {
    /// Sections that the curve is made for [default: those of the daemon's robot]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=6))]
    pub(crate) sections: Option<u32>,
    /// How long it lasts [default: as in the paper]
    #[arg(long, value_name = "TIME", value_parser = value::curve_duration)]
    pub(crate) duration: Option<Duration>,
}

/// Interpolation between points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Between {
    /// Straight lines
    Linear,
    /// A smooth cubic curve
    Cubic,
}

/// Options of the spiral.
#[derive(Debug, Args)]
pub(crate) struct SpiralOptions {
    /// First value of the parameter t, in degrees [default: 5]
    #[arg(long, value_name = "DEG", value_parser = value::not_negative)]
    pub(crate) start: Option<f64>,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

/// Options of the line.
#[derive(Debug, Args)]
pub(crate) struct LineOptions {
    /// Where it begins, in m [default: tip of the straight robot]
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) start: Option<Vector>,
    /// How fast it goes, in m/s
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0.03,0,-0.01", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// Direction that the tip axis keeps, for example 0,0,1 as in the paper [default: any]. It is sent,
    /// but this daemon follows the position only
    #[arg(long, value_name = "X,Y,Z", value_parser = value::direction, allow_hyphen_values = true)]
    pub(crate) axis: Option<Vector>,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

/// Options of the circle.
#[derive(Debug, Args)]
pub(crate) struct CircleOptions {
    /// Radius in m [default: 0.16986 for a last section of 0.3 m]
    #[arg(long, value_name = "M", value_parser = value::positive)]
    pub(crate) radius: Option<f64>,
    /// Height in m [default: 0.22137 above a last section of 0.3 m]
    #[arg(long, value_name = "M", value_parser = value::number, allow_hyphen_values = true)]
    pub(crate) height: Option<f64>,
    /// How fast it goes round, in rad/s; negative: clockwise
    #[arg(long, value_name = "RAD/S", value_parser = value::number, default_value = "1", allow_hyphen_values = true)]
    pub(crate) rate: f64,
    #[command(flatten)]
    pub(crate) curve: CurveArguments,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

/// Options of a file.
#[derive(Debug, Args)]
pub(crate) struct FileOptions {
    /// The CSV file; its rows are sent as they are, time counts from the first row
    pub(crate) path: PathBuf,
    #[command(flatten)]
    pub(crate) feed: FeedArguments,
}

/// Options of `status`.
#[derive(Debug, Args)]
pub(crate) struct StatusOptions {
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Show it anew every second, until interrupted
    #[arg(long)]
    pub(crate) watch: bool,
    /// Begin the statistics anew and show nothing; a stopped robot stays stopped (that is cdcrctl reset)
    #[arg(long, conflicts_with_all = ["watch", "format"])]
    pub(crate) reset_statistics: bool,
}

/// Options of `incidents`.
#[derive(Debug, Args)]
pub(crate) struct IncidentsOptions {
    /// One line for each (text), or each whole as one JSON object on a line
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Only so many of those that are kept, the newest
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..))]
    pub(crate) count: Option<u64>,
    /// Go on with each new one, until interrupted
    #[arg(long)]
    pub(crate) follow: bool,
}

/// Options of `settings`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct SettingsOptions {
    #[command(subcommand)]
    pub(crate) action: Option<SettingsAction>,
    #[command(flatten)]
    pub(crate) show: SettingsShow,
}

/// What to do with the settings.
#[derive(Debug, Subcommand)]
pub(crate) enum SettingsAction {
    /// Show them with their ranges, as the newest cycle used them
    #[command(after_help = "Example:\n  cdcrctl settings show --format json")]
    Show(SettingsShow),
    /// Change some of them, all at once or not at all, until the daemon ends
    #[command(
        after_help = "Examples:\n  cdcrctl settings set position_weight=2 rate_weight=1e-6\n  \
        cdcrctl settings set budget_ms=2      a solve may take 2 ms; 0: all the time that is left\n\n\
        The keys are those of the table [controller] of the configuration, where they stay as they are, and \
        budget_ms."
    )]
    Set {
        /// What to change
        #[arg(required = true, value_name = "KEY=VALUE", value_parser = Change::parse)]
        changes: Vec<Change>,
    },
}

/// How to show the settings.
#[derive(Debug, Args)]
pub(crate) struct SettingsShow {
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

/// Options of `echo`.
#[derive(Debug, Args)]
pub(crate) struct EchoOptions {
    /// Which messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: Topic,
    /// One line for each message (text), or one JSON object on each line
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// End after this many messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
    /// Print at most this many messages a second and leave out the rest
    #[arg(long, value_name = "HZ", value_parser = value::positive)]
    pub(crate) rate: Option<f64>,
}

/// Messages that can be printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Topic {
    /// One record of every cycle
    Telemetry,
    /// The commands to the driver
    Command,
    /// The snapshots, ten a second
    Status,
    /// The bad cycles: those that are kept, and each new one
    Incidents,
    /// What clients send as reference
    Reference,
    /// What clients send about obstacles
    Obstacles,
}

/// Options of `obstacle`.
#[derive(Debug, Args)]
pub(crate) struct ObstacleOptions {
    #[command(subcommand)]
    pub(crate) action: ObstacleAction,
}

/// What to do with obstacles.
#[derive(Debug, Subcommand)]
pub(crate) enum ObstacleAction {
    /// Add a sphere, or with --to a capsule; a known id is replaced
    #[command(
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl obstacle add --id 2 --at 0.2,0,0 --to 0.2,0,0.5 --radius 0.01 --lifetime 30s\n  \
        cdcrctl obstacle add --id 3 --at 0.5,0,0.6 --radius 0.05 --velocity -0.02,0,0 --lifetime 10s\n\n\
        The body keeps controller.safe_distance_m away from it in every mode: no command brings it \
        nearer. An obstacle that moves into the standing robot is not evaded."
    )]
    Add(ObstacleAdd),
    /// Remove obstacles by their ids; one that is not known changes nothing
    #[command(after_help = "Example:\n  cdcrctl obstacle remove 1 2")]
    Remove {
        /// Their ids
        #[arg(required = true, value_name = "ID", num_args = 1..=64)]
        ids: Vec<u32>,
    },
    /// Remove all obstacles
    #[command(after_help = "Example:\n  cdcrctl obstacle clear")]
    Clear,
}

/// A new obstacle.
#[derive(Debug, Args)]
pub(crate) struct ObstacleAdd {
    /// Its id, chosen by you, unique among all clients
    #[arg(long)]
    pub(crate) id: u32,
    /// Centre of the sphere, or first end of the capsule, in m
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) at: Vector,
    /// Second end of the capsule's axis, in m
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) to: Option<Vector>,
    /// Radius in m
    #[arg(long, value_name = "M", value_parser = value::not_negative)]
    pub(crate) radius: f64,
    /// Velocity in m/s: the daemon moves it on from now
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0,0,0", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// How long it stays known [default: until removed]
    #[arg(long, value_name = "TIME", value_parser = value::curve_duration)]
    pub(crate) lifetime: Option<Duration>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_manual_is_what_the_command_line_says() {
        cdcr_packaging::check(&Arguments::command(), "1").expect("up to date");
    }

    #[test]
    fn every_command_shows_an_example() {
        fn check(command: &clap::Command) {
            let help = command.get_after_help().map(ToString::to_string);
            let help = help.unwrap_or_default();
            assert!(help.contains("Example"), "{}", command.get_name());
            command.get_subcommands().for_each(check);
        }
        check(&Arguments::command());
    }

    #[test]
    fn negative_vectors_are_values_and_not_options() {
        let line = "cdcrctl ref line --start -0.1,0,0.8 --velocity -0.01,0,0";
        let parsed = Arguments::try_parse_from(line.split(' ')).expect("legal");
        let Task::Ref(RefOptions {
            curve: Curve::Line(line),
        }) = parsed.task
        else {
            panic!("a line");
        };
        assert_eq!(line.start, Some([-0.1, 0.0, 0.8]));
    }
}
