//! Classic CDR (XCDR1), little-endian, behind the four bytes of its encapsulation header: OMG DDSI-RTPS 2.5 §10.
//! Alignment counts from after the header.

use byteorder::LittleEndian;
use cdr_encoding::CdrDeserializer;
use serde::Serialize;
use serde::de::{DeserializeOwned, DeserializeSeed};

/// Plain CDR, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Bytes that are not what they should be.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum CdrError {
    /// Another encoding, or none.
    #[error("the first bytes are {0:?}, expected little-endian CDR, [0, 1, 0, 0]")]
    Encapsulation(Vec<u8>),
    /// Cut, too long, or of another type.
    #[error("no such message: {0}")]
    Content(String),
}

/// Header and bytes of a value.
///
/// # Errors
/// [`CdrError::Content`], where the value is of a kind that CDR lacks, such as a map of unknown length.
pub fn to_bytes(value: &impl Serialize) -> Result<Vec<u8>, CdrError> {
    let mut bytes = ENCAPSULATION.to_vec();
    cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, value)
        .map_err(|error| CdrError::Content(error.to_string()))?;
    Ok(bytes)
}

/// The value of header and bytes.
///
/// # Errors
/// [`CdrError`], where the bytes are no such value or more than one.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    fill(bytes, core::marker::PhantomData)
}

/// As [`from_bytes`], into what `seed` has.
pub(crate) fn fill<'a, S: DeserializeSeed<'a>>(
    bytes: &'a [u8],
    seed: S,
) -> Result<S::Value, CdrError> {
    let head = &bytes[..bytes.len().min(ENCAPSULATION.len())];
    let content = bytes
        .strip_prefix(&ENCAPSULATION)
        .ok_or_else(|| CdrError::Encapsulation(head.to_vec()))?;
    let mut deserializer = CdrDeserializer::<LittleEndian>::new(content);
    let value = seed
        .deserialize(&mut deserializer)
        .map_err(|error| CdrError::Content(error.to_string()))?;
    let more = content.len() - deserializer.bytes_consumed();
    if more > 0 {
        return Err(CdrError::Content(format!("{more} bytes too many")));
    }
    Ok(value)
}
