//! The headers in `include/` agree with this library.

#![allow(clippy::unwrap_used, reason = "in a test a panic is the report")]

mod functions;
mod layout;
mod messages;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn include() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("include")
}

fn header(name: &str) -> String {
    std::fs::read_to_string(include().join(name)).unwrap()
}

/// Errors of a compiler for a source in `language`; empty if there are none. `None` without such a compiler.
fn refused(compiler: &str, language: &str, source: &str) -> Option<String> {
    let mut command = Command::new(compiler);
    command
        .args([format!("-std={language}").as_str(), "-fsyntax-only"])
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"])
        .arg("-I")
        .arg(include())
        .args(["-x", if language.contains("++") { "c++" } else { "c" }, "-"])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().ok()?;
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(source.as_bytes()).unwrap();
    drop(stdin);
    let output = child.wait_with_output().unwrap();
    let reported = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.success(), reported.is_empty(), "{reported}");
    Some(reported)
}
