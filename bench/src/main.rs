//! `cdcr-bench`: the program. Everything that measures is in the library.

mod cli;

use anyhow::Result;
use clap::Parser;

fn main() -> Result<()> {
    cli::execute(cli::Cli::parse())
}
