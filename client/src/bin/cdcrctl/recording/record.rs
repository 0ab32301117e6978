use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use cdcr_client::{Connection, Stream, events, monotonic_ns, text};
use cdcr_interchange::encode;
use cdcr_interchange::mcap::{self, Stamp, Writer};
use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::{Incident, ObstacleUpdate, ReferenceChunk, Status, Telemetry};

use super::topic::{Recorded, Topic};
use super::when::{date_time, unix_offset_ns};
use crate::Done;
use crate::args::{RecordingOptions, Target};
use crate::echo::json;
use crate::interrupt::Interrupt;
use crate::settings::save::configuration;

/// How often the services are read. The queue of telemetry lasts for 256 cycles, but a client that sends one message leaves a few milliseconds
/// later, and takes along what nobody has read.
const READ_EVERY: Duration = Duration::from_millis(2);
/// How often what was read goes to the file: what a recorder that is killed loses at most.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// What was sent this long before the recording began may still be judged after it \[ns\].
const JUDGED_WITHIN_NS: u64 = 100_000_000;
/// Chunks and updates that are remembered until their outcome is told: the daemon takes in fewer at once.
const REMEMBERED: usize = 256;
/// After this long without a cycle, see whether the daemon still lives.
const QUIET: Duration = Duration::from_secs(1);

pub(crate) fn run(target: &Target, options: &RecordingOptions) -> anyhow::Result<Done> {
    let interrupt = Interrupt::catch()?;
    let (_, robot) = target.location()?;
    let connection = target.connect()?;
    let mut streams = Streams::open(&connection)?;
    let offset_ns = unix_offset_ns();
    let status = connection.status(QUIET)?;
    let default = || {
        format!(
            "{robot}-{}.mcap",
            date_time(status.header.sent_ns + offset_ns)
        )
        .into()
    };
    let path: PathBuf = options.output.clone().unwrap_or_else(default);
    let name = path.display();
    let file = File::create_new(&path).with_context(|| format!("cannot make {name}"))?;
    let cannot_write = || format!("cannot write {name}");
    let mut recorder =
        Recorder::begin(file, robot, &status, offset_ns).with_context(cannot_write)?;
    let settings = configuration(status.settings, &status)?;
    let attached = recorder.attach("settings.toml", "application/toml", settings.as_bytes());
    let ended = attached.and_then(|()| {
        recorder.attach(
            "status.json",
            "application/json",
            json::message(&status).to_string().as_bytes(),
        )
    });
    eprintln!("recording into {name}; Ctrl-C ends it");
    let ended = match ended {
        Ok(()) => recorder.record(&connection, &mut streams, options.duration, &interrupt)?,
        Err(cause) => Ended::Failed(cause),
    };
    let (lost, counts) = (recorder.lost(&streams), recorder.counts);
    recorder.finish(&ended, &lost).with_context(cannot_write)?;
    tell(&path, counts, &ended, &lost)?;
    match ended {
        Ended::Asked | Ended::Daemon => Ok(Done::Good),
        Ended::Failed(cause) if is_full(&cause) => {
            eprintln!("error: {name}: {cause}: the recording ended there");
            Ok(Done::DiskFull)
        }
        Ended::Failed(cause) => Err(cause).with_context(cannot_write),
    }
}

/// Why a recording ended.
#[derive(Debug)]
enum Ended {
    /// By a signal, or its time was over.
    Asked,
    /// The daemon ended, or another one follows.
    Daemon,
    /// The file cannot be written.
    Failed(io::Error),
}

fn is_full(cause: &io::Error) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(cause.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

/// What was recorded, on one line, and what is missing.
fn tell(path: &Path, counts: Counts, ended: &Ended, lost: &[(Topic, u64)]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let counts = Topic::ALL.map(|topic| format!("{} {}", counts[topic as usize], topic.plural()));
    let why = match ended {
        Ended::Daemon => "; the daemon ended",
        Ended::Asked | Ended::Failed(_) => "",
    };
    writeln!(out, "{}: {}{why}", path.display(), counts.join(", "))?;
    for (topic, count) in lost {
        writeln!(
            out,
            "lost: {count} {}, because this program was too slow",
            topic.plural()
        )?;
    }
    Ok(())
}

/// Everything that is recorded, as it comes.
struct Streams {
    telemetry: Stream<Telemetry>,
    references: Stream<ReferenceChunk>,
    obstacles: Stream<ObstacleUpdate>,
    statuses: Stream<Status>,
    incidents: Stream<Incident>,
}

impl Streams {
    fn open(connection: &Connection) -> anyhow::Result<Self> {
        Ok(Self {
            // Before the telemetry: what a cycle took in must not be missing.
            references: connection.references()?,
            obstacles: connection.obstacle_updates()?,
            telemetry: connection.telemetry()?,
            statuses: connection.statuses()?,
            incidents: connection.incidents()?,
        })
    }
}

/// A file that grows.
struct Recorder {
    writer: Writer<File>,
    /// The number of each topic in the file.
    channels: [u16; Topic::ALL.len()],
    /// From `CLOCK_MONOTONIC` to the time since 1970 \[ns\].
    offset_ns: u64,
    begun_ns: u64,
    /// The daemon.
    sender_id: u64,
    counts: Counts,
    /// Sender and number of the newest chunks and updates.
    taken: VecDeque<(u64, u64)>,
    /// Those that the daemon accepted and that never came here.
    missed: Counts,
}

/// Messages of each topic.
type Counts = [u64; Topic::ALL.len()];

impl Recorder {
    fn begin(file: File, robot: &str, status: &Status, offset_ns: u64) -> anyhow::Result<Self> {
        let library = concat!("cdcrctl ", env!("CARGO_PKG_VERSION"));
        let mut writer = Writer::new(file, "ros2", library)?;
        let mut channels = [0; Topic::ALL.len()];
        for topic in Topic::ALL {
            channels[topic as usize] = writer.add_channel(&topic.channel(robot)?)?;
        }
        let about = [
            ("robot", robot.to_owned()),
            ("robot_fingerprint", status.robot.fingerprint.to_string()),
            ("daemon", text(&status.build)),
            ("recorder", library.to_owned()),
            ("unix_minus_monotonic_ns", offset_ns.to_string()),
        ];
        let about = about.map(|(name, value)| (name.to_owned(), value));
        writer.add_metadata("cdcr", about.into())?;
        Ok(Self {
            writer,
            channels,
            offset_ns,
            begun_ns: monotonic_ns(),
            sender_id: status.header.sender_id,
            counts: [0; Topic::ALL.len()],
            taken: VecDeque::with_capacity(REMEMBERED),
            missed: [0; Topic::ALL.len()],
        })
    }

    fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> io::Result<()> {
        let time_ns = self.begun_ns + self.offset_ns;
        self.writer.attach(name, media_type, time_ns, data)
    }

    /// Records until it ends.
    fn record(
        &mut self,
        connection: &Connection,
        streams: &mut Streams,
        duration: Option<Duration>,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Ended> {
        let begin = Instant::now();
        let (mut heard, mut flushed) = (begin, begin);
        loop {
            // What has passed until then is read once more.
            let is_over = duration.is_some_and(|duration| begin.elapsed() >= duration);
            let is_asked = interrupt.is_raised() || is_over;
            // What a cycle took in stands before its record: it came before that.
            let mut records = Vec::new();
            while let Some(record) = streams.telemetry.try_next()? {
                records.push(record);
            }
            let (cycles, is_other) = self.of_our_daemon(&records);
            let written = self.take_all(streams, cycles)?;
            let now = Instant::now();
            let flush = |recorder: &mut Self| recorder.writer.flush();
            let written = written.and_then(|()| {
                if now - flushed < FLUSH_EVERY {
                    return Ok(());
                }
                flushed = now;
                flush(self)
            });
            if let Err(cause) = written {
                return Ok(Ended::Failed(cause));
            }
            if is_asked {
                return Ok(Ended::Asked);
            }
            if is_other {
                return Ok(Ended::Daemon);
            }
            if !cycles.is_empty() {
                heard = now;
            } else if now - heard > QUIET {
                if connection.status(QUIET).is_err() {
                    return Ok(Ended::Daemon);
                }
                heard = Instant::now();
            }
            thread::sleep(READ_EVERY);
        }
    }

    /// The records of the daemon that the recording is of; whether another one follows.
    fn of_our_daemon<'a>(&self, records: &'a [Telemetry]) -> (&'a [Telemetry], bool) {
        let is_other = |record: &Telemetry| record.header.sender_id != self.sender_id;
        let count = records.iter().position(is_other);
        (&records[..count.unwrap_or(records.len())], count.is_some())
    }

    /// Writes what waits; the inner error is that of the file.
    fn take_all(
        &mut self,
        streams: &mut Streams,
        records: &[Telemetry],
    ) -> anyhow::Result<io::Result<()>> {
        macro_rules! take {
            ($($stream:ident),+) => { $(
                while let Some(message) = streams.$stream.try_next()? {
                    if let Err(cause) = self.write(&message) {
                        return Ok(Err(cause));
                    }
                }
            )+ };
        }
        take!(references, obstacles, statuses, incidents);
        let written = records.iter().try_for_each(|record| {
            self.miss(record);
            self.write(record)
        });
        Ok(written)
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
    fn lost(&self, streams: &Streams) -> Vec<(Topic, u64)> {
        let all = [
            (Topic::Telemetry, streams.telemetry.lost()),
            (Topic::Reference, streams.references.lost()),
            (Topic::Obstacles, streams.obstacles.lost()),
            (Topic::Status, streams.statuses.lost()),
            (Topic::Incidents, streams.incidents.lost()),
        ];
        let all = all.map(|(topic, lost)| (topic, lost.max(self.missed[topic as usize])));
        all.into_iter().filter(|(_, lost)| *lost > 0).collect()
    }

    fn write<T: Recorded>(&mut self, message: &T) -> io::Result<()> {
        let header = message.header();
        // Bad cycles that the daemon kept from before.
        if header.sent_ns < self.begun_ns && T::TOPIC == Topic::Incidents {
            return Ok(());
        }
        let bytes = encode(message).map_err(io::Error::other)?;
        let unix_ns = header.sent_ns + self.offset_ns;
        let stamp = Stamp {
            sequence: header.sequence as u32,
            log_ns: unix_ns,
            publish_ns: unix_ns,
        };
        if matches!(T::TOPIC, Topic::Reference | Topic::Obstacles) {
            if self.taken.len() == REMEMBERED {
                self.taken.pop_front();
            }
            self.taken.push_back((header.sender_id, header.sequence));
        }
        let channel = self.channels[T::TOPIC as usize];
        self.writer.write(channel, stamp, &bytes)?;
        self.counts[T::TOPIC as usize] += 1;
        Ok(())
    }

    /// Ends the file, also where there is hardly room left.
    fn finish(mut self, ended: &Ended, lost: &[(Topic, u64)]) -> io::Result<()> {
        let whole_bytes = self.writer.whole_bytes();
        if matches!(ended, Ended::Failed(_)) {
            return cut(self.writer.abandon(), whole_bytes);
        }
        let counts = lost
            .iter()
            .map(|(topic, count)| (format!("lost_{}", topic.service().key()), count.to_string()));
        if self
            .writer
            .add_metadata("cdcr_end", counts.collect())
            .is_err()
        {
            return cut(self.writer.abandon(), whole_bytes);
        }
        let whole_bytes = self.writer.whole_bytes();
        match self.writer.finish() {
            Ok(_) => Ok(()),
            Err((file, _)) => cut(file, whole_bytes),
        }
    }
}

/// Takes away what is half written, and ends what is whole.
fn cut(mut file: File, whole_bytes: u64) -> io::Result<()> {
    file.set_len(whole_bytes)?;
    file.seek(SeekFrom::Start(whole_bytes))?;
    mcap::end(&mut file)
}
