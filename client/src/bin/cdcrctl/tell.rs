//! What a person is told beside what is printed.

/// Prints a line to the standard error. Where that is closed nobody reads it, and the work goes on; `eprintln!` would panic.
macro_rules! tell {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        drop(writeln!(std::io::stderr(), $($text)*));
    }};
}
