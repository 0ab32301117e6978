//! `cdcrd`: the process. Everything else is in the library.

use std::process::ExitCode;

use cdcr_daemon::cli::{Cli, execute};
use cdcr_daemon::exit::ExitCause;
use cdcr_daemon::log;
use clap::Parser;

fn main() -> ExitCode {
    log::start();
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Error);
    match execute(Cli::parse()) {
        Ok(status) => status,
        Err(error) => {
            eprintln!("cdcrd: {error:#}");
            ExitCause::of(&error).into()
        }
    }
}
