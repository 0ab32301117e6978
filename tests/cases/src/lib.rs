//! Cases of the tests of external inputs (docs/fuzzing.md): random ones in [`try_cases`], kept ones in [`replay`].

#![allow(
    missing_docs,
    clippy::missing_panics_doc,
    clippy::unwrap_used,
    reason = "of tests: a comment that repeats a name helps nobody, and a panic is the report"
)]

mod cases;
mod corpus;

use std::str::FromStr;

pub use cases::{Tally, cases_asked, try_cases};
pub use corpus::replay;

/// The number in an environment variable.
pub fn asked<T: FromStr>(variable: &str) -> Option<T> {
    let text = std::env::var(variable).ok()?;
    let Ok(number) = text.parse() else {
        panic!("{variable} = {text:?} is not a valid number");
    };
    Some(number)
}
