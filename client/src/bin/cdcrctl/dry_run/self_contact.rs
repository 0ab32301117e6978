//! A body that would touch itself, on a path that the daemon would not complete.

use std::fmt;

use cdcr_controller::robot::{self, Configuration, Robot, RobotError, RobotParameters};

/// The deepest overlap of two parts of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SelfContact {
    time_s: f64,
    contact: robot::SelfContact,
}

/// Overlap that the daemon permits the commands of a robot in this shape \[m\].
pub(super) fn permitted_m(robot: &Robot, shape: &Configuration) -> f64 {
    let most_m = robot.self_overlap_max_m();
    let present = robot.self_contact(shape, most_m);
    present.map_or(most_m, |present| present.overlap_m)
}

/// A robot whose body may touch itself.
pub(super) fn without_limit(robot: &Robot) -> Result<Robot, RobotError> {
    Robot::new(&RobotParameters {
        self_overlap_max_m: *robot::ranges::SELF_OVERLAP_MAX_M.end(),
        ..robot.parameters()
    })
}

impl SelfContact {
    /// Of a shape at this time, if it is deeper than `above_m`.
    pub(super) fn find(
        robot: &Robot,
        shape: &Configuration,
        above_m: f64,
        time_s: f64,
    ) -> Option<Self> {
        let contact = robot.self_contact(shape, above_m)?;
        Some(Self { time_s, contact })
    }

    pub(super) fn overlap_m(&self) -> f64 {
        self.contact.overlap_m
    }
}

impl fmt::Display for SelfContact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [one, other] = self.contact.sections.map(|section| 1 + section);
        write!(
            f,
            "sections {one} and {other} would touch at {:.2} s, {:.0} mm deep by their body_radius_m",
            self.time_s,
            1e3 * self.overlap_m()
        )
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use cdcr_client::model::robot_of;

    use super::*;
    use crate::dry_run::tests::robot;

    fn find(bends_rad: &[f64]) -> Option<SelfContact> {
        let shape = Configuration::from_slice(bends_rad).expect("within the maximum");
        let robot = robot_of(&robot(3)).expect("a robot");
        SelfContact::find(&robot, &shape, robot.self_overlap_max_m(), 1.0)
    }

    #[test]
    fn a_body_touches_itself_where_it_closes_a_ring() {
        assert_eq!(find(&[0.0; 6]), None);
        // Three quarters of a circle.
        assert_eq!(find(&[PI / 2.0, 0.0, PI / 2.0, 0.0, PI / 2.0, 0.0]), None);
        let ring = 2.0 * PI / 3.0;
        let found = find(&[ring, 0.0, ring, 0.0, ring, 0.0]).expect("a ring");
        assert_eq!(found.contact.sections, [0, 2]);
        let text = found.to_string();
        assert!(text.starts_with("sections 1 and 3 would touch"), "{text}");
        let thick_m = 2.0 * robot(3).section[0].body_radius_m;
        assert!((found.overlap_m() - thick_m).abs() < 1e-9, "{found}");
        // Another lap in the same plane lies on the first one.
        let laps = find(&[ring; 6]).expect("two laps");
        assert!((laps.overlap_m() - thick_m).abs() < 1e-9, "{laps}");
    }

    /// In a ring, only what is deeper than the ring is not permitted.
    #[test]
    fn a_start_in_contact_permits_its_own_overlap() {
        let robot = robot_of(&robot(3)).expect("a robot");
        let ring = 2.0 * PI / 3.0;
        let at = |bend_rad| Configuration::from_bend_angles(&[[bend_rad, 0.0]; 3]);
        let (open, closed) = (at(PI / 2.0), at(ring));
        let permitted = [&open, &closed].map(|shape| permitted_m(&robot, shape));
        assert!(permitted[0] < permitted[1]);
        let found = permitted.map(|most_m| SelfContact::find(&robot, &closed, most_m, 1.0));
        assert!(found[0].is_some() && found[1].is_none());
        assert_eq!(
            without_limit(&robot).map(|it| permitted_m(&it, &closed)),
            Ok(2.0)
        );
    }
}
