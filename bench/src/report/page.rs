//! Results as one self-contained page: one style, and all tables and plots inside, so that it can be sent alone.

use std::fmt::Write as _;

use super::{BenchReport, Part, QUICK, Start, file_name, targets};
use crate::dataset::{Dataset, Sheet, escape};

const STYLE: &str = include_str!("page.css");

const INTRODUCTION: &str = "\
<p>What <code>cdcr-bench all</code> measured. Everything that a number needs to be judged is on this page: the \
machine, the method, and the baselines that were measured in the same run. On a shared machine an absolute \
latency says little; the ratio to the bare loop, taken in turns with it, says what the daemon adds. The same \
numbers are in <code>report.json</code>, for <code>cdcr-bench compare</code>, each case in a CSV, and every \
latency in <code>histograms/</code>, in the log format of HDR histograms.</p>\n";

pub(super) fn of_dataset(start: &Start, dataset: &Dataset) -> String {
    let mut html = String::new();
    add(&mut html, dataset);
    machine(&mut html, start);
    page(dataset.heading, &html)
}

/// All results, with contents, machine and targets first.
pub(super) fn of_report(report: &BenchReport, targets: Option<&Sheet>) -> String {
    let mut html = INTRODUCTION.to_owned();
    if report.extent.quick {
        failure(&mut html, QUICK);
    }
    let judged = report.not_judged();
    let mut entries = vec![("environment", "The machine")];
    if targets.is_some() || judged.is_some() {
        entries.push(("targets", "Figures to reach"));
    }
    let heading = |part: &Part| part.result.as_ref().map_or(part.name, |r| r.heading);
    entries.extend(report.parts.iter().map(|part| (part.name, heading(part))));
    html += "<nav><ul>\n";
    for (id, words) in entries {
        let _ = writeln!(html, "<li><a href=\"#{id}\">{}</a></li>", escape(words));
    }
    html += "</ul></nav>\n";
    machine(&mut html, &report.start);
    if targets.is_some() || judged.is_some() {
        title(&mut html, "targets", "Figures to reach");
    }
    if let Some(targets) = targets {
        html += targets::EXPLANATION;
        let _ = writeln!(html, "<div class=\"wide plain\">\n{}</div>", targets.html());
    }
    if let Some(why) = judged {
        let _ = writeln!(html, "<p>{}</p>", escape(why));
    }
    for part in &report.parts {
        title(&mut html, part.name, heading(part));
        match &part.result {
            Ok(dataset) => add(&mut html, dataset),
            Err(cause) => failure(&mut html, &format!("There is no result: {cause}")),
        }
    }
    page("What cdcr reaches, measured", &html)
}

fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n"
    )
}

fn title(html: &mut String, id: &str, words: &str) {
    let _ = writeln!(html, "<h2 id=\"{id}\">{}</h2>", escape(words));
}

fn failure(html: &mut String, words: &str) {
    let _ = writeln!(html, "<p class=\"failed\">{}</p>", escape(words));
}

fn machine(html: &mut String, start: &Start) {
    title(html, "environment", "The machine");
    let table = start.environment.table().html();
    let _ = writeln!(html, "<div class=\"wide plain\">\n{table}</div>");
}

fn add(html: &mut String, dataset: &Dataset) {
    let name = dataset.name;
    html.push_str(dataset.explanation);
    for table in dataset.tables() {
        let _ = writeln!(html, "<div class=\"wide\">\n{}</div>", table.html());
    }
    for plot in &dataset.plots {
        let (id, svg) = (file_name(name, plot.name), plot.svg.trim());
        let caption = escape(plot.caption);
        let _ = writeln!(
            html,
            "<figure id=\"{id}\">\n{svg}\n<figcaption>{caption}</figcaption>\n</figure>"
        );
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
        let mut html = String::new();
        failure(&mut html, "<script>");
        title(&mut html, "a", "a \"heading\"");
        let html = page("1 < 2 & more", &html);
        assert!(html.contains("<h1>1 &lt; 2 &amp; more</h1>"), "{html}");
        assert!(
            html.contains("<h2 id=\"a\">a &quot;heading&quot;</h2>"),
            "{html}"
        );
        assert!(!html.contains("<script"), "{html}");
    }
}
