//! Files of the kernel, read below a root that a test can replace, and what they tell.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

const CPUINFO: &str = "/proc/cpuinfo";
/// Words of the kernel's command line that keep others off a core.
const ISOLATING: [&str; 3] = ["isolcpus=", "nohz_full=", "rcu_nocbs="];

#[derive(Debug, Clone)]
pub(super) struct System {
    root: PathBuf,
}

impl System {
    pub(super) fn real() -> Self {
        Self::below(Path::new("/"))
    }

    pub(super) fn below(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
        }
    }

    /// The text of a file without the space around it; none where it cannot be read, or is empty.
    pub(super) fn read(&self, file: &str) -> Option<String> {
        let text = fs::read(self.root.join(file.trim_start_matches('/'))).ok()?;
        // Texts of firmware end with a zero.
        let text = String::from_utf8_lossy(&text);
        let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// The value of the first line `key : value`.
    pub(super) fn field(&self, file: &str, key: &str) -> Option<String> {
        let text = self.read(file)?;
        let mut lines = text.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines.find(|(name, _)| name.trim() == key)?;
        Some(value.trim().to_owned()).filter(|value| !value.is_empty())
    }

    /// The word in brackets of a file that lists what could be chosen.
    pub(super) fn chosen(&self, file: &str, brackets: [char; 2]) -> Option<String> {
        let text = self.read(file)?;
        let (_, rest) = text.split_once(brackets[0])?;
        Some(rest.split_once(brackets[1])?.0.to_owned())
    }

    /// The kernel and what it was told that matters to a punctual loop.
    pub(super) fn kernel(&self) -> Value {
        let own = |name: &str| self.read(&format!("/proc/sys/kernel/{name}"));
        let number = |name| own(name).and_then(|text| text.parse::<i64>().ok());
        // Number of the build and what it was built with.
        let version = own("version").unwrap_or_default();
        json!({
            "release": own("osrelease").unwrap_or_default(),
            // `PREEMPT_RT`, or the word of the version, with the mode where it can be chosen.
            "preemption": preemption(self, &version),
            "version": version,
            // `isolcpus`, `nohz_full` and `rcu_nocbs` of its command line; all else there is left out.
            "isolation": isolation(&self.read("/proc/cmdline").unwrap_or_default()),
            "clock_source": self
                .read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
            // Transparent huge pages: `always`, `madvise` or `never`.
            "huge_pages": self.chosen("/sys/kernel/mm/transparent_hugepage/enabled", ['[', ']']),
            // Time that real-time threads may have of each period; -1: all of it.
            "rt_runtime_us": number("sched_rt_runtime_us"),
            "rt_period_us": number("sched_rt_period_us"),
        })
    }

    pub(super) fn processor(&self, core: usize) -> Value {
        let field = |key| self.field(CPUINFO, key);
        let model = field("model name")
            .or_else(|| field("Model"))
            .or_else(|| self.read("/proc/device-tree/model"));
        json!({
            "model": model.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            "vendor": field("vendor_id").or_else(|| field("CPU implementer")),
            "cores": online(self),
            // Of the core, like `L1 Data 32K`.
            "caches": caches(self, core),
            "frequency_mhz": frequency_mhz(self, core),
            "governor": self.read(&format!("{}/cpufreq/scaling_governor", folder(core))),
        })
    }

    /// Whether the processor says that a hypervisor runs it; none where processors have no such flag.
    pub(super) fn is_virtual(&self) -> Option<bool> {
        let flags = self.field(CPUINFO, "flags")?;
        Some(
            flags
                .split_ascii_whitespace()
                .any(|flag| flag == "hypervisor"),
        )
    }

    /// Name of the hypervisor; none on a machine that is not virtual.
    pub(super) fn hypervisor(&self) -> Option<String> {
        if self.is_virtual() == Some(false) {
            return None;
        }
        let firmware = |name| self.read(&format!("/sys/class/dmi/id/{name}"));
        self.read("/sys/hypervisor/type").or_else(|| {
            // Where nothing says that it is virtual, this would be the maker of a real machine.
            self.is_virtual()?;
            let names: Vec<String> = ["sys_vendor", "product_name"]
                .into_iter()
                .filter_map(firmware)
                .collect();
            (!names.is_empty()).then(|| names.join(" "))
        })
    }
}

fn folder(core: usize) -> String {
    format!("/sys/devices/system/cpu/cpu{core}")
}

fn online(system: &System) -> usize {
    let list = system.read("/sys/devices/system/cpu/online");
    let count = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        Some(last.parse::<usize>().ok()? + 1 - first.parse::<usize>().ok()?)
    };
    let counted = list.and_then(|list| list.split(',').map(count).sum());
    counted.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
}

fn caches(system: &System, core: usize) -> Vec<String> {
    let cache = |index: usize| {
        let read = |name| system.read(&format!("{}/cache/index{index}/{name}", folder(core)));
        Some(format!(
            "L{} {} {}",
            read("level")?,
            read("type")?,
            read("size")?
        ))
    };
    (0..8).map_while(cache).collect()
}

fn frequency_mhz(system: &System, core: usize) -> Option<f64> {
    let khz = system.read(&format!("{}/cpufreq/scaling_cur_freq", folder(core)));
    let khz: Option<f64> = khz.and_then(|khz| khz.parse().ok());
    khz.map(|khz| khz * 1e-3)
        .or_else(|| system.field(CPUINFO, "cpu MHz")?.parse().ok())
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

/// A root folder with these files of the kernel.
#[cfg(test)]
pub(super) fn fake(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in files {
        let file = folder.path().join(name);
        fs::create_dir_all(file.parent().expect("a folder above")).expect("made");
        fs::write(file, text).expect("written");
    }
    folder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_real_machine_with_a_real_time_kernel_has_no_hypervisor() {
        let folder = fake(&[
            ("proc/cpuinfo", "flags : fpu avx\n"),
            ("sys/class/dmi/id/sys_vendor", "Maker\n"),
            ("sys/kernel/realtime", "1\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "-1\n"),
        ]);
        let system = System::below(folder.path());
        assert_eq!(system.is_virtual(), Some(false));
        assert_eq!(system.hypervisor(), None);
        let kernel = system.kernel();
        assert_eq!(kernel["preemption"], "PREEMPT_RT");
        assert_eq!(kernel["rt_runtime_us"], -1);
        assert_eq!(kernel["isolation"], json!([]));
    }
}
