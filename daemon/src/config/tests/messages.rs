//! What is said of the configurations of `messages.txt`.

use std::path::Path;

use crate::config::{Config, ConfigError, Layers, Origin};
use crate::warnings::warnings;

/// The configuration of a case, or why it is refused.
fn configuration(case: &[&str]) -> Result<Config, ConfigError> {
    let is_layer = |line: &&&str| line.starts_with("--set ") || line.starts_with("CDCR_");
    let file: Vec<&str> = case
        .iter()
        .filter(|line| !is_layer(line))
        .copied()
        .collect();
    let mut layers = Layers::default().text(&file.join("\n"), Path::new("robot.toml"))?;
    for (key, value) in case
        .iter()
        .filter(is_layer)
        .filter_map(|line| line.split_once('='))
    {
        layers = match key.strip_prefix("--set ") {
            Some(key) => layers.key(key, &value.replace("\\n", "\n"), Origin::Option("--set"))?,
            None => layers.variables([(key.into(), value.into())])?.0,
        };
    }
    Ok(layers.settings()?.validate()?.config)
}

#[test]
fn each_configuration_gets_its_message() {
    let mut case = Vec::new();
    let mut is_over = true;
    for (index, line) in include_str!("messages.txt").lines().enumerate() {
        let place = format!("messages.txt, line {}", index + 1);
        let (mark, words) = line.split_once(' ').unwrap_or((line, ""));
        if mark == "##" || is_over && line.is_empty() {
            continue;
        }
        let is_case = !["=", "~", "ok"].contains(&mark);
        if is_case {
            if is_over {
                case.clear();
            }
            case.push(line);
        } else {
            match (configuration(&case), mark) {
                (Ok(config), "~") => {
                    let warnings = warnings(&config);
                    assert_eq!(warnings.len(), 1, "{place}: {warnings:?}");
                    assert!(warnings[0].contains(words), "{place}: {warnings:?}");
                }
                (Ok(config), "ok") => assert_eq!(warnings(&config), [""; 0], "{place}"),
                (Err(error), "=") => assert_eq!(error.to_string(), words, "{place}"),
                (result, _) => panic!("{place}: {result:?}"),
            }
        }
        is_over = !is_case;
    }
}
