//! One stretch of one subject under one load: started, warmed up, measured, ended.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use super::observer::{Observed, Observer};
use super::tally::Tally;
use super::{Options, Setup, WARM_UP};
use crate::interrupt;
use crate::load::{Done, Load, Running};
use crate::subject::bare::Bare;
use crate::subject::cyclictest::Cyclictest;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::steal_ms;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// The daemon's own real-time thread with nothing to do: `cdcrd bare`.
    Bare,
    /// The daemon, tracking.
    Daemon,
    /// cyclictest of rt-tests, with the daemon's period and priority.
    Cyclictest,
}

impl Subject {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bare => "bare",
            Self::Daemon => "daemon",
            Self::Cyclictest => "cyclictest",
        }
    }
}

/// One stretch of one subject.
#[derive(Debug)]
pub struct Segment {
    /// Counts and latencies.
    pub tally: Tally,
    /// What the load did meanwhile, its warm-up included.
    pub load: Done,
    /// Share of the daemon's cycles in which the robot followed its reference.
    pub tracking_share: Option<f64>,
    /// Solves that the budget ended.
    pub budget_hits: u64,
}

/// Who runs the segments.
#[derive(Debug)]
pub struct Runner<'a> {
    options: &'a Options,
    cores: Cores,
    cyclictest: Option<Cyclictest>,
    period: Duration,
    deadline_ns: u64,
    late_start_ns: u64,
}

impl<'a> Runner<'a> {
    /// On these cores. A daemon is started once, to see that the configuration is good and to learn its period.
    ///
    /// # Errors
    /// When the daemon does not start with it.
    pub fn new(options: &'a Options, cores: Cores) -> Result<Self> {
        let launch = launch(options);
        let daemon = Daemon::start(&launch, &cores)?;
        let connection = daemon.connect()?;
        let status = connection.status(Duration::from_secs(1))?;
        let record = connection
            .telemetry()?
            .next_within(Duration::from_secs(1))?;
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

    /// What can be measured with this set-up.
    pub fn subjects(&self, setup: Setup) -> Vec<Subject> {
        let mut subjects = vec![Subject::Bare, Subject::Daemon];
        if setup == Setup::Realtime && self.cyclictest.is_some() {
            subjects.push(Subject::Cyclictest);
        }
        subjects
    }

    /// The period of the daemon.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// Measures one stretch.
    ///
    /// # Errors
    /// When a process or the load fails.
    pub fn run(&self, subject: Subject, load: Load, setup: Setup) -> Result<Segment> {
        match subject {
            Subject::Daemon => self.daemon(load, setup),
            Subject::Bare => self.beside_decoy(load, |runner| runner.bare(setup)),
            Subject::Cyclictest => self.beside_decoy(load, Self::cyclictest),
        }
    }

    fn daemon(&self, load: Load, setup: Setup) -> Result<Segment> {
        let realtime = setup == Setup::Realtime;
        let launch = launch(self.options).placed(&self.cores, realtime);
        let daemon = Daemon::start(&launch, &self.cores)?;
        let core = self.cores.client();
        let tracking = Tracking::start(daemon.location(), core)?;
        let observer = Observer::start(daemon.location(), core, realtime)?;
        let running = Running::start(load, &self.cores, Some(daemon.location()))?;
        interrupt::sleep(WARM_UP)?;
        observer.begin();
        let steal = steal_ms(self.cores.realtime);
        self.wait(&observer, &daemon)?;
        let steal = difference(steal, steal_ms(self.cores.realtime));
        let observed = observer.finish();
        let done = running.stop();
        tracking.stop().with_context(|| daemon.last_words())?;
        let Observed {
            mut tally,
            tracking_share,
            budget_hits,
        } = observed.with_context(|| daemon.last_words())?;
        daemon.stop()?;
        tally.counts.steal_ms = steal;
        Ok(Segment {
            tally,
            load: done?,
            tracking_share: Some(tracking_share),
            budget_hits,
        })
    }

    fn wait(&self, observer: &Observer, daemon: &Daemon) -> Result<()> {
        let mut left = self.options.segment();
        while !left.is_zero() {
            ensure!(
                !observer.has_ended(),
                "the observer ended before its time{}",
                daemon.last_words()
            );
            let step = left.min(Duration::from_millis(500));
            interrupt::sleep(step)?;
            left -= step;
        }
        Ok(())
    }

    /// Measures something that is no daemon. A load that needs one gets a decoy: without real time, beside
    /// the load, so that the load does the same work as beside the daemon that is measured.
    fn beside_decoy(
        &self,
        load: Load,
        measure: impl FnOnce(&Self) -> Result<Tally>,
    ) -> Result<Segment> {
        let decoy = if load.needs_daemon() {
            Some(self.decoy()?)
        } else {
            None
        };
        let target = decoy.as_ref().map(Daemon::location);
        let running = Running::start(load, &self.cores, target)?;
        let steal = steal_ms(self.cores.realtime);
        let tally = measure(self);
        let steal = difference(steal, steal_ms(self.cores.realtime));
        let done = running.stop();
        if let Some(decoy) = decoy {
            decoy.stop()?;
        }
        let mut tally = tally?;
        tally.counts.steal_ms = steal;
        Ok(Segment {
            tally,
            load: done?,
            tracking_share: None,
            budget_hits: 0,
        })
    }

    /// A daemon that keeps off the core that is measured.
    fn decoy(&self) -> Result<Daemon> {
        let launch = launch(self.options).placed(&self.cores, false);
        let cores = self.cores.without_realtime();
        Daemon::start(&launch, &cores)
    }

    fn bare(&self, setup: Setup) -> Result<Tally> {
        let launch = launch(self.options).placed(&self.cores, setup == Setup::Realtime);
        let duration = WARM_UP + self.options.segment();
        let cycles = Bare::start(&launch, &self.cores, duration)?.wait()?;
        let first_ns = cycles.first().map_or(0, |cycle| cycle.due_ns);
        let begin_ns = first_ns + WARM_UP.as_nanos() as u64;
        let warm = cycles.partition_point(|cycle| cycle.due_ns < begin_ns);
        Tally::of(&cycles[warm..], false)
    }

    fn cyclictest(&self) -> Result<Tally> {
        let cyclictest = self.cyclictest.as_ref().context("cyclictest is gone")?;
        let cycles = |time: Duration| (time.as_nanos() / self.period.as_nanos().max(1)) as u64;
        let (warm, counted) = (cycles(WARM_UP), cycles(self.options.segment()));
        let (core, priority) = (self.cores.realtime, Some(CYCLE_PRIORITY));
        let running = cyclictest.start(self.period, priority, core, warm + counted)?;
        let latencies = running.wait()?.without_first(warm)?;
        Tally::of_cyclictest(&latencies, self.deadline_ns, self.late_start_ns)
    }
}

/// Priority of the daemon's cycle thread in the default configuration.
const CYCLE_PRIORITY: u8 = 80;

fn launch(options: &Options) -> Launch {
    let launch = Launch::patient(options.config.clone());
    match options.period_ms {
        Some(period_ms) => launch.with("cycle.period_ms", period_ms),
        None => launch,
    }
}

/// What came between, in as far as it is counted.
fn difference(before: Option<f64>, after: Option<f64>) -> f64 {
    match (before, after) {
        (Some(before), Some(after)) => after - before,
        _ => 0.0,
    }
}
