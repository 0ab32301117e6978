mod calibrate;
pub(crate) mod complete;
mod obstacle;
mod plant;
mod recording;
mod reference;
mod settings;
mod status;
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
pub(crate) use status::StatusOptions;
pub(crate) use straight::{GENTLE, GotoOptions, JogOptions, StraightArguments};

/// Command-line client of cdcrd, the controller of cable-driven continuum robots: feed references, send
/// requests, watch, record.
#[derive(Debug, Parser)]
#[command(
    name = "cdcrctl",
    version,
    max_term_width = 100,
    after_help = "Examples:\n  \
        cdcrctl demo                     run everything once, with a private daemon\n  \
        cdcrctl ref spiral --track       feed the paper's spiral to a running daemon\n  \
        cdcrctl status\n\n\
        Exit codes: 0 success, 1 error, 2 wrong usage, 3 disk full (record), 130 interrupted."
)]
pub(crate) struct Arguments {
    #[command(flatten)]
    pub(crate) target: Target,
    #[command(subcommand)]
    pub(crate) task: CtlCommand,
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
pub(crate) enum CtlCommand {
    /// Run the paper's spiral on a private daemon and report error, timing and what limits them
    #[command(
        after_help = "Example:\n  cdcrctl demo --sections 3 --out demo-pictures\n\n\
        The demo starts its own cdcrd (found beside cdcrctl) on a private prefix, and removes its \
        files at the end; it ignores --prefix, --root and --robot. Before the spiral, cdcrd bare runs for \
        one second: the loop without work is the baseline of the machine.\n\n\
        Fields of --format json, over the cycles in mode tracking:\n  \
        sections, duration_s, cycles, out\n  \
        mean_error_mm, max_error_mm           distance of the ideal simulated robot's tip from the curve\n  \
        paper_mean_error_mm                   mean error that the paper reports\n  \
        wake_us, solve_us, response_us        p50, p99 and max of each\n  \
        deadline_misses, late_starts          counts, each also per second (..._per_s)\n  \
        misses_by_cause                       deadline misses by cause\n  \
        misses_explained_by_steal             deadline misses with at least half of the delay stolen by the hypervisor\n  \
        skipped_periods                       releases without a command\n  \
        lost_records                          telemetry records lost\n  \
        steal                                 steal_s of window_s stolen from the core by the hypervisor; or null\n  \
        realtime, realtime_missing            whether all real-time privileges were granted, and the missing ones\n  \
        baseline, baseline_error              cdcrd bare: duration_s, cycles, counts, causes, wake_us; or null\n                                        \
        and the reason\n  \
        verdict.limited_by                    nothing, hypervisor, platform, other-task, no-real-time,\n                                        \
        page-faults, cdcr or unknown\n  \
        verdict.text, .next, .grant           a sentence, the command to run next, the command that\n                                        \
        grants real time; or null"
    )]
    Demo(DemoOptions),
    /// Feed a reference to the daemon, ahead of time
    #[command(after_help = "Example:\n  cdcrctl ref spiral --track")]
    Ref(RefOptions),
    /// Move the tip to a point along a straight line, from rest to rest, then hold
    #[command(
        after_help = "Examples:\n  cdcrctl goto 0.1,0.05,0.8\n  cdcrctl goto 0.1,0.05,0.8 --dry-run     check reachability and limits only"
    )]
    Goto(GotoOptions),
    /// Move the tip by an offset along a straight line, then hold
    #[command(after_help = "Example:\n  cdcrctl jog 0,0,-0.01 --speed 0.01")]
    Jog(JogOptions),
    /// Simulate a robot and its driver, for a daemon with link.kind = "driver"
    #[command(
        after_help = "Example:\n  cdcrd run --set link.kind=driver --set realtime.mode=prefer\n  cdcrctl plant --preset sloppy --tip 100"
    )]
    Plant(PlantOptions),
    /// Follow the reference that a client feeds; wait at most 2 s for it to begin
    #[command(after_help = "Example:\n  cdcrctl ref spiral & cdcrctl track")]
    Track,
    /// Stop tracking and hold the position
    #[command(
        after_help = "Examples:\n  cdcrctl hold\n  cdcrctl hold --wait=5s      wait until the robot is at rest"
    )]
    Hold(WaitOptions),
    /// Straighten the robot; this moves it
    ///
    /// An interrupt of --wait (Ctrl-C, SIGTERM, a closed terminal) holds the robot; after the time of --wait it continues.
    #[command(
        after_help = "Examples:\n  cdcrctl home\n  cdcrctl home --wait        wait until the robot is there and at rest"
    )]
    Home(WaitOptions),
    /// Stop the robot and latch: it moves again only after a reset
    #[command(
        after_help = "Example:\n  cdcrctl stop     then check the robot, then: cdcrctl reset"
    )]
    Stop,
    /// Leave mode stopped or faulted, and hold
    #[command(
        after_help = "A robot whose motors follow positions may move after the reset by up to its following error (cdcrctl status): keep clear.\n\n\
        Examples:\n  cdcrctl reset --wait\n  cdcrctl reset --accept-pose     after a motion by hand"
    )]
    Reset(ResetOptions),
    /// Show the newest status: mode, counters, latencies, robot, settings
    #[command(
        after_help = "Examples:\n  cdcrctl status\n  cdcrctl status --watch                update every second\n  \
        cdcrctl status --format json          print all fields and percentiles\n  \
        cdcrctl status --reset-statistics     reset the statistics for all clients"
    )]
    Status(StatusOptions),
    /// Show robot, control loop and events live in the terminal
    #[command(
        after_help = "Examples:\n  cdcrctl top\n  cdcrctl top --ascii     for a terminal without Unicode\n\n\
        Keys: s or space stops the robot, h holds, t tracks the reference that a client feeds; the daemon's answers appear in the \
        list of events. p pauses and resumes the display, + and - zoom at the tip, q quits without stopping the robot.\n\n\
        The picture shows the robot from the side, the front and above at one scale: backbone and tip, the \
        paths of tip and reference, and obstacles, red within the safe distance. Bars and percentiles cover the last 10 s; a bar is \
        the maximum of its interval."
    )]
    Top(TopOptions),
    /// Show recent incidents: late starts, deadline misses, skipped periods, first cycles of faults
    #[command(
        after_help = "Examples:\n  cdcrctl incidents\n  cdcrctl incidents --count 5 --format json     print all fields of the newest 5\n  \
        cdcrctl incidents --follow                    then print each new one, until interrupted\n\n\
        The daemon keeps 64 incidents. cause: what made the cycle late; waited: time in which the cycle thread was \
        ready to run but another thread had the core; gap: longest time between two clock reads \
        in the solver; steal: time stolen from the machine by the hypervisor around the cycle."
    )]
    Incidents(IncidentsOptions),
    /// Show, change or save the solver settings of the running daemon
    #[command(
        after_help = "Examples:\n  cdcrctl settings\n  cdcrctl settings set solver=gauss-newton horizon_steps=5\n  \
        cdcrctl settings show --format json"
    )]
    Settings(SettingsOptions),
    /// Print messages as they are published
    #[command(
        after_help = "Example:\n  cdcrctl echo telemetry --rate 10\n  cdcrctl echo command --count 1 --format json\n  \
        cdcrctl echo --field cycle --field tip_position_m.2 --count 3"
    )]
    Echo(EchoOptions),
    /// Show rate and intervals of messages every second
    ///
    /// Telemetry records are published in batches, within 20 ms: use `hz command` to see the jitter of the loop.
    #[command(after_help = "Example:\n  cdcrctl hz --count 3\n  cdcrctl hz command --count 1")]
    Hz(HzOptions),
    /// Send messages to a plotter, as JSON in UDP datagrams of less than 2 kB
    ///
    /// Each datagram has its time in seconds as "timestamp". Fields that are NaN or infinite are left out.
    #[command(
        after_help = "Examples:\n  cdcrctl plot --udp localhost:9870      PlotJuggler: UDP Server, JSON, timestamp\n  \
        cdcrctl plot --udp localhost:9870 --field position_error_m --field report.cost"
    )]
    Plot(PlotOptions),
    /// Record all messages into an MCAP file, complete enough to recompute every cycle
    #[command(
        after_help = "Examples:\n  cdcrctl record                    write ROBOT-DATE-TIME.mcap until interrupted or the daemon ends\n  \
        cdcrctl record -o spiral.mcap & cdcrctl ref spiral --track\n  \
        cdcrctl record --around incident     record from 5 s before to 5 s after the next incident\n\n\
        Start the recording before the reference is fed: cycles that follow an unrecorded reference \
        cannot be recomputed. A full disk ends the recording with exit code 3; the file stays readable up to there."
    )]
    Record(RecordingOptions),
    /// Wait for a trigger, record the time around it, and plot it
    #[command(
        after_help = "Examples:\n  cdcrctl scope --trigger 'error>5mm'\n  cdcrctl scope --trigger fault --before 10s -o fault.mcap\n\n\
        On a terminal, plots error, clearance, response time, fastest bend rate and mode over time while it waits and records, with the trigger \
        level and a line at the trigger cycle, which meets the condition while the cycle before did not. q quits. \
        At the end it prints the same charts. The file includes the time before the trigger."
    )]
    Scope(ScopeOptions),
    /// Summarise a recording: messages, gaps, modes, deadline misses, largest error
    #[command(
        after_help = "Examples:\n  cdcrctl info spiral.mcap\n  cdcrctl info spiral.mcap --repair     recover the recording of a killed recorder"
    )]
    Info(InfoOptions),
    /// Feed references and obstacles of a recording to the daemon, or recompute its cycles and compare them with the recording
    ///
    /// The tip first moves smoothly from its position to the first reference. References and obstacles keep their recorded times,
    /// scaled by --speed. At the end the daemon holds, and the replayed obstacles are removed. Obstacles of others are neither
    /// replaced nor removed: where an id is in use, nothing is sent.
    #[command(
        after_help = "Examples:\n  cdcrctl replay spiral.mcap --speed 0.5     needs a daemon of the same robot\n  cdcrctl replay --verify spiral.mcap\n\n\
        --verify and --with need no daemon. --verify saves the first cycle that differs, with its inputs, as NAME-cycle-N.mcap, which the same \
        command reads, and exits with code 1. Cycles that follow an unrecorded reference are counted separately."
    )]
    Replay(ReplayOptions),
    /// Write a recording as an HTML page: robot in 3-D, path, error, clearance, controls, cables, latencies, events
    ///
    /// One self-contained HTML file for any browser. It stays below 5 MB for recordings of any length: the curves then
    /// show minimum and maximum of each interval.
    #[command(after_help = "Example:\n  cdcrctl report spiral.mcap -o spiral.html")]
    Report(ReportOptions),
    /// Convert the messages of a recording to CSV tables
    #[command(
        after_help = "Example:\n  cdcrctl convert spiral.mcap --csv spiral\n\n\
        One row per cycle, event, reference point, obstacle, status and incident; columns are named by field, such as \
        command.mode or bend_rad[2]. Plans are left out."
    )]
    Convert(ConvertOptions),
    /// Add, list or remove obstacles, which the body of the robot avoids
    #[command(
        after_help = "Example:\n  cdcrctl obstacle add --id 1 --at 0,0.17,0.22 --radius 0.02\n  \
        cdcrctl status                   shows their number and the smallest clearance\n  \
        cdcrctl obstacle remove 1"
    )]
    Obstacle(ObstacleOptions),
    /// Calibrate lengths, cables, base and tip sensor of the robot, and measure sensor noise
    #[command(
        after_help = "Example:\n  cdcrctl home --wait\n  cdcrctl calibrate noise\n  \
        cdcrctl calibrate excite -o moved.csv\n  cdcrctl calibrate geometry moved.csv"
    )]
    Calibrate(CalibrateOptions),
}

/// How to print.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Text for people
    Text,
    /// JSON for programs
    Json,
}

/// Options of what takes the robot some time.
#[derive(Debug, Args)]
pub(crate) struct WaitOptions {
    /// Wait until the motion is done and the robot is at rest, at most 60s or TIME; fail on timeout or when another mode
    /// takes over. At rest: no measured bend rate above 0.02 rad/s, averaged over 0.2 s
    #[arg(long, value_name = "TIME", num_args = 0..=1, require_equals = true, default_missing_value = "60s",
        value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) wait: Option<Duration>,
}

#[derive(Debug, Args)]
pub(crate) struct ResetOptions {
    /// Accept the measured pose where it is far from where the last command left the robot, for example after a motion by hand.
    /// Without it, such a reset is refused, because encoders that lost their zero look the same
    #[arg(long)]
    pub(crate) accept_pose: bool,
    #[command(flatten)]
    pub(crate) wait: WaitOptions,
}

#[derive(Debug, Args)]
pub(crate) struct DemoOptions {
    /// Number of sections, 1 to 3, as in the paper
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=3), allow_negative_numbers = true)]
    pub(crate) sections: u32,
    /// Duration of the spiral, 0.1 s to 20 s; 4.97 s in the paper
    #[arg(long, value_name = "TIME", default_value = "4.97s", value_parser = value::duration_in(0.1..=20.0))]
    pub(crate) duration: Duration,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Write telemetry.csv, path.svg, shape.svg, error.svg and timing.svg into this folder
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct TopOptions {
    /// Frames per second, 1 to 60
    #[arg(long, value_name = "HZ", default_value_t = 20, value_parser = clap::value_parser!(u8).range(1..=60), allow_negative_numbers = true)]
    pub(crate) rate: u8,
    /// Draw with ASCII characters only; default where the locale has no Unicode
    #[arg(long)]
    pub(crate) ascii: bool,
}

#[derive(Debug, Args)]
pub(crate) struct IncidentsOptions {
    /// Output format: one line or one JSON object per incident
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Show only the N most recent
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
    /// Continue with each new incident, until interrupted
    #[arg(long)]
    pub(crate) follow: bool,
}

#[derive(Debug, Args)]
pub(crate) struct EchoOptions {
    /// Topic of the messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: EchoTopic,
    /// Output format: one line or one JSON object per message
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Print only this field, as its JSON path: `mode`, `tip_position_m.2`, `command.bend_rate_rad_s`.
    /// Repeatable
    #[arg(long, value_name = "PATH")]
    pub(crate) field: Vec<String>,
    /// Exit after N messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
    /// Print at most this many messages per second and skip the rest
    #[arg(long, value_name = "HZ", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct HzOptions {
    /// Topic of the messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: EchoTopic,
    /// Exit after N lines
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
}

#[derive(Debug, Args)]
pub(crate) struct PlotOptions {
    /// Topic of the messages
    #[arg(value_enum, default_value = "telemetry")]
    pub(crate) topic: EchoTopic,
    /// Address of the plotter
    #[arg(long, value_name = "HOST:PORT")]
    pub(crate) udp: String,
    /// Send only this field, as in cdcrctl echo; repeatable [default: the most used fields of the topic; all of command]
    #[arg(long, value_name = "PATH")]
    pub(crate) field: Vec<String>,
    /// Send at most this many messages per second and skip the rest
    #[arg(long, value_name = "HZ", value_parser = value::positive, allow_negative_numbers = true)]
    pub(crate) rate: Option<f64>,
    /// Exit after N messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    pub(crate) count: Option<u64>,
}

/// Messages that can be printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum EchoTopic {
    /// One record of every cycle
    Telemetry,
    /// Commands to the driver
    Command,
    /// Status, ten times per second
    Status,
    /// Incidents: those kept by the daemon, then each new one
    Incidents,
    /// References that clients send
    Reference,
    /// Obstacles that clients send
    Obstacles,
}

#[cfg(test)]
mod tests;
