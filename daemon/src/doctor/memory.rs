//! Memory: shared, huge, swapped.

use cdcr_shared_types::{Measurement, ObstacleUpdate, ReferenceChunk, Service};

use super::system::chosen_of;
use super::{Assessed, Assessment, Scene, Unreadable};
use crate::services::daemon_bytes;

checks! {
    Always shared_memory, "shared memory",
        "The daemon and its clients meet in files in the root folder; when its memory is full, nobody can connect.";
    RealTime huge_pages, "transparent huge pages",
        "To make huge pages, the kernel moves the memory of a running process, which waits meanwhile; hence the daemon exempts itself.";
    RealTime swap, "swap",
        "Memory that is not locked may be on a disk when the cycle needs it.";
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

fn shared_memory(scene: &Scene) -> Assessed {
    let (size, free) = scene
        .probe
        .shared_memory_bytes
        .clone()
        .map_err(|cause| Unreadable::new(scene.plan.root.display().to_string(), cause))?;
    // A daemon that runs has taken its part.
    let daemon = if scene.daemon_runs() {
        0
    } else {
        daemon_bytes()
    };
    let both = daemon + client_bytes();
    let mb = |bytes: u64| bytes as f64 * 1e-6;
    let value = format!(
        "{:.0} MB of {:.0} MB free; still needed {:.0} MB",
        mb(free),
        mb(size),
        mb(both)
    );
    let mount = scene.probe.shared_memory_mount.display();
    let files = CLIENT_FILES + if scene.daemon_runs() { 0 } else { DAEMON_FILES };
    if let Some(free) = scene.probe.shared_memory_files.filter(|free| *free < files) {
        let value = format!("{value}; {free} files can be made, still needed {files}");
        let remedy = format!("sudo mount -o remount,nr_inodes=100k {mount}, or remove files there");
        return Ok(Assessment::fault(value, remedy));
    }
    let enough_bytes = (size + both).next_multiple_of(1 << 26) >> 20;
    let remedy = format!(
        "sudo mount -o remount,size={enough_bytes}M {mount}   (a container: --shm-size={enough_bytes}m)"
    );
    Ok(if free < daemon {
        Assessment::fault(value, remedy)
    } else if free < both {
        Assessment::warning(value, remedy)
    } else {
        Assessment::ok(value)
    })
}

fn huge_pages(scene: &Scene) -> Assessed {
    let path = "/sys/kernel/mm/transparent_hugepage/enabled";
    let Some(text) = scene.system.read_if_there(path)? else {
        return Ok(Assessment::ok("the kernel has none"));
    };
    let chosen = chosen_of(&text, ['[', ']'])
        .ok_or_else(|| Unreadable::new(path, format!("{text:?} has no choice in brackets")))?;
    if chosen != "always" {
        return Ok(Assessment::ok(chosen));
    }
    Ok(match &scene.probe.no_huge_pages {
        Ok(()) => Assessment::ok("always, but not for the daemon: it exempts itself"),
        Err(refusal) => Assessment::warning(
            format!("always, also for the daemon: PR_SET_THP_DISABLE is refused ({refusal})"),
            format!("echo madvise | sudo tee {path}"),
        ),
    })
}

fn swap(scene: &Scene) -> Assessed {
    let areas = scene
        .system
        .read_if_there("/proc/swaps")?
        .unwrap_or_default();
    // The first line is the head.
    let count = areas
        .lines()
        .skip(1)
        .filter(|line| !line.trim().is_empty())
        .count();
    if count == 0 {
        return Ok(Assessment::ok("none"));
    }
    let is_locked = scene.probe.memory_lock.is_ok();
    let word = if is_locked { "can be" } else { "is not" };
    let value = format!("{count} in use, and memory {word} locked");
    let remedy = "sudo swapoff -a, or let the daemon lock its memory";
    Ok(Assessment::good_if(is_locked, value, remedy))
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
            fake.severity("shared_memory")
        };
        assert_eq!(with_free(daemon_bytes() - 1), Fault);
        assert_eq!(with_free(daemon_bytes()), Warning);
        assert_eq!(with_free(daemon_bytes() + client_bytes()), Good);
        // A daemon that runs has taken its part.
        assert_eq!(with_free(client_bytes()), Fault);
        fake.write("/proc/12/stat", "");
        assert_eq!(fake.severity("shared_memory"), Good);
    }
}
