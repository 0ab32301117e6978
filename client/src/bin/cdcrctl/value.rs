//! Command-line values, each checked against its range.

use std::ops::RangeInclusive;
use std::time::Duration;

use cdcr_client::{DURATION_MAX_S, FigurePlane};
use cdcr_shared_types::codes::Interpolation;
pub(crate) use cdcr_shared_types::duration_in;
use clap::builder::{PossibleValuesParser, TypedValueParser};

/// Three numbers `x,y,z`.
pub(crate) type Vector = [f64; 3];
/// Two numbers `a:b`.
pub(crate) type Ratio = [u32; 2];

/// `x,y,z`: three finite numbers.
pub(crate) fn vector(text: &str) -> Result<Vector, String> {
    let numbers: Vec<f64> = text.split(',').map(number).collect::<Result<_, _>>()?;
    let count = numbers.len();
    numbers
        .try_into()
        .map_err(|_| format!("expected three numbers with commas between them, found {count}"))
}

/// A direction `x,y,z` of non-zero length, normalised.
pub(crate) fn direction(text: &str) -> Result<Vector, String> {
    let v = vector(text)?;
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    if norm < 1e-9 {
        return Err("a direction must not be zero".to_owned());
    }
    Ok(v.map(|x| x / norm))
}

/// Largest magnitude of any value, in any unit, and the inverse of the smallest non-zero one.
const LARGEST: f64 = 1e9;
const SMALLEST: f64 = 1e-9;

/// A finite number.
pub(crate) fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.abs() <= LARGEST => Ok(value),
        Ok(value) if value.is_finite() => Err(format!("{value:e} is beyond {LARGEST:e}")),
        _ => Err(format!("{text:?} is not a finite number")),
    }
}

/// A finite number above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match number(text)? {
        value if value >= SMALLEST => Ok(value),
        value if value > 0.0 => Err(format!("{value:e} is below {SMALLEST:e}")),
        value => Err(format!("{value} is not above zero")),
    }
}

/// Largest speed of a tip or an obstacle that is taken to be meant \[m/s\].
pub(crate) const SPEED_M_S_MAX: f64 = 2.0;

/// A speed of a tip in m/s.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    match positive(text)? {
        value if value > SPEED_M_S_MAX => Err(format!(
            "{value} m/s is more than {SPEED_M_S_MAX}: is it in mm/s? 50 mm/s are 0.05"
        )),
        value => Ok(value),
    }
}

/// A number in a range.
pub(crate) fn number_in(
    range: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let (value, least, most) = (number(text)?, range.start(), range.end());
        let refused = || format!("{value} is not between {least} and {most}");
        range.contains(&value).then_some(value).ok_or_else(refused)
    }
}

/// A finite number that is not negative.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    match number(text)? {
        value if value >= 0.0 => Ok(value),
        value => Err(format!("{value} is below zero: use 0 or more")),
    }
}

/// A length above zero with its unit: `2mm`, `0.002m`.
pub(crate) fn length_m(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (digits, unit_m) = match (text.strip_suffix("mm"), text.strip_suffix('m')) {
        (Some(digits), _) => (digits, 1e-3),
        (None, Some(digits)) => (digits, 1.0),
        (None, None) => return Err("a unit is missing: use for example 2mm or 0.002m".to_owned()),
    };
    Ok(unit_m * positive(digits)?)
}

/// Duration of a fed curve, of more than one point \[s\].
pub(crate) const CURVE_S: RangeInclusive<f64> = 0.01..=DURATION_MAX_S;
/// Timeout for a robot to be measured at rest, which takes at least a fifth of a second \[s\].
pub(crate) const WAIT_S: RangeInclusive<f64> = 0.3..=DURATION_MAX_S;
/// Recorded time around a trigger \[s\].
pub(crate) const AROUND_S: RangeInclusive<f64> = 0.0..=60.0;

/// A time between points, or before the start; the library checks the range.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    duration_in(0.0..=DURATION_MAX_S)(text)
}

/// The size of a file, from 1 MB to 1000 TB: `500MB`, `1.5GB` \[bytes\].
pub(crate) fn size_bytes(text: &str) -> Result<u64, String> {
    let units = [("MB", 1e6), ("GB", 1e9), ("TB", 1e12)];
    let text = text.trim();
    let split = |(unit, bytes)| Some((text.strip_suffix(unit)?, bytes));
    let (digits, unit_bytes) = (units.into_iter().find_map(split))
        .ok_or("a unit is missing: use for example 500MB or 20GB")?;
    let bytes = unit_bytes * positive(digits)?;
    let is_within = (1e6..=1e15).contains(&bytes);
    let refused = || "must be 1 MB to 1000 TB".to_owned();
    is_within.then_some(bytes as u64).ok_or_else(refused)
}

/// `a:b`: two whole numbers from 1 to 100.
pub(crate) fn ratio(text: &str) -> Result<Ratio, String> {
    let part = |part: &str| part.trim().parse().ok().filter(|n| (1..=100).contains(n));
    let parts = text.split_once(':').map(|(a, b)| [a, b].map(part));
    match parts {
        Some([Some(a), Some(b)]) => Ok([a, b]),
        _ => Err("expected two whole numbers from 1 to 100, for example 3:2".to_owned()),
    }
}

/// The name of a plane.
pub(crate) fn plane() -> impl TypedValueParser<Value = FigurePlane> {
    PossibleValuesParser::new(["xy", "xz", "yz"]).map(|name| match &*name {
        "xz" => FigurePlane::Xz,
        "yz" => FigurePlane::Yz,
        _ => FigurePlane::Xy,
    })
}

/// The name of an interpolation.
pub(crate) fn interpolation() -> impl TypedValueParser<Value = Interpolation> {
    let kinds = || Interpolation::ALL.iter().copied();
    PossibleValuesParser::new(kinds().map(Interpolation::text)).try_map(move |name| {
        let named = kinds().find(|kind| kind.text() == name);
        named.ok_or("no such way")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_beyond_all_use_are_refused_in_few_digits() {
        for text in ["1e308", "-1e10", "1e-300"] {
            let refused = positive(text).expect_err(text);
            assert!(refused.len() < 30, "{refused}");
        }
    }

    #[test]
    fn lengths_have_units() {
        assert_eq!(length_m("2mm"), Ok(0.002));
        assert_eq!(length_m("0.25 m"), Ok(0.25));
        for wrong in ["2", "2cm", "0mm", "-1m", "mm", "nanm"] {
            assert!(length_m(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn sizes_have_units_and_a_range() {
        assert_eq!(size_bytes("1MB"), Ok(1_000_000));
        assert_eq!(size_bytes(" 1.5 GB"), Ok(1_500_000_000));
        for wrong in ["1", "5G", "0.9MB", "1001TB", "0GB", "-1GB", "nanGB", "GB"] {
            assert!(size_bytes(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_time_has_a_range() {
        let is_within = |text| duration_in(0.1..=20.0)(text).is_ok();
        let times = ["99ms", "100ms", "20s", "21s"];
        assert_eq!(times.map(is_within), [false, true, true, false]);
    }

    #[test]
    fn vectors_have_three_finite_numbers() {
        assert_eq!(vector("0.1, 0,-0.3"), Ok([0.1, 0.0, -0.3]));
        assert!(vector("0.1,0").is_err());
        assert!(vector("0.1,nan,0").is_err());
        assert_eq!(direction("0,0,2"), Ok([0.0, 0.0, 1.0]));
        assert!(direction("0,0,0").is_err());
    }
}
