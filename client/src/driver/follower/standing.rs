//! Where the motors stand when a driver is started again.

use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::POSE_DIFFERS_RAD;
use cdcr_shared_types::{Command, Measurement};

use super::{CommandFollower, CommandRefusal, CommandedPosition, bounds, measured_bends};

impl CommandFollower {
    /// States where the motors stand before the first command: the last [`position_at`](Self::position_at) that this driver gave them
    /// before it was started again. They stay there, and the distance from the measured robot becomes the [`offset`](Self::offset): a load
    /// keeps it beside them. Without this a first command moves them to the measured position, and the robot by its load.
    ///
    /// A place that is more than 0.2 rad from the measured robot is refused with the first command. Do not call it where the motors
    /// were without torque. [`forget`](Self::forget) forgets it.
    ///
    /// # Errors
    /// A number that is not finite, a place beyond the limits of the robot, cables that are not those of the bends, and a place
    /// that is stated after the first command ([`CommandRefusal::Begun`]).
    pub fn stand_at(&mut self, place: CommandedPosition) -> Result<(), CommandRefusal> {
        if self.present.is_some() {
            return Err(CommandRefusal::Begun);
        }
        let command = place.in_command(&Command::default());
        bounds::check(&self.robot, Interface::Position, &command, None)?;
        bounds::check_mean_lengths(&self.robot, &place.cable_length_m)?;
        let cables = Measurement {
            kind: MeasurementKind::CableLengths.code(),
            cable_length_m: place.cable_length_m,
            ..Measurement::default()
        };
        let bends = Measurement {
            kind: MeasurementKind::Configuration.code(),
            bend_rad: measured_bends::bends_rad(&self.robot, &cables),
            ..Measurement::default()
        };
        bounds::check_near(&self.robot, &command, &bends)?;
        self.standing = Some(place);
        Ok(())
    }

    /// Refuses a stated place so far from the robot that no load explains it: the place is wrong, or something holds the robot.
    pub(super) fn check_standing(&self) -> Result<(), CommandRefusal> {
        let (None, Some(place), Some(measured)) = (&self.present, &self.standing, &self.measured)
        else {
            return Ok(());
        };
        let bends_rad = measured_bends::bends_rad(&self.robot, measured);
        let pairs = place.bend_rad.iter().zip(bends_rad);
        let apart_rad = pairs.map(|(place, bend)| (place - bend).abs());
        match apart_rad
            .into_iter()
            .find(|rad| rad.is_nan() || *rad > POSE_DIFFERS_RAD)
        {
            Some(apart_rad) => Err(CommandRefusal::Held { apart_rad }),
            None => Ok(()),
        }
    }
}
