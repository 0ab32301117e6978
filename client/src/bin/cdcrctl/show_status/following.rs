//! The following error: by the bends, and by what the cables of a section differ by together.

use std::fmt::Write as _;

use cdcr_client::cable_tolerances_m;
use cdcr_shared_types::Status;
use cdcr_shared_types::codes::Interface;

/// The largest following error of a section (rad).
pub(crate) fn following_error_rad(status: &Status) -> f64 {
    let sections = (status.robot.sections as usize).min(status.following_error_rad.len());
    let errors_rad = status.following_error_rad[..sections].iter();
    errors_rad.copied().fold(0.0, f64::max)
}

/// The first section whose cables differ from the commanded lengths by more in the mean than a driver follows at first, and by how much (m).
fn common_error(status: &Status) -> Option<(usize, f64)> {
    let (cables_m, _) = status.following_error_m.as_chunks::<3>();
    let radii_m = status
        .robot
        .section
        .iter()
        .map(|section| section.cable_radius_m);
    let sections = cables_m.iter().zip(cable_tolerances_m(radii_m));
    let used = sections.take(status.robot.sections as usize);
    for (j, (cables_m, tolerance_m)) in used.enumerate() {
        let mean_m = cables_m.iter().sum::<f64>() / 3.0;
        if mean_m.abs() > tolerance_m {
            return Some((j + 1, mean_m));
        }
    }
    None
}

/// The lines of the following error.
pub(super) fn write(out: &mut String, status: &Status) -> std::fmt::Result {
    let largest_rad = following_error_rad(status);
    let errors_m = status.following_error_m.iter();
    let largest_m = errors_m.fold(0.0_f64, |most, m| most.max(m.abs()));
    writeln!(
        out,
        "\nfollowing   {} interface, error {largest_rad:.4} rad, {:.2} mm of cable ({} cycles above the warning)",
        Interface::text_of(status.interface),
        1e3 * largest_m,
        status.following_warnings
    )?;
    if let Some((section, common_m)) = common_error(status) {
        writeln!(
            out,
            "            the three cables of section {section} are measured {:.1} mm {} than commanded, which no bend explains: set their zero \
             (docs/drivers.md, Zero). The driver library refuses such a first command",
            1e3 * common_m.abs(),
            if common_m > 0.0 { "longer" } else { "shorter" }
        )?;
    }
    Ok(())
}
