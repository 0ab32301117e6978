//! Configurations on the command line: their sources, and the output about them.

use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use cdcr_controller::robot::SectionParameters;
use cdcr_shared_types::Location;
use clap::{Args, Subcommand, ValueHint};
use serde::Serialize;

use super::tuning::TuningPreset;
use crate::config::{
    ConfigDraft, ConfigError, DEFAULT_TEXT, Layers, RealtimeConfig, RealtimeMode, SCHEMA_TEXT,
    Validated, explain,
};
use crate::instance::{InstanceError, is_in_memory};
use crate::system::can_be_pinned;
use crate::warnings::warnings;

#[allow(
    clippy::doc_markdown,
    reason = "a help text is printed as it is, and has no backticks"
)]
#[derive(Debug, Subcommand)]
pub(super) enum ConfigCommand {
    /// Print the default configuration with a description of every key.
    #[command(after_help = "Example: cdcrd config default > robot.toml")]
    Default,
    /// Print the JSON schema of the configuration, for editors and programs.
    #[command(after_help = "Example: cdcrd config schema > cdcr.schema.json\n\
        For editors with Taplo, begin the configuration with the line: #:schema ./cdcr.schema.json")]
    Schema,
    /// Explain a key or a table: type, range, default, current value and its source.
    #[command(
        after_help = "Example: cdcrd config explain cycle.period_ms --config robot.toml\n\
        \u{20}        cdcrd config explain cycle"
    )]
    Explain {
        /// Key, such as cycle.period_ms, or table, such as cycle.
        key: String,
        #[command(flatten)]
        source: ConfigSource,
    },
}

/// Where the configuration comes from. An option wins over its environment variable, both over the
/// file, the file over the defaults. (The environment is read here and not by clap, because the variable
/// of one option must not win over another option for the same key.)
#[allow(
    clippy::doc_markdown,
    reason = "a help text is printed as it is, and has no backticks"
)]
#[derive(Debug, Args)]
pub(super) struct ConfigSource {
    /// Configuration file (TOML) [env: CDCR_CONFIG]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set the keys that trade precision against smoothness and speed, as measured on a well-built robot
    #[arg(long, alias = "preset", value_enum, value_name = "NAME")]
    tuning: Option<TuningPreset>,
    /// Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]
    #[arg(long, value_name = "KEY=VALUE", value_parser = assignment)]
    set: Vec<(String, String)>,
    /// Name of the robot in the service names: robot.name [env: CDCR_ROBOT]
    #[arg(long, value_name = "NAME")]
    robot: Option<OsString>,
    /// Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<OsString>,
    /// Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]
    // An empty path, such as an unset variable of a script, is refused: it would be the default root.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::AnyPath)]
    root: Option<PathBuf>,
}

/// Parses an argument of `--set`.
fn assignment(text: &str) -> Result<(String, String), String> {
    let (key, value) = text
        .split_once('=')
        .filter(|(key, _)| !key.trim().is_empty())
        .ok_or("use KEY=VALUE, for example cycle.period_ms=2")?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}

impl ConfigSource {
    /// The validated configuration. Warnings go to the log.
    pub(super) fn load(&self) -> Result<Validated, ConfigError> {
        let validated = self.settings()?.validate()?;
        for warning in warnings(&validated.config) {
            tracing::warn!("{warning}");
        }
        Ok(validated)
    }

    /// The configuration before validation, with the origins of its values.
    pub(super) fn settings(&self) -> Result<ConfigDraft, ConfigError> {
        let mut layers = Layers::default();
        let file = self.config.clone();
        if let Some(file) = file.or_else(|| variable("CDCR_CONFIG").map(PathBuf::from)) {
            layers = layers.file(&file)?;
        }
        let (mut layers, warnings) = layers.variables(std::env::vars_os())?;
        for warning in warnings {
            tracing::warn!("{warning}");
        }
        let root = self.root.clone().map(PathBuf::into_os_string);
        let short = [
            ("robot.name", "CDCR_ROBOT", "--robot", &self.robot),
            ("transport.prefix", "CDCR_PREFIX", "--prefix", &self.prefix),
            ("transport.root", "CDCR_ROOT", "--root", &root),
        ];
        for (key, name, ..) in short {
            layers = with(layers, key, variable(name), name)?;
        }
        for (key, value) in self.tuning.into_iter().flat_map(TuningPreset::keys) {
            layers = layers.key(key, &format!("{value:?}"), "--tuning")?;
        }
        for (key, value) in &self.set {
            layers = layers.key(key, value, "--set")?;
        }
        for (key, _, name, value) in short {
            layers = with(layers, key, value.clone(), name)?;
        }
        layers.settings()
    }
}

/// An environment variable that is set and not empty.
fn variable(name: &str) -> Option<OsString> {
    std::env::var_os(name).filter(|value| !value.is_empty())
}

/// Sets a key to a text, if any; a folder becomes absolute.
fn with(
    layers: Layers,
    key: &str,
    value: Option<OsString>,
    origin: &str,
) -> Result<Layers, ConfigError> {
    match value {
        None => Ok(layers),
        Some(folder) if key == "transport.root" => {
            let absolute = std::path::absolute(&folder).map_or(folder, PathBuf::into_os_string);
            layers.string(key, &absolute, origin)
        }
        Some(value) => layers.string(key, &value, origin),
    }
}

/// Executes `cdcrd config …`.
pub(super) fn execute(command: ConfigCommand) -> Result<()> {
    match command {
        ConfigCommand::Default => print_text(DEFAULT_TEXT),
        ConfigCommand::Schema => print_text(SCHEMA_TEXT),
        ConfigCommand::Explain { key, source } => print_text(&explain(&key, &source.settings()?)?),
    }
}

/// Executes `cdcrd check`.
pub(super) fn check(source: &ConfigSource) -> Result<()> {
    let settings = source.settings()?;
    let changed = settings.changed();
    let validated = settings.validate()?;
    let mut lines = summary(&validated);
    if !changed.is_empty() {
        lines.push("set".to_owned());
    }
    for (key, value, origin) in changed {
        lines.push(format!("  {key} = {}  ({origin})", shortened(&value)));
    }
    let warnings = warnings(&validated.config).into_iter();
    let warnings = warnings.chain(root_warning(&validated.location));
    let warnings = warnings.chain(core_warning(&validated.config.realtime));
    lines.extend(warnings.map(|warning| format!("warning: {warning}")));
    lines.push(String::new());
    print_text(&lines.join("\n"))
}

/// The refusal with which a daemon would end here, because its root folder is on a disk. Nothing is created: a missing folder
/// would be where the nearest existing one above it is.
fn root_warning(location: &Location) -> Option<String> {
    let root = location.root();
    let there = root.ancestors().find(|folder| folder.exists())?;
    let is_on_disk = is_in_memory(there).is_ok_and(|is_in_memory| !is_in_memory);
    is_on_disk.then(|| {
        let root = root.display().to_string();
        let refusal = InstanceError::RootOnDisk { root };
        format!("`cdcrd run` would be refused here: {refusal}")
    })
}

/// Where no thread can be pinned to the configured core.
fn core_warning(realtime: &RealtimeConfig) -> Option<String> {
    let core = usize::try_from(realtime.core).ok()?;
    let is_refused = realtime.mode != RealtimeMode::Off && !can_be_pinned(core);
    is_refused.then(|| {
        format!(
            "realtime.core = {core} is not available here: no thread can be pinned to it; `cdcrd doctor` lists the cores of this machine"
        )
    })
}

/// Prints a text. A closed pipe (`cdcrd config default | head`) is not an error.
fn print_text(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write the output"),
    }
}

/// The value, shortened to one line.
fn shortened(value: &str) -> String {
    match value.char_indices().nth(60) {
        Some((end, _)) => format!("{} …", &value[..end]),
        None => value.to_owned(),
    }
}

/// The robot, and the settings of its control.
fn summary(validated: &Validated) -> Vec<String> {
    let (config, robot, location) = (&validated.config, &validated.robot, &validated.location);
    let (name, nmpc) = (&config.robot.name, &config.controller);
    let (kind, root) = (as_written(&config.link.kind), location.root().display());
    let (mode, period_ms) = (as_written(&config.realtime.mode), config.cycle.period_ms);
    let sections = robot.sections().iter().zip(1..).map(|(section, number)| {
        let SectionParameters { length_m, bend_max_rad, rate_max_rad_s, cable_radius_m, cable_offset_rad, body_radius_m } =
            section;
        let first_deg = cable_offset_rad.to_degrees();
        format!(
            "  section {number}  length {length_m} m, bend ≤ {bend_max_rad} rad, rate ≤ {rate_max_rad_s} rad/s, cables at \
             {cable_radius_m} m, the first at {first_deg:.1}°, body radius {body_radius_m} m"
        )
    });
    let mut lines = vec![
        "the configuration is valid".to_owned(),
        format!("robot      {name} ({kind}), reach {:.3} m", robot.reach_m()),
    ];
    lines.extend(sections);
    let actuator = &config.actuator;
    let tip_speed = robot
        .tip_speed_max_m_s()
        .map_or_else(String::new, |limit_m_s| {
            format!("; section ends ≤ {limit_m_s} m/s")
        });
    lines.extend([
        format!(
            "motors     {}, delay {} ms, lag {} ms, play {} m; cables ≤ {} m/s, stroke ≤ {} m (at full bend {:.3} m){tip_speed}",
            as_written(&config.link.interface),
            actuator.delay_ms,
            actuator.time_constant_ms,
            actuator.play_m,
            config.robot.cable_speed_max_m_s,
            config.robot.cable_stroke_max_m,
            config.robot.full_stroke_m()
        ),
        format!("cycle      {period_ms} ms, real time: {mode}"),
        format!(
            "controller {}, N = {}, swarm {} x {}, {} refinement steps",
            as_written(&nmpc.solver),
            nmpc.horizon_steps,
            nmpc.swarm_size,
            nmpc.swarm_iterations,
            nmpc.refinement_steps
        ),
        format!("transport  prefix {} in {root}", location.prefix()),
    ]);
    lines
}

/// A choice by its name in the file.
fn as_written(choice: &impl Serialize) -> String {
    let value = serde_json::to_value(choice).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cdcr_scratch::Scratch;

    use super::*;

    fn warning(root: &Path) -> Option<String> {
        root_warning(&Location::new("cdcrtest_check_", root).unwrap())
    }

    #[test]
    fn a_core_that_is_not_there_is_warned_of() {
        let of = |core| {
            core_warning(&RealtimeConfig {
                core,
                ..RealtimeConfig::default()
            })
        };
        assert_eq!(of(-1), None);
        let there = core_affinity::get_core_ids().unwrap()[0].id;
        assert_eq!(of(i32::try_from(there).unwrap()), None);
        assert!(of(1023).unwrap().contains("realtime.core = 1023"));
    }

    #[test]
    fn a_root_folder_on_a_disk_is_warned_of_and_not_created() {
        let memory = Scratch::in_memory().unwrap();
        assert_eq!(warning(&memory.path().join("a/root")), None);
        // A file system that is not a tmpfs, on every Linux.
        let root = Path::new("/proc/cdcr/root");
        let text = warning(root).unwrap();
        assert!(
            text.contains("the root folder /proc/cdcr/root is on a disk"),
            "{text}"
        );
        assert!(text.contains("(tmpfs) with --root"), "{text}");
        let disk = Scratch::temporary().unwrap();
        if !is_in_memory(disk.path()).unwrap() {
            let root = disk.path().join("a/root");
            assert!(warning(&root).is_some());
            assert!(!disk.path().join("a").exists());
        }
    }
}
