//! Numbers that come in beside arrays, and their ranges. Whole numbers come as `i128`, so that each that is too small or too large is refused here, by its name.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use crate::errors::{Failure, REPORT};

/// How long anything may be waited for or last [s]: thirty years, which every clock can add.
pub(crate) const SECONDS: RangeInclusive<f64> = 0.0..=1e9;

/// A number inside its range; NaN is in none.
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

/// A whole number that is small enough for what it counts.
pub(crate) fn count<N>(name: &str, value: i128, range: RangeInclusive<N>) -> Result<N, Failure>
where
    N: TryFrom<i128> + Into<i128> + Copy,
    <N as TryFrom<i128>>::Error: Display,
{
    let range = (*range.start()).into()..=(*range.end()).into();
    let found = within(name, value, range)?;
    N::try_from(found).map_err(|error| Failure::argument(format!("{name}: {error}"), REPORT))
}

/// A time to wait or to last.
pub(crate) fn seconds(name: &str, value_s: f64) -> Result<Duration, Failure> {
    Ok(Duration::from_secs_f64(within(name, value_s, SECONDS)?))
}

/// When a time to wait, which begins now, is over.
pub(crate) fn until(name: &str, value_s: f64) -> Result<Instant, Failure> {
    Ok(Instant::now() + seconds(name, value_s)?)
}
