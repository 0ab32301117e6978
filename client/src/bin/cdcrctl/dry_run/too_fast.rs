//! What the dry run refuses as too fast is refused before it is tracked.

use anyhow::bail;
use cdcr_client::{FeedOptions, Trajectory};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_shared_types::Telemetry;

use super::{PositionsOf, longest_s, simulate};

/// Fails where a reference is to be tracked that the dry run refuses as too fast, or because the body would touch itself, by its positions
/// and without obstacles, which the guard avoids. What is too long to be simulated is not checked.
pub(crate) fn check_speed(
    record: &Telemetry,
    settings: NmpcSettings,
    trajectory: &dyn Trajectory,
    options: &FeedOptions,
    allowed_m: f64,
) -> anyhow::Result<()> {
    if trajectory.duration_s() > longest_s(record) {
        tell!(
            "note: the reference is too long to simulate: whether it is too fast for the robot is not checked"
        );
        return Ok(());
    }
    let free = Telemetry {
        obstacle_count: 0,
        ..*record
    };
    let demands = simulate(&free, settings, &PositionsOf(trajectory), options)?;
    match demands.miss(allowed_m) {
        Some((cause, remedy)) => bail!(
            "{cause}: {remedy}, or allow more than {} mm (--max-error); nothing moved",
            1e3 * allowed_m
        ),
        None => demands.check_self_contact(),
    }
}
