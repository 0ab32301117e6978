mod calibrate;
pub(crate) mod complete;
mod obstacle;
mod plant;
mod recording;
mod reference;
mod settings;
mod straight;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use cdcr_client::Connection;
use cdcr_shared_types::{DEFAULT_PREFIX, Location};
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::ArgValueCandidates;

use crate::value;
pub(crate) use calibrate::{
    CalibrateAction, CalibrateOptions, ExciteOptions, GeometryOptions, NoiseOptions, RecordOptions,
};
pub(crate) use obstacle::{ObstacleAction, ObstacleAdd, ObstacleOptions};
pub(crate) use plant::PlantOptions;
pub(crate) use recording::{
    ConvertOptions, InfoOptions, RecordingOptions, ReplayOptions, ReportOptions, ScopeOptions,
};
pub(crate) use reference::{
    ChangeArguments, CircleOptions, Curve, CurveArguments, FeedArguments, FigureArguments,
    LineOptions, RefOptions, SpiralOptions,
};
pub(crate) use settings::{SettingsAction, SettingsOptions};
pub(crate) use straight::{GENTLE, GotoOptions, JogOptions, StraightArguments};

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
        Exit codes: 0 good, 1 error, 2 wrong usage, 3 disk full (record), 130 interrupted."
)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pub(crate) target: Target,
    #[command(subcommand)]
    pub(crate) task: Task,
}

/// Which daemon is meant.
#[derive(Debug, Clone, Args)]
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
        add = ArgValueCandidates::new(complete::robots),
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
        misses_explained_by_steal             those in which the hypervisor had the core for half of the delay\n  \
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
    /// Move the tip to a point, along a straight way from rest to rest, and hold there
    #[command(
        after_help = "Examples:\n  cdcrctl goto 0.1,0.05,0.8\n  cdcrctl goto 0.1,0.05,0.8 --dry-run     whether it can be reached, and what it takes"
    )]
    Goto(GotoOptions),
    /// Move the tip by so much from where it is, along a straight way, and hold there
    #[command(after_help = "Example:\n  cdcrctl jog 0,0,-0.01 --speed 0.01")]
    Jog(JogOptions),
    /// Play a simulated robot behind a driver, for a daemon with link.kind = "driver"
    #[command(
        after_help = "Example:\n  cdcrd run --set link.kind=driver --set realtime.mode=prefer\n  cdcrctl plant --preset sloppy --tip 100"
    )]
    Plant(PlantOptions),
    /// Follow the reference that a client feeds; waits at most 2 s for one
    #[command(after_help = "Example:\n  cdcrctl ref spiral & cdcrctl track")]
    Track,
    /// Stop following and keep the position
    #[command(
        after_help = "Examples:\n  cdcrctl hold\n  cdcrctl hold --wait=5s      until it rests"
    )]
    Hold(WaitOptions),
    /// Move to the straight configuration
    #[command(
        after_help = "Examples:\n  cdcrctl home\n  cdcrctl home --wait        until the robot is there and rests"
    )]
    Home(WaitOptions),
    /// Stop the robot and latch; only a reset lets it move again
    #[command(after_help = "Example:\n  cdcrctl stop && cdcrctl reset")]
    Stop,
    /// Leave the modes stopped and faulted
    #[command(after_help = "Example:\n  cdcrctl reset --wait")]
    Reset(WaitOptions),
    /// Show the newest snapshot: mode, counters, latencies, robot, settings
    #[command(
        after_help = "Examples:\n  cdcrctl status\n  cdcrctl status --watch                once a second\n  \
        cdcrctl status --format json          everything, with all percentiles\n  \
        cdcrctl status --reset-statistics     reset the statistics, for all clients"
    )]
    Status(StatusOptions),
    /// Watch the robot, its loop and what happens to both, live in this terminal
    #[command(
        after_help = "Examples:\n  cdcrctl top\n  cdcrctl top --ascii     for a terminal without Unicode\n\n\
        Keys: s or space stops the robot, h holds, t tracks the reference that a client feeds; each answer is in the list of \
        what happened. p stops the picture and lets it go on, + and - zoom to the tip, q quits; the robot goes on.\n\n\
        The picture shows the robot from the side, the front and above, all at one scale: its backbone and tip, where \
        both tip and reference have been, and obstacles, red within the safe distance. Bars and percentiles are of the last 10 s; a bar is \
        the largest value of its time."
    )]
    Top(TopOptions),
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
        after_help = "Example:\n  cdcrctl echo telemetry --rate 10\n  cdcrctl echo command --count 1 --format json\n  \
        cdcrctl echo --field cycle --field tip_position_m.2 --count 3"
    )]
    Echo(EchoOptions),
    /// Show how often messages come, and what is between them, each second
    ///
    /// Records of the telemetry are sent a few at once, within 20 ms: `hz command` shows how even the loop is.
    #[command(after_help = "Example:\n  cdcrctl hz --count 3\n  cdcrctl hz command --count 1")]
    Hz(HzOptions),
    /// Send messages to a plotter, as JSON in UDP datagrams of less than 2 kB
    ///
    /// Each has the time in seconds as "timestamp". What is NaN or infinite is left out.
    #[command(
        after_help = "Examples:\n  cdcrctl plot --udp localhost:9870      PlotJuggler: UDP Server, JSON, timestamp\n  \
        cdcrctl plot --udp localhost:9870 --field position_error_m --field report.cost"
    )]
    Plot(PlotOptions),
    /// Record what passes into an MCAP file: all that its cycles can be computed again from
    #[command(
        after_help = "Examples:\n  cdcrctl record                    into ROBOT-DATE-TIME.mcap, until interrupted or the daemon ends\n  \
        cdcrctl record -o spiral.mcap & cdcrctl ref spiral --track\n  \
        cdcrctl record --around incident     5 s before the next bad cycle, and 5 s after\n\n\
        Begin it before the reference is fed: what was sent before is not in the file, and cycles that follow it\n\
        cannot be computed again. A full disk ends the recording with exit code 3; the file keeps what is whole."
    )]
    Record(RecordingOptions),
    /// Wait until something happens, record what is around it, and draw it
    #[command(
        after_help = "Examples:\n  cdcrctl scope --trigger 'error>5mm'\n  cdcrctl scope --trigger fault --before 10s -o fault.mcap\n\n\
        Draws error, clearance, response, the fastest bend and the mode over the time, on a terminal while it waits and records, with the level of\n\
        the trigger and a line at the cycle that fired: the first in which it holds after one in which it does not. q ends it.\n\
        In the end the same charts are printed. What was before is in the file, too."
    )]
    Scope(ScopeOptions),
    /// Show what a recording holds: messages, gaps, modes, misses, the largest error
    #[command(
        after_help = "Examples:\n  cdcrctl info spiral.mcap\n  cdcrctl info spiral.mcap --repair     save what a recorder that was killed left"
    )]
    Info(InfoOptions),
    /// Feed references and obstacles of a recording to the daemon again; or compute its cycles again and compare them with what was
    ///
    /// The tip goes to the first reference on a smooth way, from wherever it is. References, obstacles and their motion keep their times, or
    /// have --speed. In the end the daemon holds, and obstacles that were sent are removed.
    #[command(
        after_help = "Examples:\n  cdcrctl replay spiral.mcap --speed 0.5     with a daemon of the same robot\n  cdcrctl replay --verify spiral.mcap\n\n\
        --verify and --with need no daemon. The first cycle that comes out otherwise is saved with its inputs as NAME-cycle-N.mcap, which the same\n\
        command reads, and makes the exit code 1. Cycles that follow a reference from before the recording are counted apart."
    )]
    Replay(ReplayOptions),
    /// Make a page of a recording: the robot in 3-D, its path, error, clearance, controls, cables, latencies, events
    ///
    /// One HTML file that any browser opens, without a network. It stays below 5 MB however long the recording is: curves then
    /// show the least and the largest value of each stretch of time.
    #[command(after_help = "Example:\n  cdcrctl report spiral.mcap -o spiral.html")]
    Report(ReportOptions),
    /// Write the messages of a recording as tables
    #[command(
        after_help = "Example:\n  cdcrctl convert spiral.mcap --csv spiral\n\n\
        One row for each cycle, event, reference point, obstacle, snapshot and incident; a column has the name of its field, as\n\
        command.mode or bend_rad[2]. Plans are left out."
    )]
    Convert(ConvertOptions),
    /// Add or remove obstacles that the body of the robot keeps away from
    #[command(
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl status                   how many are known, and the smallest clearance\n  \
        cdcrctl obstacle remove 1"
    )]
    Obstacle(ObstacleOptions),
    /// Find lengths, cables, base and sensor of the robot, and the noise of its sensors
    #[command(
        after_help = "Example:\n  cdcrctl home --wait\n  cdcrctl calibrate noise\n  \
        cdcrctl calibrate excite -o moved.csv\n  cdcrctl calibrate geometry moved.csv"
    )]
    Calibrate(CalibrateOptions),
}

/// How to print.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// For people
    Text,
    /// For programs
    Json,
}

/// Options of what takes the robot some time.
#[derive(Debug, Args)]
pub(crate) struct WaitOptions {
    /// Wait until it is done and the robot is measured to rest, 60s at most or TIME; fail when it takes longer, or something
    /// else comes between. At rest: over 0.2 s no bend moves by more than 0.02 rad/s on average
    #[arg(long, value_name = "TIME", num_args = 0..=1, require_equals = true, default_missing_value = "60s",
        value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) wait: Option<Duration>,
}

#[derive(Debug, Args)]
pub(crate) struct DemoOptions {
    /// Sections of the robot: 1, 2 or 3, as in the paper
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=3), allow_negative_numbers = true)]
    pub(crate) sections: u32,
    /// How long the spiral lasts, 0.1 s to 20 s; the paper's lasts 4.97 s
    #[arg(long, value_name = "TIME", default_value = "4.97s", value_parser = value::duration_in(0.1..=20.0))]
    pub(crate) duration: Duration,
    /// How to print the report
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Write telemetry.csv, path.svg, shape.svg, error.svg and timing.svg into this folder
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct StatusOptions {
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Update it every second, until interrupted
    #[arg(long)]
    pub(crate) watch: bool,
    /// Reset the statistics and show nothing; a stopped robot stays stopped (that is cdcrctl reset)
    #[arg(long, conflicts_with_all = ["watch", "format"])]
    pub(crate) reset_statistics: bool,
}

#[derive(Debug, Args)]
pub(crate) struct TopOptions {
    /// Pictures a second, 1 to 60
    #[arg(long, value_name = "HZ", default_value_t = 20, value_parser = clap::value_parser!(u8).range(1..=60), allow_negative_numbers = true)]
    pub(crate) rate: u8,
    /// Draw with letters, as where the locale has no Unicode
    #[arg(long)]
    pub(crate) ascii: bool,
}

#[derive(Debug, Args)]
pub(crate) struct IncidentsOptions {
    /// One line (text) or one JSON object for each
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Show only the N most recent
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
    /// Then show each new one, until interrupted
    #[arg(long)]
    pub(crate) follow: bool,
}

#[derive(Debug, Args)]
pub(crate) struct EchoOptions {
    /// Which messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: Topic,
    /// One line for each message (text), or one JSON object on each line
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Print this field alone, by its name in JSON: with points between, `mode`, `tip_position_m.2`, `command.bend_rate_rad_s`.
    /// May be given more than once
    #[arg(long, value_name = "PATH")]
    pub(crate) field: Vec<String>,
    /// End after this many messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
    /// Print at most this many messages a second and leave out the rest
    #[arg(long, value_name = "HZ", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct HzOptions {
    /// Which messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: Topic,
    /// End after this many lines
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
}

#[derive(Debug, Args)]
pub(crate) struct PlotOptions {
    /// Which messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: Topic,
    /// Where the plotter listens
    #[arg(long, value_name = "HOST:PORT")]
    pub(crate) udp: String,
    /// Send this field, as in cdcrctl echo; may be given more than once [default: those of the telemetry that are looked at most]
    #[arg(long, value_name = "PATH")]
    pub(crate) field: Vec<String>,
    /// Send at most this many messages a second and leave out the rest
    #[arg(long, value_name = "HZ", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate: Option<f64>,
    /// End after this many messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
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

#[cfg(test)]
mod tests {
    use super::complete::SHELLS;
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_manual_is_what_the_command_line_says() {
        cdcr_packaging::check(
            &Arguments::command(),
            "1",
            Some((complete::VARIABLE, &SHELLS)),
        )
        .expect("up to date");
    }

    #[test]
    fn a_number_that_may_not_be_negative_is_named_with_what_is_allowed() {
        for (line, parts) in [
            (
                "obstacle add --id 1 --at 0,0,1 --radius -1",
                ["--radius <M>", "-1 is below zero: use 0 or more"],
            ),
            (
                "ref circle --speed -1",
                ["--speed <TIMES>", "-1 is not above zero"],
            ),
            (
                "ref circle --repeat -1",
                ["--repeat <N>", "-1 is not in 1..=10000"],
            ),
            (
                "replay run.mcap --speed -1",
                ["--speed <TIMES>", "between 0.1 and 4"],
            ),
            ("echo --count -1", ["--count <N>", "invalid value '-1'"]),
        ] {
            let words = ["cdcrctl"].into_iter().chain(line.split(' '));
            let refused = Arguments::try_parse_from(words).unwrap_err().to_string();
            for part in parts {
                assert!(refused.contains(part), "{line}: {refused}");
            }
        }
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
