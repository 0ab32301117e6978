//! A scene of its own for each test.

use std::fmt::Debug;
use std::fs::{Permissions, set_permissions};
use std::os::unix::fs::PermissionsExt;
use std::str::FromStr;

use cdcr_scratch::Scratch;

use super::sample::{InterruptRate, Thread};
use super::{CHECKS, CoreSet, Finding, Load, Probe, Scene, System};
use crate::config::{Config, RealtimeMode};

/// A scene over a folder that plays the system.
pub(super) struct Fake {
    folder: Scratch,
    /// The scene. Everything that is tried works, nothing happens on core 1, real time is preferred.
    pub(super) scene: Scene,
}

impl Fake {
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        let folder = Scratch::temporary().unwrap();
        let mut config = Config::default();
        config.realtime.core = 1;
        config.realtime.mode = RealtimeMode::Prefer;
        config.transport.root = "/run/cdcr".to_owned();
        let fake = Self {
            scene: Scene {
                system: System(folder.path().to_owned()),
                validated: config.check().unwrap(),
                probe: Probe {
                    fifo: Ok(()),
                    pinned: true,
                    memory_lock: Ok(()),
                    no_huge_pages: Ok(()),
                    rtprio_max: Some(80),
                    memlock_max_bytes: None,
                    deep_sleep_lock: Ok(()),
                    shared_memory_mount: "/run".into(),
                    shared_memory_bytes: Ok((1 << 30, 1 << 29)),
                    shared_memory_files: None,
                    root_in_memory: Ok(true),
                    user_id: rustix::process::geteuid().as_raw(),
                },
                load: Ok(Load::default()),
            },
            folder,
        };
        for (path, text) in files {
            fake.write(path, text);
        }
        fake
    }

    pub(super) fn write(&self, path: &str, text: &str) {
        let path = self.scene.system.path(path);
        assert!(path.starts_with(self.folder.path()));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    /// Sets something of the scene that a line of `findings.txt` names.
    pub(super) fn set(&mut self, name: &str, value: &str) {
        let Scene {
            validated, probe, ..
        } = &mut self.scene;
        let realtime = &mut validated.config.realtime;
        let refused = || Err(value.to_owned());
        match name {
            "realtime.core" => realtime.core = parsed(value),
            "realtime.cycle_priority" => realtime.cycle_priority = parsed(value),
            "realtime.no_deep_sleep" => realtime.no_deep_sleep = parsed(value),
            "realtime.spin_us" => realtime.spin_us = parsed(value),
            "cycle.period_ms" => validated.config.cycle.period_ms = parsed(value),
            "probe.deep_sleep_lock" => probe.deep_sleep_lock = refused(),
            "probe.fifo" => probe.fifo = refused(),
            "probe.memlock_max_bytes" => probe.memlock_max_bytes = Some(parsed(value)),
            "probe.memory_lock" => probe.memory_lock = refused(),
            "probe.mode" => {
                let mode = u32::from_str_radix(value, 8).unwrap();
                let root = self.scene.system.path("/run/cdcr");
                set_permissions(root, Permissions::from_mode(mode)).unwrap();
            }
            "probe.no_huge_pages" => probe.no_huge_pages = refused(),
            "probe.pinned" => probe.pinned = parsed(value),
            "probe.root_in_memory" => {
                probe.root_in_memory = value.parse().map_err(|_| value.to_owned());
            }
            "probe.rtprio_max" => probe.rtprio_max = Some(parsed(value)),
            "probe.shared_memory_bytes" => {
                let sizes = value
                    .split_once(' ')
                    .and_then(|(size, free)| Some((size.parse().ok()?, free.parse().ok()?)));
                probe.shared_memory_bytes = sizes.ok_or_else(|| value.to_owned());
            }
            "probe.user_id" => probe.user_id += 1,
            _ => self.count(name, &value.split(' ').collect::<Vec<_>>()),
        }
    }

    /// Adds something that happens in the second that is watched.
    fn count(&mut self, name: &str, words: &[&str]) {
        let load = self.scene.load.as_mut().unwrap();
        match (name, words) {
            ("load.busy", [core, busy]) => {
                load.cores.entry(parsed(core)).or_default().busy = parsed(busy);
            }
            ("load.steal", [now, since_start]) => {
                let core = load.cores.entry(1).or_default();
                (core.steal, core.steal_since_start) = (parsed(now), parsed(since_start));
            }
            ("load.neighbour", [name, share, flags @ ..]) => {
                load.neighbours.push((thread(name, flags), parsed(share)));
            }
            ("load.realtime", [name, priority, allowed, flags @ ..]) => {
                load.realtime.push(Thread {
                    priority: parsed(priority),
                    allowed: CoreSet::parse(allowed),
                    ..thread(name, flags)
                });
            }
            ("load.interrupt", [label, rate_hz]) => load.interrupts.push(InterruptRate {
                label: (*label).to_owned(),
                description: "eth0".to_owned(),
                rate_hz: parsed(rate_hz),
            }),
            ("load.irqbalance", [process]) => load.irqbalance = Some(parsed(process)),
            _ => panic!("nothing is called {name} and has {words:?}"),
        }
    }

    /// What the check with this key says.
    pub(super) fn finding(&self, key: &str) -> Finding {
        let check = CHECKS.iter().find(|check| check.key == key);
        check.expect("a known key").finding(&self.scene)
    }

    /// Asserts what a line of `findings.txt` says that is found.
    pub(super) fn expect(&mut self, line: &str) {
        let mut words = line.splitn(3, ' ');
        let (key, severities) = (words.next().unwrap(), words.next().unwrap());
        let finding = self.finding(key);
        let text = format!("{} | {} |", finding.value, finding.remedy);
        let found = if severities.contains('/') {
            let in_mode = |mode| {
                self.scene.validated.config.realtime.mode = mode;
                self.finding(key).severity.word()
            };
            [
                RealtimeMode::Require,
                RealtimeMode::Off,
                RealtimeMode::Prefer,
            ]
            .map(in_mode)
            .join("/")
        } else {
            finding.severity.word().to_owned()
        };
        assert_eq!(found, severities, "{text}");
        let quoted: Vec<&str> = words.next().unwrap_or_default().split('"').collect();
        for word in quoted.chunks_exact(2) {
            let is_absent = word[0].ends_with('!');
            assert_ne!(text.contains(word[1]), is_absent, "{:?}: {text}", word[1]);
        }
    }
}

fn thread(name: &str, flags: &[&str]) -> Thread {
    let id = flags.iter().find_map(|flag| flag.strip_prefix("id="));
    Thread {
        is_kernel: flags.contains(&"kernel"),
        is_deadline: flags.contains(&"deadline"),
        name: name.to_owned(),
        id: id.map_or(77, parsed),
        ..Thread::default()
    }
}

fn parsed<T: FromStr<Err: Debug>>(text: &str) -> T {
    text.parse().unwrap()
}
