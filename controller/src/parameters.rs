//! Declares user parameters once: the struct, default values, and a list of parameters with texts and ranges.
//! The default file, the schema, explanations and checks are generated from this list.

use std::ops::RangeInclusive;

/// The unit that ends a name, longest first.
const UNITS: [(&str, &str); 8] = [
    ("_rad_s2", "rad/s²"),
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_ms", "ms"),
    ("_us", "µs"),
    ("_m", "m"),
];

/// A user parameter.
#[derive(Debug)]
pub struct UserParameter {
    /// Name, ending with the unit.
    pub name: &'static str,
    /// Description, line by line; `{range}` stands for the range.
    pub doc: &'static [&'static str],
    /// Smallest and largest value of a number with limits.
    pub range: Option<RangeInclusive<f64>>,
    /// Smallest and largest value that is probably meant; `None`: any value of the range.
    pub usual: Option<RangeInclusive<f64>>,
    /// Restriction by other parameters, in words.
    pub also: Option<&'static str>,
}

impl UserParameter {
    /// The unit that ends the name; empty: none.
    pub fn unit(&self) -> &'static str {
        let unit = UNITS.iter().find(|(end, _)| self.name.ends_with(end));
        unit.map_or("", |(_, unit)| unit)
    }

    /// Smallest and largest value with the unit: `0.1 to 100 ms`.
    pub fn range_text(&self) -> Option<String> {
        self.range.as_ref().map(|range| self.text_of(range))
    }

    /// Smallest and largest value that is probably meant, with the unit.
    pub fn usual_text(&self) -> Option<String> {
        self.usual.as_ref().map(|usual| self.text_of(usual))
    }

    fn text_of(&self, range: &RangeInclusive<f64>) -> String {
        let (low, high) = (number_text(*range.start()), number_text(*range.end()));
        let gap = if self.unit().is_empty() { "" } else { " " };
        format!("{low} to {high}{gap}{}", self.unit())
    }

    /// Question about a value that is probably unintended: `usual is 0 to 10 rad/s; in degrees?`.
    pub fn warning(&self, value: f64) -> Option<String> {
        let usual = self
            .usual
            .as_ref()
            .filter(|usual| !usual.contains(&value))?;
        let usual = self.text_of(usual);
        Some(format!("usual is {usual}{}", self.other_unit()))
    }

    /// Allowed values, and what to ask about a value outside them: `allowed is 0.001 to 10; in mm?`. An angle is in degrees only
    /// beyond a turn.
    pub fn refusal(&self, value: f64) -> Option<String> {
        let range = self.range.as_ref()?;
        if range.contains(&value) {
            return None;
        }
        let is_angle = self.unit() == "rad";
        let is_large = value > *range.end() || (is_angle && value < *range.start());
        let asks = is_large && !(is_angle && value.abs() <= core::f64::consts::TAU);
        let other = if asks { self.other_unit() } else { "" };
        let [low, high] = [range.start(), range.end()].map(|limit| number_text(*limit));
        Some(format!("allowed is {low} to {high}{other}"))
    }

    /// The unit in which a large value was probably given.
    fn other_unit(&self) -> &'static str {
        match self.unit() {
            "rad" | "rad/s" => "; in degrees?",
            "m" => "; in mm?",
            "m/s" => "; in mm/s?",
            _ => "",
        }
    }

    /// Description with the range filled in, line by line.
    pub fn text(&self) -> String {
        let range = self.range_text().unwrap_or_default();
        let lines = self
            .doc
            .iter()
            .map(|line| line.trim().replace("{range}", &range));
        lines.collect::<Vec<_>>().join("\n")
    }
}

/// A number in the notation of the documentation: π and 2π by name, exponents for very small and very large
/// values.
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

/// Declares parameters: each with its text, type, default, range, the part of it that is usual, and restrictions by other parameters.
/// Without defaults there is no `Default`, and all values must be given.
#[macro_export]
macro_rules! parameters {
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty = $default:expr
            $(, in $range:expr $(, usual $usual:expr)? $(, $also:literal)?)?;)+
    }) => {
        $crate::parameters! {
            $(#[$meta])* pub struct $name {
                $($(#[doc = $doc])+ $field: $type $(, in $range $(, usual $usual)? $(, $also)?)?;)+
            }
        }

        impl Default for $name {
            fn default() -> Self { Self { $($field: $default,)+ } }
        }
    };
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty
            $(, in $range:expr $(, usual $usual:expr)? $(, $also:literal)?)?;)+
    }) => {
        $(#[$meta])*
        pub struct $name {
            $($(#[doc = $doc])+ $(#[doc = concat!("\n\nRange: `", stringify!($range), "`.")])?
            pub $field: $type,)+
        }

        impl $name {
            /// Every parameter, in order.
            pub const PARAMETERS: &'static [$crate::parameters::UserParameter] =
                &[$($crate::parameters::UserParameter {
                    name: stringify!($field),
                    doc: &[$($doc),+],
                    range: $crate::first_or_none!($($range)?),
                    usual: $crate::first_or_none!($($($usual)?)?),
                    also: $crate::first_or_none!($($($also)?)?),
                },)+];

            /// Values of the numeric parameters with limits, in the same order; `None` for all others.
            /// Allocates nothing, because settings are checked within a cycle.
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

/// `Some` of the argument, or `None` without one.
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
