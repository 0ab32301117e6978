use cdcr_controller::robot::{Configuration, Robot};

use crate::obstacles::KnownObstacle;

/// Clearance \[m\] of the body where it is; `led_m` is that where its commands lead it, infinite where there is no obstacle.
pub(super) fn present_clearance_m(
    robot: &Robot,
    present: &Configuration,
    obstacles: impl Iterator<Item = KnownObstacle>,
    led_m: f64,
) -> f64 {
    if !led_m.is_finite() {
        return led_m;
    }
    let body = robot.body(present);
    body.least_clearance_m(obstacles.map(|known| known.obstacle))
}
