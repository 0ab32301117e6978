//! Privileges: priority, core, locked memory.

use super::{Assessed, Assessment, Scene, Unreadable};

checks! {
    RealTime fifo, "SCHED_FIFO",
        "Without a real-time priority every other program may keep the cycle waiting for many periods.";
    RealTime pin, "pinned to a core",
        "A thread that moves between cores meets cold caches and whoever is there.";
    RealTime memory_lock, "locked memory",
        "A page that was given away must be fetched again in the middle of a cycle.";
}

/// A daemon had 179 to 215 MB locked; each client that connects adds what it shares.
const LOCKED_BYTES: u64 = 512 << 20;

const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;

/// The priority that the unit of the service and the package's `limits.d` file grant.
const RTPRIO: i32 = 90;

/// How to get a resource limit. No capabilities on the program file: the unit drops them all, so that it could
/// not even start a file that has some, and everybody who may run the file would get them.
fn grant(limit: &str, container: &str) -> String {
    format!(
        "run it as the service (sudo systemctl start cdcrd); or, by hand, as a member of the group cdcr (sudo \
         groupadd -f cdcr && sudo usermod -aG cdcr \"$USER\") with the line `@cdcr - {limit}` in \
         /etc/security/limits.d/cdcr.conf, which the package brings, after the next login; or, in a \
         container: --ulimit {container}"
    )
}

fn is_capable(scene: &Scene, capability: u32) -> Result<bool, Unreadable> {
    let field = scene.system.own_status("CapEff")?;
    let bits = u64::from_str_radix(&field, 16)
        .map_err(|_| Unreadable::new("CapEff", format!("{field:?} is no number")))?;
    Ok(bits >> capability & 1 == 1)
}

/// Whether the kernel's rules for processes allow the cycle's priority.
pub(super) fn may_have_priority(scene: &Scene) -> Result<bool, Unreadable> {
    let asked = u64::try_from(scene.plan.cycle_priority).unwrap_or(0);
    let limit_is_enough = scene.probe.rtprio_max.is_none_or(|limit| limit >= asked);
    Ok(limit_is_enough || is_capable(scene, CAP_SYS_NICE)?)
}

fn fifo(scene: &Scene) -> Assessed {
    let priority = scene.plan.cycle_priority;
    let refusal = match &scene.probe.fifo {
        Ok(()) => return Ok(Assessment::ok(format!("granted at priority {priority}"))),
        Err(refusal) => refusal,
    };
    if may_have_priority(scene)? {
        return Ok(scene.plan.missing(
            format!("refused at priority {priority}, in spite of the privilege: {refusal}"),
            "in a systemd unit: RestrictRealtime=no; else see `RT group` below",
        ));
    }
    let limit = scene.probe.rtprio_max.unwrap_or(u64::MAX);
    Ok(scene.plan.missing(
        format!(
            "refused at priority {priority}: RLIMIT_RTPRIO is {limit}, no CAP_SYS_NICE ({refusal})"
        ),
        grant(
            &format!("rtprio {}", priority.max(RTPRIO)),
            &format!("rtprio={}", priority.max(RTPRIO)),
        ),
    ))
}

fn pin(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    if scene.probe.pinned {
        return Ok(Assessment::ok(format!("core {core}")));
    }
    let allowed = scene.system.own_status("Cpus_allowed_list")?;
    let online = scene.system.online()?;
    if !online.contains(core) {
        return Ok(scene.plan.missing(
            format!("core {core} does not run; online are {online}"),
            format!("set realtime.core to one of {allowed}"),
        ));
    }
    // An affinity that was inherited refuses nothing, only the cpuset of the group does.
    Ok(scene.plan.missing(
        format!("core {core} is refused by the control group; allowed are {allowed}"),
        format!(
            "set realtime.core to one of {allowed}, or give the group core {core}, too (a unit: AllowedCPUs=, \
             a container: --cpuset-cpus)"
        ),
    ))
}

fn memory_lock(scene: &Scene) -> Assessed {
    let limit = scene.probe.memlock_max_bytes;
    let limit_text = limit.map_or("unlimited".to_owned(), |limit| {
        format!("{:.1} MB", limit as f64 * 1e-6)
    });
    let remedy = grant("memlock unlimited", "memlock=-1");
    if let Err(refusal) = &scene.probe.memory_lock {
        let value = format!("refused: {refusal}; RLIMIT_MEMLOCK is {limit_text}");
        return Ok(scene.plan.missing(value, remedy));
    }
    let is_enough = limit.is_none_or(|limit| limit >= LOCKED_BYTES);
    if is_enough || is_capable(scene, CAP_IPC_LOCK)? {
        return Ok(Assessment::ok("granted"));
    }
    let value = format!("RLIMIT_MEMLOCK is {limit_text}; a daemon with clients may need 512 MiB");
    Ok(scene.plan.missing(value, remedy))
}
