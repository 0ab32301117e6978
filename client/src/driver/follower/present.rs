use cdcr_shared_types::Command;

use crate::driver::CommandedPosition;

/// The command in force, with its move.
#[derive(Debug, Clone, Copy)]
pub(super) struct Present {
    pub(super) command: Command,
    pub(super) begin: CommandedPosition,
    pub(super) end: CommandedPosition,
    /// Offset of the positions from those of the command, since another daemon has taken over, or since a command was
    /// taken after a gap in Stopped or Faulted.
    pub(super) offset: Option<CommandedPosition>,
    /// Highest speed of the move as a share of the robot's; 1 unless it catches up.
    pub(super) pace: f64,
    /// It makes up for a gap, for longer than a period.
    pub(super) catches_up: bool,
    /// The motors stay while a reset moves the commanded position to a robot that a load keeps beside them.
    pub(super) stays: bool,
    /// Time at which the command was taken and the move began \[ns\].
    pub(super) begin_ns: u64,
    /// Time at which the move ends \[ns\].
    pub(super) end_ns: u64,
}

impl Present {
    pub(super) fn is_of_sender(&self, command: &Command) -> bool {
        self.command.header.sender_id == command.header.sender_id
    }

    /// Time from which the motors stand unless another command comes \[ns\].
    pub(super) fn stands_from_ns(&self) -> u64 {
        self.end_ns.min(self.command.valid_until_ns)
    }

    /// A command at `now_ns` comes after a gap: the present one has expired, or the gap before it is not yet caught up.
    pub(super) fn has_gap(&self, now_ns: u64) -> bool {
        now_ns >= self.command.valid_until_ns || self.catches_up
    }

    /// The command has not expired, by a clock that is not behind.
    pub(super) fn is_valid_at(&self, now_ns: u64) -> bool {
        let valid_ns = self
            .command
            .valid_until_ns
            .saturating_sub(self.command.release_ns);
        now_ns < self.command.valid_until_ns && now_ns.saturating_add(valid_ns) >= self.begin_ns
    }

    pub(super) fn position_at(&self, now_ns: u64) -> CommandedPosition {
        let now_ns = now_ns.min(self.command.valid_until_ns);
        self.begin.towards(&self.end, self.part(now_ns))
    }

    /// Completed part of the move, 0 to 1.
    pub(super) fn part(&self, now_ns: u64) -> f64 {
        if now_ns >= self.end_ns {
            1.0
        } else if now_ns <= self.begin_ns {
            0.0
        } else {
            (now_ns - self.begin_ns) as f64 / (self.end_ns - self.begin_ns) as f64
        }
    }
}
