use std::path::PathBuf;
use std::time::Duration;

use cdcr_shared_types::limits::OBSTACLES_MAX;
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
    /// Add a sphere, or a capsule with --to; replace the obstacle with the same id
    #[command(
        visible_alias = "move",
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl obstacle add --id 2 --at 0.2,0,0 --to 0.2,0,0.5 --radius 0.01\n  \
        cdcrctl obstacle add --id 3 --at 0.5,0,0.6 --radius 0.05 --velocity -0.02,0,0 --lifetime 10s\n\n\
        Behind a driver, omit --lifetime and remove the obstacle afterwards. The body keeps controller.safe_distance_m away from it \
        in every mode: no command brings it nearer. A robot at rest does not evade an obstacle that moves towards it."
    )]
    Add(ObstacleAdd),
    /// Show the obstacles of the newest cycle at their positions in it
    #[command(after_help = "Example:\n  cdcrctl obstacle list --format json")]
    List(ObstacleList),
    /// Remove obstacles by id; fail when one of them was not known
    #[command(after_help = "Example:\n  cdcrctl obstacle remove 1 2")]
    Remove {
        /// Ids of the obstacles
        #[arg(required = true, value_name = "ID", num_args = 1..=OBSTACLES_MAX,
            add = ArgValueCandidates::new(complete::obstacle_ids))]
        ids: Vec<u32>,
    },
    /// Remove all obstacles, those of every client
    #[command(after_help = "Example:\n  cdcrctl obstacle clear")]
    Clear,
    /// Play a scene from a file: one JSON object per line and change, or an array as printed by obstacle list
    ///
    /// `{"time_s": 1.5, "id": 1, "start_m": [0.3, 0, 0.5], "radius_m": 0.02}` adds or moves an obstacle 1.5 s after the
    /// beginning; `end_m` makes it a capsule; `velocity_m_s` and `lifetime_ns` are as obstacle list prints them, and
    /// `{"time_s": 4, "remove": [1]}` removes obstacles. Without `time_s`: at the beginning. Times must not decrease. The whole
    /// file is checked before anything is sent, also that it has at most 64 obstacles at one time.
    #[command(after_help = "Example:\n  cdcrctl obstacle file configs/scene.json")]
    File(ObstacleFile),
    /// Read obstacles from the standard input, one JSON object per line, and send each at once
    ///
    /// Each line is as in a file. `measured_ns` is the time of the measurement in ns of `CLOCK_MONOTONIC` (`time.monotonic_ns()` in Python;
    /// default: arrival of the line). An update of a moving obstacle is refused if it is older than 1 s. `time_s` is ignored. Lines that wait
    /// while the daemon decides are sent together, up to 64 obstacles in one update, which it takes or refuses as a whole. An invalid or
    /// refused line ends the command with an error; obstacles sent before it stay.
    #[command(after_help = "Example:\n  camera.py | cdcrctl obstacle stdin\n  \
        echo '{\"id\": 1, \"start_m\": [0.3, 0, 0.5], \"radius_m\": 0.02}' | cdcrctl obstacle stdin")]
    Stdin(ObstacleStdin),
}

/// A scene.
#[derive(Debug, Args)]
pub(crate) struct ObstacleFile {
    /// Scene file
    pub(crate) path: PathBuf,
    /// Accept obstacles that are far away, faster than 2 m/s, or contain the base (values are in m and m/s)
    #[arg(long)]
    pub(crate) far: bool,
}

/// Obstacles from elsewhere.
#[derive(Debug, Args)]
pub(crate) struct ObstacleStdin {
    /// Accept obstacles that are far away or contain the base (values are in m)
    #[arg(long)]
    pub(crate) far: bool,
}

/// How to show the obstacles.
#[derive(Debug, Args)]
pub(crate) struct ObstacleList {
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

/// A new obstacle.
#[derive(Debug, Args)]
pub(crate) struct ObstacleAdd {
    /// Id, unique among all clients
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
    /// Velocity in m/s, from now on
    #[arg(long, value_name = "X,Y,Z", value_parser = value::vector, default_value = "0,0,0", allow_hyphen_values = true)]
    pub(crate) velocity: Vector,
    /// Remove it after this time [default: keep it until it is removed]. Refused where
    /// the daemon supervises the sources of obstacles: this command could not renew it
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::CURVE_S), allow_hyphen_values = true)]
    pub(crate) lifetime: Option<Duration>,
    /// Accept an obstacle that is far away, faster than 2 m/s, or contains the base (values are in m and m/s)
    #[arg(long)]
    pub(crate) far: bool,
}
