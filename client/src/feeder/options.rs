use std::time::Duration;

use cdcr_shared_types::codes::Interpolation;

use super::FeedError;

/// Options of a feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FeedOptions {
    /// Time between two points of a trajectory without knots.
    pub step: Duration,
    /// Delay from now to the start of the trajectory.
    pub lead: Duration,
    /// Time by which a point is sent in advance: the client may be late by this much without effect.
    pub ahead: Duration,
    /// How the daemon interpolates between the points.
    pub interpolation: Interpolation,
    /// Whether to request tracking as soon as the first chunk is accepted.
    pub track: bool,
}

impl Default for FeedOptions {
    fn default() -> Self {
        Self {
            step: Duration::from_millis(5),
            lead: Duration::from_millis(300),
            ahead: Duration::from_secs(1),
            interpolation: Interpolation::Cubic,
            track: false,
        }
    }
}

impl FeedOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`FeedError::Option`] with the first option that is out of its range.
    pub fn check(&self) -> Result<(), FeedError> {
        let ranges = [
            ("step", self.step, 0.000_1, 1.0),
            ("lead", self.lead, 0.05, 60.0),
            ("ahead", self.ahead, 0.1, 10.0),
        ];
        for (name, value, least_s, most_s) in ranges {
            let value_s = value.as_secs_f64();
            if !(least_s..=most_s).contains(&value_s) {
                return Err(FeedError::Option {
                    name,
                    value_s,
                    least_s,
                    most_s,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_in_range_and_a_zero_step_is_not() {
        assert!(FeedOptions::default().check().is_ok());
        let zero = FeedOptions {
            step: Duration::ZERO,
            ..FeedOptions::default()
        };
        let text = zero.check().expect_err("out of range").to_string();
        assert!(text.contains("step") && text.contains("0.0001"), "{text}");
    }
}
