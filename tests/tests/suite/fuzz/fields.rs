//! The numbers of a message in their order in memory. Messages are plain numbers of fixed size without
//! padding, so any bytes are a message. This module reads and writes them without `unsafe`.

use std::fmt;

use cdcr_shared_types::message::{Struct, ValueMut};

#[derive(Debug)]
pub(crate) enum Number<'a> {
    U32(&'a mut u32),
    U64(&'a mut u64),
    F64(&'a mut f64),
}

impl Number<'_> {
    pub(crate) fn size(&self) -> usize {
        match self {
            Self::U32(_) => 4,
            Self::U64(_) | Self::F64(_) => 8,
        }
    }

    pub(crate) fn bits(&self) -> u64 {
        match self {
            Self::U32(value) => u64::from(**value),
            Self::U64(value) => **value,
            Self::F64(value) => value.to_bits(),
        }
    }

    pub(crate) fn set_bits(&mut self, bits: u64) {
        match self {
            Self::U32(value) => **value = bits as u32,
            Self::U64(value) => **value = bits,
            Self::F64(value) => **value = f64::from_bits(bits),
        }
    }

    /// Parses a value written by [`fmt::Display`].
    pub(crate) fn parse(&mut self, text: &str) -> Option<()> {
        match self {
            Self::U32(value) => **value = text.parse().ok()?,
            Self::U64(value) => **value = text.parse().ok()?,
            Self::F64(value) => {
                **value = match text.strip_prefix("bits 0x") {
                    Some(bits) => f64::from_bits(u64::from_str_radix(bits, 16).ok()?),
                    None => text.parse().ok()?,
                }
            }
        }
        Some(())
    }
}

/// Decimal, so that all bits are preserved; a NaN by its bits.
impl fmt::Display for Number<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::U32(value) => write!(f, "{value}"),
            Self::U64(value) => write!(f, "{value}"),
            Self::F64(value) if value.is_nan() => write!(f, "bits 0x{:016x}", value.to_bits()),
            Self::F64(value) => write!(f, "{value:?}"),
        }
    }
}

/// A step of the path to a number.
#[derive(Debug, Clone, Copy)]
pub(crate) enum PathStep {
    Field(&'static str),
    Index(usize),
}

/// The path to a number, such as `points[3].time_ns`.
pub(crate) fn name(path: &[PathStep]) -> String {
    let mut text = String::new();
    for part in path {
        match part {
            PathStep::Field(field) if text.is_empty() => text.push_str(field),
            PathStep::Field(field) => text.extend([".", field]),
            PathStep::Index(index) => text.extend(["[", &index.to_string(), "]"]),
        }
    }
    text
}

/// Callback for each number.
pub(crate) type Visit<'v> = dyn FnMut(&[PathStep], Number<'_>) + 'v;

/// A structure of numbers.
pub(crate) trait Fields {
    /// Visits every number in the order of the layout.
    fn walk(&mut self, path: &mut Vec<PathStep>, visit: &mut Visit<'_>);

    /// Visits every number in the order of the layout.
    fn for_each(&mut self, mut visit: impl FnMut(&[PathStep], Number<'_>))
    where
        Self: Sized,
    {
        self.walk(&mut Vec::new(), &mut visit);
    }

    /// The message with these bytes; missing bytes at the end are zero.
    fn from_bytes(bytes: &[u8]) -> Self
    where
        Self: Sized + Default,
    {
        let (mut message, mut rest) = (Self::default(), bytes);
        message.for_each(|_, mut number| {
            let (mine, others) = rest.split_at(number.size().min(rest.len()));
            let mut word = [0; 8];
            word[..mine.len()].copy_from_slice(mine);
            number.set_bits(u64::from_le_bytes(word));
            rest = others;
        });
        message
    }

    /// Changes the number at `index`.
    fn change(&mut self, index: usize, change: impl Fn(u64) -> u64)
    where
        Self: Sized,
    {
        let mut at = 0;
        self.for_each(|_, mut number| {
            if at == index {
                number.set_bits(change(number.bits()));
            }
            at += 1;
        });
    }
}

impl<T: Struct> Fields for T {
    fn walk(&mut self, path: &mut Vec<PathStep>, visit: &mut Visit<'_>) {
        walk(ValueMut::Struct(self), path, visit);
    }
}

fn walk(value: ValueMut<'_>, path: &mut Vec<PathStep>, visit: &mut Visit<'_>) {
    match value {
        ValueMut::U8(_) => unreachable!("only the daemon sends text"),
        ValueMut::U32(number) => visit(path, Number::U32(number)),
        ValueMut::U64(number) => visit(path, Number::U64(number)),
        ValueMut::F64(number) => visit(path, Number::F64(number)),
        ValueMut::Array(array) => {
            for index in 0..array.count() {
                path.push(PathStep::Index(index));
                walk(array.element_mut(index), path, visit);
                path.pop();
            }
        }
        ValueMut::Struct(message) => message.visit_mut(&mut |field, value| {
            path.push(PathStep::Field(field.name));
            walk(value, path, visit);
            path.pop();
        }),
    }
}

/// Names the fields of a struct that is not a message; all of them are `u32`.
macro_rules! fields {
    ($type:ident { $($field:ident),+ $(,)? }) => {
        impl $crate::fuzz::fields::Fields for $type {
            fn walk(
                &mut self,
                path: &mut Vec<$crate::fuzz::fields::PathStep>,
                visit: &mut $crate::fuzz::fields::Visit<'_>,
            ) {
                let Self { $($field),+ } = self;
                $(
                    path.push($crate::fuzz::fields::PathStep::Field(stringify!($field)));
                    visit(path, $crate::fuzz::fields::Number::U32($field));
                    path.pop();
                )+
            }
        }
    };
}
pub(crate) use fields;

#[test]
fn numbers_are_where_the_bytes_say() {
    let mut bytes = [0; 72];
    bytes[32..36].copy_from_slice(&7_u32.to_le_bytes());
    bytes[64..72].copy_from_slice(&f64::NEG_INFINITY.to_le_bytes());
    let message = cdcr_shared_types::Measurement::from_bytes(&bytes);
    assert_eq!((message.kind, message.bend_rad[0]), (7, f64::NEG_INFINITY));
}
