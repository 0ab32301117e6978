use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::{Command, Measurement, RobotDescription};

use super::{CommandRefusal, CommandedPosition, CommandedRates, bounds};

/// What a driver obeys at any time, from the commands that reached it: speeds that end, positions that are not
/// overshot, and nothing that the robot must not do.
///
/// [`Driver`](crate::Driver) feeds one from shared memory. It is public for a driver that gets its commands some other way,
/// and computes only: the time comes in as a value.
#[derive(Debug, Clone)]
pub struct CommandFollower {
    robot: RobotDescription,
    interface: Interface,
    present: Option<Present>,
    measured: Option<Measurement>,
    refusals: u64,
}

/// The command in force, and its move.
#[derive(Debug, Clone, Copy)]
struct Present {
    command: Command,
    begin: CommandedPosition,
    end: CommandedPosition,
    /// When the move ends \[ns\].
    end_ns: u64,
}

impl Present {
    /// Which part of the move is done, 0 to 1.
    fn part(&self, now_ns: u64) -> f64 {
        let begin_ns = self.command.release_ns;
        if now_ns >= self.end_ns {
            1.0
        } else if now_ns <= begin_ns {
            0.0
        } else {
            (now_ns - begin_ns) as f64 / (self.end_ns - begin_ns) as f64
        }
    }
}

/// Longer than any move: what a robot that may not move at all would need \[s\].
const MOVE_MAX_S: f64 = 1e6;
/// What rounding may add to a move that takes one period \[s\].
const ROUNDING_S: f64 = 1e-8;

impl CommandFollower {
    /// Follows nothing yet, and no command beyond the limits of `robot`.
    pub fn new(robot: &RobotDescription, interface: Interface) -> Self {
        Self {
            robot: *robot,
            interface,
            present: None,
            measured: None,
            refusals: 0,
        }
    }

    /// Tells what was measured last. A first position is held to it: motors that have stood elsewhere hold until a reset has
    /// brought the commanded position to them. Without any measurement of bends or cables it is taken as it is.
    pub fn tell_measured(&mut self, measurement: &Measurement) {
        self.measured = Some(*measurement);
    }

    /// Takes a command that arrived at `now_ns`. One of another daemon is taken when that of the present one has run out.
    ///
    /// # Errors
    /// Why it is not followed; it is counted, too. The one before stays in force until it runs out.
    pub fn take(&mut self, command: &Command, now_ns: u64) -> Result<(), CommandRefusal> {
        let begin = self.position_at(command.release_ns);
        if let Err(refusal) = self.check(command, begin.as_ref(), now_ns) {
            self.refusals += 1;
            return Err(refusal);
        }
        let end = CommandedPosition {
            bend_rad: command.bend_target_rad,
            cable_length_m: command.cable_length_m,
        };
        // The first position of all is where the robot was measured: there is no way to it.
        let begin = begin.unwrap_or(end);
        self.present = Some(Present {
            command: *command,
            begin,
            end,
            end_ns: self.end_ns(command, &begin, &end),
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

    /// The target is reached in time, unless the robot would have to be faster than it may be: after commands that
    /// were lost, or where control begins anew beside the old position.
    fn end_ns(&self, command: &Command, begin: &CommandedPosition, end: &CommandedPosition) -> u64 {
        let shortest_s = bounds::shortest_s(&self.robot, begin, end) - ROUNDING_S;
        let shortest_ns = (1e9 * shortest_s.clamp(0.0, MOVE_MAX_S)) as u64;
        command
            .target_ns
            .max(command.release_ns.saturating_add(shortest_ns))
    }

    /// How fast the robot shall move at `now_ns`: at rest before the first command, and from the newest one's
    /// `valid_until_ns` on. For a driver that obeys [`Interface::Velocity`].
    pub fn rates_at(&self, now_ns: u64) -> CommandedRates {
        match &self.present {
            Some(Present { command, .. }) if now_ns < command.valid_until_ns => CommandedRates {
                bend_rate_rad_s: command.bend_rate_rad_s,
                cable_speed_m_s: command.cable_speed_m_s,
            },
            _ => CommandedRates::default(),
        }
    }

    /// Where the robot shall be at `now_ns`: from where the command before led at this one's release, on a straight line, to
    /// its target at `target_ns`, and there until the next command. `None` before the first. For a driver that obeys
    /// [`Interface::Position`].
    ///
    /// It is never past the target, never faster than the robot's limits (then it arrives later), and it stays where it
    /// is from `valid_until_ns` on.
    pub fn position_at(&self, now_ns: u64) -> Option<CommandedPosition> {
        self.present.as_ref().map(|present| {
            let now_ns = now_ns.min(present.command.valid_until_ns);
            present.begin.towards(&present.end, present.part(now_ns))
        })
    }

    /// The daemon whose command is in force, or was the last one.
    pub fn sender_id(&self) -> Option<u64> {
        self.present.map(|present| present.command.header.sender_id)
    }

    /// Commands that were refused.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    /// Rests until the next command, which is then a first one again. For motors whose torque was off: they are no
    /// longer where the last command led. To be called after the reset: until then the commands name the old position.
    pub fn forget(&mut self) {
        self.present = None;
    }
}

/// Numbers and times of one daemon only rise. Those of another begin anew, so its commands must be later, and the
/// present one silent.
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
