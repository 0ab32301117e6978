use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use cdcr_client::counted;
use cdcr_client::replay::{Difference, Outcome, ReplayedCycle, Replayer};
use cdcr_interchange::encode;
use cdcr_interchange::mcap::{Channel, Stamp, Writer};
use cdcr_shared_types::codes::{ChunkMode, EventKind};
use cdcr_shared_types::limits::EVENTS_MAX;
use cdcr_shared_types::message::Struct;
use cdcr_shared_types::{Header, InputEvent, ReferenceChunk, Telemetry};
use serde_json::json;

use super::file::{RecordedMessage, Recording};
use super::topic::Topic;
use super::{play, what_if};
use crate::args::{Format, ReplayOptions, Target};
use crate::done::Done;

pub(crate) fn run(target: &Target, options: &ReplayOptions) -> anyhow::Result<Done> {
    if !options.with.is_empty() {
        return what_if::run(options);
    }
    if !options.verify {
        return play::run(target, options);
    }
    let mut recording = Recording::open(&options.file)?;
    let begin = Instant::now();
    let verified = verify(&mut recording, &options.file)?;
    let name = options.file.display();
    ensure!(verified.cycles > 0, "{name} contains no cycle");
    let took_s = begin.elapsed().as_secs_f64();
    let mut out = io::stdout().lock();
    match options.format {
        Format::Text => write!(out, "{}", verified.text(took_s))?,
        Format::Json => writeln!(out, "{}", verified.json(took_s))?,
    }
    out.flush()?;
    recording.warn_of_cut();
    match &verified.first_difference {
        Some((_, Ok(saved))) => bail!(
            "not all cycles were reproduced: see the first with `cdcrctl replay --verify {}`",
            saved.display()
        ),
        Some((_, Err(_))) => bail!("not all cycles were reproduced"),
        None => Ok(Done::Good),
    }
}

/// Result of a recomputed recording.
#[derive(Debug, Default)]
struct Verified {
    cycles: u64,
    reproduced: u64,
    solved: u64,
    without_reference: u64,
    different: u64,
    /// Missing records, and the cycle before each gap.
    missing_records: u64,
    gaps_after: Vec<u64>,
    /// Header and cycle of the newest record.
    last: Option<(Header, u64)>,
    /// The first difference, and the recording with the inputs of its cycle, or why it was not saved.
    first_difference: Option<(Difference, Result<PathBuf, String>)>,
    first_ns: Option<u64>,
    last_ns: u64,
}

fn verify(recording: &mut Recording, path: &Path) -> anyhow::Result<Verified> {
    let mut verified = Verified::default();
    each_cycle(recording, |cycle, replayer| {
        verified.take(cycle, replayer, path);
        Ok(())
    })?;
    Ok(verified)
}

/// Recomputes the cycles of a recording, one after the other.
pub(super) fn each_cycle(
    recording: &mut Recording,
    mut take: impl FnMut(ReplayedCycle, &mut Replayer) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut replayer = Replayer::default();
    while let Some(message) = recording.next_message()? {
        match message {
            RecordedMessage::Reference(chunk) => replayer.take_chunk(&chunk),
            RecordedMessage::Telemetry(record) => {
                if let Some(cycle) = replayer.take_record(&record)? {
                    take(cycle, &mut replayer)?;
                }
            }
            RecordedMessage::Obstacles(_)
            | RecordedMessage::Status(_)
            | RecordedMessage::Incident(_) => {}
        }
    }
    while let Some(cycle) = replayer.finish_one()? {
        take(cycle, &mut replayer)?;
    }
    Ok(())
}

impl Verified {
    fn take(&mut self, cycle: ReplayedCycle, replayer: &Replayer, path: &Path) {
        let ReplayedCycle { record, outcome } = cycle;
        self.cycles += 1;
        self.first_ns.get_or_insert(record.release_ns);
        self.last_ns = record.release_ns;
        let header = record.header;
        if let Some((last, cycle)) = self.last.replace((header, record.cycle))
            && last.sender_id == header.sender_id
            && header.sequence > last.sequence + 1
        {
            self.missing_records += header.sequence - last.sequence - 1;
            self.gaps_after.push(cycle);
        }
        match outcome {
            Outcome::Reproduced(made) => {
                self.reproduced += 1;
                self.solved += u64::from(made.solved);
            }
            Outcome::WithoutReference => self.without_reference += 1,
            Outcome::Different(difference) => {
                self.different += 1;
                if self.first_difference.is_none() {
                    let saved = save(&record, replayer.chunks_in_force(), path)
                        .map_err(|cause| format!("{cause:#}"));
                    self.first_difference = Some((difference, saved));
                }
            }
        }
    }

    /// Speed relative to real time.
    fn speed(&self, took_s: f64) -> f64 {
        let first_ns = self.first_ns.unwrap_or(self.last_ns);
        (self.last_ns - first_ns) as f64 * 1e-9 / took_s
    }

    fn text(&self, took_s: f64) -> String {
        let Self {
            cycles,
            reproduced,
            solved,
            without_reference,
            different,
            ..
        } = self;
        let speed = self.speed(took_s);
        let mut lines = vec![format!(
            "{reproduced} of {cycles} cycles reproduced, {solved} of them solved; {speed:.0} times real time"
        )];
        if let [first, others @ ..] = &self.gaps_after[..] {
            let missing = counted(self.missing_records, "record");
            let more = match others.len() {
                0 => String::new(),
                count => format!(" and at {}", counted(count as u64, "later place")),
            };
            lines.push(format!("missing: {missing}, after cycle {first}{more}"));
        }
        if *without_reference > 0 {
            lines.push(format!(
                "{without_reference} cycles follow a reference that is not completely recorded"
            ));
        }
        if let Some((difference, saved)) = &self.first_difference {
            lines.push(format!(
                "{different} cycles differ; the first: {difference}"
            ));
            lines.push(match saved {
                Ok(path) => format!("its inputs: {}", path.display()),
                Err(cause) => format!("its inputs are not saved: {cause}"),
            });
        }
        lines.join("\n") + "\n"
    }

    fn json(&self, took_s: f64) -> serde_json::Value {
        let first = self.first_difference.as_ref().map(|(difference, saved)| {
            json!({
                "cycle": difference.cycle,
                "what": difference.what,
                "recorded": difference.recorded,
                "computed": difference.computed,
                "inputs": saved.as_ref().ok().map(|path| path.display().to_string()),
            })
        });
        json!({
            "cycles": self.cycles,
            "reproduced": self.reproduced,
            "first_difference": first,
            "different": self.different,
            "without_reference": self.without_reference,
            "missing_records": self.missing_records,
            "gaps_after": self.gaps_after,
            "solved": self.solved,
            "times_real_time": self.speed(took_s),
        })
    }
}

/// Saves one cycle with its inputs as a recording. The reference chunks around it become a complete
/// reference: the first one replaces, and the record's events accept all of them.
fn save(
    record: &Telemetry,
    mut chunks: Vec<ReferenceChunk>,
    path: &Path,
) -> anyhow::Result<PathBuf> {
    chunks.truncate(EVENTS_MAX);
    let mut record = *record;
    record.event_count = chunks.len() as u32;
    for (i, (chunk, event)) in chunks.iter_mut().zip(&mut record.events).enumerate() {
        let mode = if i == 0 {
            ChunkMode::Replace
        } else {
            ChunkMode::Append
        };
        chunk.mode = mode.code();
        *event = InputEvent {
            sender_id: chunk.header.sender_id,
            sequence: chunk.header.sequence,
            kind: EventKind::Reference.code(),
            ..InputEvent::default()
        };
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let other = path.with_file_name(format!("{stem}-cycle-{}.mcap", record.cycle));
    let written = || -> anyhow::Result<()> {
        let mut writer = Writer::new(
            File::create(&other)?,
            "ros2",
            concat!("cdcrctl ", env!("CARGO_PKG_VERSION")),
        )?;
        let [references, telemetry] = [Topic::Reference, Topic::Telemetry]
            .map(|topic| -> anyhow::Result<Channel> { Ok(topic.channel("cdcr")?) });
        let [references, telemetry] = [
            writer.add_channel(&references?)?,
            writer.add_channel(&telemetry?)?,
        ];
        let mut put = |id: u16, header: &Header, message: &dyn Struct| -> anyhow::Result<()> {
            let stamp = Stamp {
                sequence: header.sequence as u32,
                log_ns: header.sent_ns,
                publish_ns: header.sent_ns,
            };
            Ok(writer.write(id, stamp, &encode(message)?)?)
        };
        for chunk in &chunks {
            put(references, &chunk.header, chunk)?;
        }
        put(telemetry, &record.header, &record)?;
        writer.finish().map_err(|(_, error)| error)?;
        Ok(())
    };
    written().with_context(|| format!("cannot write {}", other.display()))?;
    Ok(other)
}
