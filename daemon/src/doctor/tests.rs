//! Simulated machines and the findings on them: `findings.txt`.

use std::collections::HashSet;
use std::fs::{Permissions, set_permissions};
use std::os::unix::fs::PermissionsExt;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, from_value, to_value};

use super::sample::Snapshot;
use super::*;
use crate::config::Config;
use crate::system::choose;
use crate::system::tests::Files;

/// Observations over a folder that replaces the system's files.
pub(super) struct Machine {
    pub(super) files: Files,
    /// All trials succeed, core 1 is idle, real time is preferred.
    pub(super) observed: Observations,
    before: Snapshot,
}

impl Machine {
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        let files = Files::new(files);
        let mut config = Config::default();
        config.realtime.core = 1;
        config.realtime.mode = RealtimeMode::Prefer;
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
        };
        let observed = Observations {
            system: files.system.clone(),
            validated: config.check().unwrap(),
            probe,
            load: Ok(Load::default()),
        };
        Self {
            files,
            observed,
            before: Snapshot::default(),
        }
    }

    /// The finding of the check with this key.
    pub(super) fn finding(&self, key: &str) -> Finding {
        let check = CHECKS.iter().find(|check| check.key == key);
        check.expect("a known key").finding(&self.observed)
    }

    /// Executes one line of `findings.txt`.
    fn read(&mut self, line: &str) {
        let (name, rest) = line.split_once(' ').unwrap_or((line, ""));
        match rest.strip_prefix('=').map(str::trim_start) {
            Some(text) if name.starts_with('/') => {
                let text = text.replace("\\n", "\n").replace("\\t", "\t");
                self.files.write(name, text.replace("\\0", "\0"));
            }
            Some(mode) if name == "mode" => {
                let mode = Permissions::from_mode(u32::from_str_radix(mode, 8).unwrap());
                set_permissions(self.observed.system.path("/run/cdcr"), mode).unwrap();
            }
            Some(value) => self.set(name, serde_json::from_str(value).unwrap()),
            None if name == "choice" => self.expect_choice(rest),
            None if name == "count" => {
                self.before = Snapshot::take(&self.observed.system, 1).unwrap();
            }
            None if name == "watch" => self.watch(rest.parse().unwrap()),
            None => self.expect(name, rest),
        }
    }

    /// Sets a field of the observations.
    fn set(&mut self, name: &str, value: Value) {
        let observed = &mut self.observed;
        match name.split_once('.').unwrap() {
            ("probe", field) => set(&mut observed.probe, field, value),
            ("load", field) => set(observed.load.as_mut().unwrap(), field, value),
            _ => set(&mut observed.validated.config, name, value),
        }
    }

    /// Sets the load to the difference between the counters now and before.
    fn watch(&mut self, seconds: f64) {
        let after = Snapshot::take(&self.observed.system, 1);
        let load = after.map(|after| Load::between(&self.before, after, 1, seconds, &[53]));
        self.observed.load = load;
    }

    fn expect_choice(&self, words: &str) {
        let (core, option) = words.split_once(' ').unwrap_or((words, ""));
        let ours = option.strip_prefix("ours=").map(|id| id.parse().unwrap());
        let refused = CoreSet::parse(option.strip_prefix("refused=").unwrap_or_default());
        let chosen = choose(
            &self.observed.system,
            ours,
            |core| !refused.contains(&core),
            || (),
        );
        assert_eq!(chosen, core.parse().ok());
    }

    fn expect(&mut self, key: &str, rest: &str) {
        let (severities, words) = rest.split_once(' ').unwrap_or((rest, ""));
        let finding = self.finding(key);
        let text = format!("{} | {} |", finding.value, finding.remedy);
        let mut found = finding.severity.word().to_owned();
        if severities.contains('/') {
            use RealtimeMode::{Off, Prefer, Require};
            let in_mode = |mode| {
                self.observed.validated.config.realtime.mode = mode;
                self.finding(key).severity.word()
            };
            found = [Require, Off, Prefer].map(in_mode).join("/");
        }
        assert_eq!(found, severities, "{text}");
        let quoted: Vec<&str> = words.split('"').collect();
        for word in quoted.chunks_exact(2) {
            let is_absent = word[0].ends_with('!');
            assert_ne!(text.contains(word[1]), is_absent, "{:?}: {text}", word[1]);
        }
    }
}

/// Sets a field, or adds an element to it.
fn set<T: Serialize + DeserializeOwned>(object: &mut T, name: &str, value: Value) {
    let mut fields = to_value(&*object).unwrap();
    let pointer = format!("/{}", name.replace('.', "/"));
    match fields.pointer_mut(&pointer).expect(name) {
        Value::Array(list) => list.push(value),
        field => *field = value,
    }
    *object = from_value(fields).unwrap();
}

#[test]
fn each_machine_is_found_to_be_as_it_is() {
    let mut assessed = HashSet::new();
    let mut machine = Machine::new(&[]);
    for (index, line) in include_str!("findings.txt").lines().enumerate() {
        eprintln!("findings.txt, line {}: {line}", index + 1);
        if line.starts_with("## ") {
            machine = Machine::new(&[]);
        } else if !line.is_empty() && !line.starts_with('#') {
            machine.read(line);
            assessed.insert(line.split(' ').next().unwrap_or_default());
        }
    }
    for check in CHECKS {
        assert!(assessed.contains(check.key), "{}", check.key);
    }
}

#[test]
fn every_check_has_a_name_of_its_own_and_a_reason() {
    let keys: HashSet<_> = CHECKS.iter().map(|check| check.key).collect();
    assert_eq!(keys.len(), CHECKS.len());
    for check in CHECKS {
        assert!(check.why.ends_with('.'), "{}: {}", check.key, check.why);
    }
}

#[test]
fn a_system_that_shows_nothing_is_unknown_and_not_good() {
    let mut machine = Machine::new(&[]);
    machine.observed.load = Err(unreadable("/proc/stat", "gone"));
    machine.observed.probe.fifo = Err("no".to_owned());
    let report = machine.observed.report();
    assert!(report.count(Severity::Unknown) > 5, "{report:#?}");
    assert!(report.worst >= Severity::Warning);
    let unknown = report.findings.iter().find(|f| f.key == "steal");
    assert!(unknown.is_some_and(|f| f.value.contains("/proc/stat") && !f.remedy.is_empty()));
}

#[test]
fn nothing_of_real_time_is_bad_where_none_is_asked_for_and_what_is_ok_needs_no_remedy() {
    let mut machine = Machine::new(&[]);
    for finding in machine.observed.report().findings {
        let is_ok = finding.severity == Severity::Ok;
        assert_eq!(is_ok, finding.remedy == "nothing to do", "{finding:?}");
    }
    machine.observed.validated.config.realtime.mode = RealtimeMode::Off;
    machine.observed.probe.fifo = Err("no".to_owned());
    machine.observed.probe.memory_lock = Err("no".to_owned());
    let report = machine.observed.report();
    assert_eq!(report.worst, Severity::Ok, "{report:#?}");
}
