use std::collections::btree_map::{BTreeMap, Entry};
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, bail, ensure};
use cdcr_client::counted;
use cdcr_interchange::mcap::{Item, Loss, ReadError, Stamp, Writer};

use super::file::{DamagedRecording, Recording};
use crate::done::Done;
use crate::files::new_file;

/// Losses listed singly.
const LISTED: usize = 10;

/// Copies everything that is whole into another, complete file.
pub(super) fn repair(path: &Path, is_interrupted: impl Fn() -> bool) -> anyhow::Result<Done> {
    let mut recording = Recording::open_damaged(path)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let other = path.with_file_name(format!("{stem}-repaired.mcap"));
    let name = other.display();
    let file = new_file(&other, "or rename it")?;
    let copied = copy(&mut recording, file, is_interrupted);
    if !matches!(&copied, Ok((messages, _)) if *messages > 0) {
        // If nothing was saved, no file remains.
        drop(std::fs::remove_file(&other));
    }
    let (messages, failure) = copied.with_context(|| format!("{name} was not created"))?;
    let path = path.display();
    let whole = recording.whole();
    let all_bytes = recording.read_of_all_bytes()[1];
    let losses = whole.losses();
    let is_damaged = losses.iter().any(|loss| loss.bytes.end < all_bytes);
    let was = match &failure {
        Some(failure) => failure.to_string(),
        None if is_damaged => "the recording is damaged".to_owned(),
        None if recording.is_cut() => "the recording is truncated".to_owned(),
        None => "the recording is complete".to_owned(),
    };
    ensure!(messages > 0, "{path} contains no message: {was}");
    let lost = whole
        .message_count()
        .map_or(0, |all| all.saturating_sub(messages));
    let saved = counted(messages, "message");
    let lost = match lost {
        1.. if failure.is_none() => format!(", {lost} lost"),
        _ => String::new(),
    };
    let mut lines = vec![format!("{path}: {was}; {saved} saved in {name}{lost}")];
    if is_damaged {
        let first_ns = whole.first_ns().unwrap_or(0);
        let has_time = whole.message_count() != Some(messages);
        let listed = losses.iter().take(LISTED);
        lines.extend(listed.map(|loss| line(loss, first_ns, has_time)));
        if let Some(more @ 1..) = losses.len().checked_sub(LISTED) {
            lines.push(format!("lost: {}", counted(more as u64, "more part")));
        }
    }
    let text = lines.join("\n");
    match failure {
        None => writeln!(io::stdout(), "{text}")?,
        // The file may hold more than could be read now.
        Some(_) => bail!("{text}"),
    }
    Ok(Done::Good)
}

/// One lost part, as a line; with its time if messages are lost.
fn line(loss: &Loss, first_ns: u64, has_time: bool) -> String {
    let seconds = |from_ns: u64, to_ns: u64| to_ns.saturating_sub(from_ns) as f64 * 1e-9;
    let kilobytes = (loss.bytes.end - loss.bytes.start) as f64 * 1e-3;
    let mut parts = vec![format!(
        "lost: {kilobytes:.1} kB at byte {}",
        loss.bytes.start
    )];
    match loss.time_ns {
        _ if !has_time => {}
        [Some(last_ns), Some(next_ns)] => {
            let [lasts_s, at_s] = [seconds(last_ns, next_ns), seconds(first_ns, last_ns)];
            parts.push(format!("{lasts_s:.3} s from {at_s:.3} s on"));
        }
        [Some(last_ns), None] => {
            parts.push(format!("all from {:.3} s on", seconds(first_ns, last_ns)));
        }
        [None, _] => parts.push("before the first saved message".to_owned()),
    }
    let attachments = loss.attachments.iter();
    parts.extend(attachments.map(|name| format!("attachment {name}")));
    parts.join(", ")
}

/// The number of copied messages, and the error that ended the copy.
fn copy(
    recording: &mut DamagedRecording,
    file: File,
    is_interrupted: impl Fn() -> bool,
) -> anyhow::Result<(u64, Option<ReadError>)> {
    let library = concat!("cdcrctl ", env!("CARGO_PKG_VERSION"));
    let mut writer = Writer::new(file, "ros2", library)?;
    let mut ids = BTreeMap::new();
    let mut messages = 0_u64;
    let failure = loop {
        ensure!(!is_interrupted(), "interrupted");
        let item = match recording.next_item() {
            Ok(Some(item)) => item,
            Ok(None) => break None,
            Err(error) => break Some(error.downcast::<ReadError>()?),
        };
        match item {
            Item::Message(message) => {
                let id = match ids.entry(message.channel_id) {
                    Entry::Occupied(id) => *id.get(),
                    Entry::Vacant(free) => *free.insert(writer.add_channel(message.channel)?),
                };
                let stamp = Stamp {
                    sequence: message.sequence,
                    log_ns: message.log_ns,
                    publish_ns: message.publish_ns,
                };
                writer.write(id, stamp, message.data)?;
                messages += 1;
            }
            Item::Attachment {
                name,
                media_type,
                time_ns,
                data,
            } => writer.attach(&name, &media_type, time_ns, &data)?,
            Item::Metadata { name, values } => writer.add_metadata(&name, values)?,
        }
    };
    writer.finish().map_err(|(_, error)| error)?;
    Ok((messages, failure))
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::super::topic::Topic;
    use super::*;

    #[test]
    fn a_repair_that_is_interrupted_leaves_no_file_and_can_be_done_again() {
        let folder = Scratch::temporary().unwrap();
        let path = folder.path().join("run.mcap");
        let file = File::create_new(&path).unwrap();
        let mut writer = Writer::new(file, "ros2", "test").unwrap();
        let channel = Topic::Telemetry.channel("cdcr").unwrap();
        let id = writer.add_channel(&channel).unwrap();
        let stamp = Stamp {
            sequence: 0,
            log_ns: 0,
            publish_ns: 0,
        };
        writer.write(id, stamp, &[0; 8]).unwrap();
        writer.finish().unwrap();
        let repaired = path.with_file_name("run-repaired.mcap");
        let error = repair(&path, || true).unwrap_err();
        assert!(format!("{error:#}").ends_with("interrupted"), "{error:#}");
        assert!(!repaired.exists());
        repair(&path, || false).unwrap();
        assert!(repaired.exists());
        let again = repair(&path, || false).unwrap_err().to_string();
        assert!(
            again.ends_with("run-repaired.mcap exists: remove it or rename it"),
            "{again}"
        );
    }
}
