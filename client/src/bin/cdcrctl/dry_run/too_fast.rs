//! What the dry run refuses as too fast is refused before it is tracked.

use anyhow::bail;
use cdcr_client::{FeedOptions, Trajectory};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_shared_types::Telemetry;

use super::held_back::HeldBack;
use super::{Demands, PositionsOf, longest_s, simulate};

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

impl Demands {
    /// Cause and remedy where a point is missed by more than `allowed_m`, although the bends allow every point ([`reach`](crate::reach)).
    pub(crate) fn miss(&self, allowed_m: f64) -> Option<(String, &'static str)> {
        let beside = self.beside(self.missed_clearance_m);
        let (cause, remedy) = match (self.missed_at, beside) {
            (Some(limit @ (HeldBack::Stroke { .. } | HeldBack::Bend(_))), _) => {
                (limit.to_string(), limit.remedy())
            }
            // A robot that goes round an obstacle may be at a limit of its speed, too: raising it would not help.
            (_, Some(beside)) => (
                format!("obstructed or too fast{beside}"),
                "use another path, remove the obstacle, or use a lower --speed",
            ),
            (Some(limit), None) => (limit.to_string(), limit.remedy()),
            (None, None) if self.along.clearance_m == f64::INFINITY => {
                ("too fast".to_owned(), "use a lower --speed")
            }
            (None, None) => (
                "too fast, or obstructed".to_owned(),
                "use a lower --speed, or remove obstacles",
            ),
        };
        let missed = self.missed();
        let cause = format!("{cause}: {missed}, though the robot's bends allow every point");
        (self.error_max_m > allowed_m).then_some((cause, remedy))
    }
}
