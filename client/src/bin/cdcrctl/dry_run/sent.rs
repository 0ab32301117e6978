//! The points of a trajectory, as they would be sent.

use anyhow::bail;
use cdcr_client::model::orientation_of;
use cdcr_client::{FeedOptions, Trajectory};
use cdcr_controller::reference::{self, Interpolation, ReferencePoint};
use cdcr_shared_types::codes;

/// A file with rows farther apart than this may have times in milliseconds \[s\].
const FAR_APART_S: f64 = 1.0;

/// The positions of a trajectory, with any orientation.
pub(super) struct PositionsOf<'a>(pub(super) &'a dyn Trajectory);

impl Trajectory for PositionsOf<'_> {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn duration_s(&self) -> f64 {
        self.0.duration_s()
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        self.0.position_m(time_s)
    }

    fn knots_s(&self) -> Option<&[f64]> {
        self.0.knots_s()
    }
}

/// Fails when the motion is too long to be simulated: probably its times are in milliseconds if its rows are far apart.
pub(super) fn check_duration(trajectory: &dyn Trajectory, longest_s: f64) -> anyhow::Result<()> {
    let duration_s = trajectory.duration_s();
    if duration_s <= longest_s {
        return Ok(());
    }
    let steps = trajectory.knots_s().map_or(0, |knots_s| knots_s.len() - 1);
    let step_s = duration_s / steps as f64;
    if steps > 0 && step_s >= FAR_APART_S {
        bail!(
            "the motion takes {duration_s:.0} s, more than {longest_s:.0} s, with rows {step_s:.1} s apart: are these \
             milliseconds?\nt_s is in s: 150 ms are 0.15"
        );
    }
    bail!("the motion takes {duration_s:.0} s, more than {longest_s:.0} s: use a higher speed");
}

/// The points as they would be sent, on a clock that starts with the trajectory.
pub(super) fn points(
    trajectory: &dyn Trajectory,
    options: &FeedOptions,
    reach_m: f64,
) -> anyhow::Result<reference::Trajectory> {
    let duration_s = trajectory.duration_s();
    let step_s = options.step.as_secs_f64();
    let even =
        (0..=(duration_s / step_s).ceil() as u64).map(|k| (k as f64 * step_s).min(duration_s));
    let mut times_s = match trajectory.knots_s() {
        Some(knots_s) => knots_s.to_vec(),
        None => even.collect(),
    };
    times_s.dedup_by(|later, earlier| *later - *earlier < 1e-6);
    let interpolation = match options.interpolation {
        codes::Interpolation::Linear => Interpolation::Linear,
        codes::Interpolation::Cubic => Interpolation::Cubic,
    };
    let point = |time_s: &f64| ReferencePoint {
        time_ns: (time_s * 1e9) as u64,
        position_m: trajectory.position_m(*time_s).into(),
        orientation: orientation_of(trajectory.orientation(*time_s)),
        interpolation,
    };
    let mut points = reference::Trajectory::with_capacity(times_s.len(), reach_m);
    points.replace(times_s.iter().map(point))?;
    Ok(points)
}
