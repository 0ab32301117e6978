//! What the processor tells.

use serde::{Deserialize, Serialize};

use super::system::System;

const CPUINFO: &str = "/proc/cpuinfo";

/// The processor, as it is seen from the core that is measured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Processor {
    pub model: String,
    pub vendor: Option<String>,
    pub cores: usize,
    /// Caches of the core, like `L1 Data 32K`.
    pub caches: Vec<String>,
    /// Frequency, as told at the start \[MHz\].
    pub frequency_mhz: Option<f64>,
    pub governor: Option<String>,
}

impl Processor {
    pub(super) fn of(system: &System, core: usize) -> Self {
        let field = |key| system.field(CPUINFO, key);
        let model = field("model name")
            .or_else(|| field("Model"))
            .or_else(|| system.read("/proc/device-tree/model"));
        Self {
            model: model.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            vendor: field("vendor_id").or_else(|| field("CPU implementer")),
            cores: online(system),
            caches: caches(system, core),
            frequency_mhz: frequency_mhz(system, core),
            governor: system.read(&format!("{}/cpufreq/scaling_governor", folder(core))),
        }
    }

    pub(super) fn words(&self) -> String {
        let mut words = vec![self.model.clone()];
        words.extend(self.vendor.clone());
        words.push(match self.cores {
            1 => "1 core".to_owned(),
            count => format!("{count} cores"),
        });
        words.extend(self.frequency_mhz.map(|mhz| format!("{mhz:.0} MHz")));
        words.extend(self.caches.iter().cloned());
        words.join(", ")
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

/// Whether the processor says that a hypervisor runs it; none where processors have no such flag.
pub(super) fn is_virtual(system: &System) -> Option<bool> {
    let flags = system.field(CPUINFO, "flags")?;
    Some(
        flags
            .split_ascii_whitespace()
            .any(|flag| flag == "hypervisor"),
    )
}

/// Name of the hypervisor; none on a machine that is not virtual.
pub(super) fn hypervisor(system: &System) -> Option<String> {
    if is_virtual(system) == Some(false) {
        return None;
    }
    let firmware = |name| system.read(&format!("/sys/class/dmi/id/{name}"));
    system.read("/sys/hypervisor/type").or_else(|| {
        // Where nothing says that it is virtual, this would be the maker of a real machine.
        is_virtual(system)?;
        let names: Vec<String> = ["sys_vendor", "product_name"]
            .into_iter()
            .filter_map(firmware)
            .collect();
        (!names.is_empty()).then(|| names.join(" "))
    })
}

#[cfg(test)]
mod tests {
    use super::super::system::fake;
    use super::*;

    #[test]
    fn a_virtual_processor_is_described() {
        let folder = fake(&[
            (
                "proc/cpuinfo",
                "processor : 0\nvendor_id\t: Maker\nmodel name\t: Quick 9\ncpu MHz\t: 2500.5\n\
                 flags\t: fpu hypervisor avx\n",
            ),
            ("sys/devices/system/cpu/online", "0-3,5\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/level", "1\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/type", "Data\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/size", "32K\n"),
            ("sys/class/dmi/id/sys_vendor", "Cloud\n"),
            ("sys/class/dmi/id/product_name", "large\n"),
        ]);
        let system = System::below(folder.path());
        let processor = Processor::of(&system, 2);
        assert_eq!(
            processor.words(),
            "Quick 9, Maker, 5 cores, 2500 MHz, L1 Data 32K"
        );
        assert_eq!(is_virtual(&system), Some(true));
        assert_eq!(hypervisor(&system).as_deref(), Some("Cloud large"));
    }

    #[test]
    fn the_maker_of_a_real_machine_is_no_hypervisor() {
        let folder = fake(&[
            ("proc/cpuinfo", "flags : fpu avx\n"),
            ("sys/class/dmi/id/sys_vendor", "Maker\n"),
        ]);
        let system = System::below(folder.path());
        assert_eq!(
            (is_virtual(&system), hypervisor(&system)),
            (Some(false), None)
        );
    }
}
