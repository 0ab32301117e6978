use std::env;
use std::io::Read;
use std::process::{Child, Command, Stdio};

/// `cdcrd doctor` at work: what the machine of a recording is like.
pub(super) struct Examination {
    child: Child,
}

impl Examination {
    /// Begins it, where `cdcrd` lies beside this program. It takes a second.
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

    /// What it found; none where it has not ended, or not well.
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
