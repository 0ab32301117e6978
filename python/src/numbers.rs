//! Scalar arguments and their ranges. Integers come as `i128`, so that values out of range are rejected here,
//! with their name.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use crate::errors::{Failure, REPORT};

/// Range of waits and durations [s]: thirty years, which can be added to any clock.
pub(crate) const SECONDS: RangeInclusive<f64> = 0.0..=1e9;

/// A number within its range; NaN is outside every range.
pub(crate) fn within<N: Debug + PartialOrd + Copy>(
    name: &str,
    value: N,
    range: RangeInclusive<N>,
) -> Result<N, Failure> {
    if range.contains(&value) {
        return Ok(value);
    }
    let (least, most) = (range.start(), range.end());
    Err(Failure::argument(
        format!("{name} is {value:?}; allowed is {least:?} to {most:?}"),
        format!("Give {name} a value inside the range."),
    ))
}

/// An integer within the range of its type.
pub(crate) fn count<N>(name: &str, value: i128, range: RangeInclusive<N>) -> Result<N, Failure>
where
    N: TryFrom<i128> + Into<i128> + Copy,
    <N as TryFrom<i128>>::Error: Display,
{
    let range = (*range.start()).into()..=(*range.end()).into();
    let found = within(name, value, range)?;
    N::try_from(found).map_err(|error| Failure::argument(format!("{name}: {error}"), REPORT))
}

/// A wait or duration.
pub(crate) fn seconds(name: &str, value_s: f64) -> Result<Duration, Failure> {
    Ok(Duration::from_secs_f64(within(name, value_s, SECONDS)?))
}

/// End of a wait that begins now.
pub(crate) fn until(name: &str, value_s: f64) -> Result<Instant, Failure> {
    Ok(Instant::now() + seconds(name, value_s)?)
}
