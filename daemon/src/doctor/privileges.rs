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

/// Whether this process has a capability.
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

#[cfg(test)]
mod tests {
    use super::super::Severity;
    use super::super::fake::Fake;
    use crate::config::RealtimeMode;

    const NO_CAPABILITY: (&str, &str) = (
        "/proc/self/status",
        "CapEff:\t0000000000000000\nCpus_allowed_list:\t0-1\n",
    );

    /// The severity in each mode: require, prefer, off.
    fn severities(fake: &mut Fake, key: &str) -> [Severity; 3] {
        [
            RealtimeMode::Require,
            RealtimeMode::Prefer,
            RealtimeMode::Off,
        ]
        .map(|mode| {
            fake.scene.plan.mode = mode;
            fake.severity(key)
        })
    }

    const MISSING: [Severity; 3] = [Severity::Fault, Severity::Warning, Severity::Ok];

    #[test]
    fn a_priority_that_is_refused_is_as_bad_as_it_was_asked_for() {
        let mut fake = Fake::new(&[NO_CAPABILITY]);
        assert_eq!(severities(&mut fake, "fifo"), [Severity::Ok; 3]);
        fake.scene.probe.fifo = Err("not permitted".to_owned());
        fake.scene.probe.rtprio_max = Some(0);
        assert_eq!(severities(&mut fake, "fifo"), MISSING);
        fake.scene.plan.mode = RealtimeMode::Prefer;
        fake.expect(
            "fifo",
            Severity::Warning,
            &[
                "RLIMIT_RTPRIO is 0",
                "systemctl start cdcrd",
                "@cdcr - rtprio 90",
                "/etc/security/limits.d/",
                "--ulimit rtprio=90",
            ],
        );
        fake.scene.plan.cycle_priority = 95;
        fake.expect("fifo", Severity::Warning, &["@cdcr - rtprio 95"]);
    }

    #[test]
    fn no_privilege_is_given_to_the_program_file() {
        let mut fake = Fake::new(&[NO_CAPABILITY]);
        fake.scene.probe.fifo = Err("not permitted".to_owned());
        fake.scene.probe.rtprio_max = Some(0);
        fake.scene.probe.memory_lock = Err("not permitted".to_owned());
        for key in ["fifo", "memory_lock"] {
            let remedy = fake.assess(key).remedy;
            assert!(remedy.contains("limits.d"), "{key}: {remedy}");
            assert!(!remedy.contains("setcap"), "{key}: {remedy}");
        }
    }

    #[test]
    fn a_refusal_in_spite_of_the_privilege_has_another_remedy() {
        let mut fake = Fake::new(&[("/proc/self/status", "CapEff:\t0000000000800000\n")]);
        fake.scene.probe.fifo = Err("not permitted".to_owned());
        fake.scene.probe.rtprio_max = Some(0);
        fake.expect("fifo", Severity::Warning, &["in spite", "RestrictRealtime"]);
        fake.write("/proc/self/status", "CapEff:\tnonsense\n");
        fake.expect("fifo", Severity::Unknown, &["nonsense"]);
    }

    #[test]
    fn a_core_that_is_refused_is_named() {
        let mut fake = Fake::new(&[NO_CAPABILITY, ("/sys/devices/system/cpu/online", "0-7")]);
        assert_eq!(severities(&mut fake, "pin"), [Severity::Ok; 3]);
        fake.scene.probe.pinned = false;
        fake.scene.plan.core = Some(7);
        assert_eq!(severities(&mut fake, "pin"), MISSING);
        fake.scene.plan.mode = RealtimeMode::Prefer;
        let words = ["core 7", "realtime.core to one of 0-1", "AllowedCPUs"];
        fake.expect("pin", Severity::Warning, &words);
        // It would confine every thread to the core of the real-time ones.
        assert!(!fake.assess("pin").remedy.contains("taskset"));
        fake.write("/sys/devices/system/cpu/online", "0-3");
        let words = ["core 7 does not run", "0-3", "realtime.core to one of 0-1"];
        fake.expect("pin", Severity::Warning, &words);
        assert!(!fake.assess("pin").remedy.contains("AllowedCPUs"));
    }

    #[test]
    fn memory_needs_a_grant_that_suffices() {
        let mut fake = Fake::new(&[NO_CAPABILITY]);
        assert_eq!(severities(&mut fake, "memory_lock"), [Severity::Ok; 3]);
        fake.scene.probe.memlock_max_bytes = Some(8 << 20);
        assert_eq!(severities(&mut fake, "memory_lock"), MISSING);
        fake.write("/proc/self/status", "CapEff:\t0000000000004000\n");
        assert_eq!(severities(&mut fake, "memory_lock"), [Severity::Ok; 3]);
        fake.scene.probe.memory_lock = Err("cannot allocate memory".to_owned());
        assert_eq!(severities(&mut fake, "memory_lock"), MISSING);
        fake.scene.plan.mode = RealtimeMode::Prefer;
        fake.expect(
            "memory_lock",
            Severity::Warning,
            &["8.4 MB", "@cdcr - memlock unlimited", "--ulimit memlock=-1"],
        );
    }
}
