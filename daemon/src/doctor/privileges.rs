//! Privileges: priority, core, locked memory.

use cdcr_shared_types::codes::RTPRIO_GRANTED;

use super::finding::{Assessed, problem};
use super::{Observations, Reading, unreadable};

/// A daemon had 179 to 215 MB locked; each client adds its shared memory.
const LOCKED_BYTES: u64 = 512 << 20;

const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;

/// The remedy for a resource limit. It grants no file capabilities: the unit drops all capabilities and could
/// not even start such a file, and every user who may execute the file would get them.
fn grant(limit: &str, container: &str) -> String {
    format!(
        "run it as the service (sudo systemctl start cdcrd); or manually as a member of group cdcr (sudo \
         groupadd -f cdcr && sudo usermod -aG cdcr \"$USER\") with the line `@cdcr - {limit}` in \
         /etc/security/limits.d/cdcr.conf, which the package installs, after the next login; or, in a \
         container: --ulimit {container}"
    )
}

fn is_capable(observed: &Observations, capability: u32) -> Reading<bool> {
    let field = observed.system.status("/proc/self", "CapEff")?;
    let odd = |_| unreadable("CapEff", format!("invalid number {field:?}"));
    let bits = u64::from_str_radix(&field, 16).map_err(odd)?;
    Ok(bits >> capability & 1 == 1)
}

/// The resource limit or a capability allows the cycle's priority.
pub(super) fn may_have_priority(observed: &Observations) -> Reading<bool> {
    let asked = u64::try_from(observed.realtime().cycle_priority).unwrap_or(0);
    let limit_is_enough = observed.probe.rtprio_max.is_none_or(|limit| limit >= asked);
    Ok(limit_is_enough || is_capable(observed, CAP_SYS_NICE)?)
}

pub(super) fn fifo(observed: &Observations) -> Assessed {
    let priority = observed.realtime().cycle_priority;
    let Err(refusal) = &observed.probe.fifo else {
        return Ok(format!("granted at priority {priority}"));
    };
    if may_have_priority(observed)? {
        return problem!(observed.missing(), "refused at priority {priority}, despite the privilege: {refusal}"
            => "in a systemd unit: RestrictRealtime=no; else see `RT group` below");
    }
    let limit = observed.probe.rtprio_max.unwrap_or(u64::MAX);
    let enough = priority.max(RTPRIO_GRANTED);
    let remedy = grant(&format!("rtprio {enough}"), &format!("rtprio={enough}"));
    problem!(observed.missing(), "refused at priority {priority}: RLIMIT_RTPRIO is {limit}, no CAP_SYS_NICE ({refusal})"
        => "{remedy}")
}

pub(super) fn pin(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    if observed.probe.pinned {
        return Ok(format!("core {core}"));
    }
    let allowed = observed.system.status("/proc/self", "Cpus_allowed_list")?;
    let online = observed.system.online()?;
    if !online.contains(&core) {
        return problem!(observed.missing(), "core {core} is offline; online are {online}"
            => "set realtime.core to one of {allowed}");
    }
    // An inherited affinity does not prevent pinning; only the cpuset of the control group does.
    problem!(observed.missing(), "core {core} is refused by the control group; allowed are {allowed}"
        => "set realtime.core to one of {allowed}, or also give the group core {core} (a unit: AllowedCPUs=, a \
            container: --cpuset-cpus)")
}

pub(super) fn memory_lock(observed: &Observations) -> Assessed {
    let limit = observed.probe.memlock_max_bytes;
    let megabytes = limit.map(|limit| format!("{:.1} MB", limit as f64 * 1e-6));
    let shown = megabytes.unwrap_or_else(|| "unlimited".to_owned());
    let value = if let Err(refusal) = &observed.probe.memory_lock {
        format!("refused: {refusal}; RLIMIT_MEMLOCK is {shown}")
    } else if limit.is_none_or(|limit| limit >= LOCKED_BYTES) || is_capable(observed, CAP_IPC_LOCK)?
    {
        return Ok("granted".to_owned());
    } else {
        format!("RLIMIT_MEMLOCK is {shown}; a daemon with clients may need 512 MiB")
    };
    let remedy = grant("memlock unlimited", "memlock=-1");
    problem!(observed.missing(), "{value}" => "{remedy}")
}
