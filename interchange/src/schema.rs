use core::fmt::Write as _;
use std::collections::BTreeMap;

use cdcr_shared_types::message::{Field, Kind, Meaning, MessageLayout};
use hiroz_schema::{
    FieldDescription, FieldTypeDescription, TypeDescription, TypeDescriptionMsg, TypeId,
    calculate_hash,
};

use crate::wire::{is_kept, is_sequence, is_text};

/// Package of the messages of this project.
const PACKAGE: &str = "cdcr_msgs";

/// Schema of a message for readers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// Package and name: `cdcr_msgs/msg/Telemetry`.
    pub name: String,
    /// The definition with those of all its parts, as `ros2msg` in MCAP:
    /// <https://mcap.dev/spec/registry#ros2msg>.
    pub text: String,
    /// The ROS 2 type hash, `RIHS01_…`: REP 2016.
    pub hash: String,
}

/// Schema of a message of the wire.
pub fn of_layout(layout: &'static MessageLayout) -> Schema {
    Definition::of_layout(layout).schema()
}

/// A message in the terms of ROS 2.
#[derive(Debug, Clone)]
pub(crate) struct Definition {
    lines: String,
    description: TypeDescription,
    parts: Vec<Definition>,
}

/// Type of a field.
pub(crate) enum FieldType {
    /// Name in a definition, and type id of a single value.
    Plain(&'static str, u8),
    Message(Definition),
    Array(Box<FieldType>, usize),
    Sequence(Box<FieldType>),
}

impl Definition {
    /// A definition without fields.
    pub(crate) fn new(name: &str) -> Self {
        Self {
            lines: String::new(),
            description: TypeDescription {
                type_name: name.to_owned(),
                fields: Vec::new(),
            },
            parts: Vec::new(),
        }
    }

    /// Adds a field; `note` is an optional comment.
    pub(crate) fn field(&mut self, name: &str, kind: FieldType, note: &str) {
        let mut field_type = FieldTypeDescription::primitive(0);
        let text = kind.describe(&mut field_type, &mut self.parts);
        let _ = write!(self.lines, "{text} {name}");
        if !note.is_empty() {
            let _ = write!(self.lines, "  # {note}");
        }
        self.lines.push('\n');
        self.description.fields.push(FieldDescription {
            name: name.to_owned(),
            field_type,
            default_value: String::new(),
        });
    }

    fn of_layout(layout: &'static MessageLayout) -> Self {
        let mut definition = Self::new(&format!("{PACKAGE}/msg/{}", layout.name));
        for field in layout.fields.iter().filter(|field| is_kept(field)) {
            definition.field(field.name, FieldType::from_field(field), &note(field));
        }
        definition
    }

    pub(crate) fn schema(&self) -> Schema {
        let mut parts = BTreeMap::new();
        self.collect(&mut parts);
        let name = &self.description.type_name;
        let mut text = self.lines.clone();
        for (name, part) in &parts {
            let _ = write!(
                text,
                "{}\nMSG: {}\n{}",
                "=".repeat(80),
                short(name),
                part.lines
            );
        }
        let referenced = parts.values().map(|part| part.description.clone());
        let hash = calculate_hash(&TypeDescriptionMsg {
            type_description: self.description.clone(),
            referenced_type_descriptions: referenced.collect(),
        });
        Schema {
            name: name.clone(),
            text,
            hash: hash.to_rihs_string(),
        }
    }

    /// All nested parts, by name.
    fn collect<'a>(&'a self, parts: &mut BTreeMap<&'a str, &'a Self>) {
        for part in &self.parts {
            parts.insert(&part.description.type_name, part);
            part.collect(parts);
        }
    }
}

impl FieldType {
    fn from_field(field: &Field) -> Self {
        match field.kind {
            Kind::Array(..) if is_text(field) => Self::Plain("string", TypeId::STRING),
            Kind::Array(element, _) if is_sequence(field) => {
                Self::Sequence(Box::new(Self::of_kind(element)))
            }
            kind => Self::of_kind(&kind),
        }
    }

    fn of_kind(kind: &Kind) -> Self {
        match *kind {
            Kind::U8 => Self::Plain("uint8", TypeId::UINT8),
            Kind::U32 => Self::Plain("uint32", TypeId::UINT32),
            Kind::U64 => Self::Plain("uint64", TypeId::UINT64),
            Kind::F64 => Self::Plain("float64", TypeId::FLOAT64),
            Kind::Array(element, count) => Self::Array(Box::new(Self::of_kind(element)), count),
            Kind::Struct(layout) => Self::Message(Definition::of_layout(layout)),
        }
    }

    /// Returns its text in a definition; fills in the type description for the hash.
    fn describe(self, into: &mut FieldTypeDescription, parts: &mut Vec<Definition>) -> String {
        match self {
            Self::Plain(text, id) => {
                into.type_id = id;
                text.to_owned()
            }
            Self::Message(definition) => {
                into.type_id = TypeId::NESTED_TYPE;
                into.nested_type_name
                    .clone_from(&definition.description.type_name);
                let text = short(&definition.description.type_name);
                parts.push(definition);
                text
            }
            Self::Array(element, count) => {
                let text = element.describe(into, parts);
                into.type_id += TypeId::ARRAY_OFFSET;
                into.capacity = count as u64;
                format!("{text}[{count}]")
            }
            Self::Sequence(element) => {
                let text = element.describe(into, parts);
                into.type_id += TypeId::UNBOUNDED_SEQUENCE_OFFSET;
                format!("{text}[]")
            }
        }
    }
}

/// The form `package/Name` of definitions.
fn short(name: &str) -> String {
    name.replace("/msg/", "/")
}

/// Unit, codes and conditions of a field.
fn note(field: &Field) -> String {
    let list = |values: &[(u32, &str, &str)]| {
        let values = values
            .iter()
            .map(|(value, name, _)| format!("{value} {name}"));
        values.collect::<Vec<_>>().join(", ")
    };
    let mut note = match field.meaning {
        Meaning::Code(codes) => list(codes.values),
        Meaning::Bits(bits) => format!("bits: {}", list(bits)),
        Meaning::Per(codes, first) => {
            let from = codes.values.get(first..).unwrap_or_default();
            format!("one for each of {}", list(from))
        }
        Meaning::Yes => "1: yes, 0: no".to_owned(),
        Meaning::OrNone => "the largest value: none".to_owned(),
        _ => field.unit.to_owned(),
    };
    if matches!(field.meaning, Meaning::OrNone) && !field.unit.is_empty() {
        note = format!("{}; {note}", field.unit);
    }
    if let Kind::Array(_, most) = field.kind
        && is_sequence(field)
    {
        note = format!(
            "{note}{}at most {most}",
            if note.is_empty() { "" } else { "; " }
        );
    }
    if let Some((other, code)) = field.when {
        note = format!("{note}; where {other} is {code}");
    }
    note
}
