//! `cdcr-bench rate`.

use anyhow::Result;
use cdcr_bench::rate;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// How often the default is measured with each of its periods, 1 to 100. The search for the shortest periods
    /// is made once.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// The default and its solvers only, in short trials: a look of half a minute instead of a measurement of
    /// five.
    #[arg(long, conflicts_with = "rounds")]
    quick: bool,
    /// Let the daemon wake up so long before each release and spin to it, 0 to 1000 µs; at most a quarter of the
    /// period.
    #[arg(long, value_name = "US", default_value_t = 0.0, value_parser = spin_us)]
    spin: f64,
    #[command(flatten)]
    output: Output,
}

fn spin_us(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (0.0..=1000.0).contains(&value) {
        Ok(value)
    } else {
        Err("must be 0 to 1000".to_owned())
    }
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    let base = if args.quick {
        rate::Options::quick()
    } else {
        rate::Options {
            rounds: args.rounds,
            ..rate::Options::full()
        }
    };
    let options = rate::Options {
        spin_us: args.spin,
        ..base
    };
    args.output.measure(&options, rate::expected_s, rate::run)
}
