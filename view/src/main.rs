//! `cdcr-view`: serves the messages of a daemon live over a websocket, for viewers that use Foxglove's
//! protocol. Its channels are those of a recording.
//!
//! This is a separate program: its server is larger than the daemon, and moving a robot does not need it. It
//! listens on the loopback interface only and accepts no data from viewers.

#![forbid(unsafe_code)]

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use cdcr_client::channels::{Drawing, Drawings, Drawn, Recorded, Topic};
use cdcr_client::{Connection, Stream, counted, monotonic_ns};
use cdcr_interchange::encode;
use cdcr_interchange::mcap::{Channel, MESSAGE_ENCODING, SCHEMA_ENCODING};
use cdcr_shared_types::{DEFAULT_PREFIX, Location, Telemetry};
use clap::Parser;
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServer,
};
use iceoryx2::prelude::{LogLevel, set_log_level};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Interval at which the services are read: the queue of telemetry holds 256 cycles.
const READ_EVERY: Duration = Duration::from_millis(5);
/// Loopback interface only.
const HOST: &str = "127.0.0.1";

#[allow(
    clippy::doc_markdown,
    reason = "a help text is printed as it is, and has no backticks"
)]
/// Serve live data of cdcrd to Foxglove, Lichtblick and PlotJuggler on the loopback interface.
#[derive(Debug, Parser)]
#[command(
    name = "cdcr-view",
    version,
    max_term_width = 100,
    after_help = "Example:\n  cdcr-view --port 8765     then open the connection ws://127.0.0.1:8765 in the viewer"
)]
struct Arguments {
    /// Prefix of the daemon's shared-memory files
    #[arg(long, env = "CDCR_PREFIX", default_value = DEFAULT_PREFIX)]
    prefix: String,
    /// Root path of the daemon's files [default: /dev/shm/cdcr-UID]
    #[arg(long, env = "CDCR_ROOT", value_name = "DIR")]
    root: Option<PathBuf>,
    /// Name of the robot
    #[arg(long, env = "CDCR_ROBOT", default_value = "cdcr")]
    robot: String,
    /// Port to listen on, on 127.0.0.1; 0: any free port
    #[arg(long, default_value_t = 8765)]
    port: u16,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be closed.
            drop(writeln!(io::stderr(), "error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run() -> anyhow::Result<()> {
    // This program reports the errors itself, so iceoryx2's log is turned off.
    set_log_level(LogLevel::Fatal);
    let arguments = Arguments::parse();
    let is_over = Arc::<AtomicBool>::default();
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&is_over))?;
    }
    let root = arguments.root.unwrap_or_else(Location::default_root);
    let location = Location::new(&arguments.prefix, &root).context("--prefix or --root")?;
    let connection = Connection::open(&location, &arguments.robot)?;
    let mut live = Live::open(&connection, &arguments.robot)?;
    let server = WebSocketServer::new()
        .name(format!("cdcr {}", arguments.robot))
        .bind(HOST, arguments.port)
        .context(&live.context)
        .start_blocking()
        .with_context(|| {
            format!(
                "cannot listen on {HOST}:{}; --port names another one",
                arguments.port
            )
        })?;
    let mut out = io::stdout();
    let port = server.port();
    writeln!(
        out,
        "serving {} at ws://{HOST}:{port}; Ctrl-C to end",
        arguments.robot
    )?;
    out.flush()?;
    while !is_over.load(Ordering::Relaxed) {
        live.pass_on()?;
        thread::sleep(READ_EVERY);
    }
    // Viewers are disconnected at once.
    drop(server.stop());
    let lost = live.lost();
    if lost > 0 {
        let lost = counted(lost, "message");
        writeln!(out, "lost {lost}: this program was too slow")?;
    }
    Ok(())
}

/// Passes the messages of the services to the channels of the server.
struct Live {
    context: Arc<Context>,
    telemetry: Stream<Telemetry>,
    others: Vec<Box<dyn Passed>>,
    records: Arc<RawChannel>,
    drawn: Vec<Arc<RawChannel>>,
    drawings: Drawings,
    offset_ns: u64,
}

impl Live {
    fn open(connection: &Connection, robot: &str) -> anyhow::Result<Self> {
        let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos() as u64;
        let offset_ns = unix_ns.saturating_sub(monotonic_ns());
        let context = Context::new();
        let channel = |topic: Topic| -> anyhow::Result<Arc<RawChannel>> {
            Ok(advertise(&context, topic.channel(robot)?)?)
        };
        let drawn = Drawn::ALL
            .iter()
            .map(|drawn| advertise(&context, drawn.channel(robot)))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            telemetry: connection.telemetry()?,
            others: vec![
                Box::new((connection.references()?, channel(Topic::Reference)?)),
                Box::new((connection.obstacle_updates()?, channel(Topic::Obstacles)?)),
                Box::new((connection.statuses()?, channel(Topic::Status)?)),
                Box::new((connection.incidents()?, channel(Topic::Incidents)?)),
            ],
            records: channel(Topic::Telemetry)?,
            drawn,
            drawings: Drawings::new(robot, offset_ns),
            offset_ns,
            context,
        })
    }

    /// Number of messages lost before they reached the server.
    fn lost(&self) -> u64 {
        let others = self.others.iter().map(|other| other.lost());
        self.telemetry.lost() + others.sum::<u64>()
    }

    /// Passes on all queued messages.
    fn pass_on(&mut self) -> anyhow::Result<()> {
        for other in &mut self.others {
            other.pass_on(self.offset_ns)?;
        }
        while let Some(record) = self.telemetry.try_next()? {
            log(&self.records, &record, self.offset_ns)?;
            let at = stamp(record.header.sent_ns + self.offset_ns);
            for Drawing { channel, data } in self.drawings.encode(&record)? {
                self.drawn[channel as usize].log_with_meta(&data, at);
            }
        }
        Ok(())
    }
}

/// A service whose messages are passed on unchanged.
trait Passed {
    fn pass_on(&mut self, offset_ns: u64) -> anyhow::Result<()>;
    fn lost(&self) -> u64;
}

impl<T: Recorded> Passed for (Stream<T>, Arc<RawChannel>) {
    fn pass_on(&mut self, offset_ns: u64) -> anyhow::Result<()> {
        let (stream, channel) = self;
        while let Some(message) = stream.try_next()? {
            log(channel, &message, offset_ns)?;
        }
        Ok(())
    }

    fn lost(&self) -> u64 {
        self.0.lost()
    }
}

/// Encodes and logs a message, if the channel has subscribers.
fn log<T: Recorded>(channel: &RawChannel, message: &T, offset_ns: u64) -> anyhow::Result<()> {
    if channel.has_sinks() {
        let at = stamp(message.header().sent_ns + offset_ns);
        channel.log_with_meta(&encode(message)?, at);
    }
    Ok(())
}

fn stamp(unix_ns: u64) -> PartialMetadata {
    PartialMetadata {
        log_time: Some(unix_ns),
    }
}

fn advertise(context: &Arc<Context>, channel: Channel) -> Result<Arc<RawChannel>, FoxgloveError> {
    let Channel {
        topic,
        schema,
        text,
        metadata,
    } = channel;
    ChannelBuilder::new(topic)
        .message_encoding(MESSAGE_ENCODING)
        .schema(Schema::new(schema, SCHEMA_ENCODING, text.into_bytes()))
        .metadata(metadata)
        .context(context)
        .build_raw()
}
