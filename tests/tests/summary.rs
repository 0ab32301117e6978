//! The last of all test programs, by its name: prints what the others skipped.
//!
//! It takes the arguments of a test harness. A harness that runs each test separately, such as cargo-nextest,
//! finds no test here.

use std::process::ExitCode;

use cdcr_test_skip::{REQUIRE, Run, required_here};

fn main() -> ExitCode {
    if std::env::args().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    if let Err(error) = required_here() {
        eprintln!("{error}");
        return ExitCode::FAILURE;
    }
    let mut skipped = match Run::this().take() {
        Ok(skipped) => skipped,
        Err(error) => {
            println!(
                "what was skipped is not known, because it cannot be written beside the tests ({error}): see the lines \
                 that begin with 'skipped:'"
            );
            return ExitCode::SUCCESS;
        }
    };
    // A test that skips a part repeatedly counts once.
    skipped.dedup();
    for line in &skipped {
        println!("{line}");
    }
    match skipped.len() {
        0 => println!("nothing was skipped"),
        1 => println!("1 test was skipped, see {REQUIRE} in docs/testing.md"),
        count => println!("{count} tests were skipped, see {REQUIRE} in docs/testing.md"),
    }
    ExitCode::SUCCESS
}
