//! The committed manual pages and completions of `cdcrd`.

use cdcr_daemon::cli::Cli;
use clap::CommandFactory;

#[test]
fn the_manual_matches_the_command_line() {
    cdcr_packaging::check(&Cli::command(), "8", None).expect("up to date");
}
