//! Structs of the C interface other than messages; a test compares `include/cdcr.h` with them.

use core::ffi::c_char;

use cdcr_client::{CommandedPosition, CommandedRates, DriverUpdate};
use cdcr_shared_types::limits::{CABLES_MAX, COORDINATES_MAX};
use cdcr_shared_types::{Command, LAYOUTS};

use crate::code::Code;
use crate::failure::Failure;

/// Incremented with every change of a function, or of a struct of `cdcr.h` that is not a message.
const BORDER: u8 = 3;

/// `CDCR_LAYOUT`: a program compiled with the header of another version is refused. The versions in the
/// message names change with the layout and the meaning of the messages.
pub const LAYOUT: u64 = {
    let mut hash = hashed(0xcbf2_9ce4_8422_2325, &[BORDER]);
    let mut at = 0;
    while at < LAYOUTS.len() {
        hash = hashed(hash, LAYOUTS[at].type_name.as_bytes());
        at += 1;
    }
    hash
};

/// Refuses a program that was compiled with another `cdcr.h`.
pub(crate) fn check_layout(layout: u64) -> Result<(), Failure> {
    if layout == LAYOUT {
        return Ok(());
    }
    let text = format!(
        "the program was compiled with another cdcr.h ({layout:#018x}) than the library ({LAYOUT:#018x}): \
         compile it with the header that belongs to the library, and pass CDCR_LAYOUT"
    );
    Err(Failure::new(Code::Layout, text))
}

/// FNV-1a.
const fn hashed(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut at = 0;
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u64).wrapping_mul(0x0100_0000_01b3);
        at += 1;
    }
    hash
}

// Declares structs of the C interface, and the list of their sizes and offsets.
macro_rules! structs {
    ($($(#[$meta:meta])* $name:ident $c_name:literal { $($field:ident: $type:ty,)+ })+) => {
        $(
            $(#[$meta])*
            #[repr(C)]
            #[derive(Debug, Clone, Copy)]
            #[allow(missing_docs, reason = "cdcr.h says it")]
            pub struct $name { $(pub $field: $type,)+ }
        )+

        /// Name, size and fields (with offset and size) of each struct that is not a message.
        pub const STRUCTS: &[(&str, usize, &[(&str, usize, usize)])] = &[$((
            $c_name,
            size_of::<$name>(),
            &[$((
                stringify!($field),
                core::mem::offset_of!($name, $field),
                size_of::<$type>(),
            ),)+],
        ),)+];
    };
}

structs! {
    /// Place of a daemon; NULL is replaced by the environment variable or the default.
    Place "CdcrPlace" {
        robot: *const c_char,
        prefix: *const c_char,
        root: *const c_char,
    }

    /// [`CommandedRates`] in C.
    Rates "CdcrRates" {
        bend_rate_rad_s: [f64; COORDINATES_MAX],
        cable_speed_m_s: [f64; CABLES_MAX],
    }

    /// [`CommandedPosition`] in C.
    Position "CdcrPosition" {
        bend_rad: [f64; COORDINATES_MAX],
        cable_length_m: [f64; CABLES_MAX],
    }

    /// [`DriverUpdate`] in C.
    Update "CdcrDriverUpdate" {
        command: Command,
        new_daemon: u64,
        refusals: u64,
        has_command: u32,
        was_refused: u32,
    }
}

impl From<CommandedRates> for Rates {
    fn from(rates: CommandedRates) -> Self {
        Self {
            bend_rate_rad_s: rates.bend_rate_rad_s,
            cable_speed_m_s: rates.cable_speed_m_s,
        }
    }
}

impl From<CommandedPosition> for Position {
    fn from(position: CommandedPosition) -> Self {
        Self {
            bend_rad: position.bend_rad,
            cable_length_m: position.cable_length_m,
        }
    }
}

impl From<Position> for CommandedPosition {
    fn from(position: Position) -> Self {
        Self {
            bend_rad: position.bend_rad,
            cable_length_m: position.cable_length_m,
        }
    }
}

impl Update {
    /// `refusals`: commands refused since the driver was opened.
    pub(crate) fn new(update: &DriverUpdate, refusals: u64) -> Self {
        Self {
            command: update.command.unwrap_or_default(),
            new_daemon: update.new_daemon.unwrap_or(0),
            refusals,
            has_command: update.command.is_some().into(),
            was_refused: update.refused.is_some().into(),
        }
    }
}
