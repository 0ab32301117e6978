//! The arguments of every benchmark, and what becomes of its result.

use std::path::PathBuf;

use anyhow::Result;
use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::latency::baseline;
use cdcr_shared_types::Location;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Measure<B: Benchmark> {
    #[command(flatten)]
    options: B,
    #[command(flatten)]
    output: Output,
}

impl<B: Benchmark> Measure<B> {
    pub(super) fn run(self) -> Result<()> {
        self.output.measure(self.options)
    }
}

/// The other process of the bare measurement.
#[derive(Debug, clap::Args)]
pub(super) struct Peer {
    /// Prefix of the files in shared memory.
    #[arg(long)]
    prefix: String,
    /// Root folder of iceoryx2.
    #[arg(long)]
    root: PathBuf,
    /// The process that started it.
    #[arg(long)]
    parent: u32,
    /// Its core.
    #[arg(long)]
    core: usize,
    /// Both processes are on one core.
    #[arg(long)]
    shares: bool,
}

impl Peer {
    pub(super) fn run(&self) -> Result<()> {
        baseline::peer(&baseline::PeerOptions {
            location: Location::new(&self.prefix, &self.root)?,
            core: self.core,
            parent: self.parent,
            shares: self.shares,
        })
    }
}
