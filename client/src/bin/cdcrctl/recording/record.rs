use std::collections::VecDeque;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use cdcr_client::channels::{Drawing, Drawings, Drawn, Recorded, Topic};
use cdcr_client::{counted, events, monotonic_ns};
use cdcr_interchange::encode;
use cdcr_interchange::mcap::Stamp;
use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::{Status, Telemetry};

use super::examination::Examination;
use super::intake::{Intake, Reading};
use super::invocation::Invocation;
use super::sink::{CHANNELS, Head, Sink};
use super::when::{date_time, unix_offset_ns};
use crate::args::{RecordingOptions, Target};
use crate::done::Done;
use crate::echo::json;
use crate::files::check_new;
use crate::interrupt::Interrupt;
use crate::settings::save::configuration;
use crate::tell;
use crate::trigger::Trigger;

/// Interval of the flushes: a killed recorder loses at most this, besides data that waits for the disk.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// A message sent this long before the recording began may still get its outcome in it \[ns\].
const EVALUATED_WITHIN_NS: u64 = 100_000_000;
/// What the user can do when the file exists, instead of removing it.
pub(super) const OR: &str = "or name another";
/// Chunks and updates kept until their outcome arrives: the daemon gathers fewer at once.
const REMEMBERED: usize = 256;
pub(crate) fn run(target: &Target, options: &RecordingOptions) -> anyhow::Result<Done> {
    let around = options.around.map(|trigger| Around {
        trigger,
        before: options.before,
        after: options.after,
    });
    let task = RecordTask {
        output: options.output.as_deref(),
        duration: options.duration,
        max_bytes: options.max_size,
        around,
        watch: &mut (),
    };
    record(target, task)
}

/// Options of a recording.
pub(super) struct RecordTask<'a> {
    /// Output file; by default named for robot and time.
    pub(super) output: Option<&'a Path>,
    pub(super) duration: Option<Duration>,
    /// Maximum size of the file.
    pub(super) max_bytes: Option<u64>,
    /// Restricts the recording to the time around a trigger.
    pub(super) around: Option<Around>,
    pub(super) watch: &'a mut dyn RecordWatch,
}

/// Observer of a running recording.
pub(super) trait RecordWatch {
    /// Gets a record, with the trigger if it fired and the recording begins.
    fn take(&mut self, record: &Telemetry, fires: Option<Trigger>) {
        if let Some(trigger) = fires {
            tell!("{trigger} in cycle {}", record.cycle);
        }
    }

    /// Called a few hundred times per second; returns whether to end the recording.
    fn should_end(&mut self) -> anyhow::Result<bool> {
        Ok(false)
    }

    /// Called at the end.
    fn end(&mut self) {}
}

impl RecordWatch for () {}

/// A recording around a trigger, with the time before it and after it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around {
    pub(super) trigger: Trigger,
    pub(super) before: Duration,
    pub(super) after: Duration,
}

/// Records a daemon into a file.
pub(super) fn record(target: &Target, task: RecordTask<'_>) -> anyhow::Result<Done> {
    let ended = recorded(target, task);
    let cause = ended.as_ref().err().and_then(|error| error.downcast_ref());
    match (&ended, cause.and_then(remedy_if_full)) {
        (Err(error), Some(remedy)) => {
            tell!("error: {error:#}; {remedy}");
            Ok(Done::DiskFull)
        }
        _ => ended,
    }
}

fn recorded(target: &Target, mut task: RecordTask<'_>) -> anyhow::Result<Done> {
    let interrupt = Interrupt::catch()?;
    let (_, robot) = target.location()?;
    let (intake, status) = Intake::begin(target)?;
    let offset_ns = unix_offset_ns();
    let default = || {
        format!(
            "{robot}-{}.mcap",
            date_time(status.header.sent_ns + offset_ns)
        )
        .into()
    };
    let path: PathBuf = task.output.map_or_else(default, Path::to_owned);
    let name = path.display();
    let cannot_write = || format!("cannot write {name}");
    if task.around.is_some() {
        // Reported now rather than after the wait for the trigger.
        check_new(&path, OR)?;
    }
    let head = head(robot, &status, offset_ns)?;
    let examination = Examination::begin();
    let before = task.around.map_or(Duration::ZERO, |around| around.before);
    let sink = Sink::new(head, &path, before);
    let mut recorder = Recorder::new(sink, robot, &status, offset_ns);
    let ended = match task.around {
        Some(around) => {
            tell!("waiting for {}; Ctrl-C to end", around.trigger);
            recorder.record(&intake, &mut task, &interrupt)?
        }
        None => match recorder.begin()? {
            Ok(()) => {
                tell!("recording into {name}; Ctrl-C to end");
                recorder.record(&intake, &mut task, &interrupt)?
            }
            Err(cause) => Ended::Failed(cause),
        },
    };
    task.watch.end();
    if !recorder.sink.has_begun() {
        return match ended {
            Ended::Interrupted => Ok(Done::Interrupted),
            Ended::Daemon => bail!("the daemon ended, nothing was recorded"),
            Ended::Asked | Ended::Size | Ended::Failed(_) => {
                bail!("the trigger did not fire, nothing was recorded")
            }
        };
    }
    let ended = match ended {
        Ended::Failed(_) => ended,
        _ => recorder.sink.flush().map_or_else(Ended::Failed, |()| ended),
    };
    let (lost, counts) = (recorder.lost(), recorder.sink.whole);
    let is_removed = recorder.sink.is_removed();
    let finished = recorder.finish(&ended, &lost, examination);
    let ended = match ended {
        Ended::Failed(cause) if counts.iter().all(|count| *count == 0) => {
            return Err(cause)
                .with_context(|| format!("cannot write {name}, nothing was recorded"));
        }
        ended => ended,
    };
    finished.with_context(cannot_write)?;
    if tell::results_are_read() {
        print_summary(&path, counts, &ended, &lost).map_err(OutputError)?;
    }
    if let Ended::Failed(cause) = ended {
        return Err(cause).with_context(|| format!("{name}: the recording ended there"));
    }
    ensure!(
        !is_removed,
        "{name} was removed during the recording: nothing is left of it"
    );
    Ok(Done::Good)
}

/// Settings, status and configuration of the daemon, with which its cycles can be recomputed.
fn head(robot: &str, status: &Status, offset_ns: u64) -> anyhow::Result<Head> {
    let mut head = Head::new(robot, status, offset_ns)?;
    let settings = configuration(status.settings, status)?;
    head.attach("settings.toml", "application/toml", settings.into_bytes());
    let snapshot = json::message(status).to_string();
    head.attach("status.json", "application/json", snapshot.into_bytes());
    if let Some(started) = Invocation::from_process(status.process_id) {
        let how = started.json().to_string().into_bytes();
        head.attach("daemon.json", "application/json", how);
        if let Some(text) = started.configuration() {
            head.attach("configuration.toml", "application/toml", text);
        }
    }
    Ok(head)
}

/// The summary cannot be printed. The file is complete.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the output")]
struct OutputError(#[source] io::Error);

/// Why a recording ended.
#[derive(Debug)]
enum Ended {
    /// Its duration was reached.
    Asked,
    /// Its file has the maximum size.
    Size,
    /// A signal arrived, or the observer ended it.
    Interrupted,
    /// The daemon ended, or another one replaced it.
    Daemon,
    /// The file cannot be written.
    Failed(io::Error),
}

fn nanoseconds(time: Duration) -> u64 {
    time.as_nanos() as u64
}

/// Remedy when a file cannot become larger.
fn remedy_if_full(cause: &io::Error) -> Option<&'static str> {
    match cause.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            Some("free space there, or name a file on another disk with -o")
        }
        ErrorKind::FileTooLarge => {
            Some("raise the limit (ulimit -f), or name a file on another disk with -o")
        }
        _ => None,
    }
}

/// Prints a line with the recorded and the missing messages.
fn print_summary(
    path: &Path,
    counts: [u64; CHANNELS],
    ended: &Ended,
    lost: &[(Topic, u64)],
) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let counts = Topic::ALL.map(|topic| counted(counts[topic as usize], topic.noun()));
    let why = match ended {
        Ended::Daemon => "; the daemon ended",
        Ended::Size => "; the file has its maximum size",
        _ => "",
    };
    writeln!(out, "{}: {}{why}", path.display(), counts.join(", "))?;
    for (topic, count) in lost {
        writeln!(
            out,
            "lost {}: this program was too slow",
            counted(*count, topic.noun())
        )?;
    }
    Ok(())
}

/// Writes the received messages, and counts missing ones.
struct Recorder {
    sink: Sink,
    drawings: Drawings,
    /// Number of messages of each drawn channel.
    drawn: [u32; Drawn::ALL.len()],
    /// Offset from `CLOCK_MONOTONIC` to the time since 1970 \[ns\].
    offset_ns: u64,
    begun_ns: u64,
    /// End of the recording on the daemon's clock, if it has one.
    ends_ns: Option<u64>,
    /// Identity of the recorded daemon.
    sender_id: u64,
    /// Sender and sequence number of the newest chunks and updates.
    taken: VecDeque<(u64, u64)>,
    /// Messages of each topic that the daemon accepted and the recorder did not receive.
    missed: [u64; Topic::ALL.len()],
    /// Messages of each topic missing in the sequence numbers.
    lost: [u64; Topic::ALL.len()],
    /// Whether the daemon has reported an incident.
    had_incident: bool,
    before: Option<Box<Telemetry>>,
}

impl Recorder {
    fn new(sink: Sink, robot: &str, status: &Status, offset_ns: u64) -> Self {
        Self {
            sink,
            drawings: Drawings::new(robot, offset_ns),
            drawn: [0; Drawn::ALL.len()],
            offset_ns,
            begun_ns: monotonic_ns(),
            ends_ns: None,
            sender_id: status.header.sender_id,
            taken: VecDeque::with_capacity(REMEMBERED),
            missed: [0; Topic::ALL.len()],
            lost: [0; Topic::ALL.len()],
            had_incident: false,
            before: None,
        }
    }

    fn begin(&mut self) -> anyhow::Result<io::Result<()>> {
        self.sink.begin(monotonic_ns() + self.offset_ns)
    }

    /// Whether the trigger fires with a record.
    fn fires(&mut self, trigger: Trigger, record: &Telemetry) -> bool {
        let before = self.before.replace(Box::new(*record));
        if trigger == Trigger::Incident {
            return self.had_incident;
        }
        before.is_some_and(|before| trigger.fires(&before, record))
    }

    fn record(
        &mut self,
        intake: &Intake,
        task: &mut RecordTask<'_>,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Ended> {
        let (mut flushed, mut ended) = (Instant::now(), None);
        self.ends_ns = task.duration.map(|all| self.begun_ns + nanoseconds(all));
        loop {
            if ended.is_none() && (interrupt.is_raised() || task.watch.should_end()?) {
                ended = Some(Ended::Interrupted);
                intake.end();
            }
            let Some(reading) = intake.next()? else {
                return Ok(ended.unwrap_or(Ended::Daemon));
            };
            let (cycles, is_other) = self.of_our_daemon(&reading.records);
            let mut written = self.take_all(&reading, cycles, task)?;
            if flushed.elapsed() >= FLUSH_EVERY {
                flushed = Instant::now();
                written = written.and_then(|()| self.sink.flush());
            }
            if let Err(cause) = written {
                return Ok(Ended::Failed(cause));
            }
            if is_other {
                return Ok(Ended::Daemon);
            }
            if task.max_bytes.is_some_and(|max| self.sink.is_at(max)) {
                return Ok(Ended::Size);
            }
            if self.is_over(reading.until_ns) {
                return Ok(Ended::Asked);
            }
        }
    }

    /// Whether a time is after the end of the recording. Waiting for the disk does not extend it.
    fn is_over(&self, at_ns: u64) -> bool {
        self.ends_ns.is_some_and(|ends_ns| at_ns > ends_ns)
    }

    /// The records of the recorded daemon, and whether those of another daemon follow.
    fn of_our_daemon<'a>(&self, records: &'a [Telemetry]) -> (&'a [Telemetry], bool) {
        let is_other = |record: &Telemetry| record.header.sender_id != self.sender_id;
        let count = records.iter().position(is_other);
        (&records[..count.unwrap_or(records.len())], count.is_some())
    }

    /// Writes a reading: the messages that a cycle gathered come before its record. The inner error is an I/O
    /// error such as a full disk.
    fn take_all(
        &mut self,
        reading: &Reading,
        records: &[Telemetry],
        task: &mut RecordTask<'_>,
    ) -> anyhow::Result<io::Result<()>> {
        self.lost = reading.lost;
        let mut written = (self.write_all(&reading.references))
            .and_then(|()| self.write_all(&reading.obstacles))
            .and_then(|()| self.write_all(&reading.statuses))
            .and_then(|()| self.write_all(&reading.incidents));
        for record in records {
            if written.is_err() || self.is_over(record.header.sent_ns) {
                break;
            }
            self.count_missing(record);
            written = self.write(record).and_then(|()| self.draw(record));
            let waits_for = task.around.filter(|_| !self.sink.has_begun());
            let fires = waits_for.filter(|around| self.fires(around.trigger, record));
            task.watch.take(record, fires.map(|around| around.trigger));
            if let Some(around) = fires {
                self.ends_ns = Some(record.header.sent_ns + nanoseconds(around.after));
                written = written.and(self.begin()?);
            }
        }
        Ok(written)
    }

    fn write_all<T: Recorded>(&mut self, messages: &[T]) -> io::Result<()> {
        messages.iter().try_for_each(|message| self.write(message))
    }

    /// Counts gathered messages that were not received: their sender left too early, or the queue was full.
    fn count_missing(&mut self, record: &Telemetry) {
        let since_ns = self.begun_ns + EVALUATED_WITHIN_NS;
        for event in events(record) {
            let topic = match EventKind::try_from(event.kind) {
                Ok(EventKind::Reference) => Topic::Reference,
                Ok(EventKind::Obstacles) => Topic::Obstacles,
                _ => continue,
            };
            let is_ours =
                event.outcome == Outcome::Accepted.code() && event.evaluated_ns > since_ns;
            if is_ours && !self.taken.contains(&(event.sender_id, event.sequence)) {
                self.missed[topic as usize] += 1;
            }
        }
    }

    /// Lost messages, if any, from the gaps in their sequence numbers and from the events of the daemon.
    fn lost(&self) -> Vec<(Topic, u64)> {
        let all = Topic::ALL.map(|topic| {
            let place = topic as usize;
            (topic, self.lost[place].max(self.missed[place]))
        });
        all.into_iter().filter(|(_, lost)| *lost > 0).collect()
    }

    fn write<T: Recorded>(&mut self, message: &T) -> io::Result<()> {
        let header = message.header();
        if T::TOPIC == Topic::Incidents {
            // Incidents kept by the daemon from before the recording.
            if header.sent_ns < self.begun_ns {
                return Ok(());
            }
            self.had_incident = true;
        }
        let bytes = encode(message).map_err(io::Error::other)?;
        if matches!(T::TOPIC, Topic::Reference | Topic::Obstacles) {
            if self.taken.len() == REMEMBERED {
                self.taken.pop_front();
            }
            self.taken.push_back((header.sender_id, header.sequence));
        }
        let stamp = self.stamp(header.sequence as u32, header.sent_ns);
        self.sink.put(T::TOPIC as usize, stamp, bytes)
    }

    /// Writes the drawings of a record.
    fn draw(&mut self, record: &Telemetry) -> io::Result<()> {
        let drawings = self.drawings.encode(record).map_err(io::Error::other)?;
        for Drawing { channel, data } in drawings {
            self.drawn[channel as usize] += 1;
            let number = self.drawn[channel as usize];
            let stamp = self.stamp(number, record.header.sent_ns);
            let place = Topic::ALL.len() + channel as usize;
            self.sink.put(place, stamp, data)?;
        }
        Ok(())
    }

    fn stamp(&self, sequence: u32, sent_ns: u64) -> Stamp {
        let unix_ns = sent_ns + self.offset_ns;
        Stamp {
            sequence,
            log_ns: unix_ns,
            publish_ns: unix_ns,
        }
    }

    /// Completes the file, even when the disk is nearly full.
    fn finish(
        self,
        ended: &Ended,
        lost: &[(Topic, u64)],
        examination: Option<Examination>,
    ) -> io::Result<()> {
        let counts = lost
            .iter()
            .map(|(topic, count)| (format!("lost_{}", topic.service().key()), count.to_string()));
        let report = examination.and_then(Examination::end);
        let unix_ns = self.begun_ns + self.offset_ns;
        let report = report.map(|report| ("doctor.json", unix_ns, report));
        let is_good = !matches!(ended, Ended::Failed(_));
        self.sink.finish(is_good, counts.collect(), report)
    }
}
