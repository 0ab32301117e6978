use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGXFSZ};

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
}
