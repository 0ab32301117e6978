//! Description of the machine for a result. Unavailable properties are null.
//!
//! Invariant: nothing here contains the name of the machine, its user or one of its folders.

use std::path::PathBuf;

use cdcr_shared_types::proc_stat;
use serde_json::{Value, json};

use super::cores::Cores;
use super::thread::may_be_realtime;

/// Bit of the capability `CAP_IPC_LOCK` in `CapEff` (capabilities(7)).
const CAP_IPC_LOCK: u32 = 14;
const ISOLATING: [&str; 3] = ["isolcpus=", "nohz_full=", "rcu_nocbs="];

/// The properties of this machine, as a JSON object.
pub fn describe(cores: &Cores) -> Value {
    described(&Root(PathBuf::from("/")), cores, may_be_realtime())
}

fn described(root: &Root, cores: &Cores, realtime: bool) -> Value {
    let number = |text: Option<String>| -> Option<f64> {
        text?.split_ascii_whitespace().next()?.parse().ok()
    };
    let cpuinfo = |key| root.field("proc/cpuinfo", key);
    let kernel = |name: &str| root.read(&format!("proc/sys/kernel/{name}"));
    let folder = format!("sys/devices/system/cpu/cpu{}", cores.realtime);
    let core = |name: &str| root.read(&format!("{folder}/{name}"));
    // Caches of the measured core, like `L1 Data 32K`.
    let cache = |index: usize| {
        let read = |name| core(&format!("cache/index{index}/{name}"));
        let (level, kind, size) = (read("level")?, read("type")?, read("size")?);
        Some(format!("L{level} {kind} {size}"))
    };
    let model = cpuinfo("model name").or_else(|| cpuinfo("Model"));
    let model = model.or_else(|| root.read("proc/device-tree/model"));
    let khz = number(core("cpufreq/scaling_cur_freq"));
    let version = kernel("version").unwrap_or_default();
    let command_line = root.read("proc/cmdline").unwrap_or_default();
    let isolates = |word: &&str| ISOLATING.iter().any(|name| word.starts_with(name));
    json!({
        "processor": {
            "model": model.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            "vendor": cpuinfo("vendor_id").or_else(|| cpuinfo("CPU implementer")),
            "cores": root.read("proc/cpuinfo").map(|all| all.matches("processor\t:").count()),
            "caches": (0..8).map_while(cache).collect::<Vec<_>>(),
            "frequency_mhz": khz.map(|khz| khz * 1e-3).or_else(|| number(cpuinfo("cpu MHz"))),
            "governor": core("cpufreq/scaling_governor"),
        },
        // Whether the processor reports a hypervisor, which may halt the cores at any time.
        "virtual_machine": root.is_virtual(),
        "hypervisor": root.hypervisor(),
        "kernel": {
            "release": kernel("osrelease").unwrap_or_default(),
            // `PREEMPT_RT` or the word of the version, with the mode where it can be selected.
            "preemption": root.preemption(&version),
            "version": version,
            // `isolcpus`, `nohz_full` and `rcu_nocbs` of the command line; the rest is left out.
            "isolation": command_line.split_ascii_whitespace().filter(isolates).collect::<Vec<_>>(),
            "clock_source": root.read("sys/devices/system/clocksource/clocksource0/current_clocksource"),
            // Transparent huge pages: `always`, `madvise` or `never`.
            "huge_pages": chosen(root.read("sys/kernel/mm/transparent_hugepage/enabled"), ['[', ']']),
            // Limit on the time of real-time threads in each period; -1: none.
            "rt_runtime_us": number(kernel("sched_rt_runtime_us")).map(|us| us as i64),
            "rt_period_us": number(kernel("sched_rt_period_us")).map(|us| us as i64),
        },
        "memory_mb": number(root.field("proc/meminfo", "MemTotal")).map(|kib| (kib * 1024.0 / 1e6) as u64),
        // Average of the last minute before the start; 1 is one busy core.
        "load_average": number(root.read("proc/loadavg")),
        "privileges": { "realtime": realtime, "lock_memory": root.may_lock() },
        "cores": { "realtime": cores.realtime, "others": cores.others },
    })
}

struct Root(PathBuf);

impl Root {
    fn read(&self, file: &str) -> Option<String> {
        let text = std::fs::read(self.0.join(file)).ok()?;
        // Firmware texts end with a zero byte.
        let text = String::from_utf8_lossy(&text);
        let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// The value of the first line `key : value`, unless empty.
    fn field(&self, file: &str, key: &str) -> Option<String> {
        let text = self.read(file)?;
        let value = proc_stat::field(&text, key).filter(|value| !value.is_empty());
        value.map(str::to_owned)
    }

    fn preemption(&self, version: &str) -> Option<String> {
        if self.read("sys/kernel/realtime").as_deref() == Some("1") {
            return Some("PREEMPT_RT".to_owned());
        }
        let mut words = version.split_ascii_whitespace();
        let word = words.find(|word| word.starts_with("PREEMPT"))?;
        // Readable by root only.
        let mode = chosen(self.read("sys/kernel/debug/sched/preempt"), ['(', ')']);
        Some(mode.map_or(word.to_owned(), |mode| format!("{word} ({mode})")))
    }

    fn is_virtual(&self) -> Option<bool> {
        let flags = self.field("proc/cpuinfo", "flags")?;
        let mut flags = flags.split_ascii_whitespace();
        Some(flags.any(|flag| flag == "hypervisor"))
    }

    /// Name of the hypervisor. The firmware of a physical machine would name its manufacturer.
    fn hypervisor(&self) -> Option<String> {
        let names = ["sys_vendor", "product_name"];
        let names = names.map(|name| self.read(&format!("sys/class/dmi/id/{name}")));
        let names = names.into_iter().flatten().collect::<Vec<_>>().join(" ");
        let firmware = Some(names).filter(|names| !names.is_empty());
        match self.is_virtual() {
            Some(false) => None,
            Some(true) => self.read("sys/hypervisor/type").or(firmware),
            None => self.read("sys/hypervisor/type"),
        }
    }

    fn may_lock(&self) -> bool {
        use rustix::process::{Resource, getrlimit};
        let status = self.read("proc/self/status").unwrap_or_default();
        proc_stat::has_bit(&status, "CapEff", CAP_IPC_LOCK)
            || getrlimit(Resource::Memlock).current.is_none()
    }
}

fn chosen(text: Option<String>, brackets: [char; 2]) -> Option<String> {
    Some(proc_stat::chosen(&text?, brackets)?.to_owned())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn other_machines_are_understood_and_nothing_private_is_kept() {
        let folder = cdcr_scratch::Scratch::temporary().expect("a folder");
        let huge_pages = "sys/kernel/mm/transparent_hugepage/enabled";
        for (name, text) in [
            ("proc/cpuinfo", "flags : fpu avx\n"),
            ("sys/class/dmi/id/sys_vendor", "Maker\n"),
            ("sys/kernel/realtime", "1\n"),
            ("proc/cmdline", "root=/dev/sda1 isolcpus=1 quiet\n"),
            (huge_pages, "always [madvise] never\n"),
        ] {
            let file = folder.path().join(name);
            fs::create_dir_all(file.parent().expect("a folder above")).expect("made");
            fs::write(file, text).expect("written");
        }
        let root = Root(folder.path().to_owned());
        let machine = described(&root, &Cores::find().expect("cores"), false);
        for (name, value) in [
            ("/hypervisor", json!(null)),
            ("/kernel/preemption", json!("PREEMPT_RT")),
            ("/kernel/isolation", json!(["isolcpus=1"])),
            ("/kernel/huge_pages", json!("madvise")),
            ("/memory_mb", json!(null)),
        ] {
            assert_eq!(machine.pointer(name), Some(&value), "{name}");
        }
    }
}
