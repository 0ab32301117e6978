//! One declaration of what people set: struct, default values and the list of its parameters with their words and ranges,
//! which the default file, the schema, explanations and checks are made of.

use std::ops::RangeInclusive;

/// The unit that ends a name, longest first.
const UNITS: [(&str, &str); 7] = [
    ("_rad_s2", "rad/s²"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_ms", "ms"),
    ("_us", "µs"),
    ("_m", "m"),
];

/// What people set.
#[derive(Debug)]
pub struct Parameter {
    /// Its name, with the unit at its end.
    pub name: &'static str,
    /// What it is, in words, line by line; `{range}` stands for its range.
    pub doc: &'static [&'static str],
    /// Smallest and largest value of a number that is limited.
    pub range: Option<RangeInclusive<f64>>,
    /// What other parameters allow beyond that, in words.
    pub also: Option<&'static str>,
}

impl Parameter {
    /// Its unit, with a space before it; empty: none.
    fn unit(&self) -> String {
        let unit = UNITS.iter().find(|(end, _)| self.name.ends_with(end));
        unit.map(|(_, unit)| format!(" {unit}")).unwrap_or_default()
    }

    /// Smallest and largest value with the unit: `0.1 to 100 ms`.
    pub fn range_text(&self) -> Option<String> {
        let range = self.range.as_ref()?;
        let (low, high) = (number_text(*range.start()), number_text(*range.end()));
        Some(format!("{low} to {high}{}", self.unit()))
    }

    /// What it is, in words, line by line.
    pub fn text(&self) -> String {
        let range = self.range_text().unwrap_or_default();
        let lines = self
            .doc
            .iter()
            .map(|line| line.trim().replace("{range}", &range));
        lines.collect::<Vec<_>>().join("\n")
    }
}

/// A number as people write it.
pub fn number_text(value: f64) -> String {
    use std::f64::consts::{PI, TAU};
    let size = value.abs();
    if size == PI || size == TAU {
        let sign = if value < 0.0 { "-" } else { "" };
        let name = if size == PI { "π" } else { "2π" };
        return format!("{sign}{name}");
    }
    if size != 0.0 && !(1e-6..1e10).contains(&size) {
        return format!("{value:e}");
    }
    value.to_string()
}

/// Declares parameters: each with its words, its default, its range, and what other parameters allow beyond that.
/// Without defaults all have to be given.
#[macro_export]
macro_rules! parameters {
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty = $default:expr
            $(, in $range:expr $(, $also:literal)?)?;)+
    }) => {
        $crate::parameters! {
            $(#[$meta])* pub struct $name {
                $($(#[doc = $doc])+ $field: $type $(, in $range $(, $also)?)?;)+
            }
        }

        impl Default for $name {
            fn default() -> Self { Self { $($field: $default,)+ } }
        }
    };
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty $(, in $range:expr $(, $also:literal)?)?;)+
    }) => {
        $(#[$meta])*
        pub struct $name {
            $($(#[doc = $doc])+ $(#[doc = concat!("\n\nRange: `", stringify!($range), "`.")])?
            pub $field: $type,)+
        }

        impl $name {
            /// Every parameter, in order.
            pub const PARAMETERS: &'static [$crate::parameters::Parameter] =
                &[$($crate::parameters::Parameter {
                    name: stringify!($field),
                    doc: &[$($doc),+],
                    range: $crate::first_or_none!($($range)?),
                    also: $crate::first_or_none!($($($also)?)?),
                },)+];

            /// The numbers among them, in the same order; `None`: it is no number, or has no limits. Allocates nothing: settings are
            /// checked within a cycle.
            pub fn numbers(&self) -> [Option<f64>; Self::PARAMETERS.len()] {
                [$($crate::number!(self.$field $(, $range)?),)+]
            }
        }
    };
}

/// The number of a parameter that has a range.
#[doc(hidden)]
#[macro_export]
macro_rules! number {
    ($value:expr) => {
        None
    };
    ($value:expr, $range:expr) => {
        Some(f64::from($value))
    };
}

/// `Some` of what is given.
#[doc(hidden)]
#[macro_export]
macro_rules! first_or_none {
    () => {
        None
    };
    ($given:expr) => {
        Some($given)
    };
}
