//! Contents of the declarations, for generated pages and headers.

use std::collections::BTreeMap;

use crate::LAYOUTS;
use crate::message::Meaning;

/// Value, name and text of each code; for a bit its name and remedy.
pub type CodeList = &'static [(u32, &'static str, &'static str)];

/// Every enumeration used by a field, and the bits of each bit field under the name of that field.
pub fn codes() -> BTreeMap<&'static str, CodeList> {
    let mut all = BTreeMap::new();
    for field in LAYOUTS.iter().flat_map(|layout| layout.fields) {
        match field.meaning {
            Meaning::Code(codes) | Meaning::Per(codes, _) => {
                all.insert(codes.name, codes.values);
            }
            Meaning::Bits(bits) => {
                all.insert(field.name, bits);
            }
            _ => {}
        }
    }
    all
}

/// True if a name of [`codes`] is that of a bit field.
pub fn is_bits(name: &str) -> bool {
    name.starts_with(char::is_lowercase)
}

/// A documentation comment in one line, without links into the code.
pub fn words(doc: &str) -> String {
    let words: Vec<_> = doc.split_whitespace().collect();
    let text = words.join(" ");
    let text = replace_between(&text, "](crate::", ")", |_| "]".to_owned());
    let text = replace_between(&text, "[`", "`]", |name| format!("`{name}`"));
    text.replace("\\[", "[").replace("\\]", "]")
}

/// Replaces each part between two marks.
fn replace_between(text: &str, begin: &str, end: &str, instead: impl Fn(&str) -> String) -> String {
    let mut done = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(begin) {
        // Ignores a mark without an end.
        let Some((part, after)) = after.split_once(end) else {
            break;
        };
        done.push_str(before);
        done.push_str(&instead(part));
        rest = after;
    }
    done + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_into_the_code_become_words() {
        let doc = " [`codes::Mode`](crate::codes::Mode)\n of at most [`A`] \\[m\\], [`open";
        assert_eq!(words(doc), "`codes::Mode` of at most `A` [m], [`open");
    }

    #[test]
    fn bits_and_enumerations_are_distinguished() {
        let bits = codes().into_keys().filter(|name| is_bits(name));
        let bits: Vec<_> = bits.collect();
        assert_eq!(bits, ["guard_flags", "realtime_missing", "timing_flags"]);
    }
}
