//! `cdcrd`: the process. Everything else is in the library.

use std::process::ExitCode;

use cdcr_daemon::cli::{Cli, execute};
use cdcr_daemon::exit::ExitCause;
use clap::Parser;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let on_terminal = std::io::IsTerminal::is_terminal(&std::io::stderr());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(on_terminal)
        .with_target(false)
        .init();
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Error);
    match execute(Cli::parse()) {
        Ok(()) => ExitCause::Asked.into(),
        Err(error) => {
            eprintln!("cdcrd: {error:#}");
            ExitCause::of(&error).into()
        }
    }
}
