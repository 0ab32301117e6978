use std::fs::File;
use std::os::unix::fs::FileExt;

/// One tick of `/proc/stat` \[ns\]: `USER_HZ` is 100 on every platform that Linux runs on with user programs.
const TICK_NS: u64 = 10_000_000;

/// Reads how long the hypervisor kept one core from this machine.
#[derive(Debug)]
pub(super) struct StealReader {
    file: File,
    line: String,
    text: Vec<u8>,
}

impl StealReader {
    /// A reader for `core`, or for the sum of all cores. None where `/proc/stat` is not there.
    pub(super) fn open(core: Option<usize>) -> Option<Self> {
        let reader = Self {
            file: File::open("/proc/stat").ok()?,
            line: core.map_or_else(|| "cpu ".to_owned(), |core| format!("cpu{core} ")),
            text: vec![0; 64 * 1024],
        };
        Some(reader)
    }

    /// Time stolen since the machine started \[ns\].
    pub(super) fn read_ns(&mut self) -> Option<u64> {
        let length = self.file.read_at(&mut self.text, 0).ok()?;
        let text = core::str::from_utf8(&self.text[..length]).ok()?;
        Some(steal_ticks(text, &self.line)? * TICK_NS)
    }
}

/// The eighth number of a `cpu` line (`proc_stat(5)`).
fn steal_ticks(text: &str, line: &str) -> Option<u64> {
    let numbers = text.lines().find_map(|l| l.strip_prefix(line))?;
    numbers.split_ascii_whitespace().nth(7)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steal_is_the_eighth_number_of_the_cores_line() {
        let text = "cpu  9 9 9 9 9 9 9 997 0 0\ncpu0 1 2 3 4 5 6 7 490 9 10\n\
                    cpu1 1 2 3 4 5 6 7 507 9 10\ncpu10 1 2 3 4 5 6 7 1 9 10\nintr 5\n";
        assert_eq!(steal_ticks(text, "cpu1 "), Some(507));
        assert_eq!(steal_ticks(text, "cpu "), Some(997));
        assert_eq!(steal_ticks(text, "cpu7 "), None);
        assert_eq!(steal_ticks("cpu0 1 2", "cpu0 "), None);
    }

    #[test]
    fn this_machine_can_be_read() {
        let mut reader = StealReader::open(None).expect("/proc is there");
        assert!(reader.read_ns().is_some());
    }
}
