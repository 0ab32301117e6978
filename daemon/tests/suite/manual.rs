//! The committed manual pages and completions of `cdcrd`.

use cdcr_daemon::cli::Cli;
use clap::CommandFactory;

#[test]
fn the_manual_is_what_the_command_line_says() {
    cdcr_packaging::check(&Cli::command(), "8", None).expect("up to date");
}
