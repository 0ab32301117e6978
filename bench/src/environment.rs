//! The machine of a result, without which its numbers cannot be compared with others.
//!
//! Invariant: nothing here contains the name of the machine, its user or one of its folders.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

use anyhow::Result;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::dataset::flat;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;

/// Bit of the capability `CAP_IPC_LOCK` in `CapEff` (capabilities(7)).
const CAP_IPC_LOCK: u32 = 14;
const ISOLATING: [&str; 3] = ["isolcpus=", "nohz_full=", "rcu_nocbs="];
const MOVING: [&str; 11] = [
    "debug build",
    "hypervisor",
    "kernel clock source",
    "kernel isolation",
    "kernel release",
    "privileges lock memory",
    "privileges realtime",
    "processor cores",
    "processor governor",
    "processor model",
    "virtual machine",
];

/// The machine at the start of a run. Unavailable properties are null.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Environment(Map<String, Value>);

impl Environment {
    /// Reads the properties of this machine. Call it before any thread of this process is pinned.
    pub fn find() -> Result<Self> {
        let root = Root(PathBuf::from("/"));
        let mut found = Self::of(&root, &Cores::find()?, may_be_realtime());
        found.0.insert("commit".to_owned(), json!(commit()));
        Ok(found)
    }

    fn of(root: &Root, cores: &Cores, realtime: bool) -> Self {
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
        let all = json!({
            // Start of the run in UTC, like `2026-11-21T12:00:00Z`.
            "started_utc": humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            "cdcr_version": env!("CARGO_PKG_VERSION"),
            "commit": null,
            // Built without optimisation: its times are meaningless.
            "debug_build": cfg!(debug_assertions),
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
        });
        Self(all.as_object().cloned().unwrap_or_default())
    }

    pub fn is_realtime(&self) -> bool {
        self.value("privileges realtime") == true
    }

    fn value(&self, property: &str) -> Value {
        self.properties().remove(property).unwrap_or_default()
    }

    fn text(&self, property: &str) -> String {
        self.value(property).as_str().unwrap_or_default().to_owned()
    }

    fn properties(&self) -> BTreeMap<String, Value> {
        let values = flat(&json!(self)).into_iter();
        let named = values.map(|(key, value)| (key.replace('_', " "), value));
        named.collect()
    }

    pub fn rows(&self) -> Vec<Value> {
        let rows = self.properties().into_iter();
        let rows = rows.map(|(property, value)| json!({ "property": property, "value": value }));
        rows.collect()
    }

    /// Properties that differ between two machines and affect absolute times. An older file may lack a
    /// property.
    pub(crate) fn differing(&self, other: &Self) -> Vec<(&'static str, Value, Value)> {
        let empty = [json!(null), json!(""), json!(false), json!(0), json!([])];
        let mut both = Vec::from(MOVING.map(|name| (name, self.value(name), other.value(name))));
        both.retain(|(_, old, new)| old != new && !(empty.contains(old) && empty.contains(new)));
        both
    }

    fn model_and_kernel(&self) -> String {
        let [model, release] = ["processor model", "kernel release"].map(|name| self.text(name));
        format!("{model}, kernel {release}")
    }

    /// The minimal description for a number: processor, kernel, real-time rights.
    pub fn line(&self) -> String {
        let realtime = ["refused", "granted"][usize::from(self.is_realtime())];
        let machine = self.model_and_kernel();
        format!("Measured on {machine}, real time {realtime}.")
    }

    pub(crate) fn run(&self) -> String {
        let [version, started] = ["cdcr version", "started utc"].map(|name| self.text(name));
        let commit = match &*self.text("commit") {
            "" => String::new(),
            commit => format!(" ({commit})"),
        };
        let machine = self.model_and_kernel();
        format!("cdcr {version}{commit}, {started}, {machine}")
    }
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
        let mut lines = text.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines.find(|(name, _)| name.trim() == key)?;
        Some(value.trim().to_owned()).filter(|value| !value.is_empty())
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
        let capabilities = self.field("proc/self/status", "CapEff");
        let bits = capabilities.and_then(|hex| u64::from_str_radix(&hex, 16).ok());
        bits.is_some_and(|bits| bits >> CAP_IPC_LOCK & 1 == 1)
            || getrlimit(Resource::Memlock).current.is_none()
    }
}

fn chosen(text: Option<String>, brackets: [char; 2]) -> Option<String> {
    let text = text?;
    let (_, rest) = text.split_once(brackets[0])?;
    Some(rest.split_once(brackets[1])?.0.to_owned())
}

/// The commit, with a `+` for changed files; `None` without git or outside a working copy of this project.
fn commit() -> Option<String> {
    let git = |arguments: &str| {
        let mut git = Command::new("git");
        git.arg("--no-optional-locks").args(arguments.split(' '));
        let output = git.output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    let root = git("rev-parse --show-toplevel")?;
    let manifest = std::fs::read_to_string(Path::new(&root).join("bench/Cargo.toml")).ok()?;
    let commit = git("rev-parse --short=12 HEAD")?;
    let changed = git("status --porcelain --untracked-files=no")?;
    let is_ours = manifest.contains("name = \"cdcr-bench\"");
    is_ours.then(|| commit + if changed.is_empty() { "" } else { "+" })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_was_written_is_read_again_and_names_neither_the_machine_nor_a_folder() {
        let here = Environment::find().expect("a machine");
        let json = serde_json::to_string(&here).expect("JSON");
        let read = |json: &str| serde_json::from_str::<Environment>(json).expect("few keys");
        assert_eq!(read(&json), here);
        let known = here.properties();
        assert!(MOVING.iter().all(|name| known.contains_key(*name)));
        let older = read("{\"kernel\":{}}");
        assert!(older.differing(&Environment::default()).is_empty());
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let folder = std::env::current_dir().expect("a folder");
        // Skipped if the host name is a word of the description.
        let host = host.trim();
        assert!(host.len() <= 4 || !json.contains(host), "{json}");
        assert!(!json.contains(&*folder.to_string_lossy()), "{json}");
    }

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
        let machine = Environment::of(&root, &Cores::find().expect("cores"), false);
        for (name, value) in [
            ("hypervisor", json!(null)),
            ("kernel preemption", json!("PREEMPT_RT")),
            ("kernel isolation", json!(["isolcpus=1"])),
            ("kernel huge pages", json!("madvise")),
            ("memory mb", json!(null)),
        ] {
            assert_eq!(machine.value(name), value, "{name}");
        }
    }
}
