//! A program that runs beside a test.

use std::io::{ErrorKind, PipeReader, PipeWriter, Read, Write};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use derive_more::{Deref, DerefMut};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};

use crate::TIMEOUT;

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
        let status = self.0.try_wait().expect("it is our child");
        status.is_none()
    }

    /// Waits for the end. After the time limit, fails with `words` in the report.
    pub fn wait(&mut self, words: impl Fn() -> String) -> ExitStatus {
        let begin = Instant::now();
        while self.runs() {
            let is_late = begin.elapsed() > TIMEOUT;
            assert!(!is_late, "the program does not end:\n{}", words());
            std::thread::sleep(Duration::from_millis(5));
        }
        self.0.wait().expect("it is our child")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A program that runs beside the test, with its output. Killed when dropped.
#[derive(Debug, Deref, DerefMut)]
pub struct Program {
    #[deref]
    #[deref_mut]
    child: Running,
    out: Printed,
    err: Printed,
}

impl Program {
    /// Starts the program; its output is kept.
    pub fn start(command: &mut Command) -> Self {
        let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = Running::start(command);
        Self {
            out: Printed::read(child.0.stdout.take().expect("a pipe")),
            err: Printed::read(child.0.stderr.take().expect("a pipe")),
            child,
        }
    }

    /// Number of lines on standard output so far.
    pub fn lines(&self) -> usize {
        self.printed().split('\n').count() - 1
    }

    /// Standard output so far.
    pub fn printed(&self) -> String {
        let text = self.out.text.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&text).into_owned()
    }

    /// Waits for the end.
    pub fn output(&mut self) -> Output {
        Output {
            status: self.child.wait(String::new),
            stdout: self.out.finish(),
            stderr: self.err.finish(),
        }
    }
}

/// Output of a program, read while it runs, because a full pipe would block it.
#[derive(Debug)]
struct Printed {
    text: Arc<Mutex<Vec<u8>>>,
    reader: Option<JoinHandle<()>>,
}

impl Printed {
    fn read(mut pipe: impl Read + Send + 'static) -> Self {
        let text = Arc::<Mutex<Vec<u8>>>::default();
        let kept = text.clone();
        let reader = std::thread::spawn(move || {
            let mut part = [0; 4096];
            while let Ok(length @ 1..) = pipe.read(&mut part) {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend_from_slice(&part[..length]);
            }
        });
        Self {
            text,
            reader: Some(reader),
        }
    }

    /// The whole output of a program that has ended.
    fn finish(&mut self) -> Vec<u8> {
        if let Some(reader) = self.reader.take() {
            reader.join().expect("it only reads");
        }
        let text = self.text.lock().unwrap_or_else(PoisonError::into_inner);
        text.clone()
    }
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
