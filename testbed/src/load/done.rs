//! Work done by a load.

use derive_more::AddAssign;
use serde::Serialize;

use super::Load;

/// Counts of a load from start to end: evidence that it ran, and how strongly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, AddAssign)]
pub struct Done {
    /// Time from the moment when all threads worked until the end \[s\], for rates. Zero in the counts of one
    /// thread.
    pub seconds: f64,
    /// Rounds of 100 000 steps by all computing threads.
    pub spins: u64,
    pub copied_bytes: u64,
    /// Bytes written to a file and synced.
    pub written_bytes: u64,
    pub read_bytes: u64,
    pub clients: u64,
    pub failed_clients: u64,
    pub chunks: u64,
    pub updates: u64,
    pub stress_operations: u64,
}

impl Done {
    /// Names of the counts that this load should have raised and that are zero.
    pub fn missing(&self, load: Load) -> Vec<&'static str> {
        let counts = self.of_load(load).into_iter();
        counts
            .filter(|(_, count)| *count == 0)
            .map(|(name, _)| name)
            .collect()
    }

    fn of_load(&self, load: Load) -> Vec<(&'static str, u64)> {
        match load {
            Load::None => Vec::new(),
            Load::Cpu => vec![("spins", self.spins)],
            Load::Memory => vec![("copied_bytes", self.copied_bytes)],
            Load::Io => vec![
                ("written_bytes", self.written_bytes),
                ("read_bytes", self.read_bytes),
            ],
            Load::Clients => vec![("clients", self.clients)],
            Load::Flood => vec![("chunks", self.chunks), ("updates", self.updates)],
            Load::All => Load::PARTS.map(|part| self.of_load(part)).concat(),
            Load::CpuEverywhere => [self.of_load(Load::Cpu), self.of_load(Load::Memory)].concat(),
            Load::StressNg => vec![("stress_operations", self.stress_operations)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_load_did_not_do_has_a_name() {
        let mut done = Done {
            chunks: 3,
            ..Done::default()
        };
        assert_eq!(done.missing(Load::Flood), ["updates"]);
        assert!(done.missing(Load::None).is_empty());
        assert_eq!(done.missing(Load::All).len(), 6);
        done += Done {
            updates: 1,
            chunks: 1,
            ..Done::default()
        };
        assert_eq!((done.chunks, done.missing(Load::Flood)), (4, vec![]));
    }
}
