//! A scene of its own for each test.

use cdcr_scratch::Scratch;

use super::{Assessment, Load, Plan, Probe, Scene, Severity, System, checks};
use crate::config::{Config, RealtimeMode};
use crate::core_budget::CoreBudget;

/// A scene over a folder that plays the system.
pub(super) struct Fake {
    folder: Scratch,
    /// The scene. Everything that is tried works, nothing happens on core 1, real time is preferred.
    pub(super) scene: Scene,
}

impl Fake {
    /// A system with these files.
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        let folder = Scratch::temporary().unwrap();
        let root = std::path::PathBuf::from("/run/cdcr");
        let fake = Self {
            scene: Scene {
                system: System::at(folder.path()),
                plan: Plan {
                    mode: RealtimeMode::Prefer,
                    core: Some(1),
                    cycle_priority: 80,
                    exchange_priority: 70,
                    period_ms: 5.0,
                    core_budget: CoreBudget::new(&Config::default()),
                    no_deep_sleep: true,
                    lock_file: root.join("cdcr_cdcr.lock"),
                    root,
                    is_for_group: false,
                },
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

    /// Writes a file of the system.
    pub(super) fn write(&self, path: &str, text: &str) {
        let path = self.scene.system.path(path);
        assert!(path.starts_with(self.folder.path()));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    /// What the check with this key says.
    pub(super) fn assess(&self, key: &str) -> Assessment {
        let check = checks().find(|check| check.key == key).unwrap();
        let finding = check.finding(&self.scene);
        Assessment::new(finding.severity, finding.value, finding.remedy)
    }

    pub(super) fn severity(&self, key: &str) -> Severity {
        self.assess(key).severity
    }

    /// Asserts a severity, and that what was seen and its remedy hold these words.
    pub(super) fn expect(&self, key: &str, severity: Severity, words: &[&str]) {
        let assessment = self.assess(key);
        assert_eq!(assessment.severity, severity, "{key}: {assessment:?}");
        let text = format!("{} | {}", assessment.value, assessment.remedy);
        for word in words {
            assert!(text.contains(word), "{key}: {word:?} is not in {text:?}");
        }
    }
}
