//! The machine, its memory (shared, huge pages, swap), and the root folder of daemon and clients.

use std::io::ErrorKind;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use cdcr_shared_types::proc_stat::{chosen, field};
use cdcr_shared_types::{Measurement, ObstacleUpdate, ReferenceChunk, Service};
use rustix::fs::{Access, access};

use super::Severity::{Fault, Unknown, Warning};
use super::finding::{Assessed, problem};
use super::{Observations, unreadable};
use crate::services::daemon_bytes;

/// Clocks that are read without a system call.
const FAST: &str = "tsc kvm-clock hyperv_clocksource_tsc_page xen arch_sys_counter riscv_clocksource timebase tod stp";
/// Clocks that are read from a device, or count ticks.
const SLOW: &str = "hpet acpi_pm jiffies refined-jiffies pit hyperv_clocksource_msr";
/// Parts of the names of machines that are virtual.
const HYPERVISORS: &str = "KVM, QEMU, VMware, VirtualBox, Virtual Machine, Xen";

pub(super) fn clock_source(observed: &Observations) -> Assessed {
    let is_among = |names: &str, name: &str| names.split(' ').any(|known| known == name);
    let system = &observed.system;
    let folder = "/sys/devices/system/clocksource/clocksource0";
    let current = system.read(&format!("{folder}/current_clocksource"))?;
    if is_among(FAST, &current) {
        return Ok(current);
    }
    if !is_among(SLOW, &current) {
        return problem!(Unknown, "{current}: unknown speed"
            => "cat {folder}/available_clocksource");
    }
    let available = system.read(&format!("{folder}/available_clocksource"))?;
    let mut available = available.split_whitespace();
    match available.find(|name| is_among(FAST, name)) {
        Some(better) => problem!(Warning, "{current}, but {better} is available"
            => "echo {better} | sudo tee {folder}/current_clocksource"),
        None => problem!(Warning, "{current}; no fast clock source is available"
            => "search dmesg for `clocksource`; if the kernel only distrusts the TSC, boot with tsc=reliable"),
    }
}

pub(super) fn virtual_machine(observed: &Observations) -> Assessed {
    let processor = observed.system.read("/proc/cpuinfo")?;
    let mut flags = field(&processor, "flags").unwrap_or_default().split(' ');
    let has_flag = flags.any(|flag| flag == "hypervisor");
    let product = ["sys_vendor", "product_name"].map(|name| {
        let text = observed.system.read(&format!("/sys/class/dmi/id/{name}"));
        text.unwrap_or_default()
    });
    let product = product.join(" ");
    if !has_flag && !HYPERVISORS.split(", ").any(|name| product.contains(name)) {
        return Ok("no".to_owned());
    }
    let kind = match product.trim() {
        "" => "unknown hypervisor",
        product => product,
    };
    problem!(Warning, "yes, {kind}"
        => "run without a hypervisor, or pin this virtual machine to dedicated cores")
}

/// Memory added by one client and one driver that use every service they can \[bytes\].
const fn client_bytes() -> u64 {
    const fn writer<T>(service: Service) -> u64 {
        service.queues().writer_bytes(size_of::<T>())
    }
    writer::<ReferenceChunk>(Service::Reference)
        + writer::<ObstacleUpdate>(Service::Obstacles)
        + writer::<Measurement>(Service::Measurement)
}

/// Files (inodes) of a daemon, and those added by a client and a driver.
const DAEMON_FILES: u64 = 60;
const CLIENT_FILES: u64 = 60;

pub(super) fn shared_memory(observed: &Observations) -> Assessed {
    let probe = &observed.probe;
    let root = observed.validated.location.root().display().to_string();
    let hidden = |cause| unreadable(&root, cause);
    let (size, free) = probe.shared_memory_bytes.as_ref().map_err(hidden)?;
    // A running daemon has already allocated its memory.
    let (daemon, daemon_files) = if probe.daemon_runs {
        (0, 0)
    } else {
        (daemon_bytes(), DAEMON_FILES)
    };
    let needed = daemon + client_bytes();
    let [free_mb, size_mb, needed_mb] = [*free, *size, needed].map(|bytes| bytes as f64 * 1e-6);
    let value = format!("{free_mb:.0} MB of {size_mb:.0} MB free, {needed_mb:.0} MB needed");
    let mount = probe.shared_memory_mount.display();
    let files = CLIENT_FILES + daemon_files;
    if let Some(free) = probe.shared_memory_files.filter(|free| *free < files) {
        return problem!(Fault, "{value}; {free} inodes free, {files} needed"
            => "sudo mount -o remount,nr_inodes=100k {mount}, or remove files there");
    }
    if *free >= needed {
        return Ok(value);
    }
    let severity = if *free < daemon { Fault } else { Warning };
    let enough = (size + needed).next_multiple_of(1 << 26) >> 20;
    problem!(severity, "{value}"
        => "sudo mount -o remount,size={enough}M {mount}   (a container: --shm-size={enough}m)")
}

pub(super) fn huge_pages(observed: &Observations) -> Assessed {
    let path = "/sys/kernel/mm/transparent_hugepage/enabled";
    let Some(text) = observed.system.read_if_there(path)? else {
        return Ok("the kernel has none".to_owned());
    };
    let odd = || unreadable(path, format!("no choice in brackets in {text:?}"));
    let choice = chosen(&text, ['[', ']']).ok_or_else(odd)?;
    match &observed.probe.no_huge_pages {
        _ if choice != "always" => Ok(choice.to_owned()),
        Ok(()) => Ok("always, but disabled by the daemon for itself".to_owned()),
        Err(refusal) => {
            problem!(Warning, "always, including the daemon: PR_SET_THP_DISABLE refused ({refusal})"
            => "echo madvise | sudo tee {path}")
        }
    }
}

pub(super) fn swap(observed: &Observations) -> Assessed {
    let areas = observed.system.read_if_there("/proc/swaps")?;
    // The first line is the header.
    match areas.unwrap_or_default().lines().skip(1).count() {
        0 => Ok("none".to_owned()),
        count if observed.probe.memory_lock.is_ok() => {
            Ok(format!("{count} in use; memory can be locked"))
        }
        count => problem!(Warning, "{count} in use; memory is not locked"
            => "sudo swapoff -a, or let the daemon lock its memory"),
    }
}

pub(super) fn root_folder(observed: &Observations) -> Assessed {
    let root = observed.validated.location.root();
    let shown = root.display();
    if let Ok(false) = observed.probe.root_in_memory {
        return problem!(Fault, "{shown} is on a disk"
            => "use a folder in memory (tmpfs), in /dev/shm, or in /run where `df /run` says tmpfs: --root DIR, or transport.root");
    }
    let path = observed.system.path(root);
    let user = observed.probe.user_id;
    let fault = match std::fs::metadata(&path) {
        Err(cause) if cause.kind() != ErrorKind::NotFound => format!("{shown}: {cause}"),
        Err(_) if can_be_created(&path) => {
            return Ok(format!("{shown}, created at the first start"));
        }
        Err(_) => format!("{shown} is missing and cannot be created"),
        Ok(folder) if !folder.is_dir() => format!("{shown} is not a folder"),
        Ok(folder) if folder.uid() != user => {
            format!("{shown} belongs to user id {}, not to {user}", folder.uid())
        }
        Ok(folder) => {
            let mode = folder.permissions().mode() & 0o7777;
            let value = format!("{shown}, owner {user}, mode {mode:o}");
            let is_for_group = observed.validated.group_id.is_some();
            let foreign = if is_for_group { 0o002 } else { 0o022 };
            if mode & foreign == 0 {
                return Ok(value);
            }
            return problem!(Warning, "{value}: other users can write" => "chmod 700 '{shown}'");
        }
    };
    problem!(Fault, "{fault}" => "use a folder of your own: --root DIR, or transport.root")
}

/// The daemon creates the folder and its parents, if the nearest existing one permits it.
fn can_be_created(path: &Path) -> bool {
    let above = path.ancestors().skip(1).find(|folder| folder.exists());
    above.is_some_and(|folder| {
        folder.is_dir() && access(folder, Access::WRITE_OK | Access::EXEC_OK).is_ok()
    })
}
