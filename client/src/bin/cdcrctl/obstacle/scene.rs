//! Obstacles as JSON: the output of `obstacle list --format json` and the input of `obstacle file` and
//! `obstacle stdin`.

use std::collections::BTreeMap;

use cdcr_client::DURATION_MAX_S;
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::ObstacleShape;
use cdcr_shared_types::limits::OBSTACLES_MAX;
use serde::Deserialize;
use serde_json::Value;

/// One change of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SceneChange {
    /// Number of the line or array element, from 1.
    pub(super) number: usize,
    /// Time since the start of the scene \[s\].
    pub(super) time_s: f64,
    pub(super) action: SceneAction,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum SceneAction {
    Upsert(Obstacle),
    Remove(Vec<u32>),
}

impl SceneChange {
    /// Sets the time of the measurement \[ns\].
    pub(super) fn stamp(&mut self, measured_ns: u64) {
        if let SceneAction::Upsert(obstacle) = &mut self.action {
            obstacle.measured_ns = measured_ns;
        }
    }

    /// Sets the time of the measurement if it has none.
    pub(super) fn stamp_where_none(&mut self, measured_ns: u64) {
        if matches!(&self.action, SceneAction::Upsert(obstacle) if obstacle.measured_ns == 0) {
            self.stamp(measured_ns);
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownObstacle {
    #[serde(default)]
    time_s: f64,
    id: u32,
    shape: Option<String>,
    start_m: [f64; 3],
    end_m: Option<[f64; 3]>,
    radius_m: f64,
    #[serde(default)]
    velocity_m_s: [f64; 3],
    #[serde(default)]
    measured_ns: u64,
    #[serde(default)]
    lifetime_ns: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Removed {
    #[serde(default)]
    time_s: f64,
    remove: Vec<u32>,
}

/// Parses a whole scene: an object per line, or an array. Times must not decrease.
pub(super) fn parse(text: &str) -> Result<Vec<SceneChange>, String> {
    let changes: Vec<SceneChange> = if text.trim_start().starts_with('[') {
        let all: Vec<Value> = serde_json::from_str(text).map_err(|cause| cause.to_string())?;
        let elements = all.into_iter().enumerate();
        let changes = elements.map(|(index, value)| {
            change(index + 1, value).map_err(|cause| format!("element {}: {cause}", index + 1))
        });
        changes.collect::<Result<_, _>>()?
    } else {
        let lines = text.lines().enumerate();
        let changes = lines.filter_map(|(index, line)| parse_line(index + 1, line).transpose());
        changes.collect::<Result<_, _>>()?
    };
    let falls = |pair: &&[SceneChange]| pair[1].time_s < pair[0].time_s;
    match changes.windows(2).find(falls) {
        Some([before, after]) => Err(format!(
            "line {}: time_s = {} is before that of line {}, {}",
            after.number, after.time_s, before.number, before.time_s
        )),
        _ => Ok(changes),
    }
}

/// Fails when the scene has more obstacles at one time than the daemon knows.
pub(super) fn check_count(changes: &[SceneChange]) -> Result<(), String> {
    // Each with the time at which it expires.
    let mut present = BTreeMap::new();
    for change in changes {
        present.retain(|_, until_s| change.time_s < *until_s);
        match &change.action {
            SceneAction::Upsert(obstacle) => {
                let until_s = match obstacle.lifetime_ns {
                    0 => f64::INFINITY,
                    ns => change.time_s + ns as f64 * 1e-9,
                };
                present.insert(obstacle.id, until_s);
            }
            SceneAction::Remove(ids) => present.retain(|id, _| !ids.contains(id)),
        }
        if present.len() > OBSTACLES_MAX {
            return Err(format!(
                "line {}: one obstacle more than the {OBSTACLES_MAX} that a daemon knows at one time; nothing was sent",
                change.number
            ));
        }
    }
    Ok(())
}

/// Parses one line; `None` if it is empty.
pub(super) fn parse_line(number: usize, line: &str) -> Result<Option<SceneChange>, String> {
    if line.trim().is_empty() {
        return Ok(None);
    }
    let value = serde_json::from_str(line).map_err(|cause| {
        // The parser knows this line only, as its line 1.
        let cause = cause.to_string().replace("at line 1 column", "at column");
        match line.trim_start() {
            list if list.starts_with('[') => {
                format!(
                    "{cause}; use one obstacle per line, not a list (obstacle file reads lists)"
                )
            }
            _ => cause,
        }
    });
    value
        .and_then(|value: Value| match value {
            Value::Array(_) => {
                Err("use one obstacle per line, not a list (obstacle file reads lists)".to_owned())
            }
            value => change(number, value),
        })
        .map(Some)
        .map_err(|cause| format!("line {number}: {cause}"))
}

fn change(number: usize, value: Value) -> Result<SceneChange, String> {
    let is_removal = value.get("remove").is_some();
    let (time_s, action) = if is_removal {
        let removed: Removed = read(value)?;
        (removed.time_s, SceneAction::Remove(removed.remove))
    } else {
        let known: KnownObstacle = read(value)?;
        (known.time_s, SceneAction::Upsert(obstacle(&known)?))
    };
    if !(0.0..=DURATION_MAX_S).contains(&time_s) {
        return Err(format!(
            "time_s = {time_s:?} is not 0 to {DURATION_MAX_S} s"
        ));
    }
    Ok(SceneChange {
        number,
        time_s,
        action,
    })
}

fn read<T: for<'de> Deserialize<'de>>(value: Value) -> Result<T, String> {
    serde_json::from_value(value).map_err(|cause| {
        format!(
            "{cause}; an obstacle is {{\"id\": 1, \"start_m\": [x, y, z], \"radius_m\": r}}, optionally with end_m \
             (a capsule), velocity_m_s, lifetime_ns, measured_ns and time_s; {{\"remove\": [1, 2]}} removes \
             obstacles"
        )
    })
}

fn obstacle(known: &KnownObstacle) -> Result<Obstacle, String> {
    let shape = match known.shape.as_deref() {
        None if known.end_m.is_some() => ObstacleShape::Capsule,
        None => ObstacleShape::Sphere,
        Some(name) => *ObstacleShape::ALL
            .iter()
            .find(|shape| shape.text() == name)
            .ok_or_else(|| format!("shape = {name:?} is neither sphere nor capsule"))?,
    };
    if shape == ObstacleShape::Capsule && known.end_m.is_none() {
        return Err("a capsule needs end_m".to_owned());
    }
    Ok(Obstacle {
        id: known.id,
        shape: shape.code(),
        start_m: known.start_m,
        end_m: known.end_m.unwrap_or(known.start_m),
        radius_m: known.radius_m,
        velocity_m_s: known.velocity_m_s,
        measured_ns: known.measured_ns,
        lifetime_ns: known.lifetime_ns,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::echo::json;

    #[test]
    fn what_the_list_prints_is_taken() {
        let sphere = Obstacle {
            id: 1,
            start_m: [0.1, 0.2, -0.3],
            end_m: [0.1, 0.2, -0.3],
            radius_m: 0.02,
            velocity_m_s: [0.0, 0.01, 0.0],
            measured_ns: 77,
            lifetime_ns: 5,
            ..Obstacle::default()
        };
        let capsule = Obstacle {
            id: 2,
            shape: ObstacleShape::Capsule.code(),
            end_m: [0.5, 0.0, 0.1],
            ..sphere
        };
        let all = [sphere, capsule];
        let rows = all.map(|one| json::message(&one));
        let lines = rows.clone().map(|row| row.to_string()).join("\n\n");
        let array = serde_json::to_string_pretty(&rows).expect("JSON");
        for text in [lines, array] {
            let changes = parse(&text).expect("legal");
            let read: Vec<_> = changes.into_iter().map(|change| change.action).collect();
            assert_eq!(read, all.map(SceneAction::Upsert));
        }
    }

    #[test]
    fn a_wrong_line_has_one_number() {
        let text = "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 0.1}\n{\"id\": nan}";
        let Err(error) = parse(text) else {
            panic!("no JSON")
        };
        assert!(error.starts_with("line 2: "), "{error}");
        assert!(
            error.contains(" at column ") && !error.contains("line 1"),
            "{error}"
        );
    }

    #[test]
    fn little_is_enough_and_some_go_again() {
        let text = "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 0.1}\n\
            {\"time_s\": 1.5, \"id\": 3, \"start_m\": [0, 0, 1], \"end_m\": [0, 1, 1], \"radius_m\": 0.1}\n\
            {\"time_s\": 2, \"remove\": [3]}";
        let changes = parse(text).expect("legal");
        let times_s: Vec<_> = changes.iter().map(|change| change.time_s).collect();
        assert_eq!(times_s, [0.0, 1.5, 2.0]);
        let shapes = changes.iter().filter_map(|change| match &change.action {
            SceneAction::Upsert(obstacle) => Some(ObstacleShape::text_of(obstacle.shape)),
            SceneAction::Remove(ids) => {
                assert_eq!(ids, &[3]);
                None
            }
        });
        assert_eq!(shapes.collect::<Vec<_>>(), ["sphere", "capsule"]);
    }

    #[test]
    fn more_obstacles_than_the_daemon_knows_are_refused_with_their_number() {
        let scene = |count: usize, more: &str| {
            let line =
                |id| format!("{{\"id\": {id}, \"start_m\": [0, 0, 1], \"radius_m\": 0.1{more}}}\n");
            (0..count).map(line).collect::<String>()
        };
        let checked = |text: &str| check_count(&parse(text).expect("legal"));
        assert_eq!(checked(&scene(64, "")), Ok(()));
        let error = checked(&scene(1000, "")).expect_err("too many");
        let start = "line 65: one obstacle more than the 64 that a daemon knows";
        assert!(error.starts_with(start), "{error}");
        let last = |line: &str| checked(&format!("{}{line}\n", scene(64, "")));
        let one_more = "\"start_m\": [0, 0, 1], \"radius_m\": 0.1}";
        assert!(last(&format!("{{\"id\": 64, {one_more}")).is_err());
        assert!(last(&format!("{{\"id\": 63, {one_more}")).is_ok(), "moved");
        let removed = format!("{{\"remove\": [7]}}\n{{\"id\": 64, {one_more}");
        assert!(last(&removed).is_ok());
        let short = scene(64, ", \"lifetime_ns\": 500000000");
        for (time_s, is_good) in [(0.4, false), (0.5, true)] {
            let later = format!("{short}{{\"time_s\": {time_s}, \"id\": 64, {one_more}\n");
            assert_eq!(checked(&later).is_ok(), is_good, "{time_s}");
        }
    }

    #[test]
    fn a_bad_line_is_named_with_its_reason() {
        let good = "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 0.1, \"time_s\": 1}\n";
        for (bad, parts) in [
            ("{\"id\": 3", &["line 3", "EOF"][..]),
            (
                "{\"id\": -3, \"start_m\": [0, 0, 1], \"radius_m\": 1}",
                &["line 3", "-3"],
            ),
            (
                "{\"id\": 3, \"start_m\": [0, 0], \"radius_m\": 1}",
                &["line 3", "3"],
            ),
            (
                "{\"id\": 3, \"radius_m\": 1}",
                &["line 3", "start_m", "an obstacle is"],
            ),
            (
                "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 1, \"r\": 2}",
                &["line 3", "`r`"],
            ),
            (
                "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 1, \"shape\": \"cube\"}",
                &["line 3", "cube"],
            ),
            (
                "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 1, \"shape\": \"capsule\"}",
                &["end_m"],
            ),
            (
                "{\"id\": 3, \"start_m\": [0, 0, 1], \"radius_m\": 1}",
                &["line 3", "before that of line 1"],
            ),
            ("{\"remove\": [3], \"time_s\": -1}", &["line 3", "-1"]),
            ("7", &["line 3", "an obstacle is"]),
            ("[", &["line 3", "not a list"]),
        ] {
            let error = parse(&format!("{good}\n{bad}\n")).expect_err(bad);
            for part in parts {
                assert!(error.contains(part), "{bad}: {error}");
            }
        }
        assert!(parse("[7]").expect_err("a number").contains("element 1"));
    }
}
