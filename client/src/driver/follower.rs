use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::{Command, Measurement, RobotDescription};

use super::{CommandRefusal, CommandedPosition, CommandedRates, bounds};

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
    refusals: u64,
}

/// The command in force, with its move.
#[derive(Debug, Clone, Copy)]
struct Present {
    command: Command,
    begin: CommandedPosition,
    end: CommandedPosition,
    /// Time at which the command was taken and the move began \[ns\].
    begin_ns: u64,
    /// Time at which the move ends \[ns\].
    end_ns: u64,
}

impl Present {
    /// Completed part of the move, 0 to 1.
    fn part(&self, now_ns: u64) -> f64 {
        if now_ns >= self.end_ns {
            1.0
        } else if now_ns <= self.begin_ns {
            0.0
        } else {
            (now_ns - self.begin_ns) as f64 / (self.end_ns - self.begin_ns) as f64
        }
    }
}

/// Upper bound of the duration of a move, which is infinite for a robot without any speed \[s\].
const MOVE_MAX_S: f64 = 1e6;
/// Allowance for rounding of a move that takes one period \[s\].
const ROUNDING_S: f64 = 1e-8;

impl CommandFollower {
    /// A follower without a command, which refuses commands beyond the limits of `robot`.
    pub fn new(robot: &RobotDescription, interface: Interface) -> Self {
        Self {
            robot: *robot,
            interface,
            present: None,
            measured: None,
            refusals: 0,
        }
    }

    /// Sets the last measurement of bends or cables, which a first position must match. Motors at another
    /// position are held until a reset has set the commanded position to theirs. A tip does not count: where
    /// nothing else is measured, any first position is accepted.
    pub fn tell_measured(&mut self, measurement: &Measurement) {
        if measurement.kind != MeasurementKind::TipPose.code() {
            self.measured = Some(*measurement);
        }
    }

    /// Processes a command that arrived at `now_ns`. A command of another daemon is accepted once the present
    /// command has expired.
    ///
    /// # Errors
    /// The reason of a refusal, which is also counted. The present command stays in force until it expires.
    pub fn take(&mut self, command: &Command, now_ns: u64) -> Result<(), CommandRefusal> {
        let begin = self.position_at(now_ns);
        if let Err(refusal) = self.check(command, begin.as_ref(), now_ns) {
            self.refusals += 1;
            return Err(refusal);
        }
        let end = CommandedPosition {
            bend_rad: command.bend_target_rad,
            cable_length_m: command.cable_length_m,
        };
        // The robot was measured at the first position: there is no move to it.
        let begin = begin.unwrap_or(end);
        // Late commands must not make up for their delay by a jump.
        let shortest_s = bounds::shortest_s(&self.robot, &begin, &end) - ROUNDING_S;
        let shortest_ns = (1e9 * shortest_s.clamp(0.0, MOVE_MAX_S)) as u64;
        self.present = Some(Present {
            command: *command,
            begin,
            end,
            begin_ns: now_ns,
            end_ns: command.target_ns.max(now_ns.saturating_add(shortest_ns)),
        });
        Ok(())
    }

    fn check(
        &self,
        command: &Command,
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
        bounds::check(&self.robot, self.interface, command, standing)?;
        match (standing, &self.measured) {
            (None, Some(measured)) if self.interface == Interface::Position => {
                bounds::check_near(&self.robot, command, measured)
            }
            _ => Ok(()),
        }
    }

    /// Commanded rates at `now_ns`: rest before the first command and after `valid_until_ns` of the newest
    /// one. For a driver that obeys [`Interface::Velocity`].
    pub fn rates_at(&self, now_ns: u64) -> CommandedRates {
        match &self.present {
            Some(Present { command, .. }) if now_ns < command.valid_until_ns => CommandedRates {
                bend_rate_rad_s: command.bend_rate_rad_s,
                cable_speed_m_s: command.cable_speed_m_s,
            },
            _ => CommandedRates::default(),
        }
    }

    /// Commanded position at `now_ns`: on a straight line from the position at which the command was taken to
    /// its target at `target_ns`, then constant. `None` before the first command. For a driver that obeys
    /// [`Interface::Position`].
    ///
    /// The position never overshoots the target and never exceeds the robot's largest rates, so it may arrive
    /// later: after lost or late commands, or when control restarts beside the old position. It is constant
    /// from `valid_until_ns` on.
    pub fn position_at(&self, now_ns: u64) -> Option<CommandedPosition> {
        self.present.as_ref().map(|present| {
            let now_ns = now_ns.min(present.command.valid_until_ns);
            present.begin.towards(&present.end, present.part(now_ns))
        })
    }

    /// The daemon that sent the last accepted command.
    pub fn sender_id(&self) -> Option<u64> {
        self.present.map(|present| present.command.header.sender_id)
    }

    /// Number of refused commands.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    /// Rests until the next command, which is then treated as the first. For motors whose torque was off, so
    /// that they have left the commanded position. Call this after the reset: earlier commands contain the
    /// old position.
    pub fn forget(&mut self) {
        self.present = None;
    }
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
