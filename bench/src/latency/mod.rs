//! Latency of messages into the daemon, through it and back to a client.
//!
//! `inputs` measures the time from a message or request to its effect; `stops` that from a stop to zero rates.
//! `latency.toml` defines the stamps of each leg.

mod inputs;
mod leg;
mod report;
mod scene;
mod stops;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use cdcr_client::monotonic_ns;
use cdcr_shared_types::codes::{Interface, RequestKind, realtime};
use cdcr_shared_types::{Location, parse_duration};
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::transport;
use crate::subject::watcher::{PollCounts, Watcher};
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use inputs::Sender;
use leg::Round;
pub use leg::declared;

const DECLARATION: &str = include_str!("latency.toml");

const STOP_S: f64 = 0.25;
const AROUND_S: f64 = 1.0;
const PERIOD_S: f64 = 5e-3;
/// Time by which the client wakes up early \[ns\]; on a short period, a quarter of the period.
const EARLY_NS: u64 = 200_000;

#[derive(Debug, Clone, PartialEq, Eq, clap::Args)]
pub struct LatencyOptions {
    /// Rounds, 1 to 1000: each measures everything once.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Samples per kind and round, 5 to 10000; 2/5 of that for stops, 8 times that
    /// for iceoryx2 alone.
    #[arg(long, default_value_t = 250, value_parser = clap::value_parser!(u16).range(5..=10_000))]
    pub samples: u16,
    /// Period of the loop [default: as configured].
    #[arg(long, value_parser = parse_duration)]
    pub period: Option<Duration>,
    /// Configuration of the daemon [default: three sections].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl LatencyOptions {
    /// Samples of each kind, of stops and of iceoryx2 alone.
    fn samples(&self) -> [usize; 3] {
        let samples = usize::from(self.samples);
        [samples, (2 * samples).div_ceil(5), 8 * samples]
    }

    fn launch(&self, link: &str, cores: &Cores, may_be_realtime: bool) -> Launch {
        let deceleration = format!("{:.1}", stops::DECELERATION_RAD_S2);
        let period_ms = self.period.map(|period| period.as_secs_f64() * 1e3);
        Launch::stall_tolerant(self.config.clone())
            .with("link.kind", link)
            // A stall is not a sensor failure. The driver measures the target of its newest command.
            .with("link.measurement_timeout_ms", "10000.0")
            .with("safety.measurement_jump_rad", "1000.0")
            .with("safety.measurement_frozen_rad", "1000.0")
            .with("safety.following_fault_rad", "1000.0")
            .with("motion.deceleration_rad_s2", deceleration)
            .with_some("cycle.period_ms", period_ms)
            .placed(cores, may_be_realtime)
    }
}

impl Benchmark for LatencyOptions {
    const HAS_CONFIG: bool = true;

    fn quicken(&mut self) {
        (self.rounds, self.samples) = (2, 40);
    }

    fn expected_s(&self) -> f64 {
        f64::from(self.rounds) * seconds(self).iter().sum::<f64>()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let bench = Bench {
            options: self,
            cores: Cores::find()?,
            may_be_realtime: may_be_realtime(),
        };
        let (began_ns, [.., ipc]) = (monotonic_ns(), self.samples());
        let (mut rounds, mut daemon) = (Vec::new(), OfDaemon::default());
        for number in 1..=self.rounds {
            let mut round = Round::new(began_ns);
            for (part, seconds) in PARTS.into_iter().zip(seconds(self)) {
                progress.begin(&format!("round {number} of {}, {part}", self.rounds));
                match part {
                    TRANSPORT => transport::measure(&bench.cores, ipc, |leg, latency_ns| {
                        round.record(&format!("ipc.{leg}"), latency_ns);
                    })?,
                    link => bench.with_daemon(link, &mut round, &mut daemon)?,
                }
                progress.advance(seconds);
            }
            rounds.push(round);
        }
        report::dataset(&bench.title(&daemon), bench.setting(&daemon), &rounds)
    }
}

const TRANSPORT: &str = "iceoryx2 alone";
const SIMULATED: &str = "simulated";
/// The parts of a round: iceoryx2 alone, then daemons by their `link.kind`.
const PARTS: [&str; 3] = [TRANSPORT, SIMULATED, "driver"];

/// Approximate duration of each part of a round \[s\].
fn seconds(options: &LatencyOptions) -> [f64; 3] {
    let period = options.period.map(|period| period.as_secs_f64());
    let [samples, stops, ipc] = options.samples();
    let samples_s = (samples + inputs::WARM_UP) as f64 * period.unwrap_or(PERIOD_S);
    let stops_s = STOP_S * stops as f64;
    [
        transport::expected_s(ipc),
        // References and obstacles share their periods; there are two kinds of requests.
        AROUND_S + (2.0 + 4.0) * samples_s + stops_s,
        AROUND_S + 2.0 * samples_s,
    ]
}

fn early_ns(watcher: &Watcher) -> u64 {
    EARLY_NS.min(watcher.status.period_ns / 4)
}

struct Bench<'a> {
    options: &'a LatencyOptions,
    cores: Cores,
    may_be_realtime: bool,
}

impl Bench<'_> {
    fn with_daemon(&self, link: &str, round: &mut Round, reported: &mut OfDaemon) -> Result<()> {
        let launch = self.options.launch(link, &self.cores, self.may_be_realtime);
        let daemon = Daemon::start(&launch, &self.cores)?;
        let location = daemon.place.location();
        let worked = self.cores.on_client(self.may_be_realtime, || {
            let mut watcher = Watcher::open(location, EARLY_NS)?;
            let lead_ns = inputs::learn_lead_ns(&mut watcher)?;
            match link {
                SIMULATED => self.simulated(location, &mut watcher, lead_ns, round)?,
                _ => self.driven(&mut watcher, lead_ns, round)?,
            }
            reported.add(&watcher, lead_ns);
            Ok(())
        });
        worked.with_context(|| format!("with link.kind = {link}"))?;
        daemon.stop()
    }

    fn simulated(
        &self,
        location: &Location,
        watcher: &mut Watcher,
        lead_ns: u64,
        round: &mut Round,
    ) -> Result<()> {
        let [samples, stops, _] = self.options.samples();
        let sources = vec![
            Sender::Reference(scene::follow(watcher, None)?),
            Sender::Obstacle(Box::new(watcher.connection.obstacle_sender()?)),
        ];
        inputs::measure(watcher, lead_ns, sources, samples, round)?;

        watcher.open_asker(location)?;
        let requests = [RequestKind::AcquireLease, RequestKind::Track].map(Sender::Request);
        inputs::measure(watcher, lead_ns, requests.into(), samples, round)?;

        stops::measure(watcher, stops, round)
    }

    fn driven(&self, watcher: &mut Watcher, lead_ns: u64, round: &mut Round) -> Result<()> {
        let driver = watcher.connection.driver(Interface::Velocity)?;
        let measurement = Sender::Measurement(Box::new(driver));
        let _feed = scene::follow(watcher, Some(&measurement))?;
        let [samples, ..] = self.options.samples();
        inputs::measure(watcher, lead_ns, vec![measurement], samples, round)
    }

    fn title(&self, daemon: &OfDaemon) -> String {
        let threads = match (daemon.refused, self.may_be_realtime) {
            (false, true) => "SCHED_FIFO",
            (false, false) => "SCHED_FIFO for the daemon alone",
            (true, _) => "no real-time threads: not granted",
        };
        let (period_ms, lead_us) = (daemon.period_us * 1e-3, daemon.gather_lead_us);
        let gather = format!("gather {lead_us:.0} µs before the release");
        format!("Latencies of messages, period {period_ms:.1} ms, {gather}, {threads}")
    }

    fn setting(&self, daemon: &OfDaemon) -> Value {
        let [samples, stops, _] = self.options.samples();
        json!({
            "rounds": self.options.rounds,
            "samples": samples,
            "stops": stops,
            "period_us": daemon.period_us,
            "gather_lead_us": daemon.gather_lead_us,
            "realtime": !daemon.refused,
            "client_realtime": self.may_be_realtime,
            "realtime_core": self.cores.realtime,
            "client_core": self.cores.client(),
            "looks": daemon.polls,
        })
    }
}

#[derive(Default)]
struct OfDaemon {
    period_us: f64,
    gather_lead_us: f64,
    refused: bool,
    polls: PollCounts,
}

impl OfDaemon {
    fn add(&mut self, watcher: &Watcher, lead_ns: u64) {
        let status = &watcher.status;
        self.period_us = status.period_ns as f64 * 1e-3;
        self.gather_lead_us = self.gather_lead_us.max(lead_ns as f64 * 1e-3);
        self.refused |= status.realtime_missing & (realtime::FIFO | realtime::OFF) != 0;
        self.polls += watcher.polls;
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use rustix::time::{ClockId, clock_gettime};

    use super::*;

    /// Share of the time of `work` in which this thread had a core.
    fn share_of_core<R>(work: impl FnOnce() -> Result<R>) -> (f64, R) {
        let used = || Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).expect("a time");
        let (begin, used_before) = (Instant::now(), used());
        let result = work().expect("it works");
        let used = used().saturating_sub(used_before);
        (used.div_duration_f64(begin.elapsed()), result)
    }

    #[test]
    fn who_waits_for_a_robot_leaves_the_core_to_the_daemon_that_is_waited_for() {
        let cores = Cores::find().expect("cores");
        let launch = LatencyOptions::of_report(true, &[]).launch("driver", &cores, false);
        let daemon = Daemon::start(&launch, &cores).expect("a daemon");
        let mut watcher = Watcher::open(daemon.place.location(), EARLY_NS).expect("a client");
        // Without a first measurement there is no command.
        let end_ns = monotonic_ns() + 300_000_000;
        let (share, ()) = share_of_core(|| watcher.watch_until(end_ns));
        assert!(share < 0.75, "{share} of a core to watch");
        let driver = watcher.connection.driver(Interface::Velocity);
        let driver = Sender::Measurement(Box::new(driver.expect("a driver")));
        let (share, _feed) = share_of_core(|| scene::follow(&mut watcher, Some(&driver)));
        assert!(share < 0.75, "{share} of a core until the robot follows");
        daemon.stop().expect("it ends");
    }
}
