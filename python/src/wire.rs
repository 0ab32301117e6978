//! Messages as rows of structured arrays. Names, kinds and meanings come from the declaration of the
//! messages.

use cdcr_shared_types::LAYOUTS;
use cdcr_shared_types::codes::Codes;
use cdcr_shared_types::message::{Array, Field, Kind, Meaning, MessageLayout, Struct, Value};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::type_hint_identifier;
use pyo3::types::{PyByteArray, PyDict, PyList};

use crate::errors::Failure;

/// Consecutive messages of one kind.
pub(crate) struct Records {
    layout: &'static MessageLayout,
    bytes: Vec<u8>,
}

impl Records {
    pub(crate) fn new(layout: &'static MessageLayout) -> Self {
        Self {
            layout,
            bytes: Vec::new(),
        }
    }

    /// One message.
    pub(crate) fn from_message(message: &dyn Struct) -> Self {
        let mut records = Self::new(message.layout());
        records.push(message);
        records
    }

    pub(crate) fn push(&mut self, message: &dyn Struct) {
        self.bytes.reserve(self.layout.size);
        pack_struct(message, &mut self.bytes);
        debug_assert!(self.bytes.len().is_multiple_of(self.layout.size));
    }

    /// Appends the records of a later period.
    pub(crate) fn append(&mut self, more: Self) {
        self.bytes.extend(more.bytes);
    }

    pub(crate) fn count(&self) -> usize {
        self.bytes.len() / self.layout.size
    }

    /// The only message as a dictionary.
    pub(crate) fn into_message(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let array = self.into_pyobject(py)?;
        let messages = py.import("cdcr._records")?;
        let message = messages.call_method1("message", (array.get_item(0)?,))?;
        Ok(message.cast_into()?)
    }
}

impl<'py> IntoPyObject<'py> for Records {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_identifier!("builtins", "Records");

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
        let bytes = PyByteArray::new(py, &self.bytes);
        let dtype = numpy_type(py, self.layout)?;
        py.import("numpy")?
            .call_method1("frombuffer", (bytes, dtype))
    }
}

/// The fields of a message are contiguous (`shared-types/src/message.rs`), and so are their values.
fn pack_struct(message: &dyn Struct, out: &mut Vec<u8>) {
    message.visit(&mut |_, value| pack(value, out));
}

fn pack(value: Value<'_>, out: &mut Vec<u8>) {
    match value {
        Value::U8(number) => out.push(number),
        Value::U32(number) => out.extend(number.to_ne_bytes()),
        Value::U64(number) => out.extend(number.to_ne_bytes()),
        Value::F64(number) => out.extend(number.to_ne_bytes()),
        Value::Array(array) => pack_array(array, out),
        Value::Struct(message) => pack_struct(message, out),
    }
}

fn pack_array(array: &dyn Array, out: &mut Vec<u8>) {
    for index in 0..array.count() {
        pack(array.element(index), out);
    }
}

/// The numpy type of a message: its fields with names and offsets.
fn numpy_type<'py>(py: Python<'py>, layout: &'static MessageLayout) -> PyResult<Bound<'py, PyAny>> {
    let (names, formats, offsets) = (PyList::empty(py), PyList::empty(py), PyList::empty(py));
    for field in layout.fields {
        names.append(field.name)?;
        formats.append(format(py, field)?)?;
        offsets.append(field.offset)?;
    }
    let described = PyDict::new(py);
    described.set_item("names", names)?;
    described.set_item("formats", formats)?;
    described.set_item("offsets", offsets)?;
    described.set_item("itemsize", layout.size)?;
    py.import("numpy")?.call_method1("dtype", (described,))
}

fn format<'py>(py: Python<'py>, field: &'static Field) -> PyResult<Bound<'py, PyAny>> {
    match (field.meaning, field.kind) {
        (Meaning::Text, Kind::Array(_, bytes)) => {
            Ok(format!("S{bytes}").into_pyobject(py)?.into_any())
        }
        (_, kind) => format_of(py, kind),
    }
}

fn format_of(py: Python<'_>, kind: Kind) -> PyResult<Bound<'_, PyAny>> {
    let word = |word: &str| Ok(word.into_pyobject(py)?.into_any());
    match kind {
        Kind::U8 => word("u1"),
        Kind::U32 => word("u4"),
        Kind::U64 => word("u8"),
        Kind::F64 => word("f8"),
        Kind::Array(element, count) => {
            let array = (format_of(py, *element)?, (count,));
            Ok(array.into_pyobject(py)?.into_any())
        }
        Kind::Struct(layout) => numpy_type(py, layout),
    }
}

/// The numpy type of a message or a part of one, by its name, such as "Telemetry".
#[pyfunction]
#[pyo3(signature = (name) -> "np.dtype[np.void]")]
pub(crate) fn dtype<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    numpy_type(py, layout(name)?)
}

/// The fields of a message: name, unit, enumeration whose codes it holds (empty: none) and what it is.
#[pyfunction]
pub(crate) fn fields(
    name: &str,
) -> PyResult<Vec<(&'static str, &'static str, &'static str, &'static str)>> {
    let described = |field: &Field| {
        let codes = match field.meaning {
            Meaning::Code(codes) => codes.name,
            _ => "",
        };
        (field.name, field.unit, codes, field.doc)
    };
    Ok(layout(name)?.fields.iter().map(described).collect())
}

/// The names of all messages and of their parts.
#[pyfunction]
pub(crate) fn messages() -> Vec<&'static str> {
    LAYOUTS.iter().map(|layout| layout.name).collect()
}

/// Value, name and meaning of each code.
type Values = Vec<(u32, &'static str, &'static str)>;

/// The enumerations of the messages: their names, and of each code value, name and meaning.
#[pyfunction]
pub(crate) fn enumerations() -> Vec<(&'static str, Values)> {
    let mut found: Vec<&'static Codes> = Vec::new();
    for field in LAYOUTS.iter().flat_map(|layout| layout.fields) {
        if let Meaning::Code(codes) | Meaning::Per(codes, _) = field.meaning
            && !found.iter().any(|known| known.name == codes.name)
        {
            found.push(codes);
        }
    }
    let described = found
        .into_iter()
        .map(|codes| (codes.name, codes.values.to_vec()));
    described.collect()
}

fn layout(name: &str) -> Result<&'static MessageLayout, Failure> {
    let found = LAYOUTS.iter().find(|layout| layout.name == name);
    found.copied().ok_or_else(|| {
        let names: Vec<_> = LAYOUTS.iter().map(|layout| layout.name).collect();
        Failure::argument(
            format!("no message is called {name:?}"),
            format!("Use one of: {}.", names.join(", ")),
        )
    })
}
