//! Feeds the references and obstacles of a recording to a running daemon.

mod ids;
mod pieces;
mod source;

use std::io::{self, Write};
use std::thread;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use cdcr_client::{
    Connection, Lease, ObstacleSender, ReferenceFeed, Stream, TelemetryStream, counted, events,
    monotonic_ns,
};
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, ObstacleAction, Outcome, RequestKind,
};
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{ObstacleUpdate, ReferenceChunk, Telemetry};

use super::file::Recording;
use super::topic::Topic;
use crate::args::{ReplayOptions, Target};
use crate::bar::Bar;
use crate::done::Done;
use crate::dry_run::newest;
use crate::feed::check_mode;
use crate::interrupt::Interrupt;
use crate::known_obstacles::known;
use crate::tip_error::TipError;
use ids::{Ids, listed};
use source::{READ_AHEAD_NS, RecordedSteps, Step};

/// Time by which references are sent early: the tolerated lateness of this program \[ns\].
const LEAD_NS: u64 = 300_000_000;
const TURN: Duration = Duration::from_millis(2);
/// Timeout for a status or a record.
const TIMEOUT: Duration = Duration::from_secs(1);

pub(crate) fn run(target: &Target, options: &ReplayOptions) -> anyhow::Result<Done> {
    let name = options.file.display().to_string();
    let connection = target.connect()?;
    let mut source = RecordedSteps::new(Recording::open(&options.file)?.unseen());
    source.read_to(READ_AHEAD_NS)?;
    let status = connection.status(TIMEOUT)?;
    let fingerprint = source.robot_fingerprint();
    let fingerprint = fingerprint.with_context(|| format!("{name} contains no cycle"))?;
    ensure!(
        fingerprint == status.robot.fingerprint,
        "{name} is of another robot than the daemon: sections or limits differ"
    );
    check_mode(&status)?;
    let recorded = RecordedSteps::new(Recording::open(&options.file)?).obstacle_ids()?;
    let others = connection.obstacle_updates()?;
    let ids = Ids::new(recorded, &known(&connection, TIMEOUT)?);
    let in_use = ids.in_use();
    ensure!(
        in_use.is_empty() || options.keep_live,
        "{name} contains obstacles whose ids are in use: {}. Nothing was sent.\nRemove those that the daemon knows (cdcrctl obstacle remove {}), or keep them and \
         leave out those of the recording: --keep-live",
        listed(&in_use, ", "),
        listed(&in_use, " ")
    );
    if !in_use.is_empty() {
        let in_use = listed(&in_use, ", ");
        tell!(
            "note: obstacles of the recording are left out, because their ids are in use: {in_use}"
        );
    }
    let tip_m = newest(&connection)?.tip_position_m;
    let note = pieces::Pieces::read(&options.file, tip_m)?.note(&name, options.speed)?;
    if let Some(note) = note {
        tell!("{note}");
    }
    let interrupt = Interrupt::catch()?;
    let mut player = Player::new(&connection, options.speed, ids, others)?;
    let played = player.play(&mut source, &name, &interrupt);
    // Independent of the result; the first error is the relevant one.
    let held = connection.request(RequestKind::Hold);
    let removed = player.take_obstacles_away();
    let done = played?;
    held?;
    removed?;
    let Player {
        chunks, updates, ..
    } = player;
    ensure!(
        chunks + updates > 0 || done == Done::Interrupted || !in_use.is_empty(),
        "{name} contains no obstacles and no complete reference"
    );
    let speed = match options.speed {
        1.0 => String::new(),
        speed => format!("{speed} times "),
    };
    writeln!(
        io::stdout(),
        "{name}: {} and {} sent, {speed}as fast as recorded; the daemon holds",
        counted(chunks, Topic::Reference.noun()),
        counted(updates, Topic::Obstacles.noun())
    )?;
    source.recording.warn_of_cut();
    if done == Done::Good {
        player.error.show()?;
    }
    Ok(done)
}

struct Player<'c> {
    connection: &'c Connection,
    telemetry: TelemetryStream,
    lease: Lease<'c>,
    feed: ReferenceFeed,
    obstacles: ObstacleSender,
    renewed_ns: u64,
    /// Start of the playback \[ns\].
    begin_ns: u64,
    speed: f64,
    /// Sequence number of the newest chunk that begins a reference, until it is accepted.
    beginning: Option<u64>,
    has_reference: bool,
    /// Whether the recorded daemon tracks.
    wants_tracking: bool,
    ids: Ids,
    /// Obstacle updates of all clients.
    others: Stream<ObstacleUpdate>,
    chunks: u64,
    updates: u64,
    heard_ns: u64,
    error: TipError,
}

impl<'c> Player<'c> {
    fn new(
        connection: &'c Connection,
        speed: f64,
        ids: Ids,
        others: Stream<ObstacleUpdate>,
    ) -> anyhow::Result<Self> {
        let telemetry = connection.telemetry()?;
        let lease = connection.acquire_lease()?;
        let now_ns = monotonic_ns();
        Ok(Self {
            connection,
            telemetry,
            lease,
            feed: connection.reference_feed()?,
            obstacles: connection.obstacle_sender()?,
            renewed_ns: now_ns,
            begin_ns: now_ns + LEAD_NS,
            speed,
            beginning: None,
            has_reference: false,
            wants_tracking: false,
            ids,
            others,
            chunks: 0,
            updates: 0,
            heard_ns: now_ns,
            error: TipError::since(now_ns),
        })
    }

    fn play(
        &mut self,
        source: &mut RecordedSteps,
        name: &str,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Done> {
        let bar = Bar::new(name);
        loop {
            if interrupt.is_raised() {
                return Ok(Done::Interrupted);
            }
            let played_ns = self.recorded_ns(monotonic_ns());
            let lead_ns = (LEAD_NS as f64 * self.speed) as u64;
            source.read_to(played_ns + lead_ns + READ_AHEAD_NS)?;
            while let Some(step) = source.due(played_ns, lead_ns) {
                self.take(step)?;
            }
            self.read_messages()?;
            self.renew()?;
            if source.is_over(played_ns) {
                return Ok(Done::Good);
            }
            bar.show_time(played_ns as f64 * 1e-9);
            thread::sleep(TURN);
        }
    }

    /// Recorded time since the start, at this time \[ns\].
    fn recorded_ns(&self, now_ns: u64) -> u64 {
        (now_ns.saturating_sub(self.begin_ns) as f64 * self.speed) as u64
    }

    /// Time of playback for a recorded time since the start \[ns\].
    fn live_ns(&self, since_ns: i64) -> u64 {
        let since_ns = (since_ns as f64 / self.speed) as i64;
        self.begin_ns.saturating_add_signed(since_ns)
    }

    fn take(&mut self, step: Step) -> anyhow::Result<()> {
        match step {
            Step::Chunk(chunk, first_ns) => self.send_chunk(&chunk, first_ns),
            Step::Obstacles(update, first_ns) => self.send_obstacles(&update, first_ns),
            Step::Track => {
                self.wants_tracking = true;
                self.track()
            }
            Step::Hold => {
                self.wants_tracking = false;
                self.connection.request(RequestKind::Hold)?;
                Ok(())
            }
        }
    }

    fn send_chunk(&mut self, chunk: &ReferenceChunk, first_ns: u64) -> anyhow::Result<()> {
        let mode = ChunkMode::try_from(chunk.mode).unwrap_or_default();
        // The rest of a reference that began before the recording.
        if mode == ChunkMode::Append && self.chunks == 0 {
            return Ok(());
        }
        let used = chunk.points.get(..chunk.count as usize).unwrap_or_default();
        let points: Vec<_> = used
            .iter()
            .map(|point| {
                let mut point = *point;
                point.time_ns = self.live_ns(point.time_ns.wrapping_sub(first_ns).cast_signed());
                point
            })
            .collect();
        let interpolation = Interpolation::try_from(chunk.interpolation).unwrap_or_default();
        let header = self.feed.send(mode, interpolation, &points)?;
        if mode == ChunkMode::Replace {
            self.beginning = Some(header.sequence);
        }
        self.chunks += 1;
        Ok(())
    }

    fn send_obstacles(&mut self, update: &ObstacleUpdate, first_ns: u64) -> anyhow::Result<()> {
        let used = update.obstacles.get(..update.count as usize);
        let mut solids = used.unwrap_or_default().to_vec();
        let now_ns = monotonic_ns();
        for solid in &mut solids {
            let since_ns = solid.measured_ns.wrapping_sub(first_ns).cast_signed();
            solid.measured_ns = self.live_ns(since_ns).min(now_ns);
            solid.lifetime_ns = (solid.lifetime_ns as f64 / self.speed).ceil() as u64;
            solid.velocity_m_s = solid.velocity_m_s.map(|m_s| m_s * self.speed);
        }
        self.see_others()?;
        let ids = match ObstacleAction::try_from(update.action).unwrap_or_default() {
            ObstacleAction::Upsert => {
                self.ids.add(&mut solids);
                // Without obstacles it is a sign of life.
                self.obstacles.upsert_anywhere(&solids)?;
                self.updates += 1;
                return Ok(());
            }
            ObstacleAction::Remove => self.ids.remove(solids.iter().map(|solid| solid.id)),
            ObstacleAction::Clear => self.ids.take_all(),
        };
        for ids in ids.chunks(OBSTACLES_MAX) {
            self.obstacles.remove(ids)?;
            self.updates += 1;
        }
        Ok(())
    }

    /// Registers the obstacles that other clients have sent meanwhile.
    fn see_others(&mut self) -> anyhow::Result<()> {
        while let Some(update) = self.others.try_next()? {
            if update.header.sender_id == self.connection.sender_id() {
                continue;
            }
            let taken = self.ids.see(&update);
            if !taken.is_empty() {
                let taken = listed(&taken, ", ");
                tell!(
                    "note: another client has sent these obstacles; those of the recording are left out from now on: {taken}"
                );
            }
        }
        Ok(())
    }

    /// Removes the obstacles that were sent and are still those of this replay.
    fn take_obstacles_away(&mut self) -> anyhow::Result<()> {
        if self.updates == 0 {
            return Ok(());
        }
        self.see_others()?;
        let ids = self.ids.take_all();
        // Removing none ends the daemon's watch over this client, too.
        let none = ids.is_empty().then_some(&[][..]);
        for ids in ids.chunks(OBSTACLES_MAX).chain(none) {
            let header = self.obstacles.remove(ids)?;
            self.telemetry
                .outcome_on(EventKind::Obstacles, &header, TIMEOUT)?;
        }
        Ok(())
    }

    /// Requests tracking if the recorded daemon tracks and the reference was accepted.
    fn track(&mut self) -> anyhow::Result<()> {
        if self.wants_tracking && self.has_reference {
            self.connection.request(RequestKind::Track)?;
            self.wants_tracking = false;
        }
        Ok(())
    }

    fn read_messages(&mut self) -> anyhow::Result<()> {
        self.see_others()?;
        while let Some(record) = self.telemetry.try_next()? {
            self.heard_ns = monotonic_ns();
            self.error.take(&record);
            self.check_outcomes(&record)?;
        }
        let silent_ns = monotonic_ns().saturating_sub(self.heard_ns);
        if silent_ns > TIMEOUT.as_nanos() as u64 {
            // This fails when the daemon is gone.
            self.connection.status(TIMEOUT)?;
        }
        self.track()
    }

    /// Checks the outcomes of the sent messages.
    fn check_outcomes(&mut self, record: &Telemetry) -> anyhow::Result<()> {
        let sender_id = self.connection.sender_id();
        for event in events(record) {
            let is_reference = event.kind == EventKind::Reference.code();
            let is_ours = event.sender_id == sender_id
                && (is_reference || event.kind == EventKind::Obstacles.code());
            if !is_ours {
                continue;
            }
            if event.outcome != Outcome::Accepted.code() {
                bail!(
                    "the daemon rejected {}: {}",
                    EventKind::text_of(event.kind),
                    Outcome::text_of(event.outcome)
                );
            }
            let is_begun = |sequence: &mut u64| *sequence <= event.sequence;
            if is_reference && self.beginning.take_if(is_begun).is_some() {
                self.has_reference = true;
            }
        }
        Ok(())
    }

    fn renew(&mut self) -> anyhow::Result<()> {
        let now_ns = monotonic_ns();
        let every_ns = self.lease.left().as_nanos() as u64 / 5;
        if now_ns - self.renewed_ns > every_ns {
            self.lease.renew()?;
            self.renewed_ns = now_ns;
        }
        Ok(())
    }
}
