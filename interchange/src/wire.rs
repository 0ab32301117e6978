use core::fmt;

use cdcr_shared_types::message::{Array, Field, Kind, Meaning, Struct, Value, ValueMut};
use serde::de::{Deserialize, DeserializeSeed, Deserializer, Error as _, SeqAccess, Visitor};
use serde::ser::{Serialize, SerializeSeq, SerializeTuple, Serializer};

use crate::cdr::{self, CdrError};

/// Encodes a message of the wire as CDR: the used elements of arrays, without reserved fields.
///
/// # Errors
/// When a text is not UTF-8; no client or daemon of this project sends one.
pub fn encode(message: &dyn Struct) -> Result<Vec<u8>, CdrError> {
    cdr::to_bytes(&EncodedStruct(message))
}

/// Decodes the output of [`encode`] into `message`. Unused elements become zero, and reserved fields are
/// zero.
///
/// # Errors
/// [`CdrError`]; `message` is then partly overwritten.
pub fn decode(bytes: &[u8], message: &mut dyn Struct) -> Result<(), CdrError> {
    cdr::fill(bytes, MessageMut(message))
}

/// Whether a field is encoded.
pub(crate) fn is_kept(field: &Field) -> bool {
    !matches!(field.meaning, Meaning::Reserved)
}

pub(crate) fn is_text(field: &Field) -> bool {
    matches!(field.meaning, Meaning::Text)
}

/// Whether a field is encoded as a sequence of its used elements.
pub(crate) fn is_sequence(field: &Field) -> bool {
    field.used.is_some() && matches!(field.kind, Kind::Array(..))
}

struct EncodedStruct<'a>(&'a dyn Struct);

impl Serialize for EncodedStruct<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = Vec::new();
        self.0.visit(&mut |field, value| {
            if is_kept(field) {
                fields.push((field, value));
            }
        });
        let mut tuple = serializer.serialize_tuple(fields.len())?;
        for (field, value) in fields {
            match value {
                Value::Array(array) if is_text(field) => {
                    let bytes = (0..array.count()).map(|i| match array.element(i) {
                        Value::U8(byte) => byte,
                        _ => 0,
                    });
                    let text = bytes.take_while(|byte| *byte != 0).collect();
                    let text = String::from_utf8(text).map_err(serde::ser::Error::custom)?;
                    tuple.serialize_element(&text)?;
                }
                Value::Array(array) if is_sequence(field) => {
                    let used = self.0.used(field).unwrap_or(0);
                    tuple.serialize_element(&Sequence(array, used))?;
                }
                value => tuple.serialize_element(&Plain(value))?,
            }
        }
        tuple.end()
    }
}

/// A number, a struct, or an array of a fixed length.
struct Plain<'a>(Value<'a>);

impl Serialize for Plain<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Value::U8(number) => serializer.serialize_u8(number),
            Value::U32(number) => serializer.serialize_u32(number),
            Value::U64(number) => serializer.serialize_u64(number),
            Value::F64(number) => serializer.serialize_f64(number),
            Value::Struct(message) => EncodedStruct(message).serialize(serializer),
            Value::Array(array) => {
                let mut tuple = serializer.serialize_tuple(array.count())?;
                for i in 0..array.count() {
                    tuple.serialize_element(&Plain(array.element(i)))?;
                }
                tuple.end()
            }
        }
    }
}

/// The first elements of an array.
struct Sequence<'a>(&'a dyn Array, usize);

impl Serialize for Sequence<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut sequence = serializer.serialize_seq(Some(self.1))?;
        for i in 0..self.1 {
            sequence.serialize_element(&Plain(self.0.element(i)))?;
        }
        sequence.end()
    }
}

struct MessageMut<'a>(&'a mut dyn Struct);

impl<'de> DeserializeSeed<'de> for MessageMut<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let mut fields = Vec::new();
        self.0.visit_mut(&mut |field, value| {
            if is_kept(field) {
                fields.push((field, value));
            }
        });
        deserializer.deserialize_tuple(fields.len(), Fields(fields))
    }
}

struct Fields<'a>(Vec<(&'static Field, ValueMut<'a>)>);

impl<'de> Visitor<'de> for Fields<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the fields of a message")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<(), A::Error> {
        for (field, value) in self.0 {
            let part = PartMut { field, value };
            if sequence.next_element_seed(part)?.is_none() {
                return Err(A::Error::custom(format_args!("{} is missing", field.name)));
            }
        }
        Ok(())
    }
}

/// A field with its value.
struct PartMut<'a> {
    field: &'static Field,
    value: ValueMut<'a>,
}

impl<'de> DeserializeSeed<'de> for PartMut<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let name = self.field.name;
        match self.value {
            ValueMut::Array(array) if is_text(self.field) => {
                let text = String::deserialize(deserializer)?;
                let most = array.count();
                if text.len() > most {
                    return Err(D::Error::custom(TooMany { name, most }));
                }
                for i in 0..most {
                    if let ValueMut::U8(byte) = array.element_mut(i) {
                        *byte = text.as_bytes().get(i).copied().unwrap_or(0);
                    }
                }
                Ok(())
            }
            ValueMut::Array(array) if is_sequence(self.field) => {
                deserializer.deserialize_seq(Elements { name, array })
            }
            value => PlainMut { name, value }.deserialize(deserializer),
        }
    }
}

/// A number, a struct, or an array of a fixed length.
struct PlainMut<'a> {
    name: &'static str,
    value: ValueMut<'a>,
}

impl<'de> DeserializeSeed<'de> for PlainMut<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let name = self.name;
        match self.value {
            ValueMut::U8(number) => *number = u8::deserialize(deserializer)?,
            ValueMut::U32(number) => *number = u32::deserialize(deserializer)?,
            ValueMut::U64(number) => *number = u64::deserialize(deserializer)?,
            ValueMut::F64(number) => *number = f64::deserialize(deserializer)?,
            ValueMut::Struct(message) => MessageMut(message).deserialize(deserializer)?,
            ValueMut::Array(array) => {
                deserializer.deserialize_tuple(array.count(), Elements { name, array })?;
            }
        }
        Ok(())
    }
}

struct Elements<'a> {
    name: &'static str,
    array: &'a mut dyn Array,
}

impl<'de> Visitor<'de> for Elements<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "elements of {}", self.name)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<(), A::Error> {
        let (name, most) = (self.name, self.array.count());
        for i in 0..most {
            let value = self.array.element_mut(i);
            if sequence
                .next_element_seed(PlainMut { name, value })?
                .is_none()
            {
                return Ok(());
            }
        }
        sequence.next_element_seed(TooMany { name, most }).map(drop)
    }
}

/// Refuses an additional element.
struct TooMany {
    name: &'static str,
    most: usize,
}

impl fmt::Display for TooMany {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "more than {} elements of {}", self.most, self.name)
    }
}

impl<'de> DeserializeSeed<'de> for TooMany {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, _: D) -> Result<(), D::Error> {
        Err(D::Error::custom(self))
    }
}

#[cfg(test)]
mod tests;
