use core::fmt;

/// How much of a clearance is the margin of the tip, for the person who has to correct it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginShare {
    /// Clearance of the body that counts as thicker by the margin (m).
    pub clearance_m: f64,
    /// The margin (m).
    pub margin_m: f64,
    /// Smallest clearance without a fault (m).
    pub limit_m: f64,
}

impl fmt::Display for MarginShare {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [clearance_mm, margin_mm] = [self.clearance_m, self.margin_m].map(|m| 1e3 * m);
        write!(
            f,
            "the clearance of {clearance_mm:.1} mm counts the tip margin of {margin_mm:.1} mm: the tip may be that far from where the bends place it"
        )?;
        let lacks_m = self.limit_m - self.clearance_m;
        if lacks_m > 0.0 && self.margin_m > lacks_m {
            f.write_str(
                ". Without the margin the clearance may be large enough: a tip sensor that contradicts the bends is the cause then (the log has its distance and the usual causes)",
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sensor_is_named_where_the_margin_alone_makes_the_clearance_too_small() {
        // Above the limit, the measured bends beside the estimate are the cause.
        for (clearance_m, names_sensor) in [(-0.08, true), (-0.2, false), (0.003, false)] {
            let share = MarginShare {
                clearance_m,
                margin_m: 0.182,
                limit_m: 0.0,
            };
            let text = share.to_string();
            assert!(text.contains("the tip margin of 182.0 mm"), "{text}");
            assert_eq!(
                text.contains("a tip sensor that contradicts"),
                names_sensor,
                "{text}"
            );
        }
    }
}
