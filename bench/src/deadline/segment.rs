//! One stretch of one subject under one load: started, warmed up, measured, ended.

use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use cdcr_client::monotonic_ns;
use cdcr_shared_types::Location;

use super::observer::{Counted, observe};
use super::tally::Tally;
use super::{DeadlineOptions, Setup, WARM_UP};
use crate::benchmark::with_period;
use crate::interrupt;
use crate::load::{Done, Load, Running};
use crate::named::named;
use crate::subject::TIMEOUT;
use crate::subject::baseline::Baseline;
use crate::subject::cyclictest::Cyclictest;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::steal_ms;
use crate::system::thread::may_be_realtime;

named! {
    pub enum Subject {
        /// The daemon's own real-time thread with nothing to do: `cdcrd bare`.
        Bare = "bare",
        Daemon = "daemon",
        /// cyclictest of rt-tests, with the daemon's period and priority.
        Cyclictest = "cyclictest",
    }
}

#[derive(Debug)]
pub(super) struct Runner<'a> {
    options: &'a DeadlineOptions,
    cores: Cores,
    cyclictest: Option<Cyclictest>,
    period: Duration,
    deadline_ns: u64,
    late_start_ns: u64,
}

impl<'a> Runner<'a> {
    /// On these cores. A daemon is started once, to see that the configuration is good and to learn its period.
    pub(super) fn new(options: &'a DeadlineOptions, cores: Cores) -> Result<Self> {
        let launch = launch(options);
        let daemon = Daemon::start(&launch, &cores)?;
        let connection = daemon.connect()?;
        let status = connection.status(TIMEOUT)?;
        let record = connection.telemetry()?.next_within(TIMEOUT)?;
        drop(connection);
        daemon.stop()?;
        let late_start_ns = record.context("the daemon runs no cycle")?.late_start_ns;
        Ok(Self {
            options,
            cores,
            cyclictest: Cyclictest::find(),
            period: Duration::from_nanos(status.period_ns),
            deadline_ns: status.deadline_ns,
            late_start_ns,
        })
    }

    /// How what is measured is started. With real time means with all of it: whoever lacks a part is refused, and
    /// not called real-time.
    fn launch(&self, setup: Setup) -> Launch {
        match setup {
            Setup::Realtime => launch(self.options)
                .placed(&self.cores, true)
                .with("realtime.mode", "require"),
            Setup::Ordinary => launch(self.options).placed(&self.cores, false),
        }
    }

    pub(super) fn may_be_realtime(&self) -> bool {
        may_be_realtime() && {
            let required = Daemon::start(&self.launch(Setup::Realtime), &self.cores);
            required.and_then(Daemon::stop).is_ok()
        }
    }

    pub(super) fn subjects(&self, setup: Setup) -> Vec<Subject> {
        let mut subjects = vec![Subject::Bare, Subject::Daemon];
        if setup == Setup::Realtime && self.cyclictest.is_some() {
            subjects.push(Subject::Cyclictest);
        }
        subjects
    }

    pub(super) fn period(&self) -> Duration {
        self.period
    }

    /// What the subject came to, and what the load did meanwhile, its warm-up included.
    pub(super) fn run(&self, subject: Subject, load: Load, setup: Setup) -> Result<(Tally, Done)> {
        match subject {
            Subject::Daemon => self.daemon(load, setup),
            Subject::Bare => self.beside_decoy(load, || self.bare(setup)),
            Subject::Cyclictest => self.beside_decoy(load, || self.cyclictest()),
        }
    }

    fn daemon(&self, load: Load, setup: Setup) -> Result<(Tally, Done)> {
        let daemon = Daemon::start(&self.launch(setup), &self.cores)?;
        let (location, core) = (daemon.location(), self.cores.client());
        let tracking = Tracking::start(location, core)?;
        let (counted, realtime) = (Counted::new(), setup == Setup::Realtime);
        let (tally, measured) = thread::scope(|scope| {
            let observer = scope.spawn(|| observe(location, core, realtime, &counted));
            let measured = self.measure(load, setup, location, &counted, || observer.is_finished());
            // A measurement that fails ends the observer, too.
            counted.get_or_init(|| 0..0);
            let observed = observer.join();
            let observed = observed.map_err(|_| anyhow!("the observer panicked"));
            (observed.flatten().context("the observer"), measured)
        });
        tracking.stop().with_context(|| daemon.stderr_tail())?;
        let mut tally = tally.with_context(|| daemon.stderr_tail())?;
        let (steal_ms, done) = measured?;
        daemon.stop()?;
        tally.counts.steal_ms = steal_ms;
        Ok((tally, done))
    }

    /// Lets the load work beside a daemon that is observed. What was stolen \[ms\], and what the load did.
    fn measure(
        &self,
        load: Load,
        setup: Setup,
        location: &Location,
        counted: &Counted,
        has_ended: impl Fn() -> bool,
    ) -> Result<(f64, Done)> {
        let running = Running::start(load, &self.cores, Some(location))?;
        interrupt::sleep(WARM_UP)?;
        let (begin_ns, segment) = (monotonic_ns(), self.options.segment());
        counted.get_or_init(|| begin_ns..begin_ns + segment.as_nanos() as u64);
        let before_ms = self.stolen_ms(setup);
        let mut left = segment;
        // An observer that ended by itself is asked for its reason when it is ended.
        while !left.is_zero() && !has_ended() {
            if let Some(failure) = running.failure() {
                return Err(failure);
            }
            let step = left.min(Duration::from_millis(500));
            interrupt::sleep(step)?;
            left -= step;
        }
        // Nothing counts of the time in which the load ends.
        let steal_ms = self.stolen_ms(setup) - before_ms;
        Ok((steal_ms, running.stop()?))
    }

    /// Measures something that is no daemon. A load that needs one gets a decoy: without real time, beside
    /// the load, so that the load does the same work as beside the daemon that is measured.
    fn beside_decoy(
        &self,
        load: Load,
        measure: impl FnOnce() -> Result<Tally>,
    ) -> Result<(Tally, Done)> {
        let decoy = load.needs_daemon().then(|| self.decoy()).transpose()?;
        let target = decoy.as_ref().map(Daemon::location);
        let running = Running::start(load, &self.cores, target)?;
        let measured = measure();
        let done = running.stop();
        decoy.map_or(Ok(()), Daemon::stop)?;
        Ok((measured?, done?))
    }

    /// A daemon that keeps off the core that is measured.
    fn decoy(&self) -> Result<Daemon> {
        let launch = launch(self.options).placed(&self.cores, false);
        let cores = self.cores.without_realtime();
        Daemon::start(&launch, &cores)
    }

    /// What the hypervisor has taken since the start of the machine from the real-time core, in as far as it is counted
    /// \[ms\]; without real time from all, because the threads are where the system puts them.
    fn stolen_ms(&self, setup: Setup) -> f64 {
        let own = self.cores.realtime;
        let others = self.cores.others.iter().copied();
        let others = others.filter(|core| setup == Setup::Ordinary && *core != own);
        others.chain([own]).filter_map(steal_ms).sum()
    }

    /// The tally of something that warms up first, with what was stolen from then on.
    fn after_warm_up(&self, setup: Setup, wait: impl FnOnce() -> Result<Tally>) -> Result<Tally> {
        interrupt::sleep(WARM_UP)?;
        let before_ms = self.stolen_ms(setup);
        let mut tally = wait()?;
        tally.counts.steal_ms = self.stolen_ms(setup) - before_ms;
        Ok(tally)
    }

    fn bare(&self, setup: Setup) -> Result<Tally> {
        let duration = WARM_UP + self.options.segment();
        let bare = Baseline::start(&self.launch(setup), &self.cores, duration)?;
        self.after_warm_up(setup, || {
            let cycles = bare.wait()?;
            let first_ns = cycles.first().map_or(0, |cycle| cycle.due_ns);
            let begin_ns = first_ns + WARM_UP.as_nanos() as u64;
            // As the observer sees the daemon: a stall over the end of the warm-up counts, with all that it skipped.
            let warm = cycles.partition_point(|cycle| cycle.due_ns + cycle.wake_ns < begin_ns);
            Tally::of(&cycles[warm..], false)
        })
    }

    fn cyclictest(&self) -> Result<Tally> {
        let cyclictest = self.cyclictest.as_ref().context("cyclictest is gone")?;
        let cycles = |time: Duration| (time.as_nanos() / self.period.as_nanos().max(1)) as u64;
        let (warm, counted) = (cycles(WARM_UP), cycles(self.options.segment()));
        let (core, priority) = (self.cores.realtime, Some(CYCLE_PRIORITY));
        let running = cyclictest.start(self.period, priority, core, warm + counted)?;
        self.after_warm_up(Setup::Realtime, || {
            let latencies = running.wait()?.without_first(warm)?;
            Tally::of_cyclictest(&latencies, self.deadline_ns, self.late_start_ns)
        })
    }
}

/// Priority of whatever is measured with real time: that of the daemon's cycle thread, whatever its configuration says.
const CYCLE_PRIORITY: u8 = 80;

fn launch(options: &DeadlineOptions) -> Launch {
    // A driver is not there: the robot is simulated, whatever the configuration says.
    let launch = Launch::patient(options.config.clone())
        .with("link.kind", "simulated")
        .with("realtime.cycle_priority", CYCLE_PRIORITY);
    match options.period {
        Some(period) => with_period(launch, period.as_secs_f64() * 1e3),
        None => launch,
    }
}
