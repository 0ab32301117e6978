//! One random message of each kind in a folder, for readers that others wrote: schema, bytes, type hash, and what they hold.
//!
//! ```sh
//! cargo run -p cdcr-interchange --example samples -- FOLDER
//! ```

use std::error::Error;
use std::path::{Path, PathBuf};

use cdcr_interchange::standard::{
    DiagnosticArray, JointState, Log, MarkerArray, Message, PoseStamped, TfMessage,
};
use cdcr_interchange::{Schema, cdr, encode, of_layout, sample};
use cdcr_shared_types::message::{Meaning, Struct, Value as Held};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args_os().nth(1).ok_or("which folder?")?);
    for message in sample::random(1) {
        let schema = of_layout(message.layout());
        write(&folder, &schema, &encode(&*message)?, &content(&*message))?;
    }
    let header = json!({"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"});
    let pose = json!({"position": {"x": 1.5, "y": -0.0, "z": 1e300}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}});
    let point = json!({"x": 0.25, "y": 0.5, "z": -0.125});
    let color = json!({"r": 1.0, "g": 0.5, "b": 0.25, "a": 1.0});
    let time = json!({"sec": -1, "nanosec": 999_999_999});
    standard::<PoseStamped>(&folder, &json!({"header": header, "pose": pose}))?;
    let transform = json!({"translation": point, "rotation": pose["orientation"]});
    let transform = json!({"header": header, "child_frame_id": "tip", "transform": transform});
    standard::<TfMessage>(&folder, &json!({"transforms": [transform, transform]}))?;
    let joints = json!({"header": header, "name": ["cable_1"], "position": [0.5], "velocity": [], "effort": [0.25, 1.0]});
    standard::<JointState>(&folder, &joints)?;
    let marker = json!({
        "header": header, "ns": "robot", "id": -1, "type": 4, "action": 0, "pose": pose, "scale": point, "color": color,
        "lifetime": time, "frame_locked": true, "points": [point, point], "colors": [color], "texture_resource": "",
        "texture": {"header": header, "format": "png", "data": [1, 2, 255]}, "uv_coordinates": [{"u": 0.5, "v": 1.0}],
        "text": "tracking", "mesh_resource": "", "mesh_file": {"filename": "", "data": []},
        "mesh_use_embedded_materials": false
    });
    standard::<MarkerArray>(&folder, &json!({"markers": [marker]}))?;
    let status = json!({"level": 2, "name": "loop", "message": "µs", "hardware_id": "", "values": [{"key": "a", "value": "b"}]});
    standard::<DiagnosticArray>(&folder, &json!({"header": header, "status": [status]}))?;
    let log = json!({"stamp": time, "level": 20, "name": "cdcrd", "msg": "begins", "file": "", "function": "", "line": 7});
    standard::<Log>(&folder, &log)
}

fn standard<M: Message + DeserializeOwned>(
    folder: &Path,
    content: &Value,
) -> Result<(), Box<dyn Error>> {
    let message: M = serde_json::from_value(content.clone())?;
    write(folder, &M::schema(), &cdr::to_bytes(&message)?, content)
}

fn write(
    folder: &Path,
    schema: &Schema,
    bytes: &[u8],
    content: &Value,
) -> Result<(), Box<dyn Error>> {
    let name = schema.name.replace('/', ".");
    let file = |ending: &str| folder.join(format!("{name}.{ending}"));
    std::fs::write(file("msg"), &schema.text)?;
    std::fs::write(file("cdr"), bytes)?;
    std::fs::write(file("hash"), &schema.hash)?;
    std::fs::write(file("json"), content.to_string())?;
    Ok(())
}

/// What a message holds, from its fields and not from its bytes. Numbers that JSON lacks, and those that Python and JavaScript read
/// differently, are texts.
fn content(message: &dyn Struct) -> Value {
    let mut object = serde_json::Map::new();
    message.visit(&mut |field, held| {
        if matches!(field.meaning, Meaning::Reserved) {
            return;
        }
        let mut value = value(held);
        if let Value::Array(elements) = &mut value {
            if matches!(field.meaning, Meaning::Text) {
                let letters = elements.iter().filter_map(Value::as_u64);
                let text: String = letters
                    .take_while(|letter| *letter != 0)
                    .filter_map(|letter| char::from_u32(letter as u32))
                    .collect();
                object.insert(field.name.to_owned(), text.into());
                return;
            }
            if field.used.is_some() {
                elements.truncate(message.used(field).unwrap_or(0));
            }
        }
        object.insert(field.name.to_owned(), value);
    });
    object.into()
}

fn value(held: Held<'_>) -> Value {
    match held {
        Held::U8(number) => number.into(),
        Held::U32(number) => number.into(),
        Held::U64(number) => number.to_string().into(),
        Held::F64(number) if number.is_nan() => "NaN".into(),
        Held::F64(number) if number.is_infinite() => "Infinity".into(),
        Held::F64(number) => number.into(),
        Held::Struct(message) => content(message),
        Held::Array(array) => (0..array.count())
            .map(|i| value(array.element(i)))
            .collect(),
    }
}
