//! Pages that users read have no paragraph that is too long to be read once.

use std::path::{Path, PathBuf};

/// Largest length of a paragraph or of an item of a list \[words\].
const WORDS_MAX: usize = 150;

/// First words and length of each paragraph and each item of a list. Tables, headings and code are none.
fn paragraphs(page: &str) -> Vec<(String, usize)> {
    let mut texts = vec![String::new()];
    let mut is_code = false;
    for line in page.lines().map(str::trim) {
        let is_fence = line.starts_with("```");
        is_code ^= is_fence;
        let number = line.trim_start_matches(|c: char| c.is_ascii_digit());
        let is_item = line.starts_with("* ") || line.starts_with("- ") || number.starts_with(". ");
        let is_text = !is_code && !is_fence && !line.is_empty() && !line.starts_with(['|', '#']);
        if is_item || !is_text {
            texts.push(String::new());
        }
        if is_text {
            texts.last_mut().unwrap().extend([line, " "]);
        }
    }
    let begin = |text: &str| text.chars().take(60).collect();
    let lengths = texts
        .iter()
        .map(|text| (begin(text), text.split_whitespace().count()));
    lengths.filter(|(_, words)| *words > 0).collect()
}

#[test]
fn no_paragraph_is_too_long() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let docs = std::fs::read_dir(workspace.join("docs")).unwrap();
    let docs = docs.map(|entry| entry.unwrap().path());
    let docs = docs.filter(|path| path.extension().is_some_and(|end| end == "md"));
    let pages: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md", "bench/README.md"]
        .map(|name| workspace.join(name))
        .into_iter()
        .chain(docs)
        .chain([workspace.join("docs/decisions/0021-solver-measurements.md")])
        .collect();
    assert!(pages.len() > 20, "{pages:?}");
    for page in pages {
        for (begin, words) in paragraphs(&std::fs::read_to_string(&page).unwrap()) {
            assert!(
                words <= WORDS_MAX,
                "{}: {words} words: {begin}",
                page.display()
            );
        }
    }
}

#[test]
fn a_paragraph_ends_at_a_blank_line_an_item_a_table_and_code() {
    let page = "# Head\none two\nthree\n\n* four\n  five\n1. six\n| no | text |\nseven\n```sh\nno\n```\neight";
    let words: Vec<usize> = paragraphs(page)
        .into_iter()
        .map(|(_, words)| words)
        .collect();
    // The marks of a list count as words.
    assert_eq!(words, [3, 3, 2, 1, 1]);
}
