use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use clap_complete::ArgValueCandidates;

use super::{Format, complete};
use crate::value::{self, Vector};

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
        visible_alias = "move",
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl obstacle add --id 2 --at 0.2,0,0 --to 0.2,0,0.5 --radius 0.01 --lifetime 30s\n  \
        cdcrctl obstacle add --id 3 --at 0.5,0,0.6 --radius 0.05 --velocity -0.02,0,0 --lifetime 10s\n\n\
        The body keeps controller.safe_distance_m away from it in every mode: no command brings it \
        nearer. An obstacle that moves into the standing robot is not evaded."
    )]
    Add(ObstacleAdd),
    /// Show the obstacles that the newest cycle knew, where they were then
    #[command(after_help = "Example:\n  cdcrctl obstacle list --format json")]
    List(ObstacleList),
    /// Remove obstacles by their ids; one that is not known changes nothing
    #[command(after_help = "Example:\n  cdcrctl obstacle remove 1 2")]
    Remove {
        /// Their ids
        #[arg(required = true, value_name = "ID", num_args = 1..=64,
            add = ArgValueCandidates::new(complete::obstacle_ids))]
        ids: Vec<u32>,
    },
    /// Remove all obstacles
    #[command(after_help = "Example:\n  cdcrctl obstacle clear")]
    Clear,
    /// Play a scene from a file: a JSON object for each change, one on each line, or an array as obstacle list prints it
    ///
    /// `{"time_s": 1.5, "id": 1, "start_m": [0.3, 0, 0.5], "radius_m": 0.02}` adds or moves an obstacle 1.5 s after the
    /// beginning; `end_m` makes it a capsule; `velocity_m_s` and `lifetime_ns` are as obstacle list prints them, and
    /// `{"time_s": 4, "remove": [1]}` removes some. Without `time_s`: at the beginning. Times never fall. All of it is checked
    /// before anything is sent.
    #[command(after_help = "Example:\n  cdcrctl obstacle file configs/scene.json")]
    File(ObstacleFile),
    /// Take obstacles from the standard input, one JSON object on each line, as they come
    ///
    /// Each line is as in a file. `measured_ns` may say when it held, in ns of `CLOCK_MONOTONIC` (`time.monotonic_ns()` in Python);
    /// without it that is when the line came. `time_s` has no effect. A bad line ends it with an error; what came before stays known.
    #[command(after_help = "Example:\n  camera.py | cdcrctl obstacle stdin\n  \
        echo '{\"id\": 1, \"start_m\": [0.3, 0, 0.5], \"radius_m\": 0.02}' | cdcrctl obstacle stdin")]
    Stdin(ObstacleStdin),
}

/// A scene.
#[derive(Debug, Args)]
pub(crate) struct ObstacleFile {
    /// The file
    pub(crate) path: PathBuf,
    /// Accept obstacles that are far away or contain the base: the numbers are in m
    #[arg(long)]
    pub(crate) far: bool,
}

/// Obstacles from elsewhere.
#[derive(Debug, Args)]
pub(crate) struct ObstacleStdin {
    /// Accept obstacles that are far away or contain the base: the numbers are in m
    #[arg(long)]
    pub(crate) far: bool,
}

/// How to show the obstacles.
#[derive(Debug, Args)]
pub(crate) struct ObstacleList {
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
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
    #[arg(long, value_name = "M", value_parser = value::not_negative, allow_negative_numbers = true)]
    pub(crate) radius: f64,
    /// Velocity in m/s: the daemon moves it on from now
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0,0,0", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// How long it stays known [default: until removed]. Refused where the daemon
    /// supervises the sources of obstacles
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::CURVE_S))]
    pub(crate) lifetime: Option<Duration>,
    /// Accept an obstacle that is far away or contains the base: the numbers are in m
    #[arg(long)]
    pub(crate) far: bool,
}
