//! Results as one self-contained page, with style, tables and plots inside.

use std::fmt::Write as _;

use crate::dataset::{Dataset, Plot};

const PAGE: &str = include_str!("page.html");

pub(super) const INTRODUCTION: &str = include_str!("introduction.html");

/// A page with a table of contents: each result, and its plots.
pub(super) fn page(title: &str, introduction: &str, all: &[&Dataset]) -> String {
    let link = |id: &str, words: &str| format!("<li><a href=\"#{id}\">{}</a>\n", escape(words));
    // A result and its plot may have one name.
    let of_plot = |plot: &Plot| link(&format!("plot-{}", plot.name), &plot.caption);
    let of_dataset = |dataset: &&Dataset| {
        let plots: String = dataset.plots().map(of_plot).collect();
        let own = link(dataset.name, &dataset.declaration.heading);
        format!("{own}<ul>\n{plots}</ul>\n")
    };
    let links: String = all.iter().map(of_dataset).collect();
    let mut html = String::new();
    for dataset in all {
        let (name, heading) = (dataset.name, escape(&dataset.declaration.heading));
        let _ = writeln!(html, "<h2 id=\"{name}\">{heading}</h2>");
        let _ = writeln!(html, "{}", dataset.declaration.explanation);
        if !dataset.note.is_empty() {
            let class = ["", " class=\"failed\""][usize::from(dataset.warns)];
            let _ = writeln!(html, "<p{class}>{}</p>", escape(&dataset.note));
        }
        for table in dataset.tables() {
            let _ = writeln!(html, "<pre>\n{}</pre>", escape(&table.text()));
        }
        for plot in dataset.plots() {
            let (id, svg, caption) = (&plot.name, plot.svg.trim(), escape(&plot.caption));
            let figure = format!("{svg}\n<figcaption>{caption}</figcaption>");
            let _ = writeln!(html, "<figure id=\"plot-{id}\">\n{figure}\n</figure>");
        }
        if !dataset.recordings.is_empty() {
            let log = format!("histograms/{name}.hlog");
            let _ = writeln!(html, "<p>Every latency of it is in <code>{log}</code>.</p>");
        }
    }
    let page = PAGE.replace("{title}", &escape(title));
    let page = page.replace("{introduction}", introduction);
    page.replace("{links}", &links).replace("{results}", &html)
}

fn escape(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('"', "&quot;");
    text.replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_never_a_tag_and_a_warning_stands_in_a_box() {
        let mut dataset = Dataset::new("x", "heading = '1 < 2'\nexplanation = ''");
        (dataset.note, dataset.warns) = ("<script>".to_owned(), true);
        let html = page("", "", &[&dataset]);
        for words in ["1 &lt; 2</h2>", "<p class=\"failed\">&lt;script&gt;</p>"] {
            assert!(html.contains(words), "{html}");
        }
    }
}
