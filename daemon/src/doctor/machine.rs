//! What kind of machine this is, and its memory: shared, huge, swapped.

use cdcr_shared_types::{Measurement, ObstacleUpdate, ReferenceChunk, Service};

use super::Scene;
use super::finding::{Assessed, Problem, fault, unknown, warning};
use super::system::chosen_of;
use crate::services::daemon_bytes;

/// Clocks that are read without a system call.
const FAST: [&str; 9] = [
    "tsc",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "xen",
    "arch_sys_counter",
    "riscv_clocksource",
    "timebase",
    "tod",
    "stp",
];
/// Clocks that are read from a device, or count ticks.
const SLOW: [&str; 6] = [
    "hpet",
    "acpi_pm",
    "jiffies",
    "refined-jiffies",
    "pit",
    "hyperv_clocksource_msr",
];

pub(super) fn clock_source(scene: &Scene) -> Assessed {
    let folder = "/sys/devices/system/clocksource/clocksource0";
    let current = scene
        .system
        .read(&format!("{folder}/current_clocksource"))?;
    if FAST.contains(&&*current) {
        return Ok(current);
    }
    let available = format!("{folder}/available_clocksource");
    if !SLOW.contains(&&*current) {
        let value = format!("{current}: its speed is not known here");
        return Err(unknown(value, format!("cat {available}")));
    }
    let available = scene.system.read(&available)?;
    let mut available = available.split_whitespace();
    Err(match available.find(|name| FAST.contains(name)) {
        Some(better) => warning(
            format!("{current}, though {better} is there"),
            format!("echo {better} | sudo tee {folder}/current_clocksource"),
        ),
        None => warning(
            format!("{current}; there is no fast one"),
            "look for `clocksource` in dmesg; if only the kernel's doubt is in the way, boot with tsc=reliable",
        ),
    })
}

pub(super) fn virtual_machine(scene: &Scene) -> Assessed {
    let processor = scene.system.read("/proc/cpuinfo")?;
    let mut flags = processor.lines().filter(|line| line.starts_with("flags"));
    let has_flag = flags.any(|line| line.split_whitespace().any(|flag| flag == "hypervisor"));
    let product = ["sys_vendor", "product_name"].map(|name| {
        let text = scene.system.read(&format!("/sys/class/dmi/id/{name}"));
        text.unwrap_or_default()
    });
    let product = product.join(" ");
    let known = [
        "KVM",
        "QEMU",
        "VMware",
        "VirtualBox",
        "Virtual Machine",
        "Xen",
    ];
    if !has_flag && !known.iter().any(|name| product.contains(name)) {
        return Ok("no".to_owned());
    }
    let kind = match product.trim() {
        "" => "of unknown make",
        product => product,
    };
    let remedy = "run on the machine itself, or pin this virtual machine to cores of its own";
    Err(warning(format!("yes, {kind}"), remedy))
}

/// What one client and one driver add that write everything they can \[bytes\].
const fn client_bytes() -> u64 {
    let reference = Service::Reference.queues();
    let obstacles = Service::Obstacles.queues();
    let measurement = Service::Measurement.queues();
    reference.writer_bytes(size_of::<ReferenceChunk>())
        + obstacles.writer_bytes(size_of::<ObstacleUpdate>())
        + measurement.writer_bytes(size_of::<Measurement>())
}

/// Files (inodes) of a daemon, and what a client and a driver add.
const DAEMON_FILES: u64 = 60;
const CLIENT_FILES: u64 = 60;

pub(super) fn shared_memory(scene: &Scene) -> Assessed {
    let probe = &scene.probe;
    let hidden = |cause| Problem::unreadable(&scene.root().display().to_string(), cause);
    let (size, free) = probe.shared_memory_bytes.as_ref().map_err(hidden)?;
    // A daemon that runs has taken its part.
    let (daemon, daemon_files) = if scene.daemon_runs() {
        (0, 0)
    } else {
        (daemon_bytes(), DAEMON_FILES)
    };
    let needed = daemon + client_bytes();
    let [free_mb, size_mb, needed_mb] = [*free, *size, needed].map(|bytes| bytes as f64 * 1e-6);
    let value = format!("{free_mb:.0} MB of {size_mb:.0} MB free; still needed {needed_mb:.0} MB");
    let mount = probe.shared_memory_mount.display();
    let files = CLIENT_FILES + daemon_files;
    if let Some(free) = probe.shared_memory_files.filter(|free| *free < files) {
        return Err(fault(
            format!("{value}; {free} files can be made, still needed {files}"),
            format!("sudo mount -o remount,nr_inodes=100k {mount}, or remove files there"),
        ));
    }
    let enough = (size + needed).next_multiple_of(1 << 26) >> 20;
    let remedy = format!(
        "sudo mount -o remount,size={enough}M {mount}   (a container: --shm-size={enough}m)"
    );
    if *free < daemon {
        Err(fault(value, remedy))
    } else if *free < needed {
        Err(warning(value, remedy))
    } else {
        Ok(value)
    }
}

pub(super) fn huge_pages(scene: &Scene) -> Assessed {
    let path = "/sys/kernel/mm/transparent_hugepage/enabled";
    let Some(text) = scene.system.read_if_there(path)? else {
        return Ok("the kernel has none".to_owned());
    };
    let odd = || Problem::unreadable(path, format!("{text:?} has no choice in brackets"));
    let chosen = chosen_of(&text, ['[', ']']).ok_or_else(odd)?;
    match &scene.probe.no_huge_pages {
        _ if chosen != "always" => Ok(chosen.to_owned()),
        Ok(()) => Ok("always, but not for the daemon: it exempts itself".to_owned()),
        Err(refusal) => Err(warning(
            format!("always, also for the daemon: PR_SET_THP_DISABLE is refused ({refusal})"),
            format!("echo madvise | sudo tee {path}"),
        )),
    }
}

pub(super) fn swap(scene: &Scene) -> Assessed {
    let areas = scene
        .system
        .read_if_there("/proc/swaps")?
        .unwrap_or_default();
    // The first line is the head.
    match areas.lines().skip(1).count() {
        0 => Ok("none".to_owned()),
        count if scene.probe.memory_lock.is_ok() => {
            Ok(format!("{count} in use, and memory can be locked"))
        }
        count => Err(warning(
            format!("{count} in use, and memory is not locked"),
            "sudo swapoff -a, or let the daemon lock its memory",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Severity::{Fault, Ok as Good, Warning};
    use super::super::fake::Fake;
    use super::*;

    #[test]
    fn shared_memory_must_hold_a_daemon_and_a_client() {
        let mut fake = Fake::new(&[("/run/cdcr/cdcr_cdcr.lock", "12\n")]);
        let mut with_free = |bytes: u64| {
            fake.scene.probe.shared_memory_bytes = Ok((1 << 26, bytes));
            fake.finding("shared_memory").severity
        };
        assert_eq!(with_free(daemon_bytes() - 1), Fault);
        assert_eq!(with_free(daemon_bytes()), Warning);
        assert_eq!(with_free(daemon_bytes() + client_bytes()), Good);
        // A daemon that runs has taken its part.
        assert_eq!(with_free(client_bytes()), Fault);
        fake.write("/proc/12/stat", "");
        assert_eq!(fake.finding("shared_memory").severity, Good);
    }
}
