//! Declaration of a message in one place: struct, zero value and the list of its fields, which JSON, tables, tests and
//! recordings walk.
//!
//! ```text
//! message! {
//!     /// Meaning of the message.
//!     pub struct Name "cdcr.Name.v1" {
//!         /// Meaning of the field; the unit ends its name.
//!         cable_length_m: [f64; CABLES_MAX] [used 3 sections],
//!     }
//! }
//! ```
//!
//! | note | meaning |
//! |---|---|
//! | `[code Mode]` | a value of that enumeration of [`codes`](crate::codes) |
//! | `[bits guard]` | bits of that module of [`codes`](crate::codes) |
//! | `[per Outcome 1]` | one element for each code, from this one on |
//! | `[yes]` | 1: yes, 0: no |
//! | `[or_none]` | the largest value means none |
//! | `[text]` | UTF-8, padded with zeros |
//! | `[length]` | the used length of an array |
//! | `[used 3 sections]` | the first 3 · `sections` elements are used |
//! | `[when kind = MeasurementKind::TipPose]` | valid only under this condition |
//! | `[sum "late starts"]`, `[max "longest streak"]` | a counter with its heading: over two intervals, the sum or the larger value |
//! | `[unit "rad/s"]` | the unit, if the name does not end with it |
//! | `[reserved]` | zero |

use crate::codes::Codes;

/// A message, or a part of one with fields.
pub trait Struct {
    /// Name, size and fields.
    fn layout(&self) -> &'static MessageLayout;
    /// Calls `see` for each field with its value, in order.
    fn visit<'a>(&'a self, see: &mut dyn FnMut(&'static Field, Value<'a>));
    /// As [`visit`](Self::visit), with mutable values.
    fn visit_mut<'a>(&'a mut self, see: &mut dyn FnMut(&'static Field, ValueMut<'a>));
}

/// The name, the size and the fields of a message.
#[derive(Debug)]
pub struct MessageLayout {
    /// Name of the struct.
    pub name: &'static str,
    /// Name and version on the wire.
    pub type_name: &'static str,
    /// Size of the struct \[bytes\].
    pub size: usize,
    /// Fields in memory order, without gaps.
    pub fields: &'static [Field],
}

/// One field of a message.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Name, with the unit at its end.
    pub name: &'static str,
    /// Description from the doc comment.
    pub doc: &'static str,
    /// Offset from the beginning of the message \[bytes\].
    pub offset: usize,
    /// Type of the field.
    pub kind: Kind,
    /// Meaning of its numbers.
    pub meaning: Meaning,
    /// Unit of its numbers; empty: none.
    pub unit: &'static str,
    /// Used part of an array; `None`: all of it.
    pub used: Option<Used>,
    /// Field and value on which the meaning of this one depends.
    pub when: Option<(&'static str, u32)>,
}

/// Type of a field.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// A byte.
    U8,
    /// An unsigned number of 32 bits.
    U32,
    /// An unsigned number of 64 bits.
    U64,
    /// A number of double precision.
    F64,
    /// An array with its element type and length.
    Array(&'static Kind, usize),
    /// A struct with fields of its own.
    Struct(&'static MessageLayout),
}

impl Kind {
    /// Size of one value of this kind \[bytes\].
    pub fn size(&self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U32 => 4,
            Self::U64 | Self::F64 => 8,
            Self::Array(each, count) => each.size() * count,
            Self::Struct(layout) => layout.size,
        }
    }
}

/// Meaning of a field's numbers.
#[derive(Debug, Clone, Copy)]
pub enum Meaning {
    /// A quantity.
    Quantity,
    /// A code of an enumeration.
    Code(&'static Codes),
    /// Bits with their names and remedies.
    Bits(&'static [(u32, &'static str, &'static str)]),
    /// One element for each code from the given one on; earlier ones are zero.
    Per(&'static Codes, usize),
    /// 1: yes, 0: no.
    Yes,
    /// The largest value means none.
    OrNone,
    /// UTF-8, padded with zeros.
    Text,
    /// Used length of an array.
    Length,
    /// A counter with this heading: the value over two intervals is their sum.
    Sum(&'static str),
    /// A maximum with this heading: the value over two intervals is the larger one.
    Max(&'static str),
    /// Zero.
    Reserved,
}

/// Used part of an array: `each` elements for each of the number in the field `count`.
#[derive(Debug, Clone, Copy)]
pub struct Used {
    /// Elements for each.
    pub each: usize,
    /// Path of the field, from the message that holds the array: `command.sections`.
    pub count: &'static str,
}

/// Value of a field.
#[derive(Clone, Copy)]
#[allow(missing_docs, reason = "as Kind")]
pub enum Value<'a> {
    U8(u8),
    U32(u32),
    U64(u64),
    F64(f64),
    Array(&'a dyn Array),
    Struct(&'a dyn Struct),
}

/// Mutable value of a field.
#[allow(missing_docs, reason = "as Kind")]
pub enum ValueMut<'a> {
    U8(&'a mut u8),
    U32(&'a mut u32),
    U64(&'a mut u64),
    F64(&'a mut f64),
    Array(&'a mut dyn Array),
    Struct(&'a mut dyn Struct),
}

/// An array of any length and type.
pub trait Array {
    /// Number of elements.
    fn count(&self) -> usize;
    /// The element `index`.
    fn element(&self, index: usize) -> Value<'_>;
    /// The element `index`, mutable.
    fn element_mut(&mut self, index: usize) -> ValueMut<'_>;
}

/// Parts of messages.
pub trait Part: Sized {
    /// All bytes zero.
    const ZERO: Self;
    /// Type.
    const KIND: Kind;
    /// Value.
    fn value(&self) -> Value<'_>;
    /// Mutable value.
    fn value_mut(&mut self) -> ValueMut<'_>;
}

macro_rules! number {
    ($($type:ty, $variant:ident, $zero:literal;)+) => { $(
        impl Part for $type {
            const ZERO: Self = $zero;
            const KIND: Kind = Kind::$variant;
            fn value(&self) -> Value<'_> { Value::$variant(*self) }
            fn value_mut(&mut self) -> ValueMut<'_> { ValueMut::$variant(self) }
        }
    )+ };
}
number! { u8, U8, 0; u32, U32, 0; u64, U64, 0; f64, F64, 0.0; }

impl<T: Part, const N: usize> Part for [T; N] {
    const ZERO: Self = [T::ZERO; N];
    const KIND: Kind = Kind::Array(&T::KIND, N);
    fn value(&self) -> Value<'_> {
        Value::Array(self)
    }
    fn value_mut(&mut self) -> ValueMut<'_> {
        ValueMut::Array(self)
    }
}

impl<T: Part, const N: usize> Array for [T; N] {
    fn count(&self) -> usize {
        N
    }
    fn element(&self, index: usize) -> Value<'_> {
        self[index].value()
    }
    fn element_mut(&mut self, index: usize) -> ValueMut<'_> {
        self[index].value_mut()
    }
}

impl dyn Struct + '_ {
    /// The number of the field at `path`, such as `command.sections`; `None` if there is none.
    pub fn number(&self, path: &str) -> Option<u64> {
        let (name, rest) = path.split_once('.').unwrap_or((path, ""));
        let mut found = None;
        self.visit(&mut |field, value| {
            if field.name == name {
                found = match value {
                    Value::U32(number) if rest.is_empty() => Some(u64::from(number)),
                    Value::U64(number) if rest.is_empty() => Some(number),
                    Value::Struct(message) => message.number(rest),
                    _ => None,
                };
            }
        });
        found
    }

    /// The counters with their values, in order.
    pub fn counters(&self) -> Vec<(&'static Field, u64)> {
        let mut counters = Vec::new();
        self.visit(&mut |field, value| {
            if let (Meaning::Sum(_) | Meaning::Max(_), Value::U64(number)) = (field.meaning, value)
            {
                counters.push((field, number));
            }
        });
        counters
    }

    /// Number of used elements of the array `field`; `None` if the field has no meaning in this message.
    pub fn used(&self, field: &Field) -> Option<usize> {
        if let Some((name, code)) = field.when
            && self.number(name) != Some(u64::from(code))
        {
            return None;
        }
        let Kind::Array(_, elements) = field.kind else {
            return Some(1);
        };
        let used = field.used.and_then(|used| {
            let count = usize::try_from(self.number(used.count)?).ok()?;
            count.checked_mul(used.each)
        });
        Some(used.map_or(elements, |used| used.min(elements)))
    }
}

impl Field {
    /// Heading of a counter in tables; for other fields the name.
    pub fn heading(&self) -> &'static str {
        match self.meaning {
            Meaning::Sum(heading) | Meaning::Max(heading) => heading,
            _ => self.name,
        }
    }

    pub(crate) const fn new(
        name: &'static str,
        doc: &'static str,
        offset: usize,
        kind: Kind,
    ) -> Self {
        Self {
            name,
            doc,
            offset,
            kind,
            meaning: Meaning::Quantity,
            unit: unit_of(name),
            used: None,
            when: None,
        }
    }

    pub(crate) const fn meaning(self, meaning: Meaning) -> Self {
        Self { meaning, ..self }
    }

    pub(crate) const fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    pub(crate) const fn used(self, each: usize, count: &'static str) -> Self {
        let used = Some(Used { each, count });
        Self { used, ..self }
    }

    pub(crate) const fn when(self, field: &'static str, code: u32) -> Self {
        let when = Some((field, code));
        Self { when, ..self }
    }
}

/// The unit at the end of a name; longer endings first.
const fn unit_of(name: &str) -> &'static str {
    const UNITS: [(&str, &str); 7] = [
        ("_rad_s2", "rad/s²"),
        ("_rad_s", "rad/s"),
        ("_m_s", "m/s"),
        ("_rad", "rad"),
        ("_ns", "ns"),
        ("_nm", "nm"),
        ("_m", "m"),
    ];
    let mut at = 0;
    while at < UNITS.len() {
        let (ending, unit) = UNITS[at];
        if ends_with(name.as_bytes(), ending.as_bytes()) {
            return unit;
        }
        at += 1;
    }
    ""
}

const fn ends_with(name: &[u8], ending: &[u8]) -> bool {
    if name.len() < ending.len() {
        return false;
    }
    let (_, end) = name.split_at(name.len() - ending.len());
    let mut at = 0;
    while at < ending.len() {
        if end[at] != ending[at] {
            return false;
        }
        at += 1;
    }
    true
}

/// Declares messages; see the top of `message.rs`.
macro_rules! message {
    ($($(#[$meta:meta])* pub struct $name:ident $type_name:literal {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty $([$($note:tt)+])*,)+
    })+) => {
        use iceoryx2::prelude::ZeroCopySend;
        $(
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
        #[type_name($type_name)]
        pub struct $name { $($(#[doc = $doc])+ pub $field: $type,)+ }

        impl $name {
            /// Name, size and fields.
            pub const LAYOUT: &'static $crate::message::MessageLayout = &$crate::message::MessageLayout {
                name: stringify!($name),
                type_name: $type_name,
                size: size_of::<$name>(),
                fields: &[$($crate::message::noted!($crate::message::Field::new(
                    stringify!($field),
                    concat!($($doc),+),
                    core::mem::offset_of!($name, $field),
                    <$type as $crate::message::Part>::KIND,
                ); $([$($note)+])*),)+],
            };
        }

        impl $name {
            /// Adds the counters of `more`.
            pub fn accumulate(&mut self, more: &Self) {
                let _ = more;
                $($crate::message::added!(self.$field, more.$field; $([$($note)+])*);)+
            }
        }

        /// All bytes zero.
        impl Default for $name {
            fn default() -> Self { <Self as $crate::message::Part>::ZERO }
        }

        impl $crate::message::Part for $name {
            const ZERO: Self = Self { $($field: <$type as $crate::message::Part>::ZERO,)+ };
            const KIND: $crate::message::Kind = $crate::message::Kind::Struct(Self::LAYOUT);
            fn value(&self) -> $crate::message::Value<'_> { $crate::message::Value::Struct(self) }
            fn value_mut(&mut self) -> $crate::message::ValueMut<'_> { $crate::message::ValueMut::Struct(self) }
        }

        impl $crate::message::Struct for $name {
            fn layout(&self) -> &'static $crate::message::MessageLayout { Self::LAYOUT }
            fn visit<'a>(
                &'a self,
                see: &mut dyn FnMut(&'static $crate::message::Field, $crate::message::Value<'a>),
            ) {
                let mut fields = Self::LAYOUT.fields.iter();
                $(if let Some(field) = fields.next() {
                    see(field, $crate::message::Part::value(&self.$field));
                })+
            }
            fn visit_mut<'a>(
                &'a mut self,
                see: &mut dyn FnMut(&'static $crate::message::Field, $crate::message::ValueMut<'a>),
            ) {
                let mut fields = Self::LAYOUT.fields.iter();
                $(if let Some(field) = fields.next() {
                    see(field, $crate::message::Part::value_mut(&mut self.$field));
                })+
            }
        }
        )+
    };
}
pub(crate) use message;

/// Adds one counter to another, by its note.
macro_rules! added {
    ($total:expr, $more:expr; [sum $heading:literal] $($others:tt)*) => { $total += $more };
    ($total:expr, $more:expr; [max $heading:literal] $($others:tt)*) => { $total = $total.max($more) };
    ($total:expr, $more:expr; [$($note:tt)+] $($others:tt)*) => {
        $crate::message::added!($total, $more; $($others)*)
    };
    ($total:expr, $more:expr;) => {};
}
pub(crate) use added;

/// Applies the notes of a field.
macro_rules! noted {
    ($field:expr;) => { $field };
    ($field:expr; [unit $unit:literal] $($more:tt)*) => {
        $crate::message::noted!($field.unit($unit); $($more)*)
    };
    ($field:expr; [used $each:literal $($count:ident).+] $($more:tt)*) => {
        $crate::message::noted!($field.used($each, $crate::message::field_path!($($count)+)); $($more)*)
    };
    ($field:expr; [when $other:ident = $codes:ident::$code:ident] $($more:tt)*) => {
        $crate::message::noted!(
            $field.when(stringify!($other), $crate::codes::$codes::$code.code()); $($more)*
        )
    };
    ($field:expr; [$($meaning:tt)+] $($more:tt)*) => {
        $crate::message::noted!($field.meaning($crate::message::meaning!($($meaning)+)); $($more)*)
    };
}
pub(crate) use noted;

macro_rules! meaning {
    (code $codes:ident) => {
        $crate::message::Meaning::Code($crate::codes::$codes::CODES)
    };
    (bits $bits:ident) => {
        $crate::message::Meaning::Bits($crate::codes::$bits::ALL)
    };
    (per $codes:ident $first:literal) => {
        $crate::message::Meaning::Per($crate::codes::$codes::CODES, $first)
    };
    (yes) => {
        $crate::message::Meaning::Yes
    };
    (or_none) => {
        $crate::message::Meaning::OrNone
    };
    (text) => {
        $crate::message::Meaning::Text
    };
    (length) => {
        $crate::message::Meaning::Length
    };
    (sum $heading:literal) => {
        $crate::message::Meaning::Sum($heading)
    };
    (max $heading:literal) => {
        $crate::message::Meaning::Max($heading)
    };
    (reserved) => {
        $crate::message::Meaning::Reserved
    };
}
pub(crate) use meaning;

macro_rules! field_path {
    ($field:ident) => {
        stringify!($field)
    };
    ($message:ident $field:ident) => {
        concat!(stringify!($message), ".", stringify!($field))
    };
}
pub(crate) use field_path;
