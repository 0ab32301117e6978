use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::counted;

/// Why a command is not followed. The one before it stays in force until it runs out.
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
        /// Of the command.
        commanded: u32,
        /// Of the robot.
        sections: u32,
    },
    /// The daemon means the other interface, or one that is not known.
    #[error(
        "the daemon commands by {}, but this driver follows the interface {driver}: set link.interface",
        Interface::try_from(*commanded).map_or_else(|code| format!("an {code}"), |known| format!("the interface {known}"))
    )]
    Interface {
        /// Code in the command.
        commanded: u32,
        /// What the driver obeys.
        driver: Interface,
    },
    /// The move would end before it begins.
    #[error("the target of the command is {before_ns} ns before its release")]
    Times {
        /// By how much \[ns\].
        before_ns: u64,
    },
    /// The command is not newer than the one in force: its sequence, its cycle or its release went back.
    #[error("the command of cycle {cycle} is not newer than the present one of cycle {present}")]
    NotNewer {
        /// Of the command.
        cycle: u64,
        /// Of the command in force.
        present: u64,
    },
    /// Another daemon commands while the command of the present one is still valid.
    #[error("a second daemon ({sender:#018x}) commands beside {present:#018x}: end one of them")]
    OtherDaemon {
        /// Who sent the command.
        sender: u64,
        /// Whose command is in force.
        present: u64,
    },
    /// It was valid until a time that is over.
    #[error("the command of cycle {cycle} arrived {late_ns} ns after it had expired")]
    Expired {
        /// Of the command.
        cycle: u64,
        /// By how much \[ns\].
        late_ns: u64,
    },
    /// The first position is not where the robot was measured.
    #[error(
        "the first commanded position differs from the measured one: component {at} by {way:.6}, allowed is {most:.6} \
         (rad, or m of a cable). Check the robot, then cdcrctl reset"
    )]
    Elsewhere {
        /// Component of the bends, or cable, whichever was measured.
        at: usize,
        /// How far its motor would go at once \[rad or m\].
        way: f64,
        /// How far it may \[rad or m\].
        most: f64,
    },
    /// A section would bend too far.
    #[error("section {section} is commanded to bend by {bend_rad} rad, the limit is {limit_rad}")]
    Bend {
        /// From 0 at the base.
        section: usize,
        /// The commanded bend \[rad\].
        bend_rad: f64,
        /// Its limit \[rad\].
        limit_rad: f64,
    },
    /// A cable would be pulled or paid out too far.
    #[error("cable {cable} is commanded to a stroke of {stroke_m} m, the limit is {limit_m}")]
    Stroke {
        /// From 0, section by section.
        cable: usize,
        /// The commanded stroke \[m\]; positive is paid out.
        stroke_m: f64,
        /// Its limit \[m\].
        limit_m: f64,
    },
    /// A bend-vector component would change too fast.
    #[error(
        "section {section} is commanded to bend at {rate_rad_s} rad/s, the limit is {limit_rad_s}"
    )]
    Rate {
        /// From 0 at the base.
        section: usize,
        /// The commanded rate \[rad/s\].
        rate_rad_s: f64,
        /// Its limit \[rad/s\].
        limit_rad_s: f64,
    },
    /// A cable would run too fast.
    #[error("cable {cable} is commanded at {speed_m_s} m/s, the limit is {limit_m_s}")]
    CableSpeed {
        /// From 0, section by section.
        cable: usize,
        /// The commanded speed \[m/s\].
        speed_m_s: f64,
        /// Its limit \[m/s\].
        limit_m_s: f64,
    },
}
