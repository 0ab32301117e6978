//! Results as one self-contained page: one style, and all tables and plots inside, so that it can be sent alone.

use std::fmt::Write as _;

use super::file_name;
use crate::dataset::{Dataset, Plot, escape};

const STYLE: &str = include_str!("page.css");

pub(super) const INTRODUCTION: &str = "\
<p>What <code>cdcr-bench all</code> measured. Everything that a number needs to be judged is on this page: the \
machine, the method, and the baselines that were measured in the same run. On a shared machine an absolute \
latency says little; the ratio to the bare loop, taken in turns with it, says what the daemon adds. The same \
numbers are in <code>report.json</code>, for <code>cdcr-bench compare</code>, each case in a CSV, and every \
latency in <code>histograms/</code>, in the log format of HDR histograms.</p>\n";

/// With contents where there is more than one result and its machine. The introduction is HTML.
pub(super) fn page(title: &str, introduction: &str, all: &[&Dataset]) -> String {
    let heading = escape(title);
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{heading}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{heading}</h1>\n{introduction}"
    );
    if !introduction.is_empty() {
        let link = |dataset: &&Dataset| {
            let (name, heading) = (dataset.name, escape(dataset.heading));
            format!("<li><a href=\"#{name}\">{heading}</a></li>\n")
        };
        let links: String = all.iter().map(link).collect();
        let _ = writeln!(html, "<nav><ul>\n{links}</ul></nav>");
    }
    if let ([dataset, ..], "") = (all, introduction) {
        add_contents(&mut html, dataset);
    }
    for dataset in all {
        if dataset.heading != title {
            let (name, heading) = (dataset.name, escape(dataset.heading));
            let _ = writeln!(html, "<h2 id=\"{name}\">{heading}</h2>");
        }
        add(&mut html, dataset);
    }
    html + "</body>\n</html>\n"
}

/// The plots of a page of one result, where there are several: what stands in their captions before the first mark.
fn add_contents(html: &mut String, dataset: &Dataset) {
    let link = |plot: &Plot| {
        let id = file_name(dataset.name, plot.name);
        let marks = [',', ':', ';', '(', '.'];
        let what = plot.caption.split(marks).next().unwrap_or_default();
        let (name, what) = (escape(&plot.name.replace('-', " ")), escape(what.trim()));
        format!("<li><a href=\"#{id}\">{name}</a>: {what}</li>\n")
    };
    if dataset.plots.len() > 1 {
        let links: String = dataset.plots.iter().map(link).collect();
        let _ = writeln!(html, "<nav><ul>\n{links}</ul></nav>");
    }
}

fn add(html: &mut String, dataset: &Dataset) {
    let name = dataset.name;
    let _ = writeln!(html, "{}", dataset.explanation);
    if !dataset.note.is_empty() {
        let class = if dataset.warns {
            " class=\"failed\""
        } else {
            ""
        };
        let _ = writeln!(html, "<p{class}>{}</p>", escape(&dataset.note));
    }
    for table in dataset.tables() {
        let _ = writeln!(html, "<div class=\"wide\">\n{}</div>", table.html());
    }
    for plot in &dataset.plots {
        let (id, svg, caption) = (
            file_name(name, plot.name),
            plot.svg.trim(),
            escape(plot.caption),
        );
        let caption = format!("<figcaption>{caption}</figcaption>");
        let _ = writeln!(html, "<figure id=\"{id}\">\n{svg}\n{caption}\n</figure>");
    }
    if !dataset.recordings.is_empty() {
        let log = format!("histograms/{name}.hlog");
        let _ = writeln!(html, "<p>Every latency of it is in <code>{log}</code>.</p>");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_never_taken_for_a_tag() {
        let dataset = Dataset {
            name: "a",
            heading: "a \"heading\"",
            note: "<script>".to_owned(),
            ..Dataset::default()
        };
        let html = page("1 < 2 & more", "", &[&dataset]);
        assert!(html.contains("<h1>1 &lt; 2 &amp; more</h1>"), "{html}");
        assert!(
            html.contains("<h2 id=\"a\">a &quot;heading&quot;</h2>"),
            "{html}"
        );
        assert!(!html.contains("<script"), "{html}");
    }

    #[test]
    fn a_result_alone_has_one_heading_and_only_a_warning_stands_in_a_box() {
        let mut dataset = Dataset {
            name: "a",
            heading: "1 < 2",
            note: "not judged".to_owned(),
            ..Dataset::default()
        };
        let html = page("1 < 2", "", &[&dataset]);
        assert!(html.contains("<h1>1 &lt; 2</h1>"), "{html}");
        assert!(!html.contains("<h2"), "{html}");
        assert!(html.contains("<p>not judged</p>"), "{html}");
        dataset.warns = true;
        let html = page("more", "", &[&dataset]);
        assert!(html.contains("<h2 id=\"a\">1 &lt; 2</h2>"), "{html}");
        assert!(
            html.contains("<p class=\"failed\">not judged</p>"),
            "{html}"
        );
    }

    #[test]
    fn a_result_with_several_plots_has_a_list_of_them() {
        let plot = |name| Plot {
            name,
            caption: "What it shows (Fig. 3).",
            svg: String::new(),
        };
        let dataset = Dataset {
            name: "a",
            plots: vec![plot("b-c"), plot("d")],
            ..Dataset::default()
        };
        let html = page("a", "", &[&dataset, &Dataset::default()]);
        for name in ["b-c", "d"] {
            let id = file_name("a", name);
            assert!(html.contains(&format!("href=\"#{id}\"")), "{html}");
            assert!(html.contains(&format!("id=\"{id}\"")), "{html}");
        }
        assert!(html.contains("</a>: What it shows</li>"), "{html}");
    }
}
