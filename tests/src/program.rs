//! A program that runs beside a test.

use std::io::{ErrorKind, Read};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::TIMEOUT;

/// A program that runs beside the test. Killed when dropped.
#[derive(Debug)]
pub struct Program {
    child: Child,
    out: Printed,
    err: Printed,
}

impl Program {
    /// Starts it; what it prints is kept.
    pub fn start(command: &mut Command) -> Self {
        let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = loop {
            match command.spawn() {
                // A fresh copy: while another test starts a program, that one's child holds it open for a moment.
                Err(cause) if cause.kind() == ErrorKind::ExecutableFileBusy => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                child => break child.expect("the program starts"),
            }
        };
        Self {
            out: Printed::read(child.stdout.take().expect("a pipe")),
            err: Printed::read(child.stderr.take().expect("a pipe")),
            child,
        }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("it is our child");
    }

    pub fn runs(&mut self) -> bool {
        let status = self.child.try_wait().expect("it is our child");
        status.is_none()
    }

    /// Lines that it has printed on standard output so far.
    pub fn lines(&self) -> usize {
        let text = self.out.text.lock().unwrap_or_else(PoisonError::into_inner);
        text.split(|byte| *byte == b'\n').count() - 1
    }

    /// What it has printed on standard output so far.
    pub fn printed(&self) -> String {
        let text = self.out.text.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&text).into_owned()
    }

    /// Waits for its end.
    pub fn output(&mut self) -> Output {
        let begin = Instant::now();
        while self.runs() {
            assert!(begin.elapsed() < TIMEOUT, "the program does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
        Output {
            status: self.child.wait().expect("it is our child"),
            stdout: self.out.finish(),
            stderr: self.err.finish(),
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What a program prints, read while it runs: a full pipe would hold it up.
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

    /// All of it, of a program that has ended.
    fn finish(&mut self) -> Vec<u8> {
        if let Some(reader) = self.reader.take() {
            reader.join().expect("it only reads");
        }
        let text = self.text.lock().unwrap_or_else(PoisonError::into_inner);
        text.clone()
    }
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
