//! What the command line does with configurations: where they come from, and what it says about them.

use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use serde::Serialize;

use super::preset::Preset;
use crate::config::{
    ConfigError, DEFAULT_TEXT, Layers, Origin, SCHEMA_TEXT, Settings, Validated, explain,
};
use crate::warnings::warnings;

#[allow(
    clippy::doc_markdown,
    reason = "a help text is printed as it is, and has no backticks"
)]
#[derive(Debug, Subcommand)]
pub(super) enum ConfigCommand {
    /// Print the default configuration, every key explained.
    #[command(after_help = "Example: cdcrd config default > robot.toml")]
    Default,
    /// Print the JSON schema of the configuration, for editors and other programs.
    #[command(after_help = "Example: cdcrd config schema > cdcr.schema.json\n\
        Editors that know Taplo find it by this first line of a configuration: #:schema ./cdcr.schema.json")]
    Schema,
    /// Explain a key or a table: type, range, default, and the value in force.
    #[command(
        after_help = "Example: cdcrd config explain cycle.period_ms --config robot.toml\n\
        \u{20}        cdcrd config explain cycle"
    )]
    Explain {
        /// The key, like cycle.period_ms, or a table, like cycle.
        key: String,
        #[command(flatten)]
        source: Source,
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
pub(super) struct Source {
    /// Configuration file (TOML) [env: CDCR_CONFIG]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set what damps noise and chatter, as measured on a robot built well
    #[arg(long, value_enum, value_name = "NAME")]
    preset: Option<Preset>,
    /// Set one key, as TOML; repeatable [env: CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms, and so on]
    #[arg(long, value_name = "KEY=VALUE", value_parser = assignment)]
    set: Vec<(String, String)>,
    /// Name of the robot in the service names: robot.name [env: CDCR_ROBOT]
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<String>,
    /// Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
}

/// An argument of `--set`.
fn assignment(text: &str) -> Result<(String, String), String> {
    let (key, value) = text
        .split_once('=')
        .ok_or("it needs a key and a value, like cycle.period_ms=2")?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}

impl Source {
    /// The configuration, checked. What is doubtful goes to the log.
    pub(super) fn load(&self) -> Result<Validated, ConfigError> {
        let validated = self.settings()?.validate()?;
        for warning in warnings(&validated.config) {
            tracing::warn!("{warning}");
        }
        Ok(validated)
    }

    /// The configuration, not yet checked, and where its values come from.
    pub(super) fn settings(&self) -> Result<Settings, ConfigError> {
        let mut layers = Layers::default();
        let file = self
            .config
            .clone()
            .or_else(|| variable("CDCR_CONFIG").map(PathBuf::from));
        if let Some(file) = file {
            layers = layers.file(&file)?;
        }
        let (layers, warnings) = layers.variables(std::env::vars_os())?;
        for warning in warnings {
            tracing::warn!("{warning}");
        }
        self.options(aliases(layers)?)?.settings()
    }

    fn options(&self, mut layers: Layers) -> Result<Layers, ConfigError> {
        for (key, value) in self.preset.into_iter().flat_map(Preset::keys) {
            layers = layers.key(key, value, Origin::Option("--preset"))?;
        }
        for (key, value) in &self.set {
            layers = layers.key(key, value, Origin::Option("--set"))?;
        }
        if let Some(name) = &self.robot {
            layers = layers.string("robot.name", name, Origin::Option("--robot"))?;
        }
        if let Some(prefix) = &self.prefix {
            layers = layers.string("transport.prefix", prefix, Origin::Option("--prefix"))?;
        }
        if let Some(root) = &self.root {
            let origin = Origin::Option("--root");
            let root = text_of(absolute(root), "transport.root", &origin)?;
            layers = layers.string("transport.root", &root, origin)?;
        }
        Ok(layers)
    }
}

/// The variables of the options `--robot`, `--prefix` and `--root`.
fn aliases(mut layers: Layers) -> Result<Layers, ConfigError> {
    for (name, key) in [
        ("CDCR_ROBOT", "robot.name"),
        ("CDCR_PREFIX", "transport.prefix"),
        ("CDCR_ROOT", "transport.root"),
    ] {
        let Some(value) = variable(name) else {
            continue;
        };
        let value = if key == "transport.root" {
            absolute(Path::new(&value))
        } else {
            value
        };
        let origin = Origin::Variable(name.to_owned());
        let value = text_of(value, key, &origin)?;
        layers = layers.string(key, &value, origin)?;
    }
    Ok(layers)
}

/// An environment variable that is set and not empty.
fn variable(name: &str) -> Option<OsString> {
    std::env::var_os(name).filter(|value| !value.is_empty())
}

fn absolute(path: &Path) -> OsString {
    std::path::absolute(path).map_or_else(|_| path.into(), PathBuf::into_os_string)
}

fn text_of(value: OsString, key: &str, origin: &Origin) -> Result<String, ConfigError> {
    value.into_string().map_err(|value| ConfigError::Value {
        origin: origin.clone(),
        key: key.to_owned(),
        message: format!("{} is not UTF-8 text", value.display()),
    })
}

/// Carries `cdcrd config …` out.
pub(super) fn execute(command: ConfigCommand) -> Result<()> {
    match command {
        ConfigCommand::Default => say(DEFAULT_TEXT),
        ConfigCommand::Schema => say(SCHEMA_TEXT),
        ConfigCommand::Explain { key, source } => say(&explain(&key, &source.settings()?)?),
    }
}

/// Carries `cdcrd check` out.
pub(super) fn check(source: &Source) -> Result<()> {
    let settings = source.settings()?;
    let changed = settings.changed();
    let validated = settings.validate()?;
    let mut lines = vec!["the configuration is valid".to_owned()];
    lines.extend(robot(&validated));
    lines.extend(control(&validated));
    if !changed.is_empty() {
        lines.push("set".to_owned());
    }
    for (key, value, origin) in changed {
        lines.push(format!("  {key} = {}  ({origin})", shortened(&value)));
    }
    for warning in warnings(&validated.config) {
        lines.push(format!("warning: {warning}"));
    }
    lines.push(String::new());
    say(&lines.join("\n"))
}

/// Prints a text. A reader that has seen enough (`cdcrd config default | head`) is no error.
fn say(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("the text cannot be written"),
    }
}

/// At most a line of a value.
fn shortened(value: &str) -> String {
    const LENGTH: usize = 60;
    if value.chars().count() <= LENGTH {
        return value.to_owned();
    }
    let start: String = value.chars().take(LENGTH).collect();
    format!("{start} …")
}

/// Says which robot it is.
fn robot(validated: &Validated) -> Vec<String> {
    let Validated { config, robot, .. } = validated;
    let mut lines = vec![format!(
        "robot      {} ({}), reach {:.3} m",
        config.robot.name,
        as_written(&config.link.kind),
        robot.reach_m()
    )];
    lines.extend(robot.sections().iter().enumerate().map(|(index, section)| {
        format!(
            "  section {}  length {} m, bend ≤ {} rad, rate ≤ {} rad/s, cables at {} m",
            index + 1,
            section.length_m,
            section.bend_max_rad,
            section.rate_max_rad_s,
            section.cable_radius_m
        )
    }));
    lines
}

/// A choice by its name in the file.
fn as_written(choice: &impl Serialize) -> String {
    let value = serde_json::to_value(choice).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// Says how and where it would be controlled.
fn control(validated: &Validated) -> [String; 3] {
    let Validated {
        config, location, ..
    } = validated;
    let nmpc = &config.controller;
    [
        format!(
            "cycle      {} ms, real time: {}",
            config.cycle.period_ms,
            as_written(&config.realtime.mode)
        ),
        format!(
            "controller {}, N = {}, swarm {} x {}, {} refinement steps",
            as_written(&nmpc.solver),
            nmpc.horizon_steps,
            nmpc.swarm_size,
            nmpc.swarm_iterations,
            nmpc.refinement_steps
        ),
        format!(
            "transport  prefix {} below {}",
            location.prefix(),
            location.root().display()
        ),
    ]
}
