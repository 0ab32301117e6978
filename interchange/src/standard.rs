//! The standard messages of ROS 2 (Jazzy) for viewers: <https://docs.ros.org/en/jazzy/p/>, package by
//! package.

use hiroz_schema::TypeId;
use serde::{Deserialize, Serialize};

use crate::schema::{Definition, FieldType, Schema};

/// A message, or a part of one.
pub trait Message: Serialize {
    /// Name, definition and hash.
    fn schema() -> Schema;
}

/// A type for fields.
trait FieldTyped {
    fn field_type() -> FieldType;
}

macro_rules! plain {
    ($($type:ty, $text:literal, $id:ident;)+) => { $(
        impl FieldTyped for $type {
            fn field_type() -> FieldType { FieldType::Plain($text, TypeId::$id) }
        }
    )+ };
}
plain! {
    bool, "bool", BOOL;
    u8, "uint8", UINT8;
    i32, "int32", INT32;
    u32, "uint32", UINT32;
    f32, "float32", FLOAT32;
    f64, "float64", FLOAT64;
    String, "string", STRING;
}

impl<T: FieldTyped> FieldTyped for Vec<T> {
    fn field_type() -> FieldType {
        FieldType::Sequence(Box::new(T::field_type()))
    }
}

/// The type `byte`, which has its own type id and is encoded as an 8-bit number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Byte(pub u8);

impl FieldTyped for Byte {
    fn field_type() -> FieldType {
        FieldType::Plain("byte", TypeId::BYTE)
    }
}

// Declares messages with their fields in order; `field as "name"` for a name that is a keyword of Rust.
macro_rules! messages {
    ($($(#[$meta:meta])* $name:literal $type:ident {
        $($field:ident $(as $written:literal)?: $part:ty,)+
    })+) => { $(
        $(#[$meta])*
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[allow(missing_docs, reason = "the fields are those of the standard")]
        pub struct $type { $($(#[serde(rename = $written)])? pub $field: $part,)+ }

        impl FieldTyped for $type {
            fn field_type() -> FieldType { FieldType::Message($type::definition()) }
        }

        impl $type {
            fn definition() -> Definition {
                let mut definition = Definition::new($name);
                $(definition.field(messages!(@ $field $($written)?), <$part>::field_type(), "");)+
                definition
            }
        }

        impl Message for $type {
            fn schema() -> Schema { Self::definition().schema() }
        }
    )+ };
    (@ $field:ident) => { stringify!($field) };
    (@ $field:ident $written:literal) => { $written };
}

messages! {
    /// A time since 1970.
    "builtin_interfaces/msg/Time" Time { sec: i32, nanosec: u32, }
    /// Difference of two times.
    "builtin_interfaces/msg/Duration" Duration { sec: i32, nanosec: u32, }
    /// Time and frame.
    "std_msgs/msg/Header" Header { stamp: Time, frame_id: String, }
    /// A colour, each component 0 to 1.
    "std_msgs/msg/ColorRGBA" ColorRgba { r: f32, g: f32, b: f32, a: f32, }
    /// A position (m).
    "geometry_msgs/msg/Point" Point { x: f64, y: f64, z: f64, }
    /// A direction or size.
    "geometry_msgs/msg/Vector3" Vector3 { x: f64, y: f64, z: f64, }
    /// A unit quaternion.
    "geometry_msgs/msg/Quaternion" Quaternion { x: f64, y: f64, z: f64, w: f64, }
    /// Position and orientation.
    "geometry_msgs/msg/Pose" Pose { position: Point, orientation: Quaternion, }
    /// A pose with time and frame.
    "geometry_msgs/msg/PoseStamped" PoseStamped { header: Header, pose: Pose, }
    /// A transform between two frames.
    "geometry_msgs/msg/Transform" Transform { translation: Vector3, rotation: Quaternion, }
    /// A transform with its time, from `child_frame_id` to the frame of the header.
    "geometry_msgs/msg/TransformStamped" TransformStamped { header: Header, child_frame_id: String, transform: Transform, }
    /// All transforms of one time.
    "tf2_msgs/msg/TFMessage" TfMessage { transforms: Vec<TransformStamped>, }
    /// Named positions, velocities and efforts: the cables (m, m/s).
    "sensor_msgs/msg/JointState" JointState {
        header: Header, name: Vec<String>, position: Vec<f64>, velocity: Vec<f64>, effort: Vec<f64>,
    }
    /// An image; a part of a marker.
    "sensor_msgs/msg/CompressedImage" CompressedImage { header: Header, format: String, data: Vec<u8>, }
    /// A position in an image.
    "visualization_msgs/msg/UVCoordinate" UvCoordinate { u: f32, v: f32, }
    /// A file with a mesh; a part of a marker.
    "visualization_msgs/msg/MeshFile" MeshFile { filename: String, data: Vec<u8>, }
    /// A shape for a viewer.
    "visualization_msgs/msg/Marker" Marker {
        header: Header, ns: String, id: i32, kind as "type": i32, action: i32, pose: Pose, scale: Vector3, color: ColorRgba,
        lifetime: Duration, frame_locked: bool, points: Vec<Point>, colors: Vec<ColorRgba>, texture_resource: String,
        texture: CompressedImage, uv_coordinates: Vec<UvCoordinate>, text: String, mesh_resource: String, mesh_file: MeshFile,
        mesh_use_embedded_materials: bool,
    }
    /// All markers of a scene.
    "visualization_msgs/msg/MarkerArray" MarkerArray { markers: Vec<Marker>, }
    /// A named value.
    "diagnostic_msgs/msg/KeyValue" KeyValue { key: String, value: String, }
    /// State of a component: 0 good, 1 warning, 2 error, 3 stale.
    "diagnostic_msgs/msg/DiagnosticStatus" DiagnosticStatus {
        level: Byte, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// States of all components.
    "diagnostic_msgs/msg/DiagnosticArray" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus>, }
    /// A log line; level 10 debug, 20 info, 30 warning, 40 error, 50 fatal.
    "rcl_interfaces/msg/Log" Log {
        stamp: Time, level: u8, name: String, msg: String, file: String, function: String, line: u32,
    }
}

/// Shapes and actions of a [`Marker`].
pub mod shape {
    /// A [`Marker::action`](super::Marker::action), not a shape: deletes all markers.
    pub const DELETE_ALL: i32 = 3;
    /// A sphere or ellipsoid with the diameters `scale`.
    pub const SPHERE: i32 = 2;
    /// A cylinder along z with the diameters `scale.x` and `scale.y` and the length `scale.z`.
    pub const CYLINDER: i32 = 3;
    /// A line through `points` with the width `scale.x`.
    pub const LINE_STRIP: i32 = 4;
    /// A text that faces the viewer, with the height `scale.z`.
    pub const TEXT_VIEW_FACING: i32 = 9;
}
