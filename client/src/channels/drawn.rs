use cdcr_interchange::cdr::{CdrError, to_bytes};
use cdcr_interchange::mcap::Channel;
use cdcr_interchange::standard::{
    Header, JointState, Log, MarkerArray, Message, Point, Pose, PoseStamped, Quaternion, TfMessage,
    Time, Transform, TransformStamped, Vector3,
};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::OrientationKind;

use super::happening::happenings;
use super::scene::DrawnScene;
use super::topic::TYPE_HASH;

/// Rate of the drawn pictures \[Hz\].
const PICTURES_HZ: u64 = 30;

/// A standard message for viewers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// `tf2_msgs/TFMessage`: from the base to the end of each section and to the tip.
    Transforms,
    /// `geometry_msgs/PoseStamped`: pose of the tip.
    Tip,
    /// `geometry_msgs/PoseStamped`: pose of the reference, while there is one.
    Reference,
    /// `sensor_msgs/JointState`: commanded cable lengths and speeds.
    Cables,
    /// `visualization_msgs/MarkerArray`: body, obstacles, paths of tip and reference, a line of text.
    Scene,
    /// `rcl_interfaces/Log`: events.
    Log,
}

impl Drawn {
    /// All standard messages; the index of each is its number.
    pub const ALL: [Self; 6] = [
        Self::Transforms,
        Self::Tip,
        Self::Reference,
        Self::Cables,
        Self::Scene,
        Self::Log,
    ];

    /// Channel of this message for a robot.
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
    /// Channel of the message.
    pub channel: Drawn,
    /// CDR header and data.
    pub data: Vec<u8>,
}

/// Converts telemetry records to standard messages: 30 pictures per second, and a log line per event.
#[derive(Debug)]
pub struct Drawings {
    robot: String,
    unix_minus_monotonic_ns: u64,
    scene: Option<DrawnScene>,
    before: Option<Box<Telemetry>>,
}

impl Drawings {
    /// For a robot; `unix_minus_monotonic_ns` converts `CLOCK_MONOTONIC` to the time since 1970 \[ns\].
    pub fn new(robot: &str, unix_minus_monotonic_ns: u64) -> Self {
        Self {
            robot: robot.to_owned(),
            unix_minus_monotonic_ns,
            scene: None,
            before: None,
        }
    }

    /// The messages for the next record.
    ///
    /// # Errors
    /// [`CdrError`] when a message cannot be encoded; these messages always can.
    pub fn encode(&mut self, record: &Telemetry) -> Result<Vec<Drawing>, CdrError> {
        let before = self.before.take();
        let before = before.filter(|before| before.header.sender_id == record.header.sender_id);
        if before.is_none() {
            self.scene = DrawnScene::from_record(record);
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

/// Three cables per section, base first.
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

/// Unit quaternion (x, y, z, w) of the reference, or of the shortest rotation from z to its axis.
fn reference_orientation(record: &Telemetry) -> [f64; 4] {
    let reference = &record.reference;
    match OrientationKind::try_from(reference.orientation_kind) {
        Ok(OrientationKind::Full) => reference.orientation,
        Ok(OrientationKind::Axis | OrientationKind::Preferred) => {
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
