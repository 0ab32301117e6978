//! Texts, variables and options that make a configuration, and the messages of those that make none.

mod defaults;
mod explanation;
mod layers;
mod lines;
mod messages;
mod rules;

use std::path::Path;

use super::Config;

fn error_of(text: &str) -> String {
    Config::parse(text, Path::new("robot.toml"))
        .expect_err("it is wrong")
        .to_string()
}
