//! Notifications to the service manager: ready, status, watchdog, stopping.
//!
//! The protocol is that of `sd_notify(3)`: a datagram of text lines to the socket in `NOTIFY_SOCKET`, for
//! example of systemd. Without the variable nothing is sent.
//!
//! Invariant: nothing here waits. The socket does not block. The first rejected message is logged, and
//! rejected messages are sent again at the next call.

use std::ffi::{OsStr, OsString};
use std::fmt::{self, Display, Formatter};
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{Mode, Reason};
use sd_notify::NotifyState;

/// Time between two status lines of the same mode and reason: people read them.
const STATUS_LINE_INTERVAL: Duration = Duration::from_secs(1);

/// The status line in `systemctl status`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatusLine {
    pub mode: Mode,
    pub reason: Reason,
    /// Measured rate of the cycles \[Hz\].
    pub rate_hz: f64,
    /// Deadline misses since the start.
    pub deadline_misses: u64,
    /// Releases without a command since the start.
    pub skipped_periods: u64,
    /// Distance of the tip from its reference \[m\], while tracking.
    pub tracking_error_m: Option<f64>,
}

impl StatusLine {
    fn is_same_state(&self, other: &Self) -> bool {
        (self.mode, self.reason) == (other.mode, other.reason)
    }
}

impl Display for StatusLine {
    /// `tracking (asked for): 200.0 Hz, 3 misses, 1 skipped period, error 0.012 mm`
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self {
            deadline_misses: misses,
            skipped_periods: skipped,
            ..
        } = self;
        write!(
            f,
            "{} ({}): {:.1} Hz, {misses} {}, {skipped} {}",
            self.mode,
            self.reason,
            self.rate_hz,
            if *misses == 1 { "miss" } else { "misses" },
            if *skipped == 1 {
                "skipped period"
            } else {
                "skipped periods"
            },
        )?;
        match self.tracking_error_m {
            Some(error_m) => write!(f, ", error {:.3} mm", error_m * 1e3),
            None => Ok(()),
        }
    }
}

/// The service manager that started the process, if any.
#[derive(Debug)]
pub struct ServiceManager {
    listener: Option<Listener>,
    watchdog: Option<WatchdogFeed>,
    last_sent: Option<(StatusLine, Instant)>,
    /// The newest status line that could not be sent, and its time.
    last_unsent: Option<(StatusLine, Instant)>,
    is_ready_sent: bool,
    is_stopping_sent: bool,
    is_failure_logged: bool,
}

#[derive(Debug)]
struct Listener {
    socket: UnixDatagram,
    address: SocketAddr,
    name: OsString,
}

#[derive(Debug)]
struct WatchdogFeed {
    period: Duration,
    fed: Option<Instant>,
    cycles: u64,
}

impl ServiceManager {
    /// The service manager in the environment: `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID`. An
    /// invalid socket is logged, and nothing is sent.
    pub fn from_environment() -> Self {
        let Some(name) = std::env::var_os("NOTIFY_SOCKET").filter(|name| !name.is_empty()) else {
            return Self::none();
        };
        Self::connect(&name, sd_notify::watchdog_enabled()).unwrap_or_else(|error| {
            tracing::warn!(socket = ?name, %error, "cannot notify the service manager: NOTIFY_SOCKET is invalid");
            Self::none()
        })
    }

    /// No service manager: nothing is sent.
    pub fn none() -> Self {
        Self {
            listener: None,
            watchdog: None,
            last_sent: None,
            last_unsent: None,
            is_ready_sent: false,
            is_stopping_sent: false,
            is_failure_logged: false,
        }
    }

    /// A service manager that listens at `socket` (a path, or `@name` in the abstract namespace) and expects
    /// a heartbeat every `watchdog_period`.
    pub fn connect(socket: &OsStr, watchdog_period: Option<Duration>) -> io::Result<Self> {
        let watchdog = watchdog_period
            .filter(|period| !period.is_zero())
            .map(|period| WatchdogFeed {
                period,
                fed: None,
                cycles: 0,
            });
        Ok(Self {
            listener: Some(Listener::bind(socket)?),
            watchdog,
            ..Self::none()
        })
    }

    /// Longest time between heartbeats for the service manager, if it has a watchdog.
    pub fn watchdog_period(&self) -> Option<Duration> {
        self.watchdog.as_ref().map(|watchdog| watchdog.period)
    }

    /// Reports that the loop runs: call it after a good cycle. Sent once; later calls do nothing.
    pub fn ready(&mut self) {
        if !self.is_ready_sent {
            self.is_ready_sent = self.notify(&NotifyState::Ready);
        }
    }

    /// Sends a status line: at once after a change of mode or reason, otherwise at most once a second. A line
    /// that could not be sent is sent again after a second at the earliest.
    pub fn send_status(&mut self, line: &StatusLine) {
        self.send_status_at(line, Instant::now());
    }

    /// Feeds the watchdog if `cycles`, the number of cycles since the start, has changed since the last call,
    /// and half of the watchdog's period has passed since it was fed. So a hung loop starves the watchdog
    /// even if the caller runs.
    pub fn feed_watchdog(&mut self, cycles: u64) {
        self.feed_watchdog_at(cycles, Instant::now());
    }

    /// Reports the end. Sent once; later calls do nothing.
    pub fn stopping(&mut self) {
        if !self.is_stopping_sent {
            self.is_stopping_sent = self.notify(&NotifyState::Stopping);
        }
    }

    fn send_status_at(&mut self, line: &StatusLine, now: Instant) {
        let is_new = self.last_sent.is_none_or(|(last_sent, when)| {
            !last_sent.is_same_state(line)
                || (last_sent != *line && now.duration_since(when) >= STATUS_LINE_INTERVAL)
        });
        let may_retry = self.last_unsent.is_none_or(|(last_unsent, when)| {
            !last_unsent.is_same_state(line) || now.duration_since(when) >= STATUS_LINE_INTERVAL
        });
        if !is_new || !may_retry {
            return;
        }
        if self.notify(&NotifyState::Status(&line.to_string())) {
            (self.last_sent, self.last_unsent) = (Some((*line, now)), None);
        } else {
            self.last_unsent = Some((*line, now));
        }
    }

    fn feed_watchdog_at(&mut self, cycles: u64, now: Instant) {
        let Some(watchdog) = &mut self.watchdog else {
            return;
        };
        let advanced = cycles != std::mem::replace(&mut watchdog.cycles, cycles);
        let half = watchdog.period / 2;
        let due = watchdog
            .fed
            .is_none_or(|fed| now.duration_since(fed) >= half);
        if advanced
            && due
            && self.notify(&NotifyState::Watchdog)
            && let Some(watchdog) = &mut self.watchdog
        {
            watchdog.fed = Some(now);
        }
    }

    /// True if the message was sent, or there is no service manager.
    fn notify(&mut self, state: &NotifyState<'_>) -> bool {
        let Some(listener) = &self.listener else {
            return true;
        };
        let Err(error) = listener.send(&format!("{state}\n")) else {
            return true;
        };
        if !self.is_failure_logged {
            self.is_failure_logged = true;
            let socket = &listener.name;
            tracing::warn!(?socket, %error, "cannot notify the service manager; this is reported once");
        }
        false
    }
}

impl Listener {
    fn bind(name: &OsStr) -> io::Result<Self> {
        let address = match name.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
            [b'/', ..] => SocketAddr::from_pathname(name)?,
            _ => {
                let what = "it must be an absolute path or @ and an abstract name";
                return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
            }
        };
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            address,
            name: name.to_owned(),
        })
    }

    fn send(&self, message: &str) -> io::Result<()> {
        // A datagram is sent whole or not at all.
        self.socket
            .send_to_addr(message.as_bytes(), &self.address)
            .map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    /// A simulated service manager on a real socket.
    struct Manager {
        socket: UnixDatagram,
        folder: Scratch,
    }

    impl Manager {
        fn start() -> Self {
            let folder = Scratch::temporary().unwrap();
            let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
            socket.set_nonblocking(true).unwrap();
            Self { socket, folder }
        }

        fn configured_by(&self, watchdog_period: Option<Duration>) -> ServiceManager {
            let path = self.folder.path().join("notify");
            ServiceManager::connect(path.as_os_str(), watchdog_period).unwrap()
        }

        /// Moves the socket away, or back.
        fn move_away(&self, is_away: bool) {
            let [from, to] = if is_away {
                ["notify", "away"]
            } else {
                ["away", "notify"]
            };
            let path = |name: &str| self.folder.path().join(name);
            std::fs::rename(path(from), path(to)).unwrap();
        }

        /// The messages received since the last call. Datagrams between local sockets arrive immediately.
        fn received(&self) -> Vec<String> {
            let mut received = Vec::new();
            let mut buffer = [0; 1024];
            while let Ok(length) = self.socket.recv(&mut buffer) {
                received.push(String::from_utf8(buffer[..length].to_vec()).unwrap());
            }
            received
        }
    }

    fn line(mode: Mode, deadline_misses: u64) -> StatusLine {
        StatusLine {
            mode,
            reason: Reason::try_from(0).unwrap(),
            rate_hz: 200.0,
            deadline_misses,
            skipped_periods: 1,
            tracking_error_m: Some(12.3e-6),
        }
    }

    #[test]
    fn ready_and_stopping_are_sent_once() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        for _ in 0..3 {
            service.ready();
        }
        assert_eq!(manager.received(), ["READY=1\n"]);
        for _ in 0..3 {
            service.stopping();
        }
        assert_eq!(manager.received(), ["STOPPING=1\n"]);
    }

    #[test]
    fn a_status_is_one_line_with_mode_rate_misses_and_error() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        let line = line(Mode::Tracking, 3);
        service.send_status(&line);
        let reason = line.reason;
        assert_eq!(
            manager.received(),
            [format!(
                "STATUS=tracking ({reason}): 200.0 Hz, 3 misses, 1 skipped period, error 0.012 mm\n"
            )]
        );
    }

    #[test]
    fn a_new_mode_is_sent_at_once_and_new_numbers_once_a_second() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        let begin = Instant::now();
        service.send_status_at(&line(Mode::Holding, 0), begin);
        service.send_status_at(&line(Mode::Tracking, 0), begin);
        assert_eq!(manager.received().len(), 2, "two modes");
        service.send_status_at(&line(Mode::Tracking, 1), begin + STATUS_LINE_INTERVAL / 2);
        assert!(manager.received().is_empty(), "too early");
        service.send_status_at(&line(Mode::Tracking, 2), begin + STATUS_LINE_INTERVAL);
        assert_eq!(manager.received().len(), 1);
        service.send_status_at(&line(Mode::Tracking, 2), begin + HOUR);
        assert!(manager.received().is_empty(), "no news");
    }

    #[test]
    fn the_watchdog_is_fed_every_half_period_while_cycles_advance() {
        let manager = Manager::start();
        let mut service = manager.configured_by(Some(HOUR));
        assert_eq!(service.watchdog_period(), Some(HOUR));
        let begin = Instant::now();
        let quarter = HOUR / 4;
        let fed = |service: &mut ServiceManager, cycles, quarters| {
            service.feed_watchdog_at(cycles, begin + quarter * quarters);
            manager.received() == ["WATCHDOG=1\n"]
        };
        assert!(!fed(&mut service, 0, 0), "no cycle yet");
        assert!(fed(&mut service, 1, 0));
        assert!(!fed(&mut service, 2, 1), "too early");
        assert!(fed(&mut service, 3, 2));
        assert!(!fed(&mut service, 3, 4), "the loop hangs");
        assert!(!fed(&mut service, 3, 9), "and still");
        assert!(fed(&mut service, 4, 10), "it goes on");
    }

    #[test]
    fn without_a_watchdog_nothing_is_fed() {
        let manager = Manager::start();
        for period in [None, Some(Duration::ZERO)] {
            let mut service = manager.configured_by(period);
            service.feed_watchdog(1);
            assert_eq!(
                (service.watchdog_period(), manager.received().len()),
                (None, 0)
            );
        }
    }

    #[test]
    fn what_was_not_heard_is_reported_again() {
        let manager = Manager::start();
        let mut service = manager.configured_by(Some(HOUR));
        manager.move_away(true);
        service.ready();
        service.feed_watchdog(1);
        assert!(service.is_failure_logged && manager.received().is_empty());
        manager.move_away(false);
        service.ready();
        service.feed_watchdog(2);
        assert_eq!(manager.received(), ["READY=1\n", "WATCHDOG=1\n"]);
    }

    #[test]
    fn a_status_that_was_not_heard_is_reported_again_once_a_second() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        manager.move_away(true);
        let begin = Instant::now();
        service.send_status_at(&line(Mode::Tracking, 3), begin);
        manager.move_away(false);
        service.send_status_at(&line(Mode::Tracking, 4), begin + STATUS_LINE_INTERVAL / 2);
        assert!(manager.received().is_empty(), "too early");
        service.send_status_at(&line(Mode::Tracking, 4), begin + STATUS_LINE_INTERVAL);
        assert_eq!(manager.received().len(), 1);
    }

    #[test]
    fn a_status_that_was_not_heard_holds_back_no_change_of_mode() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        manager.move_away(true);
        let begin = Instant::now();
        service.send_status_at(&line(Mode::Tracking, 3), begin);
        manager.move_away(false);
        service.send_status_at(&line(Mode::Holding, 3), begin);
        assert_eq!(manager.received().len(), 1);
    }

    #[test]
    fn a_listener_that_does_not_read_does_not_hold_us_up() {
        let manager = Manager::start();
        let mut service = manager.configured_by(None);
        let begin = Instant::now();
        // Far more than a socket can queue: a blocking send would never return.
        for index in 0..10_000 {
            service.send_status_at(
                &line(Mode::Tracking, u64::from(index)),
                begin + HOUR * index,
            );
        }
        assert!(service.is_failure_logged);
        let kept = manager.received().len();
        assert!((1..10_000).contains(&kept), "{kept}");
    }

    #[test]
    fn an_abstract_name_is_an_address_too() {
        let name = format!("cdcr-test-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let socket = UnixDatagram::bind_addr(&address).unwrap();
        let mut service = ServiceManager::connect(OsStr::new(&format!("@{name}")), None).unwrap();
        service.ready();
        let mut buffer = [0; 64];
        let length = socket.recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..length], b"READY=1\n");
    }

    #[test]
    fn what_is_no_address_is_refused() {
        let too_long = format!("/{}", "x".repeat(200));
        for name in ["notify", "vsock:2:1234", &too_long] {
            assert!(
                ServiceManager::connect(OsStr::new(name), None).is_err(),
                "{name}"
            );
        }
    }

    #[test]
    fn without_a_service_manager_nothing_is_sent_and_nothing_fails() {
        let mut nobody = ServiceManager::none();
        nobody.ready();
        nobody.send_status(&line(Mode::Holding, 0));
        nobody.feed_watchdog(1);
        nobody.stopping();
        assert!(!nobody.is_failure_logged);
        assert_eq!(nobody.watchdog_period(), None);
    }
}
