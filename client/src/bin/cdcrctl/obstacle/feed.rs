//! Obstacles from a scene file or from lines on the standard input.

use std::io::{BufRead, Read as _, Write};
use std::path::Path;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use cdcr_client::{
    Connection, LinkError, Liveness, ObstacleSender, TelemetryStream, counted, event_about,
    monotonic_ns,
};
use cdcr_shared_types::codes::EventKind;
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Header, Obstacle, Service};

use super::removals::Removals;
use super::scene::{self, SceneAction, SceneChange};
use super::{TIMEOUT, accepted, check};
use crate::done::Done;
use crate::files::read_text;
use crate::interrupt::{INTERRUPT_INTERVAL, Interrupt};

/// Maximum number of queued lines: a faster writer waits.
const WAITING: usize = 1024;

/// Maximum length of a line \[bytes\]: a device has no end.
const LINE_MAX: u64 = 65_536;

/// A line of the standard input: a change with its arrival time, or an error.
type SceneLine = Result<SceneChange, String>;

/// Sends changes and counts them.
struct Feed {
    sender: ObstacleSender,
    telemetry: TelemetryStream,
    changes: usize,
    /// Obstacles that the daemon knew after the last change.
    known: Option<u32>,
    removals: Removals,
}

/// `cdcrctl obstacle file PATH`: sends each change at its time. The whole file is checked first.
pub(super) fn file(connection: &Connection, path: &Path, far: bool) -> anyhow::Result<Done> {
    let name = path.display();
    let text = read_text(path)?;
    let changes = scene::parse(&text).map_err(|cause| anyhow!("{name}: {cause}"))?;
    if changes.is_empty() {
        bail!("{name} contains no obstacle");
    }
    scene::check_count(&changes).map_err(|cause| anyhow!("{name}: {cause}"))?;
    let status = connection.status(TIMEOUT)?;
    for change in &changes {
        if let SceneAction::Upsert(obstacle) = &change.action {
            check(obstacle, &status, far, true)
                .with_context(|| format!("{name}: line {}", change.number))?;
        }
    }
    let interrupt = Interrupt::catch()?;
    let mut feed = Feed::new(connection)?;
    let begin = Instant::now();
    for together in changes.chunk_by(|one, next| one.time_s == next.time_s) {
        let due = Duration::from_secs_f64(together[0].time_s);
        while let Some(left) = due.checked_sub(begin.elapsed()).filter(|d| !d.is_zero()) {
            if interrupt.is_raised() {
                return feed.end(Done::Interrupted);
            }
            sleep(left.min(INTERRUPT_INTERVAL));
        }
        // Positions in the scene hold at the time when it is played.
        let mut now = together.to_vec();
        for change in &mut now {
            change.stamp(monotonic_ns());
        }
        feed.send(&now).with_context(|| name.to_string())?;
    }
    feed.end(Done::Good)
}

/// `cdcrctl obstacle stdin`: sends each line as it arrives, waiting lines together.
pub(super) fn stdin(connection: &Connection, far: bool) -> anyhow::Result<Done> {
    let status = connection.status(TIMEOUT)?;
    let interrupt = Interrupt::catch()?;
    let mut feed = Feed::new(connection)?;
    let lines = read_lines();
    loop {
        if interrupt.is_raised() {
            return feed.end(Done::Interrupted);
        }
        let first = match lines.recv_timeout(INTERRUPT_INTERVAL) {
            Ok(first) => first,
            Err(RecvTimeoutError::Disconnected) => return feed.end(Done::Good),
            Err(RecvTimeoutError::Timeout) => {
                feed.check_daemon(connection)?;
                continue;
            }
        };
        let waiting = lines.try_iter().take(OBSTACLES_MAX - 1);
        let mut together = Vec::new();
        let mut bad = None;
        for read in std::iter::once(first).chain(waiting) {
            let checked = read.and_then(|change| match &change.action {
                SceneAction::Upsert(obstacle) => check(obstacle, &status, far, false)
                    .map(|()| change.clone())
                    .map_err(|cause| format!("line {}: {cause:#}", change.number)),
                SceneAction::Remove(_) => Ok(change),
            });
            match checked {
                Ok(change) => together.push(change),
                Err(cause) => {
                    bad = Some(cause);
                    break;
                }
            }
        }
        feed.send(&together).context("standard input")?;
        if let Some(cause) = bad {
            bail!("standard input: {cause}\n{}", in_effect(feed.changes));
        }
    }
}

/// The error of an update that the daemon did not accept, after `before` changes. It takes or refuses an update as a whole.
fn refused(sent: &[SceneChange], cause: &anyhow::Error, before: usize) -> anyhow::Error {
    let lines = match sent {
        [one] => format!("line {}", one.number),
        [first, .., last] => format!(
            "lines {} to {}, sent as one update",
            first.number, last.number
        ),
        [] => "no line".to_owned(),
    };
    anyhow!("{lines}: {cause:#}\n{}", in_effect(before))
}

/// What a feed that ends with an error leaves to the daemon.
fn in_effect(changes: usize) -> String {
    format!(
        "earlier lines remain in effect: {}",
        counted(changes, "change")
    )
}

/// Reads lines in a thread, so that an interrupt or the end of the daemon is noticed meanwhile.
fn read_lines() -> Receiver<SceneLine> {
    let (send, receive) = mpsc::sync_channel(WAITING);
    thread::spawn(move || {
        let mut input = std::io::stdin().lock();
        for number in 1.. {
            let mut line = String::new();
            let line = match input.by_ref().take(LINE_MAX).read_line(&mut line) {
                Ok(0) => break,
                Ok(_) if line.len() as u64 == LINE_MAX && !line.ends_with('\n') => {
                    Err(format!("line {number}: it is longer than {LINE_MAX} bytes"))
                }
                Ok(_) => Ok(line),
                Err(cause) => Err(format!("line {number}: {cause}")),
            };
            let read = match line.and_then(|line| scene::parse_line(number, &line)) {
                Ok(None) => continue,
                Ok(Some(mut change)) => {
                    change.stamp_where_none(monotonic_ns());
                    Ok(change)
                }
                Err(cause) => Err(cause),
            };
            if send.send(read).is_err() {
                break;
            }
        }
    });
    receive
}

impl Feed {
    fn new(connection: &Connection) -> anyhow::Result<Self> {
        let mut feed = Self {
            telemetry: connection.telemetry()?,
            sender: connection.obstacle_sender()?,
            changes: 0,
            known: None,
            removals: Removals::default(),
        };
        // What the daemon knows before the first change.
        if let Some(record) = feed.telemetry.next_within(TIMEOUT)? {
            feed.removals.see(&record);
        }
        Ok(feed)
    }

    /// Sends the changes in order, in as few messages as possible.
    fn send(&mut self, changes: &[SceneChange]) -> anyhow::Result<()> {
        let is_same = |one: &SceneChange, next: &SceneChange| {
            matches!(
                (&one.action, &next.action),
                (SceneAction::Upsert(_), SceneAction::Upsert(_))
            )
        };
        for group in changes.chunk_by(is_same) {
            if let SceneAction::Remove(ids) = &group[0].action {
                let header = self.sender.remove(ids)?;
                self.note(&header, group)?;
                continue;
            }
            for some in group.chunks(OBSTACLES_MAX) {
                let obstacle = |change: &SceneChange| match &change.action {
                    SceneAction::Upsert(obstacle) => Some(*obstacle),
                    SceneAction::Remove(_) => None,
                };
                let obstacles: Vec<Obstacle> = some.iter().filter_map(obstacle).collect();
                let header = self.sender.upsert_anywhere(&obstacles)?;
                self.note(&header, some)?;
                self.removals.sent(&obstacles);
            }
        }
        Ok(())
    }

    fn note(&mut self, header: &Header, sent: &[SceneChange]) -> anyhow::Result<()> {
        let known = self.decided(header, &sent[0].action);
        self.known = Some(known.map_err(|cause| refused(sent, &cause, self.changes))?);
        self.changes += sent.len();
        Ok(())
    }

    /// Number of known obstacles after this message, which began with `action`, was accepted.
    fn decided(&mut self, header: &Header, action: &SceneAction) -> anyhow::Result<u32> {
        let until = Instant::now() + TIMEOUT;
        let left = || until.saturating_duration_since(Instant::now());
        while let Some(record) = self.telemetry.next_within(left())? {
            let event = event_about(&record, EventKind::Obstacles, header);
            let known = event.map(|event| accepted(&event)).transpose()?;
            // By the records before.
            if let (Some(_), SceneAction::Remove(ids)) = (known, action) {
                self.removals.removed(ids);
            }
            self.removals.see(&record);
            if let Some(known) = known {
                return Ok(known);
            }
        }
        let silent = LinkError::Silent {
            service: Service::Telemetry.key(),
            waited: TIMEOUT,
            liveness: Liveness::Unknown,
        };
        Err(silent.into())
    }

    /// Fails when no cycle has run for a while and the daemon is gone.
    fn check_daemon(&mut self, connection: &Connection) -> anyhow::Result<()> {
        match self.telemetry.next_within(INTERRUPT_INTERVAL)? {
            Some(record) => self.removals.see(&record),
            None => {
                connection.status(TIMEOUT)?;
            }
        }
        Ok(())
    }

    fn end(&self, done: Done) -> anyhow::Result<Done> {
        let changes = counted(self.changes, "change");
        let known = (self.known).map(|known| format!(", {known} known to the daemon now"));
        writeln!(
            std::io::stdout(),
            "obstacles: {changes} accepted{}",
            known.unwrap_or_default()
        )?;
        if let Some(unknown) = self.removals.text() {
            writeln!(std::io::stdout(), "nothing to remove: {unknown}")?;
        }
        Ok(done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lines_of_a_refused_update_are_named_and_what_remains() {
        let line = |number| SceneChange {
            number,
            time_s: 0.0,
            action: SceneAction::Remove(vec![]),
        };
        let lines: Vec<_> = (2..=65).map(line).collect();
        let error = |sent: &[SceneChange]| refused(sent, &anyhow!("it is full"), 1).to_string();
        let of_all = "lines 2 to 65, sent as one update: it is full\nearlier lines remain in effect: 1 change";
        assert_eq!(error(&lines), of_all);
        let of_one = "line 2: it is full\nearlier lines remain in effect: 1 change";
        assert_eq!(error(&lines[..1]), of_one);
    }
}
