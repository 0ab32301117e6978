//! The configuration: TOML text → typed → validated [`Config`].
//!
//! Every key has a default, so an empty file is the paper's robot with three sections. A mistake is
//! reported with file, line, key and what is allowed; nothing is silently corrected.

mod place;

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{
    Configuration, Robot, RobotError, RobotParameters, SectionParameters,
};
use cdcr_shared_types::{DEFAULT_PREFIX, Location, LocationError, Service};
use serde::{Deserialize, Serialize};

pub use place::ConfigError;
use place::Place;

/// The default configuration as a commented file: what `cdcrd config default` prints.
pub const DEFAULT_TEXT: &str = include_str!("../../../configs/default.toml");

/// Everything a user can set.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What the robot is.
    pub robot: RobotConfig,
    /// Where measurements come from and commands go to.
    pub link: LinkConfig,
    /// The period and what counts as late.
    pub cycle: CycleConfig,
    /// Motions that the daemon makes by itself.
    pub motion: MotionConfig,
    /// What counts as a fault of the robot, its sensors or its surroundings.
    pub safety: SafetyConfig,
    /// The reference and its lease.
    pub reference: ReferenceConfig,
    /// The optimal control problem and its solver.
    pub controller: NmpcSettings,
    /// Threads, priorities, memory.
    pub realtime: RealtimeConfig,
    /// Where in shared memory daemon and clients meet.
    pub transport: TransportConfig,
}

/// What the robot is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotConfig {
    /// Name of the robot in the service names.
    pub name: String,
    /// Largest speed of a cable \[m/s\].
    pub cable_speed_max_m_s: f64,
    /// How far a cable can be pulled or paid out from its length at the straight robot \[m\].
    pub cable_stroke_max_m: f64,
    /// The sections, base first.
    pub sections: Vec<SectionParameters>,
}

impl Default for RobotConfig {
    fn default() -> Self {
        let RobotParameters {
            sections,
            cable_speed_max_m_s,
            cable_stroke_max_m,
        } = RobotParameters::paper(3);
        Self {
            name: "cdcr".to_owned(),
            cable_speed_max_m_s,
            cable_stroke_max_m,
            sections,
        }
    }
}

/// Which robot is controlled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// The ideal kinematic robot inside the daemon.
    #[default]
    Simulated,
    /// A driver process on the measurement and command services.
    Driver,
}

/// Where measurements come from and commands go to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkConfig {
    /// Which robot.
    pub kind: LinkKind,
    /// Bend vectors at the start \[rad\], one pair for each section; empty: straight.
    pub initial_bend_rad: Vec<[f64; 2]>,
    /// A driver's measurement older than this is lost \[ms\].
    pub measurement_timeout_ms: f64,
    /// How long a robot follows the last rates when no newer command comes \[ms\]; then it holds.
    pub command_valid_ms: f64,
}

impl Default for LinkConfig {
    fn default() -> Self {
        Self {
            kind: LinkKind::Simulated,
            initial_bend_rad: Vec::new(),
            measurement_timeout_ms: 50.0,
            command_valid_ms: 100.0,
        }
    }
}

/// The period and what counts as late.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CycleConfig {
    /// Period T \[ms\].
    pub period_ms: f64,
    /// Deadline D after the release \[ms\]; 0: the period.
    pub deadline_ms: f64,
    /// A start later than this after the release counts as a late start \[ms\].
    pub late_start_ms: f64,
    /// Longest time of one solve \[ms\]; 0: all that is left until the deadline, less the margin.
    pub budget_ms: f64,
    /// Time that the solver leaves for what follows it \[ms\]; 0: a tenth of the period.
    pub budget_margin_ms: f64,
    /// How long before the release inputs are gathered \[ms\].
    pub gather_lead_ms: f64,
    /// Level of the leaky bucket (+1 for each miss and each skipped period, -1 for each good cycle)
    /// at which the robot is stopped.
    pub miss_limit: u32,
    /// The process ends when a real-time thread makes no progress for this long \[ms\].
    pub watchdog_ms: f64,
}

impl Default for CycleConfig {
    fn default() -> Self {
        Self {
            period_ms: 5.0,
            deadline_ms: 0.0,
            late_start_ms: 1.0,
            budget_ms: 0.0,
            budget_margin_ms: 0.0,
            gather_lead_ms: 0.2,
            miss_limit: 40,
            watchdog_ms: 1000.0,
        }
    }
}

impl CycleConfig {
    /// Deadline D after the release \[ns\].
    pub fn deadline_ns(&self) -> u64 {
        match ns(self.deadline_ms) {
            0 => ns(self.period_ms),
            deadline_ns => deadline_ns,
        }
    }

    /// Time that the solver leaves for what follows it \[ns\]. By default a tenth of the period: Linux
    /// halts real-time threads that use more than 95 % of a core for 50 ms in each second.
    pub fn budget_margin_ns(&self) -> u64 {
        match ns(self.budget_margin_ms) {
            0 => ns(self.period_ms) / 10,
            margin_ns => margin_ns,
        }
    }
}

/// Motions that the daemon makes by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// How fast rates shrink when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// Rate of the fastest component on the way home \[rad/s\].
    pub home_rate_rad_s: f64,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            deceleration_rad_s2: 40.0,
            home_rate_rad_s: 0.5,
        }
    }
}

/// What counts as a fault of the robot, its sensors or its surroundings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SafetyConfig {
    /// A clearance below this is a fault \[m\]; 0: contact of body and obstacle.
    pub clearance_fault_m: f64,
    /// A measurement may differ from the one before by this much, beyond what the largest rates can do
    /// \[rad\].
    pub measurement_jump_rad: f64,
    /// So many implausible measurements in a row are a fault; fewer are left out.
    pub measurement_jump_limit: u32,
    /// A measurement that does not change at all while the robot is commanded to move this far is a fault
    /// \[rad\].
    pub measurement_frozen_rad: f64,
}

impl Default for SafetyConfig {
    fn default() -> Self {
        Self {
            clearance_fault_m: 0.0,
            measurement_jump_rad: 0.2,
            measurement_jump_limit: 3,
            measurement_frozen_rad: 0.05,
        }
    }
}

/// The reference and its lease.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReferenceConfig {
    /// A lease that is not renewed for this long expires \[ms\].
    pub lease_ms: f64,
}

impl Default for ReferenceConfig {
    fn default() -> Self {
        Self { lease_ms: 500.0 }
    }
}

/// How much real time is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RealtimeMode {
    /// Refuse to start without all of it.
    Require,
    /// Take what the system grants, and say what is missing.
    #[default]
    Prefer,
    /// Ordinary threads.
    Off,
}

/// Threads, priorities, memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RealtimeConfig {
    /// How much real time is asked for.
    pub mode: RealtimeMode,
    /// Core of the real-time threads; -1: the last one that the process may use.
    pub core: i64,
    /// `SCHED_FIFO` priority of the cycle thread.
    pub cycle_priority: i32,
    /// `SCHED_FIFO` priority of the exchange thread, below that of the cycle.
    pub exchange_priority: i32,
    /// The cycle thread wakes up this long before each release and spins \[µs\]; 0: it sleeps to the release.
    pub spin_us: f64,
    /// Keep the processor out of deep sleep, by `/dev/cpu_dma_latency`, as far as the system grants it.
    pub no_deep_sleep: bool,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            mode: RealtimeMode::Prefer,
            core: -1,
            cycle_priority: 80,
            exchange_priority: 70,
            spin_us: 0.0,
            no_deep_sleep: true,
        }
    }
}

/// Where in shared memory daemon and clients meet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TransportConfig {
    /// Prefix of the shared-memory files.
    pub prefix: String,
    /// Root folder of iceoryx2; empty: `/tmp/cdcr-<user id>`.
    pub root: String,
}

impl Default for TransportConfig {
    fn default() -> Self {
        Self {
            prefix: DEFAULT_PREFIX.to_owned(),
            root: String::new(),
        }
    }
}

/// A configuration whose every part was checked, as domain values.
#[derive(Debug, Clone)]
pub struct Validated {
    /// The configuration as written.
    pub config: Config,
    /// The robot.
    pub robot: Robot,
    /// Where its simulation, or the estimate, begins.
    pub initial: Configuration,
    /// Where daemon and clients meet.
    pub location: Location,
}

/// Nanoseconds of a duration in milliseconds that was validated.
pub fn ns(milliseconds: f64) -> u64 {
    (milliseconds * 1e6).round() as u64
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`ConfigError`] with file, line, key and remedy.
    pub fn load(path: &Path) -> Result<Validated, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|cause| ConfigError::Unreadable {
            file: path.to_owned(),
            cause,
        })?;
        Self::parse(&text, path)
    }

    /// Checks a text; `file` is for the messages.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, file: &Path) -> Result<Validated, ConfigError> {
        let config: Self = toml::from_str(text).map_err(|cause| ConfigError::Syntax {
            file: file.to_owned(),
            cause: for_people(&cause.to_string()),
        })?;
        config.validate(&Place::in_text(text, file))
    }

    /// Checks a configuration that came from no file.
    ///
    /// # Errors
    /// As [`Config::load`], without a line.
    pub fn check(self) -> Result<Validated, ConfigError> {
        let nowhere = PathBuf::from("the configuration");
        self.validate(&Place::in_text("", &nowhere))
    }

    fn validate(self, place: &Place) -> Result<Validated, ConfigError> {
        self.check_ranges(place)?;
        self.check_cross_rules(place)?;
        let robot = self.robot(place)?;
        let initial = self.initial(&robot, place)?;
        let location = self.location(place)?;
        Ok(Validated {
            config: self,
            robot,
            initial,
            location,
        })
    }

    fn check_ranges(&self, place: &Place) -> Result<(), ConfigError> {
        let Self {
            link,
            cycle,
            motion,
            safety,
            reference,
            realtime,
            ..
        } = self;
        let period_ms = cycle.period_ms;
        let checks: [(&str, f64, RangeInclusive<f64>); 19] = [
            (
                "link.measurement_timeout_ms",
                link.measurement_timeout_ms,
                1.0..=10_000.0,
            ),
            (
                "link.command_valid_ms",
                link.command_valid_ms,
                1.0..=10_000.0,
            ),
            ("cycle.period_ms", period_ms, 0.5..=100.0),
            ("cycle.deadline_ms", cycle.deadline_ms, 0.0..=period_ms),
            ("cycle.late_start_ms", cycle.late_start_ms, 0.001..=100.0),
            (
                "cycle.budget_margin_ms",
                cycle.budget_margin_ms,
                0.0..=0.5 * period_ms,
            ),
            (
                "cycle.gather_lead_ms",
                cycle.gather_lead_ms,
                0.02..=0.5 * period_ms,
            ),
            ("cycle.miss_limit", f64::from(cycle.miss_limit), 1.0..=1e6),
            ("cycle.budget_ms", cycle.budget_ms, 0.0..=period_ms),
            (
                "cycle.watchdog_ms",
                cycle.watchdog_ms,
                50.0_f64.max(10.0 * period_ms)..=60_000.0,
            ),
            (
                "safety.clearance_fault_m",
                safety.clearance_fault_m,
                -10.0..=10.0,
            ),
            (
                "safety.measurement_jump_rad",
                safety.measurement_jump_rad,
                1e-6..=1e3,
            ),
            (
                "safety.measurement_jump_limit",
                f64::from(safety.measurement_jump_limit),
                1.0..=1e6,
            ),
            (
                "safety.measurement_frozen_rad",
                safety.measurement_frozen_rad,
                1e-6..=1e3,
            ),
            (
                "realtime.spin_us",
                realtime.spin_us,
                0.0..=(500.0 * period_ms).min(1000.0),
            ),
            (
                "motion.deceleration_rad_s2",
                motion.deceleration_rad_s2,
                0.01..=1e6,
            ),
            (
                "motion.home_rate_rad_s",
                motion.home_rate_rad_s,
                1e-3..=100.0,
            ),
            ("reference.lease_ms", reference.lease_ms, 20.0..=60_000.0),
            ("realtime.core", realtime.core as f64, -1.0..=1023.0),
        ];
        for (key, value, range) in checks {
            place.check(key, value, range)?;
        }
        let priorities = [
            ("realtime.cycle_priority", realtime.cycle_priority, 2..=99),
            (
                "realtime.exchange_priority",
                realtime.exchange_priority,
                1..=98,
            ),
        ];
        for (key, value, range) in priorities {
            let (low, high) = range.into_inner();
            place.check(key, f64::from(value), f64::from(low)..=f64::from(high))?;
        }
        self.controller
            .validate()
            .map_err(|error| place.error(&format!("controller.{}", error.key), &error.to_string()))
    }

    /// Rules between keys.
    fn check_cross_rules(&self, place: &Place) -> Result<(), ConfigError> {
        let RealtimeConfig {
            cycle_priority,
            exchange_priority,
            ..
        } = self.realtime;
        if exchange_priority >= cycle_priority {
            return Err(place.error(
                place.written_of(["realtime.exchange_priority", "realtime.cycle_priority"]),
                &format!(
                    "exchange_priority = {exchange_priority} must be below cycle_priority = \
                     {cycle_priority}, so that the cycle pre-empts the exchange"
                ),
            ));
        }
        Ok(())
    }

    fn robot(&self, place: &Place) -> Result<Robot, ConfigError> {
        Service::Status
            .name(&self.robot.name)
            .map_err(|error| place.error("robot.name", &error.to_string()))?;
        let parameters = RobotParameters {
            sections: self.robot.sections.clone(),
            cable_speed_max_m_s: self.robot.cable_speed_max_m_s,
            cable_stroke_max_m: self.robot.cable_stroke_max_m,
        };
        Robot::new(&parameters).map_err(|error| place.error(&key_of(&error), &error.to_string()))
    }

    fn initial(&self, robot: &Robot, place: &Place) -> Result<Configuration, ConfigError> {
        let (given, key) = (&self.link.initial_bend_rad, "link.initial_bend_rad");
        if given.is_empty() {
            return Ok(Configuration::straight(robot.section_count()));
        }
        if given.len() != robot.section_count() {
            let (is, should) = (given.len(), robot.section_count());
            let message = format!("{is} pairs are given, but the robot has {should} sections");
            return Err(place.error(key, &message));
        }
        for (index, (pair, section)) in given.iter().zip(robot.sections()).enumerate() {
            let bend_rad = pair[0].hypot(pair[1]);
            if !(0.0..=section.bend_max_rad).contains(&bend_rad) {
                let message = format!(
                    "section {}: a bend of {bend_rad} rad is out of range: allowed is 0 to {}",
                    index + 1,
                    section.bend_max_rad
                );
                return Err(place.error(key, &message));
            }
        }
        let flat: Vec<f64> = given.iter().flatten().copied().collect();
        Configuration::from_slice(&flat).ok_or_else(|| place.error(key, "too many sections"))
    }

    fn location(&self, place: &Place) -> Result<Location, ConfigError> {
        let TransportConfig { prefix, root } = &self.transport;
        let root = if root.is_empty() {
            Location::default_root()
        } else {
            PathBuf::from(root)
        };
        Location::new(prefix, &root).map_err(|error| {
            let key = match error {
                LocationError::Prefix(_) => "transport.prefix",
                LocationError::Root(_) => "transport.root",
            };
            place.error(key, &error.to_string())
        })
    }
}

/// What the parser says, without the names that types have in Rust.
fn for_people(message: &str) -> String {
    let words = [
        ("expected u32", "expected a whole number, 0 or more"),
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected i32", "expected a whole number"),
        ("expected i64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected a string", "expected a string, in quotes"),
        ("expected a sequence", "expected a list"),
    ];
    let mut text = words
        .iter()
        .fold(message.to_owned(), |text, (rust, plain)| {
            text.replace(rust, plain)
        });
    while let Some(start) = text.find("expected struct ") {
        let end = text[start + 16..]
            .find(|c: char| !c.is_alphanumeric())
            .map_or(text.len(), |length| start + 16 + length);
        text.replace_range(start..end, "expected a table");
    }
    text
}

/// The configuration key that a robot error speaks of.
fn key_of(error: &RobotError) -> String {
    match error {
        RobotError::SectionCount { .. } => "robot.sections".to_owned(),
        RobotError::Section { section, key, .. } | RobotError::CableRadius { section, key, .. } => {
            format!("robot.sections[{}].{key}", section - 1)
        }
        RobotError::Whole { key, .. } => format!("robot.{key}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(text: &str) -> String {
        Config::parse(text, Path::new("robot.toml"))
            .expect_err("it is wrong")
            .to_string()
    }

    #[test]
    fn the_default_file_is_the_default_and_every_key_is_in_it() {
        let from_text: Config = toml::from_str(DEFAULT_TEXT).expect("the default file is TOML");
        assert_eq!(from_text, Config::default());
        let default = toml::Table::try_from(Config::default()).expect("serialises");
        let written: toml::Table = toml::from_str(DEFAULT_TEXT).expect("the default file is TOML");
        for (table, keys) in &default {
            for key in keys.as_table().expect("a table").keys() {
                assert!(
                    written[table].get(key).is_some(),
                    "{table}.{key} is not in default.toml"
                );
            }
        }
    }

    #[test]
    fn every_configuration_that_we_ship_is_good() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            if entry
                .path()
                .extension()
                .is_some_and(|extension| extension == "toml")
            {
                Config::load(&entry.path()).unwrap_or_else(|error| panic!("{error}"));
                count += 1;
            }
        }
        assert!(count >= 4, "{count} configurations");
    }

    #[test]
    fn an_empty_file_is_the_papers_robot() {
        let validated = Config::parse("", Path::new("x")).expect("empty is legal");
        assert_eq!(validated.robot.section_count(), 3);
        assert_eq!(validated.initial, Configuration::straight(3));
    }

    #[test]
    fn unknown_keys_and_bad_values_are_named_with_file_and_line() {
        let message = error_of("[cycle]\nperiodms = 5\n");
        assert!(message.contains("robot.toml"), "{message}");
        assert!(
            message.contains("line 2") && message.contains("periodms"),
            "{message}"
        );
        assert!(message.contains("period_ms"), "{message}");

        let message = error_of("# comment\n[cycle]\nperiod_ms = 0.1\n");
        for part in [
            "robot.toml",
            "line 3",
            "cycle.period_ms",
            "0.1",
            "0.5 to 100",
        ] {
            assert!(message.contains(part), "{part}: {message}");
        }
        let message = error_of("[controller]\nseed = 1\nswarm_size = 9999\n");
        for part in ["line 3", "controller.swarm_size", "1 to 512"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        for (text, parts) in [
            (
                "[robot]\ncable_stroke_max_m = 0.0\n",
                ["line 2", "robot.cable_stroke_max_m", "0.0001"],
            ),
            (
                "[controller]\nsafe_distance_m = -0.1\n",
                ["line 2", "controller.safe_distance_m", "0 to 10"],
            ),
            (
                "[controller]\norientation_tolerance_rad = 2.0\n",
                ["line 2", "controller.orientation_tolerance_rad", "0 to 1"],
            ),
            (
                "[controller]\nobstacle_slope_penalty = 0.0\n",
                [
                    "line 2",
                    "controller.obstacle_slope_penalty",
                    "allowed is 1 to 1000000000000",
                ],
            ),
            (
                "[controller]\ncoordinates = \"polar\"\n",
                ["line 2", "polar", "bend-angles"],
            ),
        ] {
            let message = error_of(text);
            for part in parts {
                assert!(message.contains(part), "{part}: {message}");
            }
        }
        let message = error_of("[motion]\nhome_rate_rad_s = nan\n");
        assert!(
            message.contains("line 2") && message.contains("home_rate_rad_s"),
            "{message}"
        );
    }

    #[test]
    fn section_errors_name_the_section_and_its_line() {
        let good = "[[robot.sections]]\nlength_m = 0.3\ncable_radius_m = 0.01\ncable_offset_rad = 0.0\n\
                    bend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n";
        assert!(Config::parse(good, Path::new("x")).is_ok());
        let message = error_of(&format!("{good}{}", good.replace("0.3", "-0.3")));
        for part in ["line 9", "robot.sections[1].length_m", "-0.3"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        let message = error_of("[[robot.sections]]\nlength_m = 0.3\n");
        assert!(message.contains("missing field"), "{message}");
    }

    #[test]
    fn rules_between_keys() {
        let message = error_of("[realtime]\nexchange_priority = 80\n");
        assert!(message.contains("below cycle_priority"), "{message}");
        let message = error_of("[link]\ninitial_bend_rad = [[0.1, 0.0]]\n");
        assert!(
            message.contains("1 pairs are given, but the robot has 3"),
            "{message}"
        );
        let message = error_of("[link]\ninitial_bend_rad = [[0.1, 0.0], [9.0, 0.0], [0.0, 0.0]]\n");
        assert!(message.contains("section 2"), "{message}");
        let message = error_of("[transport]\nprefix = \"a b\"\n");
        assert!(message.contains("line 2: transport.prefix"), "{message}");
        let message = error_of("[realtime]\ncycle_priority = 60\n");
        assert!(
            message.contains("line 2: realtime.cycle_priority"),
            "{message}"
        );
        let message = error_of("[controller]\nswarm_size = -1\n");
        assert!(
            message.contains("swarm_size") && message.contains("whole number"),
            "{message}"
        );
        assert!(error_of("robot = 3\n").contains("expected a table"));
        assert!(error_of("[robot]\nname = \"a/b\"\n").contains("robot.name"));
    }
}
