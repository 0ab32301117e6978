//! Classic CDR (XCDR1), little-endian, after the four bytes of its encapsulation header: OMG DDSI-RTPS 2.5
//! §10. Alignment is relative to the end of the header.

use byteorder::LittleEndian;
use cdr_encoding::CdrDeserializer;
use serde::Serialize;
use serde::de::{DeserializeOwned, DeserializeSeed};

/// Plain CDR, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are not a valid message.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum CdrError {
    /// The encapsulation header is of another encoding, or missing.
    #[error("the first bytes are {0:?}, expected little-endian CDR, [0, 1, 0, 0]")]
    Encapsulation(Vec<u8>),
    /// The content is truncated, too long, or of another type.
    #[error("no such message: {0}")]
    Content(String),
}

/// Encodes a value with its header.
///
/// # Errors
/// [`CdrError::Content`] for a value that CDR cannot represent, such as a map of unknown length.
pub fn to_bytes(value: &impl Serialize) -> Result<Vec<u8>, CdrError> {
    let mut bytes = ENCAPSULATION.to_vec();
    cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, value)
        .map_err(|error| CdrError::Content(error.to_string()))?;
    Ok(bytes)
}

/// Decodes a value with its header.
///
/// # Errors
/// [`CdrError`] if the bytes are not exactly one such value.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    fill(bytes, core::marker::PhantomData)
}

/// Like [`from_bytes`], into the value of `seed`.
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
