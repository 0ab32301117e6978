//! Where the motors stand when a daemon or a driver takes over.

use cdcr_shared_types::Command;
use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::limits::POSE_DIFFERS_RAD;

use super::{CommandFollower, CommandRefusal, CommandedPosition, measured_bends};

impl CommandFollower {
    /// States where the motors stand before the first command: the last [`position_at`](Self::position_at) that this driver gave them
    /// before it was started again. They stay there, and the distance from the measured robot becomes the [`offset`](Self::offset): a load
    /// keeps it beside them. Without this a first command moves them to the measured position, and the robot by its load.
    ///
    /// A place that is more than 0.2 rad from the measured robot is refused with the first command. Do not call it where the motors
    /// were without torque. [`forget`](Self::forget) forgets it.
    pub fn stand_at(&mut self, place: CommandedPosition) {
        self.standing = Some(place);
    }

    /// Refuses to take over motors that stand so far from the robot that something holds it: with each restart they would
    /// press more, and neither daemon nor person would see it.
    pub(super) fn check_standing(&self, command: &Command) -> Result<(), CommandRefusal> {
        let apart_rad = match (&self.present, &self.standing) {
            _ if self.interface != Interface::Position => 0.0,
            (Some(present), _) if present.is_of_sender(command) => 0.0,
            (Some(_), _) => self.load.change_rad(),
            (None, Some(place)) => self.apart_rad(place),
            (None, None) => 0.0,
        };
        if apart_rad > POSE_DIFFERS_RAD {
            return Err(CommandRefusal::Held { apart_rad });
        }
        Ok(())
    }

    /// Largest distance of this place from the measured bends \[rad\]; 0 where none are measured.
    fn apart_rad(&self, place: &CommandedPosition) -> f64 {
        let measured = self.measured.as_ref();
        measured.map_or(0.0, |measured| {
            let bends_rad = measured_bends::bends_rad(&self.robot, measured);
            let pairs = place.bend_rad.iter().zip(bends_rad);
            pairs.fold(0.0, |most, (place, bend)| most.max((place - bend).abs()))
        })
    }
}
