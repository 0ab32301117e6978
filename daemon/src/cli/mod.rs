//! The command line: what can be asked of `cdcrd`, and in which words it answers.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, Parser, Subcommand};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};

use crate::app;
use crate::config::{Config, ConfigError, DEFAULT_TEXT, Validated};

/// Real-time control daemon for cable-driven continuum robots.
#[derive(Debug, Parser)]
#[command(
    version,
    about,
    after_help = "Example: cdcrd run --config configs/default.toml"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the control loop until SIGINT or SIGTERM.
    #[command(after_help = "Example: cdcrd run --config robot.toml\n\
        Without --config, the paper's robot with three sections is simulated.\n\
        The log goes to the standard error; RUST_LOG=debug shows more.")]
    Run {
        #[command(flatten)]
        source: Source,
        /// End when the parent process, which has this id, ends, however it ends.
        #[arg(long, value_name = "PID", hide = true)]
        end_with_parent: Option<i32>,
    },
    /// Check a configuration and say what would run.
    #[command(after_help = "Example: cdcrd check --config robot.toml")]
    Check(Source),
    /// Print configurations.
    #[command(subcommand)]
    Config(ConfigCommand),
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Print the default configuration, every key explained.
    #[command(after_help = "Example: cdcrd config default > robot.toml")]
    Default,
}

/// Where the configuration comes from. An option wins over its environment variable, both over the
/// file, the file over the defaults.
#[derive(Debug, Args)]
struct Source {
    /// Configuration file (TOML).
    #[arg(long, env = "CDCR_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Name of the robot in the service names.
    #[arg(long, env = "CDCR_ROBOT", value_name = "NAME")]
    robot: Option<String>,
    /// Prefix of the shared-memory files.
    #[arg(long, env = "CDCR_PREFIX", value_name = "PREFIX")]
    prefix: Option<String>,
    /// Root folder of the shared-memory services.
    #[arg(long, env = "CDCR_ROOT", value_name = "DIR")]
    root: Option<PathBuf>,
}

impl Source {
    fn load(&self) -> Result<Validated, ConfigError> {
        let mut config = match &self.config {
            Some(path) => Config::load(path)?.config,
            None => Config::default(),
        };
        if let Some(robot) = &self.robot {
            config.robot.name.clone_from(robot);
        }
        if let Some(prefix) = &self.prefix {
            config.transport.prefix.clone_from(prefix);
        }
        if let Some(root) = &self.root {
            config.transport.root = absolute(root).to_string_lossy().into_owned();
        }
        config.check()
    }
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Carries a command line out.
///
/// # Errors
/// What went wrong; [`ExitCause::of`](crate::exit::ExitCause::of) tells its exit status.
pub fn execute(cli: Cli) -> Result<()> {
    match cli.command {
        Command::Run {
            source,
            end_with_parent,
        } => {
            if let Some(parent) = end_with_parent {
                end_with_process(parent)?;
            }
            app::run(&source.load()?)
        }
        Command::Check(source) => {
            describe(&source.load()?);
            Ok(())
        }
        Command::Config(ConfigCommand::Default) => {
            print!("{DEFAULT_TEXT}");
            Ok(())
        }
    }
}

/// Asks the kernel for SIGTERM when our parent ends; a parent that has ended meanwhile ends us now.
fn end_with_process(parent: i32) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM))
        .context("the end of the parent process cannot be watched")?;
    let is_ours = getppid().is_some_and(|id| id.as_raw_pid() == parent);
    ensure!(is_ours, "process {parent} is not our parent (any more)");
    Ok(())
}

/// Says what would run, in words.
fn describe(validated: &Validated) {
    let Validated {
        config,
        robot,
        location,
        ..
    } = validated;
    println!("the configuration is good");
    println!(
        "robot      {} ({:?}), {} sections, reach {:.3} m",
        config.robot.name,
        config.link.kind,
        robot.section_count(),
        robot.reach_m()
    );
    for (index, section) in robot.sections().iter().enumerate() {
        println!(
            "  section {}  length {} m, bend ≤ {} rad, rate ≤ {} rad/s, cables at {} m",
            index + 1,
            section.length_m,
            section.bend_max_rad,
            section.rate_max_rad_s,
            section.cable_radius_m
        );
    }
    let nmpc = &config.controller;
    println!(
        "cycle      {} ms, {:?} real time",
        config.cycle.period_ms, config.realtime.mode
    );
    println!(
        "controller {:?}, N = {}, swarm {} x {}, {} refinement steps",
        nmpc.solver,
        nmpc.horizon_steps,
        nmpc.swarm_size,
        nmpc.swarm_iterations,
        nmpc.refinement_steps
    );
    println!(
        "transport  prefix {} below {}",
        location.prefix(),
        location.root().display()
    );
}
