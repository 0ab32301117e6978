//! What the comments of the default configuration say about each key and table.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use super::DEFAULT_TEXT;

static COMMENTS: LazyLock<BTreeMap<String, String>> = LazyLock::new(|| comments(DEFAULT_TEXT));

/// The comment above a key or a table, as `default.toml` has it: its lines, without the number signs.
pub(super) fn comment(key: &str) -> Option<&'static str> {
    COMMENTS.get(key).map(String::as_str)
}

/// The comment above each key and table. Keys without one share that of the key above them. Where a table
/// is there more than once, the first counts.
fn comments(text: &str) -> BTreeMap<String, String> {
    let mut comments = BTreeMap::new();
    let mut table = String::new();
    let mut block = String::new();
    let mut is_fresh = false;
    for line in text.lines() {
        if let Some(words) = line.strip_prefix('#') {
            if !is_fresh {
                block.clear();
            }
            is_fresh = true;
            if !block.is_empty() {
                block.push('\n');
            }
            block.push_str(words.trim());
            continue;
        }
        is_fresh = false;
        let key = if line.starts_with('[') {
            line.trim_matches(['[', ']']).clone_into(&mut table);
            table.clone()
        } else if let Some((name, _)) = line.split_once(" = ") {
            format!("{table}.{name}")
        } else {
            block.clear();
            continue;
        };
        if !block.is_empty() {
            comments.entry(key).or_insert_with(|| block.clone());
        }
        if line.starts_with('[') {
            block.clear();
        }
    }
    comments
}

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]
mod tests {
    use super::super::{keys, ranges};
    use super::*;

    #[test]
    fn a_comment_belongs_to_the_table_or_the_keys_below_it() {
        let text = "# The file.\n\n# Tables.\n[a]\nx = 1\n# One\n# and two.\ny = 1\nz = 2\n\n[[a.b]]\nq = 1\n\
                    [[a.b]]\n# Later.\nq = 2\n";
        let comments = comments(text);
        assert_eq!(comments["a"], "Tables.");
        assert_eq!(comments["a.y"], "One\nand two.");
        assert_eq!(comments["a.z"], "One\nand two.");
        assert_eq!(comments.get("a.x"), None);
        assert_eq!(comments.get("a.b"), None);
    }

    #[test]
    fn every_key_and_every_table_has_a_comment() {
        for key in keys::all() {
            let comment = comment(key).unwrap_or_else(|| panic!("{key} has no comment"));
            assert!(comment.len() > 10, "{key}: {comment}");
        }
    }

    #[test]
    fn the_comments_say_the_ranges_that_are_checked() {
        for range in &ranges::RANGES {
            let comment = comment(range.key).unwrap().replace('\n', " ");
            assert!(
                said(&comment).contains(&(range.low, range.high)),
                "{}: {} to {} is not in: {comment}",
                range.key,
                range.low,
                range.high
            );
        }
        let others = keys::all().iter().filter(|key| ranges::of(key).is_none());
        for key in others {
            let said = said(&comment(key).unwrap().replace('\n', " "));
            let is_count = matches!(
                key.as_str(),
                "robot.name" | "robot.sections" | "transport.prefix"
            );
            assert!(
                said.is_empty() || is_count,
                "{key}: {said:?} is not checked"
            );
        }
    }

    /// Every `LOW to HIGH` of a text.
    fn said(text: &str) -> Vec<(f64, f64)> {
        let words: Vec<&str> = text.split(' ').collect();
        let triples = words.windows(3).filter(|words| words[1] == "to");
        triples
            .filter_map(|words| Some((number(words[0])?, number(words[2])?)))
            .collect()
    }

    fn number(word: &str) -> Option<f64> {
        let word = word.trim_end_matches([',', '.', ';', ':']);
        let Some(factor) = word.strip_suffix('π') else {
            return word.parse().ok();
        };
        let factor = match factor {
            "" => 1.0,
            "-" => -1.0,
            factor => factor.parse().ok()?,
        };
        Some(factor * std::f64::consts::PI)
    }
}
