//! Results as one self-contained page, with style, tables and plots inside.

use std::fmt::Write as _;

use crate::dataset::{Dataset, Plot};

const STYLE: &str = include_str!("page.css");

pub(super) const INTRODUCTION: &str = include_str!("introduction.html");

/// A page with a table of contents: the results if there is an `introduction` (HTML), otherwise the plots of
/// the only result.
pub(super) fn page(title: &str, introduction: &str, all: &[&Dataset]) -> String {
    let heading = escape(title);
    let link = |id: &str, words: &str| format!("<li><a href=\"#{id}\">{words}</li>\n");
    let links: String = if introduction.is_empty() {
        let plots = all.iter().flat_map(|dataset| dataset.plots());
        let link = |plot: &Plot| {
            let (words, caption) = (plot.name.replace('-', " "), escape(&plot.caption));
            link(&plot.name, &format!("{words}</a>: {caption}"))
        };
        plots.map(link).collect()
    } else {
        let words = |dataset: &Dataset| escape(&dataset.declaration.heading) + "</a>";
        let links = all.iter().map(|of| link(of.name, &words(of)));
        links.collect()
    };
    let contents = match links.as_str() {
        "" => links,
        _ => format!("<nav><ul>\n{links}</ul></nav>\n"),
    };
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{heading}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{heading}</h1>\n{introduction}{contents}"
    );
    for dataset in all {
        let (name, heading) = (dataset.name, &dataset.declaration.heading);
        if heading != title {
            let _ = writeln!(html, "<h2 id=\"{name}\">{}</h2>", escape(heading));
        }
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
            let caption = format!("<figcaption>{caption}</figcaption>");
            let _ = writeln!(html, "<figure id=\"{id}\">\n{svg}\n{caption}\n</figure>");
        }
        if !dataset.recordings.is_empty() {
            let log = format!("histograms/{name}.hlog");
            let _ = writeln!(html, "<p>Every latency of it is in <code>{log}</code>.</p>");
        }
    }
    html + "</body>\n</html>\n"
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
