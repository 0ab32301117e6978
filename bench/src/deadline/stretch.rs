//! One stretch of one subject under one load: start, warm-up, measurement, end.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use anyhow::{Context, Result};
use cdcr_client::monotonic_ns;
use cdcr_shared_types::Location;
use cdcr_shared_types::codes::{LateCause, Mode};
use serde_json::json;

use super::report::Key;
use super::tally::{COMMAND, Tally};
use super::{DeadlineOptions, Setup, WARM_UP};
use crate::dataset::joined;
use crate::interrupt;
use crate::load::RunningLoad;
use crate::named::named;
use crate::quantiles::histogram;
use crate::subject::baseline::Baseline;
use crate::subject::cyclictest::Cyclictest;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::subject::watcher::{Seen, Watcher};
use crate::subject::{Cycle, TIMEOUT};
use crate::system::cores::Cores;
use crate::system::counts::steal_ms;
use crate::system::thread::may_be_realtime;

const CYCLE_PRIORITY: u8 = 80;
/// Time by which the client wakes up before a release \[ns\], about the length of a late wake-up.
const EARLY_NS: u64 = 100_000;
/// Time limit for the last records and incidents \[ns\]: the daemon's reporter is late on a stalled machine.
const LAST_NS: u64 = 300_000_000;

named! {
    pub enum Subject {
        Bare = "bare",
        Daemon = "daemon",
        Cyclictest = "cyclictest",
    }
}

impl Subject {
    pub(super) fn in_setup(setup: Setup) -> Vec<Self> {
        let has_cyclictest = setup == Setup::Realtime && Cyclictest::find().is_some();
        Self::ALL[..2 + usize::from(has_cyclictest)].to_vec()
    }
}

pub(super) struct Runner<'a> {
    options: &'a DeadlineOptions,
    cores: Cores,
    pub(super) period: Duration,
    deadline_ns: u64,
    late_start_ns: u64,
}

impl<'a> Runner<'a> {
    pub(super) fn new(options: &'a DeadlineOptions, cores: Cores) -> Result<Self> {
        let daemon = Daemon::start(&launch(options), &cores)?;
        let connection = daemon.connect()?;
        let status = connection.status(TIMEOUT)?;
        let record = connection.telemetry()?.next_within(TIMEOUT)?;
        drop(connection);
        daemon.stop()?;
        Ok(Self {
            options,
            cores,
            period: Duration::from_nanos(status.period_ns),
            deadline_ns: status.deadline_ns,
            late_start_ns: record.context("the daemon runs no cycle")?.late_start_ns,
        })
    }

    /// Launch of a subject. Real time means all of its parts: a subject that lacks one is refused.
    fn launch(&self, setup: Setup) -> Launch {
        let launch = launch(self.options).placed(&self.cores, setup == Setup::Realtime);
        match setup {
            Setup::Realtime => launch.with("realtime.mode", "require"),
            Setup::Ordinary => launch,
        }
    }

    pub(super) fn may_be_realtime(&self) -> bool {
        let start = || Daemon::start(&self.launch(Setup::Realtime), &self.cores);
        may_be_realtime() && start().and_then(Daemon::stop).is_ok()
    }

    /// Measures the subject under the load. The counts of the load include the warm-up. A load with clients
    /// needs a daemon: if the subject is none, the load gets a decoy daemon off the measured core.
    pub(super) fn run(&self, key: Key) -> Result<Tally> {
        let others = self.cores.without_realtime();
        let decoy = || Daemon::start(&self.launch(Setup::Ordinary), &others);
        let daemon = match key.subject {
            Subject::Daemon => Some(Daemon::start(&self.launch(key.setup), &self.cores)?),
            _ => key.load.needs_daemon().then(decoy).transpose()?,
        };
        let location = daemon.as_ref().map(|daemon| daemon.place.location());
        let tally = self.beside_load(key, location);
        let words = || Some(daemon.as_ref()?.process.output_tail());
        let tally = tally.with_context(|| words().unwrap_or_default())?;
        daemon.map_or(Ok(()), Daemon::stop)?;
        Ok(tally)
    }

    fn beside_load(&self, key: Key, location: Option<&Location>) -> Result<Tally> {
        let (setup, subject) = (key.setup, key.subject);
        let followed = location.filter(|_| subject == Subject::Daemon);
        let follow = |location| Tracking::start(location, self.cores.client());
        let tracking = followed.map(follow).transpose()?;
        let load = RunningLoad::start(key.load, &self.cores, location)?;
        let tally = match (subject, followed) {
            (_, Some(location)) => {
                let observe = || self.observe(location, setup);
                self.cores.on_client(setup == Setup::Realtime, observe)
            }
            (Subject::Cyclictest, _) => self.cyclictest(),
            _ => self.bare(setup),
        };
        let done = load.stop();
        tracking.map_or(Ok(()), Tracking::stop)?;
        let mut tally = tally?;
        tally.counts["load_did"] = json!(done?);
        Ok(tally)
    }

    fn bare(&self, setup: Setup) -> Result<Tally> {
        let duration = WARM_UP + self.options.segment();
        let bare = Baseline::start(&self.launch(setup), &self.cores, duration)?;
        interrupt::sleep(WARM_UP)?;
        self.with_steal(setup, || {
            let cycles = bare.wait()?;
            let first_ns = cycles.first().map_or(0, |cycle| cycle.due_ns);
            let begin_ns = first_ns + WARM_UP.as_nanos() as u64;
            // As for the daemon: a stall across the end of the warm-up counts, with all skipped periods.
            let warm = cycles.partition_point(|cycle| cycle.due_ns + cycle.wake_ns < begin_ns);
            Ok(Tally::from_cycles(&cycles[warm..], false))
        })
    }

    fn cyclictest(&self) -> Result<Tally> {
        let cyclictest = Cyclictest::find().context("cyclictest is gone")?;
        let cycles = |time: Duration| (time.as_nanos() / self.period.as_nanos().max(1)) as u64;
        let (warm, counted) = (cycles(WARM_UP), cycles(self.options.segment()));
        let (core, priority) = (self.cores.realtime, Some(CYCLE_PRIORITY));
        let running = cyclictest.start(self.period, priority, core, warm + counted)?;
        interrupt::sleep(WARM_UP)?;
        self.with_steal(Setup::Realtime, || {
            let latencies = running.wait()?.without_first(warm)?;
            Tally::from_cyclictest(&latencies, self.deadline_ns, self.late_start_ns)
        })
    }

    /// Receives every command of a daemon after a warm-up. With real time, this client has priority over the
    /// loads on its core. Therefore the result does not depend on how the core is shared.
    fn observe(&self, location: &Location, setup: Setup) -> Result<Tally> {
        let mut watcher = Watcher::open(location, EARLY_NS)?;
        let mut incidents = watcher.connection.incidents()?;
        let begin_ns = monotonic_ns() + WARM_UP.as_nanos() as u64;
        let end_ns = begin_ns + self.options.segment().as_nanos() as u64;
        watcher.watch_until(begin_ns)?;
        let (lost_before, before_ms) = (watcher.telemetry.lost(), self.stolen_ms(setup));
        let (mut cycles, mut commands_ns) = (BTreeMap::new(), histogram());
        let [mut tracking, mut budget_hits] = [0_u64; 2];
        // Incidents have more information than records: the time taken by the hypervisor.
        let mut causes = HashMap::new();
        let mut watch_until = |until_ns: u64| {
            // Only between releases: other work while waiting for a command would delay its receipt.
            while watcher.watch(until_ns)? {
                let is_counted = |seen: &Seen| (begin_ns..end_ns).contains(&seen.record.due_ns);
                for seen in watcher.seen.drain(..).filter(is_counted) {
                    let record = &seen.record;
                    tracking += u64::from(seen.is_in(Mode::Tracking));
                    budget_hits += u64::from(record.report.budget_spent != 0);
                    if let Some(received_ns) = seen.received_ns {
                        commands_ns.saturating_record(received_ns.saturating_sub(record.due_ns));
                    }
                    cycles.insert(record.cycle, Cycle::from_record(record));
                }
                while let Some(incident) = incidents.try_next()? {
                    let cause = LateCause::try_from(incident.telemetry.scheduling.late_cause);
                    causes.extend(cause.map(|cause| (incident.telemetry.cycle, cause)));
                }
            }
            anyhow::Ok(())
        };
        watch_until(end_ns)?;
        let stolen_ms = self.stolen_ms(setup) - before_ms;
        watch_until(end_ns + LAST_NS)?;
        for (number, cycle) in &mut cycles {
            cycle.cause = causes.get(number).copied().unwrap_or(cycle.cause);
        }
        let count = cycles.len() as u64;
        let of_clients = json!({
            "steal_ms": stolen_ms,
            "lost_records": watcher.telemetry.lost() - lost_before,
            "lost_commands": count - commands_ns.len(),
            "budget_hits": budget_hits,
            "tracking_share": tracking as f64 / count.max(1) as f64,
        });
        let mut tally = Tally::from_cycles(&cycles.into_values().collect::<Vec<_>>(), true);
        tally.counts = joined([tally.counts, of_clients]);
        tally.times[COMMAND] = commands_ns;
        Ok(tally)
    }

    fn with_steal(&self, setup: Setup, measure: impl FnOnce() -> Result<Tally>) -> Result<Tally> {
        let before_ms = self.stolen_ms(setup);
        let mut tally = measure()?;
        tally.counts["steal_ms"] = (self.stolen_ms(setup) - before_ms).into();
        Ok(tally)
    }

    /// Time that the hypervisor has taken from the real-time core since the start of the machine \[ms\], if
    /// counted. Without real time, from all cores, because the threads may run on any of them.
    fn stolen_ms(&self, setup: Setup) -> f64 {
        let own = self.cores.realtime;
        let others = self.cores.others.iter().copied();
        let others = others.filter(|core| setup == Setup::Ordinary && *core != own);
        others.chain([own]).filter_map(steal_ms).sum()
    }
}

fn launch(options: &DeadlineOptions) -> Launch {
    // There is no driver, so the robot is simulated, whatever the configuration says.
    let launch = Launch::stall_tolerant(options.config.clone())
        .with("link.kind", "simulated")
        .with("realtime.cycle_priority", CYCLE_PRIORITY);
    match options.period {
        Some(period) => launch.with_period(period.as_secs_f64() * 1e3),
        None => launch,
    }
}
