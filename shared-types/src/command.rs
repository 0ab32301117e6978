use iceoryx2::prelude::ZeroCopySend;

use crate::Header;
use crate::limits::{CABLES_MAX, COORDINATES_MAX};

/// What the robot shall do until the next command: rates, and the configuration they lead to.
///
/// The daemon sends none before it knows the robot's configuration, that is before the first
/// measurement. A driver holds the robot still when its newest command is older than `valid_for_ns`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.Command.v1")]
pub struct Command {
    /// The daemon, sequence, time of sending.
    pub header: Header,
    /// Number of the cycle: its release was at `cycle` periods after the daemon's origin.
    pub cycle: u64,
    /// Release time of that cycle \[ns, `CLOCK_MONOTONIC`\]; the rates hold from here.
    pub release_ns: u64,
    /// How long the rates may be followed without a newer command \[ns\]; then the driver holds.
    pub valid_for_ns: u64,
    /// [`codes::Mode`](crate::codes::Mode) of the daemon.
    pub mode: u32,
    /// Sections of the robot.
    pub sections: u32,
    /// Bend-vector rates (u̇₁, v̇₁, …) \[rad/s\].
    pub bend_rate_rad_s: [f64; COORDINATES_MAX],
    /// Bend vector one period after the release \[rad\].
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
            valid_for_ns: 0,
            mode: 0,
            sections: 0,
            bend_rate_rad_s: [0.0; COORDINATES_MAX],
            bend_target_rad: [0.0; COORDINATES_MAX],
            cable_length_m: [0.0; CABLES_MAX],
            cable_speed_m_s: [0.0; CABLES_MAX],
        }
    }
}
