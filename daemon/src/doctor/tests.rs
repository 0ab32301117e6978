//! Simulated machines and the findings on them: `findings.txt`.

use std::collections::HashSet;
use std::fs::{Permissions, create_dir_all, set_permissions, write};
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use RealtimeMode::{Off, Prefer, Require};
use cdcr_scratch::Scratch;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{from_str, from_value, to_value};

use super::*;
use crate::config::Config;
use crate::system::choose;

/// Observations over a folder that replaces the system's files.
struct Machine {
    _folder: Scratch,
    /// All trials succeed, core 1 is idle, real time is preferred.
    observed: Observations,
    before: Load,
}

impl Machine {
    fn new() -> Self {
        let folder = Scratch::temporary().unwrap();
        let mut config = Config::default();
        config.realtime.core = 1;
        config.transport.root = "/run/cdcr".to_owned();
        let probe = Probe {
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
            daemon_runs: false,
        };
        let observed = Observations {
            system: System(folder.path().to_owned()),
            validated: config.check().unwrap(),
            probe,
            load: Ok(Load::default()),
        };
        Self {
            _folder: folder,
            observed,
            before: Load::default(),
        }
    }

    /// Executes one line of `findings.txt`.
    fn execute(&mut self, line: &str) {
        let (name, rest) = line.split_once(' ').unwrap_or((line, ""));
        let value = rest.trim_start_matches('=').trim_start();
        let observed = &mut self.observed;
        match (name.split_once('.'), name) {
            (_, path) if path.starts_with('/') => self.write(path, value),
            (Some(("probe", field)), _) => set(&mut observed.probe, field, value),
            (Some(_), key) => set(&mut observed.validated.config, key, value),
            (_, "mode") => self.set_mode(value),
            (_, "thread") => self.load().threads.push(from_str(value).unwrap()),
            (_, "interrupt") => self.load().interrupts.push(from_str(value).unwrap()),
            (_, "count") => self.before = self.counts().unwrap(),
            (_, "watch") => self.watch(rest.parse().unwrap()),
            (_, "choice") => self.expect_choice(rest),
            (_, key) => self.expect(key, rest),
        }
    }

    fn load(&mut self) -> &mut Load {
        self.observed.load.as_mut().unwrap()
    }

    /// Sets the permissions of the root folder.
    fn set_mode(&self, octal: &str) {
        let mode = Permissions::from_mode(u32::from_str_radix(octal, 8).unwrap());
        set_permissions(self.observed.system.path("/run/cdcr"), mode).unwrap();
    }

    /// The counts of core 1, without process 53.
    fn counts(&self) -> Reading<Load> {
        Load::since_start(&self.observed.system, 1, &[53])
    }

    fn write(&self, path: &str, text: &str) {
        let text = text.replace("\\n", "\n").replace("\\t", "\t");
        let path = self.observed.system.path(path);
        create_dir_all(path.parent().unwrap()).unwrap();
        let text = text.replace("\\0", "\0");
        let parts: Vec<&[u8]> = text.split("\\xff").map(str::as_bytes).collect();
        write(path, parts.join(&0xff)).unwrap();
    }

    fn watch(&mut self, seconds: u64) {
        let passed = Duration::from_secs(seconds);
        let counts = self.counts();
        self.observed.load = counts.map(|now| now.since(&self.before, 1, passed));
    }

    fn expect_choice(&self, words: &str) {
        let (core, option) = words.split_once(' ').unwrap_or((words, ""));
        let ours = option.strip_prefix("ours=").map(|id| id.parse().unwrap());
        let refused = CoreSet::parse(option.strip_prefix("refused=").unwrap_or_default());
        let can_be_pinned = |core| !refused.contains(&core);
        let watch = || self.observed.load.clone().unwrap().cores;
        let chosen = choose(&self.observed.system, ours, can_be_pinned, watch);
        assert_eq!(chosen, core.parse().ok());
    }

    fn expect(&mut self, key: &str, rest: &str) {
        let (severities, texts) = rest.split_once(' ').unwrap_or((rest, ""));
        let check = CHECKS.iter().find(|check| check.key == key);
        let check = check.expect("a known key");
        let findings = [Require, Off, Prefer].map(|mode| {
            self.observed.validated.config.realtime.mode = mode;
            check.finding(&self.observed)
        });
        let words = findings.each_ref().map(|finding| finding.severity.word());
        let [_, off, preferred] = words;
        let [.., finding] = findings;
        let text = format!("{} | {} |", finding.value, finding.remedy);
        let found = [&*words.join("/"), preferred];
        assert!(found.contains(&severities), "{found:?}: {text}");
        assert!(off == "ok" || ALWAYS.contains(&key), "{text}");
        let needs_nothing = finding.remedy == "nothing to do";
        assert_eq!(needs_nothing, preferred == "ok", "{text}");
        let quoted: Vec<&str> = texts.split('"').collect();
        for word in quoted.chunks_exact(2) {
            let is_absent = word[0].ends_with('!');
            assert_ne!(text.contains(word[1]), is_absent, "{:?}: {text}", word[1]);
        }
    }
}

/// Sets a field that has this name in JSON.
fn set<T: Serialize + DeserializeOwned>(object: &mut T, name: &str, text: &str) {
    let mut fields = to_value(&*object).unwrap();
    let pointer = format!("/{}", name.replace('.', "/"));
    *fields.pointer_mut(&pointer).expect(name) = from_str(text).unwrap();
    *object = from_value(fields).unwrap();
}

#[test]
fn each_machine_is_found_to_be_as_it_is() {
    let mut executed = HashSet::new();
    let mut machine = Machine::new();
    for (index, line) in include_str!("findings.txt").lines().enumerate() {
        eprintln!("findings.txt, line {}: {line}", index + 1);
        if line.starts_with("## ") {
            machine = Machine::new();
        } else if !line.is_empty() && !line.starts_with('#') {
            machine.execute(line);
            executed.insert(line.split(' ').next().unwrap_or_default());
        }
    }
    for check in CHECKS {
        assert!(executed.contains(check.key), "{}", check.key);
    }
}
