use iceoryx2::prelude::ZeroCopySend;

use crate::Header;
use crate::limits::{CABLES_MAX, COORDINATES_MAX};

/// What the robot shall do until the next command.
///
/// A driver obeys the **positions or the speeds**, whichever `interface` says, never a mixture of both. The positions
/// are the integral of the speeds: constant to the bit while the speeds are zero, wherever the robot is measured.
///
/// Cycles and sequences ascend. A cycle whose command was overtaken by a newer one, while the daemon was held up, sends
/// none, and neither does one whose command has run out before it could leave, unless it is rest. In a telemetry record the
/// sequence of such a command is 0. The last command of a daemon that ends with status 0 is rest.
///
/// The daemon sends none before it knows the robot's configuration, that is before the first
/// measurement. A driver holds the robot still from `valid_until_ns` on, whatever it does until then.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.Command.v2")]
pub struct Command {
    /// The daemon, sequence, time of sending.
    pub header: Header,
    /// Number of the cycle: its release was at `cycle` periods after the daemon's origin.
    pub cycle: u64,
    /// Release time of that cycle \[ns, `CLOCK_MONOTONIC`\]; the rates hold from here.
    pub release_ns: u64,
    /// When the move to `bend_target_rad` ends: one period after the release \[ns, `CLOCK_MONOTONIC`\].
    pub target_ns: u64,
    /// Until when the speeds may be followed without a newer command \[ns, `CLOCK_MONOTONIC`\]; then the driver holds.
    /// It counts from the release, so a command that is delayed on its way is not valid for longer.
    pub valid_until_ns: u64,
    /// [`codes::Mode`](crate::codes::Mode) of the daemon.
    pub mode: u32,
    /// Sections of the robot.
    pub sections: u32,
    /// [`codes::Interface`](crate::codes::Interface): what the driver obeys, `cable_length_m` or `cable_speed_m_s`
    /// (or the bend vector and its rates, where the driver computes its own cables).
    pub interface: u32,
    /// Zero.
    pub reserved: u32,
    /// Bend-vector rates (u̇₁, v̇₁, …) \[rad/s\].
    pub bend_rate_rad_s: [f64; COORDINATES_MAX],
    /// Commanded bend vector at `target_ns` \[rad\]: that of the command before, moved on by the rates. It begins at
    /// the measured one when control begins, and after a reset.
    pub bend_target_rad: [f64; COORDINATES_MAX],
    /// Cable lengths at `bend_target_rad`, section by section, three each \[m\].
    pub cable_length_m: [f64; CABLES_MAX],
    /// Cable speeds that belong to `bend_rate_rad_s` \[m/s\].
    pub cable_speed_m_s: [f64; CABLES_MAX],
}

impl Default for Command {
    fn default() -> Self {
        Self {
            header: Header::default(),
            cycle: 0,
            release_ns: 0,
            target_ns: 0,
            valid_until_ns: 0,
            mode: 0,
            sections: 0,
            interface: 0,
            reserved: 0,
            bend_rate_rad_s: [0.0; COORDINATES_MAX],
            bend_target_rad: [0.0; COORDINATES_MAX],
            cable_length_m: [0.0; CABLES_MAX],
            cable_speed_m_s: [0.0; CABLES_MAX],
        }
    }
}
