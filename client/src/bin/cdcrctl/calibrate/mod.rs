//! Records measurements of a robot, and identifies its parameters.

mod advice;
mod bends;
mod excite;
mod geometry;
mod noise;
mod pairs;
mod record;
mod recorded;
mod recording;
mod report;
mod resting;

use crate::args::{CalibrateAction, CalibrateOptions, Target};
use crate::done::Done;

pub(crate) fn run(target: &Target, options: &CalibrateOptions) -> anyhow::Result<Done> {
    match &options.action {
        CalibrateAction::Excite(options) => excite::run(target, options),
        CalibrateAction::Record(options) => record::run(target, options),
        CalibrateAction::Geometry(options) => geometry::run(target, options),
        CalibrateAction::Noise(options) => noise::run(target, options),
    }
}
