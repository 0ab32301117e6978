//! A recording as one self-contained HTML page: key figures, the robot in 3-D, curves, latencies, events. The
//! script of the page draws everything from one block of JSON.

mod columns;
mod content;
mod happened;
mod histogram;

use std::fs;
use std::io::{self, Write};

use anyhow::{Context, ensure};
use cdcr_client::counted;

use super::file::Recording;
use crate::args::ReportOptions;
use crate::done::Done;
use crate::files::{check_new, new_file};
use content::Content;

/// What a user whose page exists can do instead of removing it.
const OR: &str = "or use another --output";
const PAGE: &str = include_str!("page.html");
const SCRIPT: &str = include_str!("page.js");

pub(crate) fn run(options: &ReportOptions) -> anyhow::Result<Done> {
    let name = options.file.display();
    let page = options
        .output
        .clone()
        .unwrap_or_else(|| options.file.with_extension("html"));
    let mut recording = Recording::open(&options.file)?;
    ensure!(
        page != options.file,
        "{name} is the recording itself: use another --output"
    );
    check_new(&page, OR)?;
    let mut content = Content::default();
    while let Some(message) = recording.next_message()? {
        content.take(&message)?;
    }
    let data = content.json(&recording, &name.to_string())?;
    // The data must not contain the end tag of the block.
    let data = serde_json::to_string(&data)?.replace('<', "\\u003c");
    let text = PAGE.replacen("{DATA}", &data, 1);
    let (head, tail) = text.rsplit_once("{SCRIPT}").unwrap_or((&text, ""));
    new_file(&page, OR)?
        .write_all([head, SCRIPT, tail].concat().as_bytes())
        .inspect_err(|_| {
            // Half a page is none.
            drop(fs::remove_file(&page));
        })
        .with_context(|| format!("cannot write {}", page.display()))?;
    writeln!(
        io::stdout(),
        "{}: {}; open it in a browser",
        page.display(),
        counted(content.cycles(), "cycle")
    )?;
    recording.warn_of_cut();
    Ok(Done::Good)
}
