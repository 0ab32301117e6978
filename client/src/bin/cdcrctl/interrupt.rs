use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGXFSZ};

/// Time without a message after which a waiting command checks that the daemon is alive.
pub(crate) const QUIET: Duration = Duration::from_secs(1);
/// Interval of a waiting command's checks for an interrupt.
pub(crate) const INTERRUPT_INTERVAL: Duration = Duration::from_millis(100);

/// One for the process: a signal between two parts of a command applies to the second.
static RAISED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// A request of the user or the system to end the program.
#[derive(Debug, Clone)]
pub(crate) struct Interrupt {
    raised: Arc<AtomicBool>,
}

impl Interrupt {
    /// Catches SIGINT, SIGTERM, SIGHUP and SIGQUIT from now on. SIGXFSZ is handled, too: a file that reaches
    /// its size limit (`ulimit -f`) causes a write error and does not end the process.
    pub(crate) fn catch() -> io::Result<Self> {
        if let Some(raised) = RAISED.get() {
            let raised = Arc::clone(raised);
            return Ok(Self { raised });
        }
        let raised = Arc::clone(RAISED.get_or_init(Arc::default));
        for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
            signal_hook::flag::register(signal, Arc::clone(&raised))?;
        }
        signal_hook::flag::register(SIGXFSZ, Arc::default())?;
        Ok(Self { raised })
    }

    pub(crate) fn is_raised(&self) -> bool {
        self.raised.load(Ordering::Relaxed)
    }

    /// Whether a part of the command has caught a signal.
    pub(crate) fn was_raised() -> bool {
        RAISED
            .get()
            .is_some_and(|raised| raised.load(Ordering::Relaxed))
    }
}
