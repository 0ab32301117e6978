use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, fchown};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use cdcr_client::{Connection, STATUS_TIMEOUT};
use cdcr_shared_types::{SolverSettings, Status};
use serde_json::Value as Json;
use toml_edit::{DocumentMut, Item, Table, Value};

use crate::done::Done;
use crate::setting::{AUTO, Setting};

/// Defaults of a daemon without a configuration file.
const DEFAULTS: &str = include_str!("../../../../../configs/default.toml");

/// First line of a new file.
const HEAD: &str = "# Settings of cdcrd that differ from the defaults.\n";

/// Limit of Linux.
const LINKS_MAX: usize = 40;

/// Solver settings that differ from the defaults, as a configuration.
pub(crate) fn configuration(settings: SolverSettings, status: &Status) -> anyhow::Result<String> {
    let (text, _) = merged("", settings, status)?;
    Ok(format!("{HEAD}{text}"))
}

pub(super) fn run(connection: &Connection, file: Option<&Path>) -> anyhow::Result<Done> {
    let settings = connection.settings()?;
    let status = connection.status(STATUS_TIMEOUT)?;
    let mut out = io::stdout().lock();
    let Some(file) = file else {
        let (text, _) = merged("", settings, &status)?;
        write!(out, "{text}")?;
        return Ok(Done::Good);
    };
    let name = file.display();
    check_kind(file)?;
    let before = match fs::read_to_string(file) {
        Err(cause) if cause.kind() == ErrorKind::NotFound => None,
        text => Some(text.with_context(|| format!("cannot read {name}"))?),
    };
    let old = before.as_deref().unwrap_or_default();
    let (mut text, changed) = merged(old, settings, &status).with_context(|| name.to_string())?;
    if before.is_none() {
        text.insert_str(0, HEAD);
    } else if changed.is_empty() {
        writeln!(
            out,
            "{name}: nothing to change, it already has these values"
        )?;
        return Ok(Done::Good);
    }
    replace(file, &text).with_context(|| format!("cannot write {name}"))?;
    if changed.is_empty() {
        writeln!(out, "{name}: created; all settings have their defaults")?;
    }
    for change in changed {
        writeln!(out, "{name}: {change}")?;
    }
    Ok(Done::Good)
}

/// The configuration `text` with these settings, and the changes.
fn merged(
    text: &str,
    settings: SolverSettings,
    status: &Status,
) -> anyhow::Result<(String, Vec<String>)> {
    let defaults: DocumentMut = DEFAULTS.parse()?;
    let mut document: DocumentMut = text.parse()?;
    let mut changed = Vec::new();
    for setting in Setting::all() {
        let (table, key) = place(setting);
        let number = value(setting, settings)?;
        // A value derived from the robot is saved as such, because another robot needs another one.
        let is_auto = key == "rate_weight" && settings.rate_weight == status.rate_weight_auto;
        let value = if is_auto { AUTO.into() } else { number.clone() };
        let holds = |document: &DocumentMut| {
            let held = document.get(table).and_then(|table| table.get(key));
            held.and_then(Item::as_value)
                .map(|held| is_same(held, &value) || is_same(held, &number))
        };
        if !holds(&document).or(holds(&defaults)).unwrap_or(false) {
            changed.push(format!("{table}.{key} = {value}"));
            put(&mut document, table, key, value)?;
        }
    }
    let merged = document.to_string();
    // The TOML writer ends its lines by LF.
    let has_crlf = text
        .split_inclusive('\n')
        .next()
        .is_some_and(|line| line.ends_with("\r\n"));
    let merged = if has_crlf {
        merged.replace("\r\n", "\n").replace('\n', "\r\n")
    } else {
        merged
    };
    Ok((merged, changed))
}

/// Table and key of a setting in the configuration.
fn place(setting: Setting) -> (&'static str, &'static str) {
    match setting.key {
        "budget_ms" => ("cycle", "budget_ms"),
        key => ("controller", key),
    }
}

fn value(setting: Setting, settings: SolverSettings) -> anyhow::Result<Value> {
    Ok(match setting.json(settings) {
        Json::String(word) => word.into(),
        Json::Number(number) if number.is_f64() => float(&setting.text(settings))?,
        Json::Number(number) => match number.as_i64() {
            Some(whole) => whole.into(),
            None => bail!(
                "{} = {number} is too large for a configuration: at most {}",
                setting.key,
                i64::MAX
            ),
        },
        other => bail!("{} has an unknown value: {other}", setting.key),
    })
}

/// A number in its written form, for example `1e-12`.
fn float(text: &str) -> anyhow::Result<Value> {
    let is_whole = text.parse::<i64>().is_ok();
    let text = if is_whole {
        format!("{text}.0")
    } else {
        text.to_owned()
    };
    Ok(text.parse()?)
}

/// Numeric value, also of an integer.
pub(crate) fn number_of(value: &Value) -> Option<f64> {
    let whole = value.as_integer().map(|whole| whole as f64);
    value.as_float().or(whole)
}

/// Whether two values are numerically equal, as 1 and 1.0.
fn is_same(one: &Value, other: &Value) -> bool {
    match (one.as_integer(), other.as_integer()) {
        (Some(one), Some(other)) => one == other,
        _ => match (number_of(one), number_of(other)) {
            (Some(one), Some(other)) => one == other,
            _ => one.as_str().is_some() && one.as_str() == other.as_str(),
        },
    }
}

/// Sets a key. Text around an old value, such as a comment, is kept.
fn put(document: &mut DocumentMut, table: &str, key: &str, mut value: Value) -> anyhow::Result<()> {
    let table = document
        .entry(table)
        .or_insert_with(|| Item::Table(Table::new()))
        .as_table_like_mut()
        .with_context(|| format!("{table} is not a table"))?;
    match table.get_mut(key).and_then(Item::as_value_mut) {
        Some(old) => {
            *value.decor_mut() = old.decor().clone();
            *old = value;
        }
        None => {
            table.insert(key, Item::Value(value));
        }
    }
    Ok(())
}

/// Refuses to replace a device, a pipe or a folder by a file.
fn check_kind(file: &Path) -> anyhow::Result<()> {
    let is_other = fs::metadata(file).is_ok_and(|file| !file.is_file());
    ensure!(
        !is_other,
        "{} is not a regular file: use another one",
        file.display()
    );
    Ok(())
}

/// Replaces a file atomically, or creates it at the target of a link. Owner, group and mode are kept.
fn replace(file: &Path, text: &str) -> anyhow::Result<()> {
    let file = behind_links(file)?;
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.new", std::process::id()));
    let new = file.with_file_name(name);
    let written = write_anew(&new, &file, text);
    let replaced = written.and_then(|()| Ok(fs::rename(&new, &file)?));
    if replaced.is_err() {
        // The new file may not exist.
        let _ = fs::remove_file(&new);
    }
    replaced
}

/// Path after following all links, as on opening; the file need not exist.
fn behind_links(file: &Path) -> io::Result<PathBuf> {
    let mut path = file.to_owned();
    for _ in 0..LINKS_MAX {
        match fs::read_link(&path) {
            Ok(next) => path = path.parent().unwrap_or(Path::new("")).join(next),
            // Not a link, or missing.
            Err(cause) if matches!(cause.kind(), ErrorKind::InvalidInput | ErrorKind::NotFound) => {
                return Ok(path);
            }
            Err(cause) => return Err(cause),
        }
    }
    Err(io::Error::other("too many levels of links"))
}

fn write_anew(new: &Path, old: &Path, text: &str) -> anyhow::Result<()> {
    let mut written = File::create_new(new)?;
    if let Ok(old) = fs::metadata(old) {
        let made = written.metadata()?;
        if (made.uid(), made.gid()) != (old.uid(), old.gid()) {
            fchown(&written, Some(old.uid()), Some(old.gid())).with_context(|| {
                format!(
                    "it is owned by user {} and group {}, which this user cannot keep: run as that user, or save into another file",
                    old.uid(),
                    old.gid()
                )
            })?;
        }
        written.set_permissions(old.permissions())?;
    }
    written.write_all(text.as_bytes())?;
    Ok(written.sync_all()?)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    use cdcr_scratch::Scratch;

    use super::*;
    use crate::setting::SettingChange;

    /// The defaults with changes.
    fn settings(changes: &[&str]) -> SolverSettings {
        let defaults: DocumentMut = DEFAULTS.parse().expect("TOML");
        let mut settings = SolverSettings::default();
        let mut set = |text: &str| {
            let change = SettingChange::parse(text).expect(text);
            change.apply(&mut settings, 0.0);
        };
        for (key, value) in defaults["controller"].as_table().expect("a table") {
            let value = value.as_value().expect("a value").clone().decorated("", "");
            let value = value.to_string().replace(AUTO, "0");
            set(&format!("{key}={}", value.trim_matches('"')));
        }
        for change in changes {
            set(change);
        }
        settings
    }

    fn text_of(text: &str, changes: &[&str]) -> String {
        merged(text, settings(changes), &Status::default())
            .expect("merged")
            .0
    }

    #[test]
    fn only_what_differs_is_written() {
        assert_eq!(text_of("", &[]), "");
        assert_eq!(text_of(DEFAULTS, &[]), DEFAULTS);
        let driver = "controller.rate_weight = 1e-7\n";
        assert_eq!(text_of(driver, &["rate_weight=1e-7"]), driver);
        assert_eq!(
            text_of("", &["rate_weight=1e-7"]),
            "[controller]\nrate_weight = 1e-7\n"
        );
        assert_eq!(
            text_of(
                "",
                &[
                    "horizon_steps=5",
                    "solver=kpso",
                    "damping=1e-12",
                    "budget_ms=2"
                ]
            ),
            "[controller]\nsolver = \"kpso\"\nhorizon_steps = 5\ndamping = 1e-12\n\n[cycle]\nbudget_ms = 2.0\n"
        );
    }

    // The 0 of an ideal robot would make another one rattle; a value set by the user is kept.
    #[test]
    fn a_rate_weight_that_depends_on_the_robot_is_saved_as_that() {
        let driver = "controller.rate_weight = 1e-7\n";
        assert_eq!(text_of(driver, &[]), "controller.rate_weight = \"auto\"\n");
        let zero = "controller.rate_weight = 0.0\n";
        assert_eq!(text_of(zero, &[]), zero, "it was set");
        let measured = Status {
            rate_weight_auto: 1e-10,
            ..Status::default()
        };
        let saved = |set: &str| merged("", settings(&[set]), &measured).expect("merged").0;
        assert_eq!(saved("rate_weight=1e-10"), "");
        assert_eq!(saved("rate_weight=0"), "[controller]\nrate_weight = 0.0\n");
    }

    #[test]
    fn comments_order_and_all_other_keys_stay() {
        let text = "# My robot.\n[controller] # mine\n# Far.\nhorizon_steps = 3   # more is slow\n\
                    rate_weight = 1 # as it is\n\n[robot]\nname = \"arm\" # left\n";
        assert_eq!(
            text_of(text, &["horizon_steps=5", "rate_weight=1", "seed=7"]),
            text.replace("= 3 ", "= 5 ")
                .replace("# as it is\n", "# as it is\nseed = 7\n")
        );
    }

    #[test]
    fn line_ends_stay() {
        let text = "# My robot.\r\n[controller]\r\nhorizon_steps = 3 # far\r\n\r\n[robot]\r\nname = \"arm\"\r\n";
        let changed = text.replace("= 3 ", "= 5 ");
        assert_eq!(text_of(text, &["horizon_steps=5"]), changed);
    }

    #[test]
    fn what_a_configuration_cannot_have_is_reported() {
        let largest = format!("seed={}", u64::MAX);
        let error = merged("", settings(&[&largest]), &Status::default()).expect_err("too large");
        assert!(
            error.to_string().contains("at most 9223372036854775807"),
            "{error}"
        );
        assert!(merged("controller = 3", settings(&["seed=7"]), &Status::default()).is_err());
        assert!(merged("[controller", settings(&[]), &Status::default()).is_err());
    }

    #[test]
    fn a_file_is_replaced_whole_with_its_rights_and_where_a_link_points() {
        let folder = Scratch::temporary().expect("a folder");
        let (file, link) = (folder.path().join("a.toml"), folder.path().join("link"));
        replace(&file, "one").expect("made");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).expect("ours");
        // Only root may do this.
        let _ = chown(&file, Some(65_534), Some(65_534));
        let owner = |file: &Path| fs::metadata(file).map(|of| (of.uid(), of.gid()));
        let before = owner(&file).expect("there");
        symlink("a.toml", &link).expect("made");
        replace(&link, "two").expect("replaced");
        assert_eq!(owner(&file).expect("there"), before);
        assert_eq!(fs::read_to_string(&file).expect("there"), "two");
        let mode = fs::metadata(&file).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
        assert!(fs::symlink_metadata(&link).expect("there").is_symlink());
        assert_eq!(fs::read_dir(folder.path()).expect("there").count(), 2);
        assert!(replace(&folder.path().join("none/a.toml"), "x").is_err());
    }

    #[test]
    fn a_device_or_a_folder_is_not_replaced() {
        for path in ["/dev/null", "/tmp"] {
            let error = check_kind(Path::new(path)).expect_err(path);
            assert!(error.to_string().contains("not a regular file"), "{error}");
        }
        let folder = Scratch::temporary().expect("a folder");
        assert!(check_kind(&folder.path().join("new.toml")).is_ok());
    }

    #[test]
    fn a_link_that_leads_nowhere_stays_and_the_file_is_made_there() {
        let folder = Scratch::temporary().expect("a folder");
        let [first, second, file] =
            ["first", "second", "a.toml"].map(|name| folder.path().join(name));
        symlink("second", &first).expect("made");
        symlink(&file, &second).expect("made");
        replace(&first, "one").expect("made");
        assert!(fs::symlink_metadata(&first).expect("there").is_symlink());
        assert_eq!(fs::read_to_string(&file).expect("made"), "one");
        assert_eq!(fs::read_dir(folder.path()).expect("there").count(), 3);
        fs::remove_file(&file).expect("ours");
        symlink(&first, &file).expect("made");
        let error = replace(&first, "two").expect_err("a circle");
        assert!(error.to_string().contains("levels of links"), "{error}");
    }
}
