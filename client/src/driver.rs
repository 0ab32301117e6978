mod bounds;
mod commanded;
mod follower;
mod load;
mod measured;
mod measured_bends;
mod refusal;
mod section_ends;

use std::cell::Cell;
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::CABLES_MAX;
use cdcr_shared_types::{Command, Header, Location, Measurement, RobotDescription, Service};

use crate::connect_error::{Place, no_status, retry};
use crate::outlet::Outlet;
use crate::sender::MessageSender;
use crate::services::{Channel, DriverServices, check_clock, check_owner};
use crate::status_reader::{STATUS_TIMEOUT, StatusReader};
use crate::stream::Stream;
use crate::{CommandStream, ConnectError, LinkError, monotonic_ns};

use measured::Measured;

pub use bounds::cable_tolerances_m;
pub use commanded::{CommandedPosition, CommandedRates};
pub use follower::CommandFollower;
pub use refusal::CommandRefusal;

/// Interval at which a waiting driver checks for a command: a fifth of the usual period.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// A driver that measures has sent a first measurement by then. Until then it follows no command that acts on those
/// of another driver; afterwards a velocity driver that measures nothing follows every command.
const MEASURES_WITHIN: Duration = Duration::from_secs(1);

/// The ports of a driver process: it sends measurements of the robot and executes the daemon's commands.
///
/// In each iteration of its loop a driver calls [`update`](Self::update). It applies
/// [`rates_at`](Self::rates_at) or [`position_at`](Self::position_at) of the present time to its motors, with
/// or without a new command. Then it sends a measurement:
///
/// ```no_run
/// # use cdcr_client::{Connection, Driver, LinkError, monotonic_ns};
/// # use cdcr_shared_types::Measurement;
/// # fn turn(
/// #     driver: &mut Driver,
/// #     set_speeds: impl Fn([f64; 18]),
/// #     measure: impl Fn() -> Measurement,
/// # ) -> Result<(), LinkError> {
/// if let Some(refusal) = driver.update()?.refused {
///     eprintln!("{refusal}");
/// }
/// set_speeds(driver.rates_at(monotonic_ns()).cable_speed_m_s);
/// driver.send(measure())?;
/// # Ok(())
/// # }
/// ```
///
/// The daemon sends no command before the first measurement, because it does not know the robot's
/// configuration. A driver that waits for a command before it measures waits forever. The robot is at rest
/// before the first command and after `valid_until_ns` of the newest one.
///
/// A command that the robot must not follow is refused ([`CommandRefusal`]): counted and reported; the driver
/// continues. The commands for another driver are among them: a driver whose measurements the daemon refuses rests. Commands are checked against the robot limits that the daemon had when this driver was opened;
/// a restarted daemon with wider limits does not widen them.
///
/// A driver continues to measure while the daemon is down. The next daemon starts at rest from these
/// measurements, and its commands are accepted once those of the old daemon have expired. The robot does not
/// move: positions keep their distance from the commanded ones ([`offset`](Self::offset)). No action is
/// needed; [`DriverUpdate::new_daemon`] informs a driver that requires confirmation.
#[derive(Debug)]
pub struct Driver {
    interface: Interface,
    robot: RobotDescription,
    measurements: Outlet<Measurement>,
    commands: CommandStream,
    follower: CommandFollower,
    measured: Cell<Measured>,
    opened: Instant,
}

/// Result of [`Driver::update`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriverUpdate {
    /// The newest accepted command.
    pub command: Option<Command>,
    /// `sender_id` of a new daemon, when it has taken over.
    pub new_daemon: Option<u64>,
    /// The newest refusal, if any.
    pub refused: Option<CommandRefusal>,
}

impl Driver {
    /// Connects to the daemon that controls `robot` at `location`, as a driver that obeys `interface`. Opens
    /// only the services of a driver, so other clients cannot exhaust its connections.
    ///
    /// # Errors
    /// As [`Connection::open`](crate::Connection::open), and [`ConnectError::Port`] when other drivers use
    /// all ports.
    pub fn connect(
        location: &Location,
        robot: &str,
        interface: Interface,
    ) -> Result<Self, ConnectError> {
        let place = Place::new(location, robot);
        Service::Measurement.name(robot)?;
        check_owner(location, &place)?;
        check_clock(location, &place)?;
        let services = DriverServices::open(location, &place)?;
        let mut statuses = StatusReader::new(Stream::open_reserved(&services.status)?);
        let status = statuses.fresh_within(STATUS_TIMEOUT)?;
        let robot = status.ok_or_else(|| no_status(location, &place))?.robot;
        let DriverServices {
            measurement,
            command,
            ..
        } = &services;
        let driver = Self::open(
            measurement,
            command,
            MessageSender::new(),
            &robot,
            interface,
        )?;
        Ok(driver)
    }

    /// Like [`connect`](Self::connect) for a daemon that is starting or whose ports are in use: retries until
    /// `timeout`.
    ///
    /// # Errors
    /// As [`connect`](Self::connect), with the error of the last attempt.
    pub fn connect_within(
        location: &Location,
        robot: &str,
        interface: Interface,
        timeout: Duration,
    ) -> Result<Self, ConnectError> {
        retry(timeout, ConnectError::may_pass_with_others, || {
            Self::connect(location, robot, interface)
        })
    }

    pub(crate) fn open(
        measurement: &Channel<Measurement>,
        command: &Channel<Command>,
        sender: MessageSender,
        robot: &RobotDescription,
        interface: Interface,
    ) -> Result<Self, LinkError> {
        Ok(Self {
            interface,
            robot: *robot,
            measurements: Outlet::open(measurement, sender)?,
            commands: Stream::open_reserved(command)?,
            follower: CommandFollower::new(robot, interface),
            measured: Cell::default(),
            opened: Instant::now(),
        })
    }

    /// Description of the robot when this driver was opened.
    pub fn robot(&self) -> &RobotDescription {
        &self.robot
    }

    /// Sends a measurement, with the interface that this driver obeys, and the newest rest of its velocity-controlled motors
    /// ([`CommandFollower::rest_ns`]) unless the measurement states one.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send(&self, measurement: Measurement) -> Result<Header, LinkError> {
        let now_ns = monotonic_ns();
        self.measured
            .set(self.measured.get().with(&measurement, now_ns));
        let mut measurement = Measurement {
            interface: self.interface.code(),
            ..measurement
        };
        if self.interface == Interface::Velocity && measurement.rested_until_ns == 0 {
            let rest_ns = self.follower.rest_ns(now_ns);
            measurement.rested_from_ns = rest_ns.start;
            measurement.rested_until_ns = rest_ns.end;
        }
        self.measurements.send(measurement)
    }

    /// Sends cable lengths \[m\] and the time of their measurement \[ns, `CLOCK_MONOTONIC`\].
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send_cable_lengths(
        &self,
        measured_ns: u64,
        cable_length_m: [f64; CABLES_MAX],
    ) -> Result<Header, LinkError> {
        self.send(Measurement {
            measured_ns,
            kind: MeasurementKind::CableLengths.code(),
            sections: self.robot.sections,
            cable_length_m,
            ..Measurement::default()
        })
    }

    /// Processes all queued commands, oldest first, and returns what is new. Never blocks. A driver that
    /// obeys positions ignores commands before its first measurement, of which a tip counts only if no bends
    /// or cables follow within [`BENDS_LATE_MS`](cdcr_shared_types::limits::BENDS_LATE_MS). Its first
    /// position must agree with the measured bends or cables; nothing is compared with a tip.
    ///
    /// # Errors
    /// When iceoryx2 fails. A refused command is not an error.
    pub fn update(&mut self) -> Result<DriverUpdate, LinkError> {
        let mut update = DriverUpdate::default();
        let measured = self.measured.get();
        if let Some(measured) = &measured.bends {
            self.follower.tell_measured(measured);
        }
        let own_id = self.measurements.sender_id();
        if measured.has_begun() {
            self.follower.tell_sender(own_id);
        }
        // Whether this process measures at all shows only after some time.
        let may_measure = !measured.has_begun() && self.opened.elapsed() < MEASURES_WITHIN;
        let awaits_measurement =
            self.interface == Interface::Position && !measured.may_begin(monotonic_ns());
        while let Some(command) = self.commands.try_next()? {
            // A command of the other interface is still refused.
            if awaits_measurement && command.interface == self.interface.code() {
                continue;
            }
            if may_measure && follower::is_for_another(&command, own_id) {
                continue;
            }
            update.take(&mut self.follower, &command, monotonic_ns());
        }
        Ok(update)
    }

    /// Commanded rates at `now_ns`; see [`CommandFollower::rates_at`].
    pub fn rates_at(&self, now_ns: u64) -> CommandedRates {
        self.follower.rates_at(now_ns)
    }

    /// Commanded position at `now_ns`; see [`CommandFollower::position_at`].
    pub fn position_at(&self, now_ns: u64) -> Option<CommandedPosition> {
        self.follower.position_at(now_ns)
    }

    /// Offset of that position from the daemon's commanded one; see [`CommandFollower::offset`].
    pub fn offset(&self) -> Option<CommandedPosition> {
        self.follower.offset()
    }

    /// States where the motors stand before the first command; see [`CommandFollower::stand_at`].
    ///
    /// # Errors
    /// As there.
    pub fn stand_at(&mut self, place: CommandedPosition) -> Result<(), CommandRefusal> {
        self.follower.stand_at(place)
    }

    /// Number of commands refused so far.
    pub fn refusals(&self) -> u64 {
        self.follower.refusals()
    }

    /// Why the newest refused command was refused, for programs that do not call [`update`](Self::update) themselves.
    pub fn last_refusal(&self) -> Option<CommandRefusal> {
        self.follower.last_refusal()
    }

    /// Rests until the next command; see [`CommandFollower::forget`].
    pub fn forget(&mut self) {
        self.follower.forget();
    }

    /// Like [`update`](Self::update), but returns the newest command only.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn newest_command(&mut self) -> Result<Option<Command>, LinkError> {
        Ok(self.update()?.command)
    }

    /// The next accepted command, or `None` when none arrived within `timeout`.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn next_command(&mut self, timeout: Duration) -> Result<Option<Command>, LinkError> {
        let deadline = Instant::now() + timeout;
        loop {
            let command = self.newest_command()?;
            if command.is_some() || Instant::now() >= deadline {
                return Ok(command);
            }
            thread::sleep(POLL_INTERVAL);
        }
    }
}

impl DriverUpdate {
    fn take(&mut self, follower: &mut CommandFollower, command: &Command, now_ns: u64) {
        let before = follower.sender_id();
        match follower.take(command, now_ns) {
            // Before the reset of a stopped robot no first command is in force.
            Ok(()) if follower.sender_id().is_none() => {}
            Ok(()) => {
                self.command = Some(*command);
                let sender_id = command.header.sender_id;
                if before.is_some_and(|before| before != sender_id) {
                    self.new_daemon = Some(sender_id);
                }
            }
            Err(refusal) => self.refused = Some(refusal),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_update_lists_what_is_new() {
        let robot = RobotDescription {
            sections: 1,
            ..RobotDescription::default()
        };
        let mut follower = CommandFollower::new(&robot, Interface::Velocity);
        let of = |sender_id, time_ns| Command {
            header: Header {
                sender_id,
                sequence: time_ns,
                sent_ns: time_ns,
            },
            cycle: time_ns,
            release_ns: time_ns,
            target_ns: time_ns + 10,
            valid_until_ns: time_ns + 30,
            sections: 1,
            interface: Interface::Velocity.code(),
            ..Command::default()
        };
        let mut update = |commands: &[Command]| {
            let mut update = DriverUpdate::default();
            for command in commands {
                update.take(&mut follower, command, command.release_ns + 1);
            }
            let taken = update.command.map(|command| command.release_ns);
            (taken, update.new_daemon, update.refused.is_some())
        };
        assert_eq!(update(&[]), (None, None, false));
        // The first daemon is not a new daemon.
        assert_eq!(update(&[of(1, 100), of(1, 110)]), (Some(110), None, false));
        // A refusal is reported along with the accepted command.
        assert_eq!(update(&[of(1, 110), of(1, 120)]), (Some(120), None, true));
        assert_eq!(update(&[of(2, 130)]), (None, None, true));
        assert_eq!(
            update(&[of(2, 200), of(2, 210)]),
            (Some(210), Some(2), false)
        );
        assert_eq!(update(&[of(2, 220)]), (Some(220), None, false));
    }
}
