use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::errors::Failure;

/// Items of a Python mapping; `what` describes the required contents.
pub(crate) fn pairs<'py, K, V>(
    name: &str,
    what: &str,
    mapping: &Bound<'py, PyMapping>,
) -> PyResult<Vec<(K, V)>>
where
    (K, V): FromPyObjectOwned<'py>,
{
    let pair = |item: Bound<'py, PyAny>| {
        item.extract::<(K, V)>().map_err(|_| {
            Failure::argument(
                format!("{name} holds {item}; needed is a mapping of {what}"),
                format!("Give {name} as a dictionary of {what}."),
            )
        })
    };
    let pairs: Result<_, _> = mapping.items()?.iter().map(pair).collect();
    Ok(pairs?)
}
