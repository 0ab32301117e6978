use anyhow::ensure;
use cdcr_shared_types::Telemetry;

/// Fails when a bend is beyond the bound.
pub(super) fn check_bends(record: &Telemetry, bend_max_rad: f64) -> anyhow::Result<()> {
    let pairs = record.present_rad.chunks(2).enumerate();
    for (section, pair) in pairs {
        let bend_rad = pair[0].hypot(pair[1]);
        ensure!(
            bend_rad <= bend_max_rad,
            "section {} bends by {bend_rad:.4} rad, more than --bend-max {bend_max_rad:.4}: tip or cables do not match the model, and the correction \
             by the measurement bends the robot farther than planned. The robot holds; the rows so far are kept. Run `cdcrctl calibrate geometry` on \
             them. To record all rows, restart cdcrd with --set estimator.tip_noise_m=0.1, which does not correct tip errors below 25 mm",
            section + 1
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bend_beyond_the_bound_names_what_helps_with_a_sensor_beside_the_tip() {
        let mut record = Telemetry::default();
        record.present_rad[2] = 1.9;
        check_bends(&record, 2.0).expect("within the bound");
        let error = check_bends(&record, 1.8)
            .expect_err("beyond it")
            .to_string();
        for part in ["section 2 bends by 1.9", "estimator.tip_noise_m=0.1"] {
            assert!(error.contains(part), "{error}");
        }
        assert!(!error.contains("larger --bend-max"), "{error}");
    }
}
