//! Shell completion: running robots, known obstacles, settings.

mod zsh;

use std::ffi::{OsStr, OsString};

use cdcr_client::STATUS_TIMEOUT;
use clap::{CommandFactory, FromArgMatches};
use clap_complete::env::Shells;
use clap_complete::{CompleteEnv, CompletionCandidate};

use super::{Arguments, Target};
use crate::known_obstacles::known;
use crate::setting::Setting;

/// Variable set by the completion scripts. It has a name of its own, so that a variable set for another
/// program does not prevent a stop.
pub(crate) const VARIABLE: &str = "CDCRCTL_COMPLETE";

/// The supported shells.
pub(crate) const SHELLS: Shells = Shells(&[
    &clap_complete::env::Bash,
    &clap_complete::env::Fish,
    &zsh::Zsh,
]);

/// Answers a completion request of a shell and exits, if there is one.
pub(crate) fn answer() {
    CompleteEnv::with_factory(Arguments::command)
        .var(VARIABLE)
        .shells(SHELLS)
        .complete();
}

/// Robots whose daemons run.
pub(crate) fn robots() -> Vec<CompletionCandidate> {
    let location = target().and_then(|target| target.location().ok().map(|(location, _)| location));
    let robots = location
        .map(|location| location.robots())
        .unwrap_or_default();
    robots.into_iter().map(CompletionCandidate::new).collect()
}

/// Ids of the obstacles known to the daemon.
pub(crate) fn obstacle_ids() -> Vec<CompletionCandidate> {
    let connection = target().and_then(|target| target.connect().ok());
    let known = connection.and_then(|connection| known(&connection, STATUS_TIMEOUT).ok());
    let ids = known.unwrap_or_default().into_iter();
    ids.map(|obstacle| CompletionCandidate::new(obstacle.id.to_string()))
        .collect()
}

/// `KEY=`, and `KEY=WORD` for a setting with words as values.
pub(crate) fn changes(current: &OsStr) -> Vec<CompletionCandidate> {
    let current = current.to_string_lossy();
    changes_after(&typed_before(), &current)
        .into_iter()
        .map(CompletionCandidate::new)
        .collect()
}

fn changes_after(before: &[OsString], current: &str) -> Vec<String> {
    // Bash splits a word at the equals sign.
    let before = before
        .strip_suffix(&[OsString::from("=")])
        .unwrap_or(before);
    let split = before
        .last()
        .and_then(|word| word.to_str())
        .and_then(setting);
    let offered: Vec<String> = match (split, current.split_once('=')) {
        (Some(setting), _) => setting.words(),
        (None, Some((key, _))) => {
            let words = setting(key).map(Setting::words).unwrap_or_default();
            words.iter().map(|word| format!("{key}={word}")).collect()
        }
        (None, None) => Setting::all()
            .map(|setting| format!("{}=", setting.key))
            .collect(),
    };
    let offered = offered.into_iter();
    offered.filter(|offer| offer.starts_with(current)).collect()
}

fn setting(key: &str) -> Option<Setting> {
    Setting::all().find(|setting| setting.key == key)
}

/// The daemon chosen by the part of the line typed so far.
fn target() -> Option<Target> {
    target_of(typed_before())
}

fn target_of(mut words: Vec<OsString>) -> Option<Target> {
    // An option whose value is being typed.
    let is_option = |word: &mut OsString| word.as_encoded_bytes().starts_with(b"--");
    words.pop_if(is_option);
    let matches = Arguments::command()
        .ignore_errors(true)
        .try_get_matches_from(words)
        .ok()?;
    Target::from_arg_matches(&matches).ok()
}

/// The words of the line before the one that is being typed.
fn typed_before() -> Vec<OsString> {
    let words = std::env::args_os().skip_while(|word| word != "--").skip(1);
    let mut words: Vec<_> = words.collect();
    let index = std::env::var("_CLAP_COMPLETE_INDEX").ok();
    let last = words.len().saturating_sub(1);
    words.truncate(index.and_then(|index| index.parse().ok()).unwrap_or(last));
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<OsString> {
        line.split_whitespace().map(OsString::from).collect()
    }

    #[test]
    fn keys_and_words_of_settings_are_offered() {
        let offered = |before: &str, current: &str| changes_after(&words(before), current);
        assert_eq!(offered("cdcrctl settings set", "obstacle_s").len(), 3);
        assert_eq!(offered("cdcrctl settings set", "hor"), ["horizon_steps="]);
        assert_eq!(
            offered("cdcrctl settings set", "solver=kpso"),
            ["solver=kpso", "solver=kpso-refined"]
        );
        assert_eq!(
            offered("cdcrctl settings set", "seed="),
            Vec::<String>::new()
        );
        // In the form passed by bash.
        assert_eq!(
            offered("cdcrctl settings set solver =", "g"),
            ["gauss-newton"]
        );
        assert_eq!(offered("cdcrctl settings set solver", "").len(), 3);
        assert_eq!(
            offered("cdcrctl settings set seed = 1", "inert"),
            ["inertia="]
        );
    }

    #[test]
    fn the_command_line_selects_the_daemon() {
        for line in [
            "cdcrctl --root /x/y --prefix p_ obstacle remove",
            "cdcrctl obstacle remove 3 --root /x/y --prefix p_ --robot",
            "cdcrctl settings set --prefix=p_ --root=/x/y hor",
        ] {
            let target = target_of(words(line)).expect(line);
            let (location, _) = target.location().expect("legal");
            assert_eq!(
                (location.prefix(), location.root().to_str()),
                ("p_", Some("/x/y")),
                "{line}"
            );
        }
    }
}
