//! Latency of iceoryx2 alone between two threads on two cores: one sends and polls, the other polls and answers.
//! Each has a node of its own, as two processes have.
//!
//! Neither side sleeps while it waits, and neither has a real-time priority: the kernel throttles a real-time
//! thread that never sleeps.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, ensure};
use cdcr_client::monotonic_ns;
use cdcr_process::PrivatePlace;
use cdcr_shared_types::{Command, Header, Location, Request, Response, ipc};
use iceoryx2::service::port_factory::{publish_subscribe, request_response};

use super::TIMEOUT;
use crate::interrupt;
use crate::system::cores::Cores;
use crate::system::thread::pin;

const WARM_UP: usize = 200;
const GAP_NS: u64 = 200_000;

/// Approximate duration of [`measure`] \[s\].
pub fn expected_s(samples: usize) -> f64 {
    0.5 + 2.0 * (WARM_UP + samples) as f64 * GAP_NS as f64 * 1e-9
}

/// Passes every latency \[ns\] to `record`, with its leg: `one_way` and `round_trip` of a message, and `request`.
pub fn measure(
    cores: &Cores,
    samples: usize,
    mut record: impl FnMut(&'static str, u64) + Send,
) -> Result<()> {
    let place = PrivatePlace::new()?;
    let (location, shares) = (place.location(), cores.is_alone());
    let (ends, (opened, is_open)) = (AtomicBool::new(false), channel());
    let ends = &ends;
    thread::scope(|scope| {
        let answering = scope.spawn(move || {
            pin(cores.realtime);
            answer(location, shares, &opened, ends)
        });
        // An error of the other thread drops its end of the channel.
        let measured = match is_open.recv_timeout(TIMEOUT) {
            Ok(()) => cores.on_client(false, || ask(location, shares, samples, &mut record)),
            Err(_) => Err(anyhow!("the answering thread opened no port")),
        };
        ends.store(true, Ordering::Relaxed);
        let answered = answering.join();
        answered.map_err(|_| anyhow!("the answering thread panicked"))??;
        measured
    })
    .context("iceoryx2 alone")
}

/// On a shared core, lets the other thread run.
fn pause(shares: bool) {
    if shares {
        thread::yield_now();
    }
}

fn answer(location: &Location, shares: bool, opened: &Sender<()>, ends: &AtomicBool) -> Result<()> {
    let services = Services::open(location)?;
    let there = services.there.subscriber_builder().create()?;
    let back = services.back.publisher_builder().create()?;
    let control = services.control.server_builder().create()?;
    opened.send(())?;
    while !ends.load(Ordering::Relaxed) {
        if let Some(sample) = there.receive()? {
            let mut message = *sample.payload();
            message.header.sent_ns = monotonic_ns();
            back.send_copy(message)?;
        }
        if let Some(asked) = control.receive()? {
            asked.send_copy(Response::default())?;
        }
        pause(shares);
    }
    Ok(())
}

/// Sends a message and returns the legs of its way, each with begin and end \[ns\].
type Once<'a> = &'a dyn Fn(Header) -> Result<Vec<(&'static str, u64, u64)>>;

fn ask(
    location: &Location,
    shares: bool,
    samples: usize,
    record: &mut impl FnMut(&'static str, u64),
) -> Result<()> {
    let services = Services::open(location)?;
    let there = services.there.publisher_builder().create()?;
    let back = services.back.subscriber_builder().create()?;
    let control = services.control.client_builder().create()?;
    let mut repeat = |once: Once<'_>| -> Result<()> {
        for index in 0..WARM_UP + samples {
            let sent_ns = monotonic_ns();
            let times = once(Header {
                sender_id: 1,
                sequence: index as u64,
                sent_ns,
            })?;
            for (leg, from_ns, to_ns) in times.into_iter().filter(|_| index >= WARM_UP) {
                record(leg, to_ns - from_ns);
            }
            // Without a sleep, like a thread that is awake when a message comes.
            while monotonic_ns() < sent_ns + GAP_NS {
                pause(shares);
                interrupt::check()?;
            }
        }
        Ok(())
    };
    repeat(&|header| {
        there.send_copy(Command {
            header,
            ..Command::default()
        })?;
        let look = || Ok(back.receive()?.map(|sample| sample.header.sent_ns));
        let (stamp_ns, received_ns) = poll(shares, look)?;
        Ok(vec![
            ("round_trip", header.sent_ns, received_ns),
            ("one_way", stamp_ns, received_ns),
        ])
    })?;
    repeat(&|header| {
        let pending = control.send_copy(Request {
            header,
            ..Request::default()
        })?;
        let (_, received_ns) = poll(shares, || Ok(pending.receive()?))?;
        Ok(vec![("request", header.sent_ns, received_ns)])
    })
}

/// Polls without a sleep until `look` returns a value, and returns it with its time.
fn poll<T>(shares: bool, look: impl Fn() -> Result<Option<T>>) -> Result<(T, u64)> {
    let begin = Instant::now();
    loop {
        if let Some(found) = look()? {
            return Ok((found, monotonic_ns()));
        }
        ensure!(begin.elapsed() < TIMEOUT, "no answer within {TIMEOUT:?}");
        pause(shares);
        interrupt::check()?;
    }
}

struct Services {
    there: publish_subscribe::PortFactory<ipc::Variant, Command, ()>,
    back: publish_subscribe::PortFactory<ipc::Variant, Command, ()>,
    control: request_response::PortFactory<ipc::Variant, Request, (), Response, ()>,
}

impl Services {
    fn open(location: &Location) -> Result<Self> {
        let node = location.node_builder()?.create::<ipc::Variant>()?;
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
