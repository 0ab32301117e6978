mod present;
mod standing;

use std::ops::Range;

use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode};
use cdcr_shared_types::{Command, Measurement, RobotDescription};

use present::Present;

use super::load::Load;
use super::{
    CommandRefusal, CommandedPosition, CommandedRates, bounds, measured_bends, section_ends,
};

/// Rates and positions that a driver applies at any time, from the received commands. Rates expire, positions
/// do not overshoot, and inadmissible commands are refused.
///
/// [`Driver`](crate::Driver) supplies one from shared memory. It is public for drivers that receive commands
/// by other means. It has no clock: the time is an argument.
#[derive(Debug, Clone)]
pub struct CommandFollower {
    robot: RobotDescription,
    interface: Interface,
    present: Option<Present>,
    measured: Option<Measurement>,
    load: Load,
    /// Where the motors stand before the first command, if the driver knows.
    standing: Option<CommandedPosition>,
    /// Sender of this driver's own measurements.
    own_id: Option<u64>,
    /// The newest rest that is over.
    rested: Rest,
    refusals: u64,
    last_refusal: Option<CommandRefusal>,
}

/// A time in which the motors rested.
#[derive(Debug, Clone, Default)]
struct Rest {
    /// \[ns\]
    range_ns: Range<u64>,
    /// Time inside it in which they obeyed \[ns\].
    obeyed_ns: u64,
}

/// Upper bound of the duration of a move, which is infinite for a robot without any speed \[s\].
const MOVE_MAX_S: f64 = 1e6;
/// Allowance for rounding of a move that takes one period \[s\].
const ROUNDING_S: f64 = 1e-8;
/// After a gap the motors move at this multiple of the commanded speed at most: at twice the speed they have caught up
/// after as long as the gap was.
const CATCH_UP: f64 = 2.0;
/// Section ends move at this multiple of their limit at most: positions are followed more slowly, speeds refused. The daemon limits
/// the speed in the estimated shape of the robot, which is not quite this driver's; one that was started again may have a wider limit.
const TIP_SPEED_MARGIN: f64 = 1.5;
/// Least share of the robot's speed at which a move is made, so that a short one ends.
const PACE_MIN: f64 = 1e-3;

impl CommandFollower {
    /// A follower without a command, which refuses commands beyond the limits of `robot`.
    pub fn new(robot: &RobotDescription, interface: Interface) -> Self {
        Self {
            robot: *robot,
            interface,
            present: None,
            measured: None,
            load: Load::default(),
            standing: None,
            own_id: None,
            rested: Rest::default(),
            refusals: 0,
            last_refusal: None,
        }
    }

    /// Sets the last measurement of bends or cables, which a first position must match. Motors at another
    /// position are held until a reset has set the commanded position to theirs. A tip does not count: where
    /// nothing else is measured, any first position is accepted.
    pub fn tell_measured(&mut self, measurement: &Measurement) {
        if measurement.kind == MeasurementKind::TipPose.code() {
            return;
        }
        self.measured = Some(*measurement);
        let measured_ns = measurement.measured_ns;
        if let Some(present) = &self.present {
            let obeys = !rests(&present.command) && !present.has_gap(measured_ns);
            let motors = present.position_at(measured_ns);
            self.load.learn(&self.robot, &motors, measurement, obeys);
        }
    }

    /// Sets the sender id of this driver's measurements. Commands that act on those of another driver are refused
    /// from then on, and one that was taken before is forgotten.
    pub fn tell_sender(&mut self, sender_id: u64) {
        self.own_id = Some(sender_id);
        let is_foreign = |present: &Present| is_for_another(&present.command, sender_id);
        if self.present.as_ref().is_some_and(is_foreign) {
            self.forget();
        }
    }

    /// Processes a command that arrived at `now_ns`. A command of another daemon is accepted once the present
    /// command has expired.
    ///
    /// # Errors
    /// The reason of a refusal, which is also counted. The present command stays in force until it expires.
    pub fn take(&mut self, command: &Command, now_ns: u64) -> Result<(), CommandRefusal> {
        let begin = self.position_at(now_ns);
        let stays = self.stays(command, now_ns);
        let offset = self.offset_of(command, begin.as_ref(), stays, now_ns);
        let commanded = CommandedPosition::from_command(command);
        let end = offset.map_or(commanded, |offset| commanded.plus(&offset));
        if let Err(refusal) = self.check(command, &end, begin.as_ref(), now_ns) {
            self.refusals += 1;
            self.last_refusal = Some(refusal);
            return Err(refusal);
        }
        if self.holds_before(command) {
            return Ok(());
        }
        self.rested = self.rest(now_ns);
        // The robot was measured at the first position: there is no move to it.
        let begin = begin.or(self.standing.take()).unwrap_or(end);
        // Late commands must not make up for their delay by a jump.
        let tip_max_m_s = self.tip_speed_max_m_s(command, offset.as_ref());
        let shortest_s = self.shortest_s(&begin, &end, tip_max_m_s) - ROUNDING_S;
        let has_gap = self
            .present
            .as_ref()
            .is_some_and(|present| present.has_gap(now_ns));
        let pace = self.pace(command, shortest_s, tip_max_m_s, now_ns);
        let takes_ns = (1e9 * (shortest_s / pace).clamp(0.0, MOVE_MAX_S)) as u64;
        let arrives_ns = now_ns.saturating_add(takes_ns);
        let is_late = arrives_ns > command.target_ns;
        // At full speed a move of one period ends as late as it began.
        let is_long = pace < 1.0 || takes_ns > command.target_ns - command.release_ns;
        let catches_up = has_gap && is_late && is_long;
        self.present = Some(Present {
            command: *command,
            begin,
            end,
            offset,
            pace: if catches_up { pace } else { 1.0 },
            catches_up,
            stays,
            begin_ns: now_ns,
            end_ns: command.target_ns.max(arrives_ns),
        });
        Ok(())
    }

    /// A first position in Stopped and Faulted is not followed: nothing moves before the reset.
    fn holds_before(&self, command: &Command) -> bool {
        self.interface == Interface::Position && self.present.is_none() && rests(command)
    }

    /// Highest speed of a move that takes `shortest_s` at the robot's largest one, as a share of that speed. After a gap:
    /// [`CATCH_UP`] times the mean speed of the way that was missed, or of the commands if these are faster now.
    fn pace(&self, command: &Command, shortest_s: f64, tip_max_m_s: f64, now_ns: u64) -> f64 {
        let Some(present) = self.present.as_ref() else {
            return 1.0;
        };
        if !present.has_gap(now_ns) {
            return 1.0;
        }
        let missed = if present.catches_up {
            present.pace
        } else {
            let missed_ns = command
                .target_ns
                .saturating_sub(present.stands_from_ns())
                .max(1);
            CATCH_UP * shortest_s * 1e9 / missed_ns as f64
        };
        let commanded = CATCH_UP * self.commanded_share(&present.command, command, tip_max_m_s);
        missed.max(commanded).clamp(PACE_MIN, 1.0)
    }

    /// Mean speed from `before` to `command`, as a share of the robot's largest one.
    fn commanded_share(&self, before: &Command, command: &Command, tip_max_m_s: f64) -> f64 {
        let positions = [before, command].map(CommandedPosition::from_command);
        let [begin, end] = &positions;
        let takes_ns = command.target_ns.saturating_sub(before.target_ns).max(1);
        self.shortest_s(begin, end, tip_max_m_s) * 1e9 / takes_ns as f64
    }

    /// Minimum time of a move in which no section end is faster than `tip_max_m_s` \[s\].
    fn shortest_s(
        &self,
        begin: &CommandedPosition,
        end: &CommandedPosition,
        tip_max_m_s: f64,
    ) -> f64 {
        let shortest_s = bounds::shortest_s(&self.robot, begin, end);
        if tip_max_m_s == f64::INFINITY {
            return shortest_s;
        }
        shortest_s.max(section_ends::way_m(&self.robot, begin, end) / tip_max_m_s)
    }

    /// Largest speed of a section end \[m/s\]: the robot's, or that of the commands where it is a little larger
    /// ([`TIP_SPEED_MARGIN`]). Infinite without a limit.
    fn tip_speed_max_m_s(&self, command: &Command, offset: Option<&CommandedPosition>) -> f64 {
        let limit_m_s = self.robot.tip_speed_max_m_s;
        if self.interface != Interface::Position || limit_m_s <= 0.0 {
            return f64::INFINITY;
        }
        let Some(present) = self
            .present
            .as_ref()
            .filter(|present| present.is_of_sender(command))
        else {
            return limit_m_s;
        };
        let takes_ns = command.target_ns.saturating_sub(present.command.target_ns);
        if takes_ns == 0 {
            return limit_m_s;
        }
        let positions = [&present.command, command].map(|command| {
            let commanded = CommandedPosition::from_command(command);
            offset.map_or(commanded, |offset| commanded.plus(offset))
        });
        let [begin, end] = &positions;
        let way_m = section_ends::way_m(&self.robot, begin, end);
        (way_m * 1e9 / takes_ns as f64).clamp(limit_m_s, TIP_SPEED_MARGIN * limit_m_s)
    }

    /// Refuses rates with which a section end would be far beyond its limit.
    fn check_tip_speed(&self, command: &Command) -> Result<(), CommandRefusal> {
        let limit_m_s = self.robot.tip_speed_max_m_s;
        if self.interface != Interface::Velocity || limit_m_s <= 0.0 {
            return Ok(());
        }
        let takes_s = 1e-9 * (command.target_ns - command.release_ns).max(1) as f64;
        let mut begin = CommandedPosition::from_command(command);
        // The commanded shape of velocity-controlled motors may have drifted away from the robot.
        if let Some(measured) = &self.measured {
            let bends_rad = measured_bends::bends_rad(&self.robot, measured);
            if bends_rad.iter().all(|rad| rad.is_finite()) {
                begin.bend_rad = bends_rad;
            }
        }
        let mut end = begin;
        for (bend_rad, rate_rad_s) in end.bend_rad.iter_mut().zip(&command.bend_rate_rad_s) {
            *bend_rad += rate_rad_s * takes_s;
        }
        let speed_m_s = section_ends::way_m(&self.robot, &begin, &end) / takes_s;
        if speed_m_s > TIP_SPEED_MARGIN * limit_m_s {
            return Err(CommandRefusal::TipSpeed {
                speed_m_s,
                limit_m_s,
            });
        }
        Ok(())
    }

    /// In Holding after a reset: the robot is where its load has kept it beside these motors.
    fn stays(&self, command: &Command, now_ns: u64) -> bool {
        let is_kept = |present: &Present| {
            let stays = present.stays && !present.has_gap(now_ns);
            // After a gap on the way, too: the robot has not moved.
            let begins = present.stays || rests(&present.command);
            present.is_of_sender(command) && (stays || begins && self.load.explains_distance())
        };
        self.interface == Interface::Position
            && command.mode == Mode::Holding.code()
            && self.present.as_ref().is_some_and(is_kept)
    }

    /// Offset from the positions of `command`. The positions of another daemon begin where it has measured the
    /// robot. Loaded motors stand elsewhere, and stay there; they move as the positions do.
    ///
    /// In Holding the commanded position moves only to a robot that is elsewhere. Motors that stand there, or that a load
    /// keeps beside it (`stays`), do not move. In Stopped and Faulted motors that missed commands do not make up for them.
    fn offset_of(
        &self,
        command: &Command,
        standing: Option<&CommandedPosition>,
        stays: bool,
        now_ns: u64,
    ) -> Option<CommandedPosition> {
        if self.interface != Interface::Position {
            return None;
        }
        let commanded = CommandedPosition::from_command(command);
        let Some(present) = &self.present else {
            return self.standing.map(|place| place.minus(&commanded));
        };
        let standing = standing?;
        if !present.is_of_sender(command) {
            return Some(standing.minus(&commanded));
        }
        if stays || rests(command) && present.has_gap(now_ns) {
            let end = present
                .offset
                .map_or(commanded, |offset| commanded.plus(&offset));
            // Motors that have missed nothing keep their bits.
            return if end == *standing {
                present.offset
            } else {
                Some(standing.minus(&commanded))
            };
        }
        let offset = present.offset?;
        let way = commanded.minus(&CommandedPosition::from_command(&present.command));
        let rest = offset.minus(&way);
        let holds = command.mode == Mode::Holding.code();
        Some(if holds && rest.size_rad() < offset.size_rad() {
            rest
        } else {
            offset
        })
    }

    fn check(
        &self,
        command: &Command,
        end: &CommandedPosition,
        standing: Option<&CommandedPosition>,
        now_ns: u64,
    ) -> Result<(), CommandRefusal> {
        if command.sections != self.robot.sections {
            return Err(CommandRefusal::Sections {
                commanded: command.sections,
                sections: self.robot.sections,
            });
        }
        if command.interface != self.interface.code() {
            return Err(CommandRefusal::Interface {
                commanded: command.interface,
                driver: self.interface,
            });
        }
        if self
            .own_id
            .is_some_and(|own_id| is_for_another(command, own_id))
        {
            let driver_id = command.driver_id;
            return Err(CommandRefusal::OtherDriver { driver_id });
        }
        if command.target_ns < command.release_ns {
            return Err(CommandRefusal::Times {
                before_ns: command.release_ns - command.target_ns,
            });
        }
        if let Some(present) = &self.present {
            check_newer(&present.command, command, now_ns)?;
        }
        if now_ns >= command.valid_until_ns {
            return Err(CommandRefusal::Expired {
                cycle: command.cycle,
                late_ns: now_ns - command.valid_until_ns,
            });
        }
        self.check_standing()?;
        // The first position of another daemon moves nothing, but the others count from it.
        let checked = match &self.present {
            Some(present) if present.is_of_sender(command) => end.in_command(command),
            _ => *command,
        };
        bounds::check(&self.robot, self.interface, &checked, standing)?;
        self.check_tip_speed(command)?;
        match (standing, &self.measured) {
            (None, Some(measured)) if self.interface == Interface::Position => {
                bounds::check_near(&self.robot, command, measured)
            }
            _ => Ok(()),
        }
    }

    /// Commanded rates at `now_ns`: rest before the first command and after `valid_until_ns` of the newest
    /// one. Also at a time before the newest one was taken by more than it is valid: another clock, with which it would not run
    /// out. For a driver that obeys [`Interface::Velocity`].
    pub fn rates_at(&self, now_ns: u64) -> CommandedRates {
        match &self.present {
            Some(present) if present.is_valid_at(now_ns) => CommandedRates {
                bend_rate_rad_s: present.command.bend_rate_rad_s,
                cable_speed_m_s: present.command.cable_speed_m_s,
            },
            _ => CommandedRates::default(),
        }
    }

    /// The newest time until `now_ns` in which the motors rested because their command had run out, for
    /// [`Measurement::rested_from_ns`]. Rests are one if the motors obeyed between them for less than a period in all. Empty at 0: none since the first command, or since [`forget`](Self::forget).
    /// For a driver that obeys [`Interface::Velocity`].
    pub fn rest_ns(&self, now_ns: u64) -> Range<u64> {
        self.rest(now_ns).range_ns
    }

    fn rest(&self, now_ns: u64) -> Rest {
        let before = self.rested.clone();
        let Some(Present {
            command, begin_ns, ..
        }) = &self.present
        else {
            return before;
        };
        let Some(range_ns) = command.rest_ns(*begin_ns, now_ns) else {
            return before;
        };
        let before_ns = before.range_ns;
        let obeyed_ns = before.obeyed_ns + range_ns.start.saturating_sub(before_ns.end);
        if before_ns.is_empty() || obeyed_ns >= command.target_ns - command.release_ns {
            return Rest {
                range_ns,
                obeyed_ns: 0,
            };
        }
        Rest {
            range_ns: before_ns.start..range_ns.end.max(before_ns.end),
            obeyed_ns,
        }
    }

    /// Commanded position at `now_ns`: on a straight line from the position at which the command was taken to
    /// its target at `target_ns`, then constant. `None` before the first command, and until the reset of a robot that is
    /// Stopped or Faulted then: the motors hold. For a driver that obeys
    /// [`Interface::Position`].
    ///
    /// The position never overshoots the target and never exceeds the robot's largest rates and cable speeds, nor the largest speed
    /// of the section ends where the commands do not (by half of it where they do), so it may arrive later, after lost or late commands. It is constant from `valid_until_ns` on. Another daemon does not move
    /// it by taking over ([`offset`](Self::offset)).
    ///
    /// If the next command comes after that time, because the driver hung or commands were lost, the position catches up
    /// at about twice the speed of the commands, inside these limits. In Stopped and Faulted it stays where it stands, and keeps its distance.
    pub fn position_at(&self, now_ns: u64) -> Option<CommandedPosition> {
        self.present.map(|present| present.position_at(now_ns))
    }

    /// Offset of [`position_at`](Self::position_at) from the commanded position; `None` until another daemon
    /// takes over, the motors miss commands before one in Stopped or Faulted, a loaded robot is reset, or the driver begins [elsewhere](Self::stand_at).
    ///
    /// The commanded position of a daemon that was started again begins where the robot is measured. A load
    /// separates this from the position of the motors. They do not move to it but keep their distance, until
    /// [`forget`](Self::forget). The distance shrinks where a reset moves the commanded position to them. Motors of a robot
    /// that a load keeps beside them stay at a reset, too: the distance is then that of the load.
    pub fn offset(&self) -> Option<CommandedPosition> {
        self.present.and_then(|present| present.offset)
    }

    /// The daemon that sent the last accepted command.
    pub fn sender_id(&self) -> Option<u64> {
        self.present.map(|present| present.command.header.sender_id)
    }

    /// Number of refused commands.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    /// Why the newest refused command was refused.
    pub fn last_refusal(&self) -> Option<CommandRefusal> {
        self.last_refusal
    }

    /// Rests until the next command, which is then treated as the first. For motors whose torque was off, so
    /// that they have left the commanded position. Call this after the reset: earlier commands contain the
    /// old position.
    pub fn forget(&mut self) {
        (self.present, self.standing) = (None, None);
        self.load = Load::default();
        self.rested = Rest::default();
    }
}

fn rests(command: &Command) -> bool {
    Mode::is_latched(command.mode)
}

/// It acts on the measurements of another driver than `own_id`.
pub(super) fn is_for_another(command: &Command, own_id: u64) -> bool {
    ![0, own_id].contains(&command.driver_id)
}

/// Sequence numbers and times of one daemon increase. Those of another daemon start again, so its commands
/// must be later, and the present command expired.
fn check_newer(present: &Command, command: &Command, now_ns: u64) -> Result<(), CommandRefusal> {
    let is_same = command.header.sender_id == present.header.sender_id;
    let is_newer = command.release_ns > present.release_ns
        && (!is_same
            || command.header.sequence > present.header.sequence && command.cycle > present.cycle);
    if !is_newer {
        return Err(CommandRefusal::NotNewer {
            cycle: command.cycle,
            present: present.cycle,
        });
    }
    if !is_same && now_ns < present.valid_until_ns {
        return Err(CommandRefusal::OtherDaemon {
            sender: command.header.sender_id,
            present: present.header.sender_id,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
