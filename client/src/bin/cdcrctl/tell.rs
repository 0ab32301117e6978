//! Messages for the user on standard error.

// Prints a line to standard error. If it is closed, the work continues; `eprintln!` would panic.
macro_rules! tell {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        drop(writeln!(std::io::stderr(), $($text)*));
    }};
}
