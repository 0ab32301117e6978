use std::io::Write;
use std::time::Duration;

use anyhow::bail;
use cdcr_client::{monotonic_ns, remedy};
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{EventKind, ObstacleShape, Outcome};

use crate::Done;
use crate::args::{ObstacleAction, ObstacleAdd, ObstacleOptions, Target};

/// How long the daemon may take to judge the message.
const VERDICT_TIMEOUT: Duration = Duration::from_secs(1);

/// `cdcrctl obstacle …`
pub(crate) fn run(target: &Target, options: &ObstacleOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let mut telemetry = connection.telemetry()?;
    let sender = connection.obstacle_sender()?;
    let header = match &options.action {
        ObstacleAction::Add(add) => sender.upsert(&[obstacle(add, monotonic_ns())])?,
        ObstacleAction::Remove { ids } => sender.remove(ids)?,
        ObstacleAction::Clear => sender.clear()?,
    };
    let event = telemetry.event_on(EventKind::Obstacles, &header, VERDICT_TIMEOUT)?;
    match Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode) {
        Outcome::Accepted => {
            let known = event.detail;
            writeln!(
                std::io::stdout(),
                "obstacles: accepted, {known} known to the daemon now"
            )?;
            Ok(Done::Good)
        }
        outcome => bail!("the daemon refused it: {outcome}. {}", advice(outcome)),
    }
}

/// What to do, in the words of this command where it has its own.
fn advice(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::BufferFull => {
            "It knows as many as it can (64): remove some with cdcrctl obstacle remove or clear."
        }
        Outcome::OutOfRange => {
            "Positions and velocities are within ±1000000 m and m/s, the radius is 0 to 1000000 m."
        }
        Outcome::InThePast => "Its lifetime was over when it arrived: give it a longer --lifetime.",
        other => remedy(other),
    }
}

fn obstacle(add: &ObstacleAdd, now_ns: u64) -> Obstacle {
    let shape = match add.to {
        Some(_) => ObstacleShape::Capsule,
        None => ObstacleShape::Sphere,
    };
    Obstacle {
        id: add.id,
        shape: shape.code(),
        start_m: add.at,
        end_m: add.to.unwrap_or(add.at),
        radius_m: add.radius,
        velocity_m_s: add.velocity,
        measured_ns: now_ns,
        lifetime_ns: add.lifetime.map_or(0, |d| d.as_nanos() as u64),
    }
}
