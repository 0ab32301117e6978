use std::env;
use std::io::Read;
use std::process::{Child, Command, Stdio};

/// A running `cdcrd doctor`, which examines the machine of a recording.
pub(super) struct Examination {
    child: Child,
}

impl Examination {
    /// Starts it, if `cdcrd` is in the folder of this program. It takes a second.
    pub(super) fn begin() -> Option<Self> {
        let program = env::current_exe().ok()?.with_file_name("cdcrd");
        let mut command = Command::new(program);
        command.args(["doctor", "--format", "json"]);
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        Some(Self { child: child.ok()? })
    }

    /// Its output; `None` if it has not ended or has failed.
    pub(super) fn end(mut self) -> Option<Vec<u8>> {
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = self.child.kill();
        }
        let mut report = Vec::new();
        let read = self.child.stdout.take()?.read_to_end(&mut report);
        let _ = self.child.wait();
        let is_whole = read.is_ok() && report.trim_ascii_end().ends_with(b"}");
        is_whole.then_some(report)
    }
}
