//! Work for a daemon: an endless reference, fed by a separate thread.

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use cdcr_client::{
    Connection, DURATION_MAX_S, FeedEvent, FeedOptions, Spiral, Trajectory, section_lengths_m,
};
use cdcr_shared_types::Location;
use cdcr_shared_types::codes::Mode;

use super::ROBOT;
use super::TIMEOUT;
use crate::interrupt;
use crate::system::thread::pin;

/// First words of the error when the robot does not begin to follow.
pub const DOES_NOT_FOLLOW: &str = "the robot does not follow the reference";
/// Longer than any measurement \[s\].
const FOR_EVER_S: f64 = DURATION_MAX_S;
/// Longest stall of the machine that the reference bridges without any effect.
const AHEAD: Duration = Duration::from_secs(3);

/// The paper's spiral, forwards and backwards: smooth, within reach, endless.
struct ThereAndBack {
    spiral: Spiral,
}

impl Trajectory for ThereAndBack {
    fn name(&self) -> &'static str {
        "spiral, there and back"
    }

    fn duration_s(&self) -> f64 {
        FOR_EVER_S
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        // At its fastest, it moves at π/4 of the paper's speed.
        let whole_s = self.spiral.duration_s;
        let phase = PI * time_s / (2.0 * whole_s);
        self.spiral.position_m(0.5 * whole_s * (1.0 - phase.cos()))
    }
}

/// A robot that follows a reference until this value is dropped. Holds the lease.
#[derive(Debug)]
pub struct Tracking {
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<()>>>,
}

impl Tracking {
    /// Starts to feed from a thread on `core`, and waits until the robot follows.
    pub fn start(location: &Location, core: usize) -> Result<Self> {
        let ending = Arc::new(AtomicBool::new(false));
        let follows = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("feed".to_owned()).spawn({
            let (location, ending, follows) =
                (location.clone(), Arc::clone(&ending), Arc::clone(&follows));
            move || feed(&location, core, &ending, &follows)
        })?;
        let mut tracking = Self {
            ending,
            thread: Some(thread),
        };
        let deadline = Instant::now() + TIMEOUT;
        while !follows.load(Ordering::Relaxed) {
            interrupt::check()?;
            if tracking
                .thread
                .as_ref()
                .is_some_and(JoinHandle::is_finished)
            {
                tracking.end()?;
                bail!("the feed of the reference ended at once");
            }
            if Instant::now() >= deadline {
                let seconds = TIMEOUT.as_secs();
                bail!("{DOES_NOT_FOLLOW} within {seconds} s");
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(tracking)
    }

    pub fn stop(mut self) -> Result<()> {
        self.end()
    }

    fn end(&mut self) -> Result<()> {
        self.ending.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else {
            return Ok(());
        };
        let result = thread.join();
        result
            .map_err(|_| anyhow!("the feed of the reference panicked"))?
            .context("the feed of the reference")
    }
}

impl Drop for Tracking {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            eprintln!("warning: {error:#}");
        }
    }
}

fn feed(location: &Location, core: usize, ending: &AtomicBool, follows: &AtomicBool) -> Result<()> {
    pin(core);
    let connection = Connection::open_within(location, ROBOT, TIMEOUT)?;
    let status = connection.status(TIMEOUT)?;
    let curve = ThereAndBack {
        spiral: Spiral::for_sections(&section_lengths_m(&status.robot)),
    };
    let options = FeedOptions {
        ahead: AHEAD,
        track: true,
        ..FeedOptions::default()
    };
    connection.feed(&curve, options)?.run(|event| {
        if let FeedEvent::Record(record) = event
            && record.mode == Mode::Tracking.code()
        {
            follows.store(true, Ordering::Relaxed);
        }
        if ending.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    Ok(())
}
