use clap::Args;

use crate::value::{self, Vector};

/// Default limits of a straight motion: speed \[m/s\] and acceleration \[m/s²\].
pub(crate) const GENTLE: (f64, f64) = (0.05, 0.5);

/// Speed, acceleration and allowed error of a straight motion.
#[derive(Debug, Args)]
pub(crate) struct StraightArguments {
    /// Largest speed of the tip, in m/s, at most 2
    #[arg(long, value_name = "M/S", value_parser = value::speed, default_value_t = GENTLE.0, allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// Largest acceleration of the tip, in m/s²
    #[arg(long, value_name = "M/S2", value_parser = value::positive, default_value_t = GENTLE.1, allow_negative_numbers = true)]
    pub(crate) acceleration: f64,
    /// Largest error at the end, such as 2mm or 0.002m: fail when the tip stays farther from the point, as measured with a tip sensor, else as
    /// estimated
    #[arg(long, value_name = "LENGTH", value_parser = value::length_m, default_value = "2mm")]
    pub(crate) max_error: f64,
    /// Move nothing: report whether the point is reachable and the rates and strokes it needs
    #[arg(long)]
    pub(crate) dry_run: bool,
}

#[derive(Debug, Args)]
pub(crate) struct GotoOptions {
    /// Target of the tip, in m in the base frame
    #[arg(value_name = "X,Y,Z", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) point: Vector,
    #[command(flatten)]
    pub(crate) way: StraightArguments,
}

#[derive(Debug, Args)]
pub(crate) struct JogOptions {
    /// Offset of the tip, in m in the base frame
    #[arg(value_name = "DX,DY,DZ", value_parser = value::vector, allow_hyphen_values = true)]
    pub(crate) by: Vector,
    #[command(flatten)]
    pub(crate) way: StraightArguments,
}
