//! What the kernel tells of itself.

use serde::{Deserialize, Serialize};

use super::system::System;
use super::told;

/// Words of the kernel's command line that keep others off a core.
const ISOLATING: [&str; 3] = ["isolcpus=", "nohz_full=", "rcu_nocbs="];

/// The kernel and what it was told that matters to a punctual loop.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kernel {
    pub release: String,
    /// Version: number of the build and what it was built with.
    pub version: String,
    /// How it preempts: `PREEMPT_RT`, or the word of the version, with the mode where it can be chosen.
    pub preemption: Option<String>,
    /// `isolcpus`, `nohz_full` and `rcu_nocbs` of its command line; all else there is left out.
    pub isolation: Vec<String>,
    /// What it reads the time from.
    pub clock_source: Option<String>,
    /// Transparent huge pages: `always`, `madvise` or `never`.
    pub huge_pages: Option<String>,
    /// Time that real-time threads may have of each period \[µs\]; -1: all of it.
    pub rt_runtime_us: Option<i64>,
    pub rt_period_us: Option<i64>,
}

impl Kernel {
    pub(super) fn of(system: &System) -> Self {
        let own = |name: &str| system.read(&format!("/proc/sys/kernel/{name}"));
        let number = |name| own(name).and_then(|text| text.parse().ok());
        let version = own("version").unwrap_or_default();
        Self {
            release: own("osrelease").unwrap_or_default(),
            preemption: preemption(system, &version),
            version,
            isolation: isolation(&system.read("/proc/cmdline").unwrap_or_default()),
            clock_source: system
                .read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
            huge_pages: system.chosen("/sys/kernel/mm/transparent_hugepage/enabled", ['[', ']']),
            rt_runtime_us: number("sched_rt_runtime_us"),
            rt_period_us: number("sched_rt_period_us"),
        }
    }

    pub(super) fn words(&self) -> String {
        let preemption = told(self.preemption.clone());
        format!(
            "{}, {}; preemption {preemption}",
            self.release, self.version
        )
    }

    pub(crate) fn isolation_words(&self) -> String {
        if self.isolation.is_empty() {
            "none".to_owned()
        } else {
            self.isolation.join(" ")
        }
    }

    pub(super) fn throttling_words(&self) -> String {
        match (self.rt_runtime_us, self.rt_period_us) {
            (Some(runtime), _) if runtime < 0 => "off".to_owned(),
            (Some(runtime), Some(period)) => format!("{runtime} µs of {period} µs"),
            _ => told(None),
        }
    }
}

fn preemption(system: &System, version: &str) -> Option<String> {
    if system.read("/sys/kernel/realtime").as_deref() == Some("1") {
        return Some("PREEMPT_RT".to_owned());
    }
    let mut words = version.split_ascii_whitespace();
    let word = words.find(|word| word.starts_with("PREEMPT"))?;
    // Only root may look.
    Some(
        match system.chosen("/sys/kernel/debug/sched/preempt", ['(', ')']) {
            Some(mode) => format!("{word} ({mode})"),
            None => word.to_owned(),
        },
    )
}

fn isolation(command_line: &str) -> Vec<String> {
    let words = command_line.split_ascii_whitespace();
    words
        .filter(|word| ISOLATING.iter().any(|name| word.starts_with(name)))
        .map(ToOwned::to_owned)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::system::fake;
    use super::*;

    #[test]
    fn a_kernel_is_described_without_the_rest_of_its_command_line() {
        let folder = fake(&[
            ("proc/sys/kernel/osrelease", "6.12.0\n"),
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC @0\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
            ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
            (
                "proc/cmdline",
                "root=/dev/sda1 isolcpus=1 quiet rcu_nocbs=1\n",
            ),
            ("sys/kernel/debug/sched/preempt", "none voluntary (full)\n"),
            (
                "sys/kernel/mm/transparent_hugepage/enabled",
                "always [madvise] never\n",
            ),
        ]);
        let kernel = Kernel::of(&System::below(folder.path()));
        assert_eq!(kernel.preemption.as_deref(), Some("PREEMPT_DYNAMIC (full)"));
        assert_eq!(kernel.isolation_words(), "isolcpus=1 rcu_nocbs=1");
        assert_eq!(kernel.throttling_words(), "950000 µs of 1000000 µs");
        assert_eq!(kernel.huge_pages.as_deref(), Some("madvise"));
    }

    #[test]
    fn a_real_time_kernel_is_named() {
        let folder = fake(&[
            ("sys/kernel/realtime", "1\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "-1\n"),
        ]);
        let kernel = Kernel::of(&System::below(folder.path()));
        assert_eq!(kernel.preemption.as_deref(), Some("PREEMPT_RT"));
        assert_eq!(kernel.throttling_words(), "off");
        assert_eq!(kernel.isolation_words(), "none");
    }
}
