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
use crate::Done;
use crate::args::{RecordingOptions, Target};
use crate::echo::json;
use crate::interrupt::Interrupt;
use crate::settings::save::configuration;
use crate::trigger::Trigger;

/// How often what was read goes to the file: what a recorder that is killed loses at most, beside what waits for the disk.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// What was sent this long before the recording began may still be judged after it \[ns\].
const JUDGED_WITHIN_NS: u64 = 100_000_000;
/// Chunks and updates that are remembered until their outcome is told: the daemon takes in fewer at once.
const REMEMBERED: usize = 256;
pub(crate) fn run(target: &Target, options: &RecordingOptions) -> anyhow::Result<Done> {
    let around = options.around.map(|trigger| Around {
        trigger,
        before: options.before,
        after: options.after,
    });
    let task = Task {
        output: options.output.as_deref(),
        duration: options.duration,
        around,
        watch: &mut (),
    };
    record(target, task)
}

/// What is recorded, and how long.
pub(super) struct Task<'a> {
    /// File to make; by default one named for robot and time.
    pub(super) output: Option<&'a Path>,
    pub(super) duration: Option<Duration>,
    /// Only what is around this.
    pub(super) around: Option<Around>,
    pub(super) watch: &'a mut dyn Watch,
}

/// Sees what is recorded as it comes.
pub(super) trait Watch {
    /// A record; and what it fires, where the recording begins with it.
    fn take(&mut self, record: &Telemetry, fires: Option<Trigger>) {
        if let Some(trigger) = fires {
            tell!("{trigger} in cycle {}", record.cycle);
        }
    }

    /// A few hundred times a second; whether the recording shall end.
    fn look(&mut self) -> anyhow::Result<bool> {
        Ok(false)
    }

    /// Nothing more comes.
    fn end(&mut self) {}
}

impl Watch for () {}

/// A recording of what was before something and of what comes after.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around {
    pub(super) trigger: Trigger,
    pub(super) before: Duration,
    pub(super) after: Duration,
}

/// Records a daemon into a file.
pub(super) fn record(target: &Target, task: Task<'_>) -> anyhow::Result<Done> {
    match recorded(target, task) {
        Err(error) if error.downcast_ref().is_some_and(is_full) => {
            tell!("error: {error:#}");
            Ok(Done::DiskFull)
        }
        done => done,
    }
}

fn recorded(target: &Target, mut task: Task<'_>) -> anyhow::Result<Done> {
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
    if task.around.is_some() && path.exists() {
        // Told now and not after the wait.
        bail!("{name} already exists");
    }
    let mut head = Head::new(robot, &status, offset_ns)?;
    let settings = configuration(status.settings, &status)?;
    head.attach("settings.toml", "application/toml", settings.into_bytes());
    let snapshot = json::message(&status).to_string();
    head.attach("status.json", "application/json", snapshot.into_bytes());
    if let Some(started) = Invocation::of(status.process_id) {
        let how = started.json().to_string().into_bytes();
        head.attach("daemon.json", "application/json", how);
        if let Some(text) = started.configuration() {
            head.attach("configuration.toml", "application/toml", text);
        }
    }
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
            Ended::Asked | Ended::Failed(_) => {
                bail!("the trigger did not fire, nothing was recorded")
            }
        };
    }
    let ended = match ended {
        Ended::Failed(_) => ended,
        _ => recorder.sink.flush().map_or_else(Ended::Failed, |()| ended),
    };
    let (lost, counts) = (recorder.lost(), recorder.sink.whole);
    recorder
        .finish(&ended, &lost, examination)
        .with_context(cannot_write)?;
    tell(&path, counts, &ended, &lost)?;
    ensure!(
        path.exists(),
        "{name} was removed while it was recorded: nothing is left of it"
    );
    match ended {
        Ended::Failed(cause) => {
            Err(cause).with_context(|| format!("{name}: the recording ended there"))
        }
        _ => Ok(Done::Good),
    }
}

/// Why a recording ended.
#[derive(Debug)]
enum Ended {
    /// Its time was over.
    Asked,
    /// By a signal.
    Interrupted,
    /// The daemon ended, or another one follows.
    Daemon,
    /// The file cannot be written.
    Failed(io::Error),
}

fn nanoseconds(time: Duration) -> u64 {
    time.as_nanos() as u64
}

fn is_full(cause: &io::Error) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(cause.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

/// What was recorded, on one line, and what is missing.
fn tell(
    path: &Path,
    counts: [u64; CHANNELS],
    ended: &Ended,
    lost: &[(Topic, u64)],
) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let counts = Topic::ALL.map(|topic| counted(counts[topic as usize], topic.noun()));
    let why = match ended {
        Ended::Daemon => "; the daemon ended",
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

/// Takes what comes, and sees to it that nothing is missing.
struct Recorder {
    sink: Sink,
    drawings: Drawings,
    /// Messages of each drawn channel so far.
    drawn: [u32; Drawn::ALL.len()],
    /// From `CLOCK_MONOTONIC` to the time since 1970 \[ns\].
    offset_ns: u64,
    begun_ns: u64,
    /// The last instant that is recorded, where there is one, on the daemon's clock.
    ends_ns: Option<u64>,
    /// The daemon.
    sender_id: u64,
    /// Sender and number of the newest chunks and updates.
    taken: VecDeque<(u64, u64)>,
    /// Those that the daemon accepted and that never came here.
    missed: [u64; Topic::ALL.len()],
    /// By the gaps in their numbers.
    lost: [u64; Topic::ALL.len()],
    /// The daemon told of a bad cycle.
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

    /// Makes the file.
    fn begin(&mut self) -> anyhow::Result<io::Result<()>> {
        self.sink.begin(monotonic_ns() + self.offset_ns)
    }

    /// Whether it happens with a record.
    fn fires(&mut self, trigger: Trigger, record: &Telemetry) -> bool {
        let before = self.before.replace(Box::new(*record));
        if trigger == Trigger::Incident {
            return self.had_incident;
        }
        before.is_some_and(|before| trigger.fires(&before, record))
    }

    /// Records until it ends.
    fn record(
        &mut self,
        intake: &Intake,
        task: &mut Task<'_>,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Ended> {
        let (mut flushed, mut ended) = (Instant::now(), None);
        self.ends_ns = task.duration.map(|all| self.begun_ns + nanoseconds(all));
        loop {
            if ended.is_none() && (interrupt.is_raised() || task.watch.look()?) {
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
            if self.is_over(reading.until_ns) {
                return Ok(Ended::Asked);
            }
        }
    }

    /// Whether an instant is after the time of the recording. A disk that makes it wait does not make it longer.
    fn is_over(&self, at_ns: u64) -> bool {
        self.ends_ns.is_some_and(|ends_ns| at_ns > ends_ns)
    }

    /// The records of the daemon that the recording is of; whether another one follows.
    fn of_our_daemon<'a>(&self, records: &'a [Telemetry]) -> (&'a [Telemetry], bool) {
        let is_other = |record: &Telemetry| record.header.sender_id != self.sender_id;
        let count = records.iter().position(is_other);
        (&records[..count.unwrap_or(records.len())], count.is_some())
    }

    /// Writes what came. What a cycle took in stands before its record. The inner error is that of a full disk or the like.
    fn take_all(
        &mut self,
        reading: &Reading,
        records: &[Telemetry],
        task: &mut Task<'_>,
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
            self.miss(record);
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

    /// Counts what a cycle took in and is not here: its sender left before it was read, or the queue was full.
    fn miss(&mut self, record: &Telemetry) {
        let since_ns = self.begun_ns + JUDGED_WITHIN_NS;
        for event in events(record) {
            let topic = match EventKind::try_from(event.kind) {
                Ok(EventKind::Reference) => Topic::Reference,
                Ok(EventKind::Obstacles) => Topic::Obstacles,
                _ => continue,
            };
            let is_ours = event.outcome == Outcome::Accepted.code() && event.judged_ns > since_ns;
            if is_ours && !self.taken.contains(&(event.sender_id, event.sequence)) {
                self.missed[topic as usize] += 1;
            }
        }
    }

    /// Messages that never came, where there are any: by the gaps in their numbers, and by what the daemon tells of them.
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
            // Bad cycles that the daemon kept from before.
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

    /// What viewers draw of a record.
    fn draw(&mut self, record: &Telemetry) -> io::Result<()> {
        let drawings = self.drawings.of(record).map_err(io::Error::other)?;
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

    /// Ends the file, also where there is hardly room left.
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
