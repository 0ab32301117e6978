use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::counted;

/// Reason to refuse a command. The previous one stays in force until it expires.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CommandRefusal {
    /// A number is NaN or infinite.
    #[error("the command contains a number that is not finite")]
    NotFinite,
    /// The daemon controls a robot with another number of sections.
    #[error(
        "the command is for {}, but this robot has {sections}: the daemon is of another robot",
        counted(*commanded, "section")
    )]
    Sections {
        /// Sections of the command.
        commanded: u32,
        /// Sections of the robot.
        sections: u32,
    },
    /// The daemon uses the other interface, or an unknown one.
    #[error(
        "the daemon commands by {}, but this driver follows the interface {driver}: set link.interface",
        Interface::try_from(*commanded).map_or_else(|code| format!("an {code}"), |known| format!("the interface {known}"))
    )]
    Interface {
        /// Code in the command.
        commanded: u32,
        /// Interface of the driver.
        driver: Interface,
    },
    /// The daemon acts on the measurements of another driver: the command is not for these motors.
    #[error(
        "the daemon acts on the measurements of another driver ({driver_id:#018x}), not on those of this one: end one of them. \
         A tip sensor beside a driver needs link.tip_sensor = \"separate\""
    )]
    OtherDriver {
        /// Sender of those measurements.
        driver_id: u64,
    },
    /// The target time is before the release.
    #[error("the target of the command is {before_ns} ns before its release")]
    Times {
        /// Time by which the target precedes the release \[ns\].
        before_ns: u64,
    },
    /// The command is not newer than the one in force: its sequence number, cycle or release went back.
    #[error("the command of cycle {cycle} is not newer than the present one of cycle {present}")]
    NotNewer {
        /// Cycle of the command.
        cycle: u64,
        /// Cycle of the command in force.
        present: u64,
    },
    /// Another daemon sends commands while the command of the present one is valid.
    #[error("a second daemon ({sender:#018x}) commands beside {present:#018x}: end one of them")]
    OtherDaemon {
        /// Sender of the command.
        sender: u64,
        /// Sender of the command in force.
        present: u64,
    },
    /// The command had expired when it arrived.
    #[error("the command of cycle {cycle} arrived {late_ns} ns after it had expired")]
    Expired {
        /// Cycle of the command.
        cycle: u64,
        /// Time since it expired \[ns\].
        late_ns: u64,
    },
    /// The first position differs from the measured one.
    #[error(
        "the first commanded position differs from the measured one: component {at} by {way:.6}, allowed is {most:.6} \
         (rad, or m of a cable). Where the three cables of a section differ alike, set their zero (docs/drivers.md, Zero). Otherwise check the robot, then cdcrctl reset, with --accept-pose where cdcrctl status asks for it"
    )]
    Elsewhere {
        /// Index of the bend component or cable, whichever was measured.
        at: usize,
        /// Distance that its motor would jump \[rad or m\].
        way: f64,
        /// Largest distance allowed \[rad or m\].
        most: f64,
    },
    /// The stated place of the motors is more than 0.2 rad from the measured robot: it presses against something, was moved, or the place is
    /// wrong.
    #[error(
        "the robot is {apart_rad:.3} rad from the stated place of its motors, more than 0.2 rad: free it, or switch off their torque, start the \
         driver again without a stated place, and check the robot"
    )]
    Held {
        /// Largest distance of a bend component \[rad\].
        apart_rad: f64,
    },
    /// A place of the motors is stated after the first command: they have moved with it.
    #[error(
        "the driver obeys a command already: state the place of its motors before the first one, or before the next one after it was made \
         to forget"
    )]
    Begun,
    /// A bend is beyond its limit.
    #[error("section {section} is commanded to bend by {bend_rad} rad, the limit is {limit_rad}")]
    Bend {
        /// Section, from 0 at the base.
        section: usize,
        /// The commanded bend \[rad\].
        bend_rad: f64,
        /// Its limit \[rad\].
        limit_rad: f64,
    },
    /// A cable stroke is beyond its limit.
    #[error("cable {cable} is commanded to a stroke of {stroke_m} m, the limit is {limit_m}")]
    Stroke {
        /// Cable, from 0, section by section.
        cable: usize,
        /// The commanded stroke \[m\]; positive pays out.
        stroke_m: f64,
        /// Its limit \[m\].
        limit_m: f64,
    },
    /// The rate of a bend component is beyond its limit.
    #[error(
        "section {section} is commanded to bend at {rate_rad_s} rad/s, the limit is {limit_rad_s}"
    )]
    Rate {
        /// Section, from 0 at the base.
        section: usize,
        /// The commanded rate \[rad/s\].
        rate_rad_s: f64,
        /// Its limit \[rad/s\].
        limit_rad_s: f64,
    },
    /// A cable speed is beyond its limit.
    #[error("cable {cable} is commanded at {speed_m_s} m/s, the limit is {limit_m_s}")]
    CableSpeed {
        /// Cable, from 0, section by section.
        cable: usize,
        /// The commanded speed \[m/s\].
        speed_m_s: f64,
        /// Its limit \[m/s\].
        limit_m_s: f64,
    },
    /// The end of a section is beyond 1.5 times its largest speed. The daemon limits the speed of the robot's estimated shape, so a
    /// smaller excess is not an error.
    #[error(
        "the end of a section is commanded at {speed_m_s:.3} m/s, the limit was {limit_m_s} m/s when this driver was opened: start the driver \
         again if the limit of the daemon was changed"
    )]
    TipSpeed {
        /// The commanded speed in the commanded shape \[m/s\].
        speed_m_s: f64,
        /// Its limit \[m/s\].
        limit_m_s: f64,
    },
}
