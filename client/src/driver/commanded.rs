use cdcr_shared_types::Command;
use cdcr_shared_types::limits::{CABLES_MAX, COORDINATES_MAX};

/// Commanded rates. The default is rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandedRates {
    /// Bend-vector rates (u̇₁, v̇₁, …) \[rad/s\].
    pub bend_rate_rad_s: [f64; COORDINATES_MAX],
    /// Cable speeds \[m/s\], three per section, base first; positive pays out.
    pub cable_speed_m_s: [f64; CABLES_MAX],
}

impl Default for CommandedRates {
    fn default() -> Self {
        Self {
            bend_rate_rad_s: [0.0; COORDINATES_MAX],
            cable_speed_m_s: [0.0; CABLES_MAX],
        }
    }
}

/// Commanded position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandedPosition {
    /// Bend vector (u₁, v₁, …) \[rad\].
    pub bend_rad: [f64; COORDINATES_MAX],
    /// Cable lengths \[m\], three per section, base first.
    pub cable_length_m: [f64; CABLES_MAX],
}

impl CommandedPosition {
    pub(super) fn from_command(command: &Command) -> Self {
        Self {
            bend_rad: command.bend_target_rad,
            cable_length_m: command.cable_length_m,
        }
    }

    /// `command` with this position.
    pub(super) fn in_command(&self, command: &Command) -> Command {
        Command {
            bend_target_rad: self.bend_rad,
            cable_length_m: self.cable_length_m,
            ..*command
        }
    }

    pub(super) fn plus(&self, offset: &Self) -> Self {
        self.with(offset, |a, b| a + b)
    }

    pub(super) fn minus(&self, other: &Self) -> Self {
        self.with(other, |a, b| a - b)
    }

    fn with(&self, other: &Self, combine: impl Fn(f64, f64) -> f64) -> Self {
        let (bends, cables) = (&other.bend_rad, &other.cable_length_m);
        Self {
            bend_rad: core::array::from_fn(|i| combine(self.bend_rad[i], bends[i])),
            cable_length_m: core::array::from_fn(|i| combine(self.cable_length_m[i], cables[i])),
        }
    }

    /// Root of the sum of squares of the bends \[rad\].
    pub(super) fn size_rad(&self) -> f64 {
        let squares = self.bend_rad.iter().map(|bend_rad| bend_rad * bend_rad);
        squares.sum::<f64>().sqrt()
    }

    /// Interpolates linearly to `end`; `part` is 0 to 1. From 1 on the result is `end`, bit for bit.
    pub(super) fn towards(&self, end: &Self, part: f64) -> Self {
        Self {
            bend_rad: core::array::from_fn(|i| between(self.bend_rad[i], end.bend_rad[i], part)),
            cable_length_m: core::array::from_fn(|i| {
                between(self.cable_length_m[i], end.cable_length_m[i], part)
            }),
        }
    }
}

// Clamped, so that rounding does not exceed an end; equal numbers keep their bits.
fn between(begin: f64, end: f64, part: f64) -> f64 {
    if part >= 1.0 || begin.to_bits() == end.to_bits() {
        return end;
    }
    (begin + part * (end - begin)).clamp(begin.min(end), begin.max(end))
}
