//! Ctrl-C ends a measurement in order: daemons are stopped, files are removed.

use std::sync::Arc;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

static RAISED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Interval at which a sleeping thread checks for a signal.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Installs signal handlers that set a flag instead of ending the process. Every wait checks the flag.
pub fn catch() -> Result<()> {
    let flag = RAISED.get_or_init(Arc::default);
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(flag)).context("signals")?;
    }
    Ok(())
}

pub fn is_raised() -> bool {
    RAISED
        .get()
        .is_some_and(|flag| flag.load(Ordering::Relaxed))
}

/// Fails after a signal, so that `?` leaves any measurement.
pub fn check() -> Result<()> {
    if is_raised() {
        bail!("interrupted: nothing was written");
    }
    Ok(())
}

pub fn sleep(duration: Duration) -> Result<()> {
    let end = Instant::now() + duration;
    loop {
        check()?;
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        thread::sleep(left.min(POLL_INTERVAL));
    }
}
