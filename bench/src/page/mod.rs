//! Self-contained pages: one style, and all tables and pictures inside, so that a page can be sent alone.

use std::fmt::Write as _;

use crate::figures::Figure;
use crate::table::Table;

const STYLE: &str = include_str!("style.css");

/// A page that grows from top to bottom.
#[derive(Debug)]
pub struct Page {
    html: String,
}

impl Page {
    pub fn new(title: &str) -> Self {
        let title = escape(title);
        Self {
            html: format!(
                "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
                 <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
                 <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
                 <h1>{title}</h1>\n"
            ),
        }
    }

    pub fn text(&mut self, html: &str) {
        self.html.push_str(html);
        self.html.push('\n');
    }

    /// The heading of a part; links lead to its `id`.
    pub fn heading(&mut self, heading: &str, id: Option<&str>) {
        let id = id.map_or_else(String::new, |id| format!(" id=\"{}\"", escape(id)));
        let _ = writeln!(self.html, "<h2{id}>{}</h2>", escape(heading));
    }

    /// A list of links to headings: id and words.
    pub fn contents(&mut self, entries: &[(&str, &str)]) {
        self.html.push_str("<nav><ul>\n");
        for (id, words) in entries {
            let _ = writeln!(
                self.html,
                "<li><a href=\"#{}\">{}</a></li>",
                escape(id),
                escape(words)
            );
        }
        self.html.push_str("</ul></nav>\n");
    }

    pub fn failure(&mut self, words: &str) {
        let _ = writeln!(self.html, "<p class=\"failed\">{}</p>", escape(words));
    }

    /// A table, wider than the page if need be.
    pub fn table(&mut self, table: &Table) {
        let _ = writeln!(self.html, "<div class=\"wide\">\n{}</div>", table.html());
    }

    /// A table whose title is the heading above it.
    pub fn plain_table(&mut self, table: &Table) {
        let _ = writeln!(
            self.html,
            "<div class=\"wide plain\">\n{}</div>",
            table.html()
        );
    }

    /// A picture with its caption; `id` is its own on this page.
    pub fn figure(&mut self, id: &str, figure: &Figure) {
        let _ = writeln!(
            self.html,
            "<figure id=\"{}\">\n{}\n<figcaption>{}</figcaption>\n</figure>",
            escape(id),
            figure.svg.trim(),
            escape(&figure.caption)
        );
    }

    pub fn end(self) -> String {
        self.html + "</body>\n</html>\n"
    }
}

/// A text between tags, or an attribute within quotes.
pub fn escape(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '&' => html.push_str("&amp;"),
            '"' => html.push_str("&quot;"),
            _ => html.push(letter),
        }
    }
    html
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_never_taken_for_a_tag() {
        let mut page = Page::new("1 < 2 & more");
        page.heading("a \"heading\"", Some("a"));
        page.failure("<script>");
        let html = page.end();
        assert!(html.contains("<h1>1 &lt; 2 &amp; more</h1>"), "{html}");
        assert!(
            html.contains("<h2 id=\"a\">a &quot;heading&quot;</h2>"),
            "{html}"
        );
        assert!(!html.contains("<script"), "{html}");
    }
}
