mod feed;
mod removals;
mod scene;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write as _;
use std::time::Duration;

use anyhow::{anyhow, bail};
use cdcr_client::{
    Connection, LinkError, ObstacleSender, check_place, counted, monotonic_ns, remedy,
};
use cdcr_controller::robot::{OBSTACLE_COMPONENT, OBSTACLE_RADIUS_M};
use cdcr_shared_types::codes::{EventKind, ObstacleShape, Outcome};
use cdcr_shared_types::limits::{OBSTACLE_AGE_MS_MAX, OBSTACLE_SPEED_M_S_MAX, OBSTACLES_MAX};
use cdcr_shared_types::{Header, InputEvent, Obstacle, Status, Telemetry};

use crate::args::{Format, ObstacleAction, ObstacleAdd, ObstacleOptions, Target};
use crate::done::Done;
use crate::dry_run::newest;
use crate::echo::json;
use crate::echo::line::clearance_text;
use crate::known_obstacles::known;
use crate::value::SPEED_M_S_MAX;

/// Timeout for the daemon's decision on a message, or for a cycle.
const TIMEOUT: Duration = Duration::from_secs(1);

pub(crate) fn run(target: &Target, options: &ObstacleOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    match &options.action {
        ObstacleAction::Add(add) => {
            let obstacle = obstacle(add, monotonic_ns());
            check(&obstacle, &connection.status(TIMEOUT)?, add.far, true)?;
            let done = change(&connection, |sender| sender.upsert_anywhere(&[obstacle]))?;
            // The obstacle is known, whatever becomes of this.
            if let Ok(record) = newest(&connection) {
                note_clearance(&record);
            }
            Ok(done)
        }
        ObstacleAction::List(options) => list(&connection, options.format),
        ObstacleAction::Remove { ids } => {
            // The daemon does not report which of the ids it knew.
            let before = known(&connection, TIMEOUT)?;
            let silent = connection.status(TIMEOUT)?.silent_obstacle_source;
            change(&connection, |sender| sender.remove(ids))?;
            let Some(unknown) = unknown_text(ids, &before) else {
                return Ok(Done::Good);
            };
            if silent == 0 || !connection.ends_wait_for(silent, TIMEOUT)? {
                bail!("{unknown}; the known ones: cdcrctl obstacle list");
            }
            writeln!(
                std::io::stdout(),
                "{unknown}, but the daemon waits no longer for the silent source that sent it"
            )?;
            Ok(Done::Good)
        }
        ObstacleAction::Clear => {
            let before = known(&connection, TIMEOUT)?;
            let done = change(&connection, ObstacleSender::clear)?;
            writeln!(std::io::stdout(), "{}", cleared(&before))?;
            Ok(done)
        }
        ObstacleAction::File(options) => feed::file(&connection, &options.path, options.far),
        ObstacleAction::Stdin(options) => feed::stdin(&connection, options.far),
    }
}

fn change(
    connection: &Connection,
    send: impl FnOnce(&ObstacleSender) -> Result<Header, LinkError>,
) -> anyhow::Result<Done> {
    let mut telemetry = connection.telemetry()?;
    let sender = connection.obstacle_sender()?;
    let header = send(&sender)?;
    let known = accepted(&telemetry.event_on(EventKind::Obstacles, &header, TIMEOUT)?)?;
    writeln!(
        std::io::stdout(),
        "obstacles: accepted, {known} known to the daemon now"
    )?;
    Ok(Done::Good)
}

/// Says that the body is nearer to an obstacle than allowed.
fn note_clearance(record: &Telemetry) {
    let safe_m = record.settings.safe_distance_m;
    if record.clearance_m < safe_m {
        let consequence = if record.clearance_m < record.clearance_fault_m {
            "which is a fault"
        } else {
            "and a robot at rest does not evade"
        };
        tell!(
            "note: the body is {} mm from an obstacle, nearer than the safe distance of {} mm, {consequence}{}",
            clearance_text(record.clearance_m),
            clearance_text(safe_m),
            margin_text(record.tip_margin_m)
        );
    }
}

/// What of the distance is not measured.
fn margin_text(margin_m: f64) -> String {
    const SHOWN_M: f64 = 1e-4;
    if margin_m < SHOWN_M {
        return String::new();
    }
    format!(
        "; the body counts as up to {:.1} mm thicker, because its tip may be so far from the model (tip margin)",
        1e3 * margin_m
    )
}

/// Number of known obstacles after a message was accepted; `event` is about it.
fn accepted(event: &InputEvent) -> anyhow::Result<u32> {
    match Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode) {
        Outcome::Accepted => Ok(event.detail),
        outcome => bail!("rejected by the daemon: {outcome}. {}", advice(outcome)),
    }
}

/// Names the obstacles to be removed that were not known before; `None`: all were.
fn unknown_text(ids: &[u32], before: &[Obstacle]) -> Option<String> {
    let is_unknown = |id: &&u32| before.iter().all(|known| known.id != **id);
    let unknown: BTreeSet<_> = ids.iter().filter(is_unknown).collect();
    let unknown: Vec<_> = unknown.into_iter().map(u32::to_string).collect();
    let text = format!(
        "no obstacle with id {} was known to the daemon",
        unknown.join(", ")
    );
    (!unknown.is_empty()).then_some(text)
}

/// What a clear has removed: this command has added none of it.
fn cleared(before: &[Obstacle]) -> String {
    let ids: Vec<_> = before.iter().map(|known| known.id.to_string()).collect();
    let count = counted(ids.len() as u64, "obstacle");
    match ids.as_slice() {
        [] => "no obstacle was known before".to_owned(),
        ids => format!("removed: {count} of other clients, {}", ids.join(", ")),
    }
}

fn list(connection: &Connection, format: Format) -> anyhow::Result<Done> {
    let known = known(connection, TIMEOUT)?;
    let shown = match format {
        Format::Text => table(&known)?,
        Format::Json => {
            let known: Vec<_> = known.iter().map(|known| json::message(known)).collect();
            serde_json::to_string_pretty(&known)? + "\n"
        }
    };
    std::io::stdout().write_all(shown.as_bytes())?;
    Ok(Done::Good)
}

fn table(known: &[Obstacle]) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    if known.is_empty() {
        return Ok("no obstacles are known\n".to_owned());
    }
    writeln!(
        out,
        "{:>10}  {:<8}{:<24}{:<24}{:>8}  {:<24}{:>8}",
        "id", "shape", "at m", "to m", "radius m", "velocity m/s", "left s"
    )?;
    for obstacle in known {
        let is_capsule = obstacle.shape == ObstacleShape::Capsule.code();
        let to = if is_capsule {
            vector_text(obstacle.end_m)
        } else {
            "-".to_owned()
        };
        let left = match obstacle.lifetime_ns {
            0 => "-".to_owned(),
            ns => format!("{:.1}", ns as f64 * 1e-9),
        };
        writeln!(
            out,
            "{:>10}  {:<8}{:<24}{to:<24}{:>8.3}  {:<24}{left:>8}",
            obstacle.id,
            ObstacleShape::text_of(obstacle.shape),
            vector_text(obstacle.start_m),
            obstacle.radius_m,
            vector_text(obstacle.velocity_m_s),
        )?;
    }
    Ok(out)
}

fn vector_text([x, y, z]: [f64; 3]) -> String {
    format!("{x:.3},{y:.3},{z:.3}")
}

/// Refuses obstacles that the daemon would accept but that are probably a mistake. A source that `ends` must
/// send no lifetimes if the daemon monitors them; one that goes on is not ended by a single fast estimate.
fn check(obstacle: &Obstacle, status: &Status, far: bool, ends: bool) -> anyhow::Result<()> {
    let timeout_ms = status.obstacle_source_timeout_ns as f64 * 1e-6;
    if ends && obstacle.lifetime_ns > 0 && timeout_ms > 0.0 {
        bail!(
            "this daemon supervises sources of obstacles with lifetimes (obstacles.source_timeout_ms = \
             {timeout_ms}): the robot would hold when this command ends\n\
             omit the lifetime, and remove the obstacle \
             with: cdcrctl obstacle remove {}",
            obstacle.id
        );
    }
    if far {
        return Ok(());
    }
    check_place(obstacle, &status.robot)
        .map_err(|cause| anyhow!("{cause}. To add it anyway: --far"))?;
    let squares = obstacle.velocity_m_s.iter().map(|v| v * v);
    let speed_m_s = squares.sum::<f64>().sqrt();
    if speed_m_s > SPEED_M_S_MAX && ends {
        bail!(
            "the obstacle moves at {speed_m_s:.1} m/s: are these mm/s?\na velocity is in m/s: 20 mm/s are 0.02. To add it anyway: --far"
        );
    }
    Ok(())
}

/// Remedy, with the options of this command where it has some.
fn advice(outcome: Outcome) -> String {
    match outcome {
        Outcome::BufferFull => format!(
            "The limit of {OBSTACLES_MAX} obstacles is reached: remove some with cdcrctl obstacle remove or clear."
        ),
        Outcome::OutOfRange => {
            let (position_m, radius_m) = (OBSTACLE_COMPONENT.end(), OBSTACLE_RADIUS_M.end());
            format!(
                "Use positions within ±{position_m} m, a speed of at most {OBSTACLE_SPEED_M_S_MAX} m/s, a radius of 0 to {radius_m} m, \
                 and a measured_ns of CLOCK_MONOTONIC that is not in the future."
            )
        }
        Outcome::InThePast => format!(
            "The lifetime had ended on arrival, or an obstacle that moves was measured more than {OBSTACLE_AGE_MS_MAX} ms ago: use a \
             longer lifetime, or a newer measured_ns."
        ),
        other => remedy(other).to_owned(),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn add(at: [f64; 3], radius: f64) -> ObstacleAdd {
        ObstacleAdd {
            id: 7,
            at,
            to: None,
            radius,
            velocity: [0.0; 3],
            lifetime: None,
            far: false,
        }
    }

    fn checked(add: &ObstacleAdd, status: &Status) -> anyhow::Result<()> {
        check(&obstacle(add, 0), status, add.far, true)
    }

    fn status() -> Status {
        let mut status = Status::default();
        status.robot.sections = 3;
        for section in &mut status.robot.section[..3] {
            section.length_m = 0.3;
        }
        status
    }

    #[test]
    fn units_that_look_wrong_are_asked_about() {
        let (far, mut fast) = (add([50.0, 0.0, 0.0], 0.1), add([0.0, 0.17, 0.22], 0.02));
        fast.velocity = [-20.0, 0.0, 0.0];
        for (mut odd, expected) in [
            (far, "are these millimetres? Positions"),
            (fast, "20.0 m/s: are these mm/s?"),
        ] {
            let error = checked(&odd, &status()).expect_err("odd").to_string();
            assert!(error.contains(expected), "{error}");
            assert!(error.ends_with("To add it anyway: --far"), "{error}");
            odd.far = true;
            assert!(checked(&odd, &status()).is_ok());
        }
    }

    #[test]
    fn a_lifetime_is_refused_where_it_would_make_the_robot_hold() {
        let mut fleeting = add([0.5, 0.0, 0.0], 0.1);
        fleeting.lifetime = Some(TIMEOUT);
        let mut watching = status();
        assert!(checked(&fleeting, &watching).is_ok());
        watching.obstacle_source_timeout_ns = 500_000_000;
        let refused = checked(&fleeting, &watching).expect_err("refused");
        let error = refused.to_string();
        assert!(error.contains("source_timeout_ms = 500"), "{error}");
        assert!(error.contains("cdcrctl obstacle remove 7"), "{error}");
        // A source that continues to send may use lifetimes.
        assert!(check(&obstacle(&fleeting, 0), &watching, false, false).is_ok());
        fleeting.lifetime = None;
        assert!(checked(&fleeting, &watching).is_ok());
    }

    #[test]
    fn ids_that_were_not_known_are_named() {
        let before = [1, 2].map(|id| Obstacle {
            id,
            ..Obstacle::default()
        });
        assert_eq!(unknown_text(&[2, 1, 2], &before), None);
        let text = unknown_text(&[7, 1, 9, 7], &before).expect("unknown");
        assert!(text.contains("id 7, 9 was"), "{text}");
        assert_eq!(
            cleared(&before),
            "removed: 2 obstacles of other clients, 1, 2"
        );
        assert_eq!(cleared(&[]), "no obstacle was known before");
    }

    #[test]
    fn the_list_has_every_obstacle_with_its_units() {
        assert_eq!(table(&[]).expect("formatted"), "no obstacles are known\n");
        let sphere = Obstacle {
            id: 1,
            start_m: [0.0, 0.17, -0.22],
            radius_m: 0.02,
            lifetime_ns: 2_500_000_000,
            ..Obstacle::default()
        };
        let capsule = Obstacle {
            id: 4_000_000_000,
            shape: ObstacleShape::Capsule.code(),
            end_m: [0.5, 0.3, 0.6],
            ..Obstacle::default()
        };
        let table = table(&[sphere, capsule]).expect("formatted");
        let row = |line: usize| {
            let words = table.lines().nth(line).expect("a row").split_whitespace();
            words.collect::<Vec<_>>().join(" ")
        };
        let sphere = "1 sphere 0.000,0.170,-0.220 - 0.020 0.000,0.000,0.000 2.5";
        assert_eq!(row(1), sphere);
        let capsule = "4000000000 capsule 0.000,0.000,0.000 0.500,0.300,0.600 ";
        assert!(row(2).starts_with(capsule), "{}", row(2));
    }
}
