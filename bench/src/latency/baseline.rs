//! Latency of iceoryx2 alone between two processes on two cores: a thread that sends and polls, and a peer
//! that polls and answers.
//!
//! The peer is this program with a hidden command. Neither side sleeps while it waits, and neither has a
//! real-time priority: the kernel throttles a real-time thread that never sleeps.

use std::fs;
use std::path::{Path, PathBuf};
use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use cdcr_client::monotonic_ns;
use cdcr_process::{PREFIX, Place, Process, ROOT, program};
use cdcr_shared_types::{Command, Header, Location, Request, Response, ipc};
use iceoryx2::port::client::Client;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::service::port_factory::{PortFactory as _, publish_subscribe, request_response};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use signal_hook::consts::SIGTERM;

use super::leg::Leg;
use super::round::Round;
use crate::interrupt;
use crate::subject::TIMEOUT;
use crate::system::cores::Cores;
use crate::system::thread::pin;
use crate::watcher::on_client_core;

const WARM_UP: usize = 200;
const GAP_NS: u64 = 200_000;

pub const PEER: &str = "peer";

pub(super) fn expected_s(samples: usize) -> f64 {
    0.5 + 2.0 * (WARM_UP + samples) as f64 * GAP_NS as f64 * 1e-9
}

pub(super) fn measure(cores: &Cores, samples: usize, round: &mut Round) -> Result<()> {
    // Dropped last.
    let place = Place::new()?;
    let _peer = start_peer(&place, cores)?;
    on_client_core(cores, false, || {
        let near = Near::open(place.location(), cores.is_alone());
        let near = near.context("a port of the bench")?;
        near.repeat(samples, round, |sequence| near.play(sequence))?;
        near.repeat(samples, round, |sequence| near.ask(sequence))
    })
}

/// Starts the peer. Call it from a thread that outlives the peer.
fn start_peer(place: &Place, cores: &Cores) -> Result<Process> {
    let mut command = process::Command::new(program("cdcr-bench")?);
    command
        .arg(PEER)
        .args(["--prefix", place.location().prefix(), "--root"])
        .arg(place.location().root())
        .args(["--parent", &process::id().to_string()])
        .args(["--core", &cores.realtime.to_string()]);
    if cores.is_alone() {
        command.arg("--shares");
    }
    cores.with_all(|| Process::start("the peer of the bare measurement", command))
}

#[derive(Debug, clap::Args)]
pub struct PeerOptions {
    /// Prefix of the files in shared memory.
    #[arg(long)]
    prefix: String,
    /// Root folder of iceoryx2.
    #[arg(long)]
    root: PathBuf,
    /// The process that started it.
    #[arg(long)]
    parent: u32,
    #[arg(long)]
    core: usize,
    /// Both processes are on one core: let the other one run.
    #[arg(long)]
    shares: bool,
}

/// The peer: answers until SIGTERM or the end of its parent. Call it from the main thread.
pub fn peer(options: &PeerOptions) -> Result<()> {
    // SIGTERM may come twice, from the parent and from the kernel when the parent has ended. The handler is
    // installed before the kernel's signal is requested.
    let ends = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGTERM, Arc::clone(&ends)).context("signals")?;
    set_parent_process_death_signal(Some(Signal::TERM)).context("to end with the parent")?;
    let is_orphan = || getppid().is_none_or(|id| id.as_raw_pid().unsigned_abs() != options.parent);
    ensure!(!is_orphan(), "the parent has ended");
    pin(options.core);
    let answered = answer(options, &ends);
    // The parent can no longer clean up. Only a root folder of a [`Place`] is removed.
    if is_orphan() && is_root_of_place(&options.root) {
        let _ = fs::remove_dir_all(&options.root);
    }
    answered
}

fn is_root_of_place(root: &Path) -> bool {
    let name = root.file_name().unwrap_or_default().to_string_lossy();
    root.parent() == Some(Path::new(Location::MEMORY))
        && name.starts_with(PREFIX)
        && name.ends_with(ROOT)
}

fn answer(options: &PeerOptions, ends: &AtomicBool) -> Result<()> {
    let location = Location::new(&options.prefix, &options.root)?;
    let services = Services::open(&location).context("a service of the peer")?;
    let there = services.there.subscriber_builder().create()?;
    let back = services.back.publisher_builder().create()?;
    let control = services.control.server_builder().create()?;
    // Checked in each iteration: on a shared, crowded core, every other thread may run in between.
    while !ends.load(Ordering::Relaxed) {
        if let Some(sample) = there.receive().context("the peer cannot hear")? {
            let mut message = *sample.payload();
            message.header.sent_ns = monotonic_ns();
            back.send_copy(message).context("the peer cannot answer")?;
        }
        if let Some(asked) = control.receive().context("the peer cannot hear")? {
            let response = Response {
                request_sequence: asked.payload().header.sequence,
                ..Response::default()
            };
            asked
                .send_copy(response)
                .context("the peer cannot answer")?;
        }
        if options.shares {
            thread::yield_now();
        }
    }
    Ok(())
}

struct Services {
    there: publish_subscribe::PortFactory<ipc::Service, Command, ()>,
    back: publish_subscribe::PortFactory<ipc::Service, Command, ()>,
    control: request_response::PortFactory<ipc::Service, Request, (), Response, ()>,
}

impl Services {
    fn open(location: &Location) -> Result<Self> {
        let node = location.node_builder()?.create::<ipc::Service>()?;
        let topic = |name: &str| -> Result<_> {
            let service = node.service_builder(&name.try_into()?);
            let topic = service.publish_subscribe::<Command>();
            Ok(topic.enable_safe_overflow(true).open_or_create()?)
        };
        let control = node.service_builder(&"bare/control".try_into()?);
        let control = control.request_response::<Request, Response>();
        Ok(Self {
            there: topic("bare/there")?,
            back: topic("bare/back")?,
            control: control.open_or_create()?,
        })
    }
}

struct Near {
    there: Publisher<ipc::Service, Command, ()>,
    back: Subscriber<ipc::Service, Command, ()>,
    control: Client<ipc::Service, Request, (), Response, ()>,
    shares: bool,
}

impl Near {
    /// Opens the ports and waits for those of the peer, because earlier messages would be lost.
    fn open(location: &Location, shares: bool) -> Result<Self> {
        let services = Services::open(location)?;
        let near = Self {
            there: services.there.publisher_builder().create()?,
            back: services.back.subscriber_builder().create()?,
            control: services.control.client_builder().create()?,
            shares,
        };
        let (there, control) = (
            services.there.dynamic_config(),
            services.control.dynamic_config(),
        );
        let deadline = Instant::now() + TIMEOUT;
        while there.number_of_subscribers() == 0 || control.number_of_servers() == 0 {
            interrupt::check()?;
            let in_time = Instant::now() < deadline;
            ensure!(
                in_time,
                "the peer of the bare measurement did not start within {TIMEOUT:?}"
            );
            thread::sleep(Duration::from_millis(2));
        }
        Ok(near)
    }

    /// Polls without a pause until `look` returns a value.
    fn wait_for<T>(&self, mut look: impl FnMut() -> Result<Option<T>>) -> Result<(T, u64)> {
        let begin = Instant::now();
        while begin.elapsed() < TIMEOUT {
            if let Some(found) = look()? {
                return Ok((found, monotonic_ns()));
            }
            self.pause()?;
        }
        bail!("the peer of the bare measurement is silent for {TIMEOUT:?}")
    }

    fn pause(&self) -> Result<()> {
        if self.shares {
            thread::yield_now();
        }
        interrupt::check()
    }

    /// Repeats `once` with a pause in between, and records the iterations after the warm-up.
    fn repeat<const N: usize>(
        &self,
        samples: usize,
        round: &mut Round,
        once: impl Fn(u64) -> Result<(u64, [(Leg, u64); N])>,
    ) -> Result<()> {
        for index in 0..WARM_UP + samples {
            let (received_ns, times) = once(index as u64 + 1)?;
            for (leg, since_ns) in times.into_iter().filter(|_| index >= WARM_UP) {
                round.record(leg, received_ns - since_ns);
            }
            // Without a sleep, like a thread that is awake when a message comes.
            while monotonic_ns() < received_ns + GAP_NS {
                self.pause()?;
            }
        }
        Ok(())
    }

    fn play(&self, sequence: u64) -> Result<(u64, [(Leg, u64); 2])> {
        let header = header(sequence);
        let message = Command {
            header,
            ..Command::default()
        };
        let sent = self.there.send_copy(message);
        sent.context("cannot send to the peer")?;
        let (back, received_ns) = self.wait_for(|| {
            let sample = self.back.receive().context("cannot hear the peer")?;
            let back = sample.map(|sample| sample.header);
            Ok(back.filter(|back| back.sequence == sequence))
        })?;
        let round_trip = (Leg::BareRoundTrip, header.sent_ns);
        Ok((received_ns, [round_trip, (Leg::BareOneWay, back.sent_ns)]))
    }

    fn ask(&self, sequence: u64) -> Result<(u64, [(Leg, u64); 1])> {
        let header = header(sequence);
        let request = Request {
            header,
            ..Request::default()
        };
        let pending = self.control.send_copy(request);
        let pending = pending.context("cannot ask the peer")?;
        let (_, received_ns) =
            self.wait_for(|| pending.receive().context("no answer of the peer"))?;
        Ok((received_ns, [(Leg::BareRequest, header.sent_ns)]))
    }
}

fn header(sequence: u64) -> Header {
    Header {
        sender_id: 1,
        sequence,
        sent_ns: monotonic_ns(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_root_of_a_place_is_removed() {
        let place = Place::new().expect("a place");
        assert!(is_root_of_place(place.location().root()));
        for root in [
            "/",
            "/dev/shm",
            "/dev/shm/root",
            "/dev/shm/cdcrbed_1_0_root/..",
            "/dev/shm/cdcrbed_1_0_lock",
            "/tmp/cdcrbed_1_0_root",
        ] {
            assert!(!is_root_of_place(Path::new(root)), "{root}");
        }
    }
}
