//! A program that runs beside a test.

use std::fs::File;
use std::io::{ErrorKind, PipeReader, PipeWriter, Write};
use std::os::unix::fs::FileExt as _;
use std::process::{Child, Command, ExitStatus, Output};
use std::time::Duration;

use cdcr_process::{has_ended, reap};
use derive_more::{Deref, DerefMut};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, WaitIdOptions, kill_process};

use crate::wait_for;

/// A process of the test. Dropping it kills and reaps it, because a zombie is not dead for iceoryx2.
#[derive(Debug)]
pub struct Running(pub Child);

impl Running {
    pub fn start(command: &mut Command) -> Self {
        loop {
            match command.spawn() {
                // A fresh copy: the child of another test may still have it open for writing for a moment.
                Err(cause) if cause.kind() == ErrorKind::ExecutableFileBusy => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                child => return Self(child.expect("the program starts")),
            }
        }
    }

    pub fn id(&self) -> u32 {
        self.0.id()
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).expect("it is our child");
    }

    pub fn runs(&mut self) -> bool {
        self.try_wait().is_none()
    }

    /// Waits for the end. After the time limit, fails with `words` in the report.
    pub fn wait(&mut self, words: impl Fn() -> String) -> ExitStatus {
        let words = || format!("the program does not end:\n{}", words());
        wait_for(words, || self.try_wait())
    }

    /// The status of a process that has ended.
    fn try_wait(&mut self) -> Option<ExitStatus> {
        // Of a process that was reaped before, the status is known.
        let has_ended = has_ended(&self.0, WaitIdOptions::NOHANG).unwrap_or(true);
        has_ended.then(|| reap(&mut self.0).expect("it is our child"))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = has_ended(&self.0, WaitIdOptions::empty());
        let _ = reap(&mut self.0);
    }
}

/// A program that runs beside the test, with its output. Killed when dropped.
#[derive(Debug, Deref, DerefMut)]
pub struct Program {
    #[deref]
    #[deref_mut]
    child: Running,
    // Files without names: a full pipe would block the program.
    out: File,
    err: File,
}

impl Program {
    /// Starts the program; its output is kept.
    pub fn start(command: &mut Command) -> Self {
        let [out, err] = [(); 2].map(|()| tempfile::tempfile().expect("a temporary file"));
        let writer = |file: &File| file.try_clone().expect("a second handle");
        let command = command.stdout(writer(&out)).stderr(writer(&err));
        let child = Running::start(command);
        Self { child, out, err }
    }

    /// Number of lines on standard output so far.
    pub fn lines(&self) -> usize {
        self.printed().split('\n').count() - 1
    }

    /// Standard output so far.
    pub fn printed(&self) -> String {
        String::from_utf8_lossy(&written(&self.out)).into_owned()
    }

    /// Waits for the end.
    pub fn output(&mut self) -> Output {
        Output {
            status: self.child.wait(String::new),
            stdout: written(&self.out),
            stderr: written(&self.err),
        }
    }
}

/// What a file contains so far. Leaves its position, which the program shares.
fn written(file: &File) -> Vec<u8> {
    let length = file.metadata().expect("it is open").len();
    let mut text = vec![0; length as usize];
    file.read_exact_at(&mut text, 0).expect("it was written");
    text
}

/// A pipe without a reader that accepts nothing more; a further writer blocks.
pub fn unread_pipe() -> (PipeReader, PipeWriter) {
    let (reader, mut writer) = std::io::pipe().unwrap();
    let flags = fcntl_getfl(&writer).unwrap();
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).unwrap();
    let full = loop {
        if let Err(error) = writer.write(&[b' '; 4096]) {
            break error;
        }
    };
    assert_eq!(full.kind(), ErrorKind::WouldBlock, "{full}");
    fcntl_setfl(&writer, flags).unwrap();
    (reader, writer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_program_prints_may_be_more_than_a_pipe_holds() {
        let mut command = Command::new("sh");
        command.args(["-c", "yes | head -c 1000000; echo late >&2; exit 3"]);
        let output = Program::start(&mut command).output();
        assert_eq!(output.status.code(), Some(3));
        assert_eq!(
            (output.stdout.len(), &output.stderr[..]),
            (1_000_000, &b"late\n"[..])
        );
    }
}
