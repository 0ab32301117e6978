//! A bar for work whose pieces are counted.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};

/// A bar for `length` pieces of work that are counted so, on a terminal only.
pub(super) fn progress(length: u64, count: &str) -> Result<ProgressBar> {
    let style = ProgressStyle::with_template(&format!("{{bar:30}} {count}, {{eta}} left"))?;
    Ok(ProgressBar::new(length).with_style(style))
}
