//! Conversion of arrays: each argument is one array of doubles whose last axes have lengths given by the
//! robot.

use numpy::{
    IxDyn, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::type_hint_identifier;
use pyo3::types::{PyFloat, PyList, PyTuple};

use crate::errors::Failure;

/// An argument as contiguous doubles, without a copy if the array is contiguous already.
pub(crate) struct Numbers<'py> {
    array: PyReadonlyArrayDyn<'py, f64>,
    /// Number of leading axes.
    lead: usize,
}

impl<'py> Numbers<'py> {
    /// Converts an array whose last axes have the lengths `tail`; `what` describes them. Any number of axes
    /// may precede.
    pub(crate) fn with_tail(
        value: &ArrayLike<'py>,
        name: &str,
        tail: &[usize],
        what: &str,
    ) -> PyResult<Self> {
        let array = doubles(value, name)?;
        let shape = array.shape();
        if !shape.ends_with(tail) {
            let tail_text = shape_text(tail, "..., ");
            let found = shape_text(shape, "");
            return Err(Failure::argument(
                format!("{name} has the shape {found}; needed is {tail_text}: {what}"),
                format!("Reshape {name}, or use the robot it belongs to."),
            )
            .into());
        }
        let lead = shape.len() - tail.len();
        Ok(Self { array, lead })
    }

    /// Converts an array of exactly `axes` axes, the last of which have the lengths `tail`.
    pub(crate) fn exact(
        value: &ArrayLike<'py>,
        name: &str,
        axes: usize,
        tail: &[usize],
        what: &str,
    ) -> PyResult<Self> {
        let numbers = Self::with_tail(value, name, tail, what)?;
        if numbers.array.shape().len() == axes {
            return Ok(numbers);
        }
        let found = shape_text(numbers.array.shape(), "");
        let lead = "N, ".repeat(axes - tail.len());
        let needed = shape_text(tail, &lead);
        Err(Failure::argument(
            format!("{name} has the shape {found}; needed is {needed}: {what}"),
            format!("Reshape {name}."),
        )
        .into())
    }

    /// Rejects NaN and infinities.
    pub(crate) fn finite(self, name: &str) -> PyResult<Self> {
        match self.values().iter().position(|value| !value.is_finite()) {
            None => Ok(self),
            Some(at) => Err(Failure::argument(
                format!("{name} holds {} at the flat index {at}", self.values()[at]),
                format!("Remove NaN and infinite numbers from {name}."),
            )
            .into()),
        }
    }

    /// The leading axes.
    pub(crate) fn lead(&self) -> &[usize] {
        &self.array.shape()[..self.lead]
    }

    /// The number of rows.
    pub(crate) fn count(&self) -> usize {
        self.lead().iter().product()
    }

    pub(crate) fn values(&self) -> &[f64] {
        self.array.as_slice().unwrap_or_default()
    }
}

/// Result of functions: an array of doubles.
pub(crate) struct Doubles {
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Doubles {
    /// An array with these leading axes, followed by those of one row.
    pub(crate) fn new(lead: &[usize], row: &[usize], values: Vec<f64>) -> Self {
        Self {
            shape: [lead, row].concat(),
            values,
        }
    }
}

impl<'py> IntoPyObject<'py> for Doubles {
    type Target = PyArrayDyn<f64>;
    type Output = Bound<'py, Self::Target>;
    type Error = PyErr;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_identifier!("builtins", "Doubles");

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
        PyArray1::from_vec(py, self.values).reshape(IxDyn(&self.shape))
    }
}

/// Argument of functions: an array, or anything that numpy converts to one.
pub(crate) struct ArrayLike<'py>(Bound<'py, PyAny>);

impl<'a, 'py> FromPyObject<'a, 'py> for ArrayLike<'py> {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_identifier!("builtins", "ArrayLike");

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        Ok(Self(object.to_owned()))
    }
}

impl<'py> ArrayLike<'py> {
    pub(crate) fn py(&self) -> Python<'py> {
        self.0.py()
    }
}

/// Three numbers.
pub(crate) fn triple(value: &ArrayLike<'_>, name: &str) -> PyResult<[f64; 3]> {
    let numbers = Numbers::exact(value, name, 1, &[3], "x, y, z")?.finite(name)?;
    Ok([
        numbers.values()[0],
        numbers.values()[1],
        numbers.values()[2],
    ])
}

fn doubles<'py>(
    ArrayLike(value): &ArrayLike<'py>,
    name: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    if let Ok(array) = value.cast_exact::<PyArrayDyn<f64>>()
        && array.is_c_contiguous()
        && (array.data() as usize).is_multiple_of(align_of::<f64>())
    {
        return Ok(array.try_readonly()?);
    }
    let numpy = value.py().import("numpy")?;
    let refused = |found: String| {
        Failure::argument(
            format!("{name} is {found}; needed is an array of real numbers"),
            format!(
                "Give {name} as an array of float64, or a list of numbers or of rows of one length."
            ),
        )
    };
    // Before numpy converts masked numbers to NaN, with a warning.
    refuse_masked(value, name)?;
    let kind = value.get_type().name()?;
    let any = numpy
        .call_method1("asarray", (value,))
        .map_err(|_| refused(format!("a {kind} of uneven rows")))?;
    let dtype = any.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    let axes = any.getattr("ndim")?.extract::<usize>()?;
    if kind == "O" && axes == 0 {
        return Err(refused(format!("of the type {}", value.get_type().name()?)).into());
    }
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(refused(format!("an array of {dtype}")).into());
    }
    let doubles = numpy.call_method1("require", (any, "float64", "CA"))?;
    // numpy's contiguous arrays have at least one axis.
    let doubles = if axes == 0 {
        doubles.call_method1("reshape", ((),))?
    } else {
        doubles
    };
    Ok(doubles.cast::<PyArrayDyn<f64>>()?.try_readonly()?)
}

/// Largest number of axes of a numpy array; a list may contain itself.
const AXES_MAX: usize = 64;
/// Largest number of list items that are searched: a list that contains itself twice has 2^64.
const PARTS_MAX: usize = 1_000_000;

/// Rejects an array of numpy.ma with masked numbers, or a list that contains one: a masked number is not
/// valid.
fn refuse_masked(value: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let masks = value.py().import("numpy.ma")?;
    let (class, mask_of) = (masks.getattr("MaskedArray")?, masks.getattr("getmask")?);
    let mut waiting = vec![(value.clone(), 0)];
    let mut seen = 0;
    while let Some((value, depth)) = waiting.pop() {
        seen += 1;
        if seen > PARTS_MAX {
            break;
        }
        let is_list = value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>();
        if is_list && depth < AXES_MAX {
            for part in value.try_iter()? {
                let part = part?;
                if !part.is_exact_instance_of::<PyFloat>() {
                    waiting.push((part, depth + 1));
                }
            }
        } else if value.is_instance(&class)? {
            let mask = mask_of.call1((value,))?;
            if mask.call_method0("any")?.is_truthy()? {
                return Err(Failure::argument(
                    format!("{name} has masked numbers"),
                    format!("Give {name}.filled(...) with numbers that are meant, or leave those rows out."),
                )
                .into());
            }
        }
    }
    Ok(())
}

/// A shape as numpy prints it; `before` stands for axes of any length.
pub(crate) fn shape_text(shape: &[usize], before: &str) -> String {
    let lengths: Vec<_> = shape.iter().map(ToString::to_string).collect();
    let lone = before.is_empty() && shape.len() == 1;
    format!(
        "({before}{}{})",
        lengths.join(", "),
        if lone { "," } else { "" }
    )
}
