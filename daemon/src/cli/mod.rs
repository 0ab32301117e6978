//! The command line of `cdcrd`, and its output.

mod bare;
mod config;
mod doctor;
mod tuning;

use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};

use crate::app;
use crate::exit::ExitCause;
use config::{ConfigCommand, ConfigSource};

/// Real-time control daemon for cable-driven continuum robots.
#[derive(Debug, Parser)]
#[command(
    name = "cdcrd",
    version,
    about,
    after_help = "Example: cdcrd run --config configs/default.toml"
)]
pub struct Cli {
    #[command(subcommand)]
    command: DaemonCommand,
}

#[derive(Debug, Subcommand)]
enum DaemonCommand {
    /// Run the control loop until SIGINT or SIGTERM.
    #[command(after_help = "Example: cdcrd run --config robot.toml\n\
        Without --config, simulates the paper's robot with three sections.\n\
        Logs to the standard error; RUST_LOG=debug logs more.\n\n\
        Signals: SIGINT and SIGTERM bring the robot to rest and end the daemon. SIGUSR1 stops the robot and latches \
        like cdcrctl stop, without shared memory. SIGHUP reloads the configuration: applies changes of [controller] and \
        cycle.budget_ms, logs other changed keys, and changes nothing if the configuration is invalid.")]
    Run {
        #[command(flatten)]
        source: ConfigSource,
        /// End when the parent process, which has this id, ends, however it ends.
        #[arg(long, value_name = "PID", hide = true)]
        end_with_parent: Option<i32>,
    },
    /// Run the real-time loop without work: the baseline of this machine.
    #[command(after_help = bare::after_help())]
    Bare(bare::BareOptions),
    /// Check a configuration and print a summary.
    #[command(after_help = "Example: cdcrd check --config robot.toml --set cycle.period_ms=2")]
    Check(ConfigSource),
    /// Check this machine for causes of delay in a real-time loop, and print remedies.
    #[command(after_help = doctor::AFTER_HELP)]
    Doctor(doctor::DoctorOptions),
    /// Print or explain the configuration.
    #[command(subcommand)]
    Config(ConfigCommand),
}

/// Executes a command line, and returns the exit status.
pub fn execute(cli: Cli) -> Result<ExitCode> {
    let done = |()| ExitCause::Asked.into();
    match cli.command {
        DaemonCommand::Run {
            source,
            end_with_parent,
        } => {
            end_with_process(end_with_parent)?;
            app::run(Box::new(move || source.load())).map(done)
        }
        DaemonCommand::Bare(options) => bare::run(&options).map(done),
        DaemonCommand::Check(source) => config::check(&source).map(done),
        DaemonCommand::Doctor(options) => doctor::run(&options).map(ExitCode::from),
        DaemonCommand::Config(command) => config::execute(command).map(done),
    }
}

/// Asks the kernel for SIGTERM at the end of the parent process, if requested; fails if the parent has
/// already ended.
fn end_with_process(parent: Option<i32>) -> Result<()> {
    let Some(parent) = parent else {
        return Ok(());
    };
    set_parent_process_death_signal(Some(Signal::TERM))
        .context("cannot watch the parent process")?;
    let is_ours = getppid().is_some_and(|id| id.as_raw_pid() == parent);
    ensure!(is_ours, "process {parent} is not the parent process");
    Ok(())
}
