use cdcr_interchange::cdr::{CdrError, to_bytes};
use cdcr_interchange::mcap::Channel;
use cdcr_interchange::standard::{
    Header, JointState, Log, MarkerArray, Message, Point, Pose, PoseStamped, Quaternion, TfMessage,
    Time, Transform, TransformStamped, Vector3,
};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::OrientationKind;

use super::happening::happenings;
use super::scene::Scene;
use super::topic::TYPE_HASH;

/// How often a picture is made \[Hz\].
const PICTURES_HZ: u64 = 30;

/// A standard message that viewers draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// `tf2_msgs/TFMessage`: from the base to the end of each section and to the tip.
    Transforms,
    /// `geometry_msgs/PoseStamped`: the tip.
    Tip,
    /// `geometry_msgs/PoseStamped`: where the tip shall be, while there is a reference.
    Reference,
    /// `sensor_msgs/JointState`: lengths and speeds of the cables as commanded.
    Cables,
    /// `visualization_msgs/MarkerArray`: body, obstacles, the ways of tip and reference, a line of text.
    Scene,
    /// `rcl_interfaces/Log`: what happened.
    Log,
}

impl Drawn {
    /// All of them; the place of each is its number.
    pub const ALL: [Self; 6] = [
        Self::Transforms,
        Self::Tip,
        Self::Reference,
        Self::Cables,
        Self::Scene,
        Self::Log,
    ];

    /// Its channel, of the daemon of this robot.
    pub fn channel(self, robot: &str) -> Channel {
        let (name, schema) = match self {
            Self::Transforms => ("", TfMessage::schema()),
            Self::Tip => ("tip", PoseStamped::schema()),
            Self::Reference => ("reference", PoseStamped::schema()),
            Self::Cables => ("cables", JointState::schema()),
            Self::Scene => ("scene", MarkerArray::schema()),
            Self::Log => ("log", Log::schema()),
        };
        Channel {
            topic: if name.is_empty() {
                "/tf".to_owned()
            } else {
                format!("/cdcr/{robot}/view/{name}")
            },
            schema: schema.name,
            text: schema.text,
            metadata: [(TYPE_HASH.to_owned(), schema.hash)].into(),
        }
    }
}

/// One message for viewers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drawing {
    /// On which channel.
    pub channel: Drawn,
    /// Header and bytes, CDR.
    pub data: Vec<u8>,
}

/// Makes the standard messages of telemetry records: a picture 30 times a second, and a line of the log for each thing that happens.
#[derive(Debug)]
pub struct Drawings {
    robot: String,
    unix_minus_monotonic_ns: u64,
    scene: Option<Scene>,
    before: Option<Box<Telemetry>>,
}

impl Drawings {
    /// Of the daemon of this robot; with what leads from `CLOCK_MONOTONIC` to the time since 1970 \[ns\].
    pub fn new(robot: &str, unix_minus_monotonic_ns: u64) -> Self {
        Self {
            robot: robot.to_owned(),
            unix_minus_monotonic_ns,
            scene: None,
            before: None,
        }
    }

    /// What the next record adds.
    ///
    /// # Errors
    /// [`CdrError`] where a message cannot be encoded; these can.
    pub fn of(&mut self, record: &Telemetry) -> Result<Vec<Drawing>, CdrError> {
        let before = self.before.take();
        let before = before.filter(|before| before.header.sender_id == record.header.sender_id);
        if before.is_none() {
            self.scene = Scene::of(record);
        }
        let mut drawings = self.log(record, before.as_deref())?;
        let picture = |record: &Telemetry| {
            u128::from(record.release_ns) * u128::from(PICTURES_HZ) / 1_000_000_000
        };
        if before.is_none_or(|before| picture(&before) != picture(record)) {
            self.draw(record, &mut drawings)?;
        }
        self.before = Some(Box::new(*record));
        Ok(drawings)
    }

    fn log(
        &self,
        record: &Telemetry,
        before: Option<&Telemetry>,
    ) -> Result<Vec<Drawing>, CdrError> {
        let lines = happenings(record, before).into_iter().map(|happening| {
            let log = Log {
                stamp: self.stamp(record),
                level: happening.level as u8,
                name: self.robot.clone(),
                msg: happening.text,
                ..Log::default()
            };
            Ok(Drawing {
                channel: Drawn::Log,
                data: to_bytes(&log)?,
            })
        });
        lines.collect()
    }

    fn draw(&mut self, record: &Telemetry, drawings: &mut Vec<Drawing>) -> Result<(), CdrError> {
        let header = Header {
            stamp: self.stamp(record),
            frame_id: self.frame("base"),
        };
        let mut put = |channel, data| drawings.push(Drawing { channel, data });
        let tip = pose(record.tip_position_m, record.tip_orientation);
        put(Drawn::Cables, to_bytes(&cables(record, &header))?);
        if record.position_error_m.is_finite() {
            let pose = pose(record.reference.position_m, reference_orientation(record));
            let header = header.clone();
            put(Drawn::Reference, to_bytes(&PoseStamped { header, pose })?);
        }
        let has_shape = self.scene.as_mut().is_some_and(|scene| scene.take(record));
        let Some(scene) = self.scene.as_ref().filter(|_| has_shape) else {
            return Ok(());
        };
        let markers = MarkerArray {
            markers: scene.markers(record, &header),
        };
        put(Drawn::Scene, to_bytes(&markers)?);
        let frames = scene.section_ends(record);
        let frames = frames
            .into_iter()
            .enumerate()
            .map(|(j, pose)| (format!("section_{}", j + 1), pose))
            .chain([("tip".to_owned(), tip.clone())]);
        let transforms = frames
            .map(|(name, pose)| TransformStamped {
                header: header.clone(),
                child_frame_id: self.frame(&name),
                transform: transform(pose),
            })
            .collect();
        put(Drawn::Transforms, to_bytes(&TfMessage { transforms })?);
        put(Drawn::Tip, to_bytes(&PoseStamped { header, pose: tip })?);
        Ok(())
    }

    fn frame(&self, name: &str) -> String {
        format!("{}/{name}", self.robot)
    }

    fn stamp(&self, record: &Telemetry) -> Time {
        let unix_ns = record.release_ns + self.unix_minus_monotonic_ns;
        Time {
            sec: (unix_ns / 1_000_000_000) as i32,
            nanosec: (unix_ns % 1_000_000_000) as u32,
        }
    }
}

/// Three cables of each section, base first.
fn cables(record: &Telemetry, header: &Header) -> JointState {
    let command = &record.command;
    let count = (3 * command.sections as usize).min(command.cable_length_m.len());
    JointState {
        header: header.clone(),
        name: (0..count)
            .map(|i| format!("section_{}_cable_{}", i / 3 + 1, i % 3 + 1))
            .collect(),
        position: command.cable_length_m[..count].to_vec(),
        velocity: command.cable_speed_m_s[..count].to_vec(),
        effort: Vec::new(),
    }
}

/// A unit quaternion (x, y, z, w): that of the reference, or the shortest turn from z to its axis.
fn reference_orientation(record: &Telemetry) -> [f64; 4] {
    let reference = &record.reference;
    match OrientationKind::try_from(reference.orientation_kind) {
        Ok(OrientationKind::Full) => reference.orientation,
        Ok(OrientationKind::Axis) => {
            let [x, y, z, _] = reference.orientation;
            super::scene::upright_to([x, y, z].into())
        }
        Ok(OrientationKind::None) | Err(_) => [0.0, 0.0, 0.0, 1.0],
    }
}

pub(super) fn pose(position_m: [f64; 3], orientation: [f64; 4]) -> Pose {
    Pose {
        position: point(position_m),
        orientation: quaternion(orientation),
    }
}

pub(super) fn point([x, y, z]: [f64; 3]) -> Point {
    Point { x, y, z }
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

fn transform(pose: Pose) -> Transform {
    let Point { x, y, z } = pose.position;
    Transform {
        translation: Vector3 { x, y, z },
        rotation: pose.orientation,
    }
}

#[cfg(test)]
mod tests;
