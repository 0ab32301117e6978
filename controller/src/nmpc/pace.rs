//! The reference of a robot whose section ends have a speed limit.
//!
//! A solver that sees a reference out of its reach asks for the largest rates of every component. Scaled down to the
//! speed limit, these no longer lead to the reference: the tip makes a detour, at needlessly large rates that cancel out.
//! So the solver sees how far the tip can be at each step, on the straight line to where it should be.

use nalgebra::Vector3;

use crate::reference::ReferenceSample;

/// Fills `paced` with the samples of `steps` steps, each at most `step_m` per step away from the tip (m). Without a
/// sample there is none. A sample that is within reach is the same to the bit.
pub(super) fn pace(
    reference: &[ReferenceSample],
    steps: usize,
    tip_m: &Vector3<f64>,
    step_m: f64,
    paced: &mut Vec<ReferenceSample>,
) {
    paced.clear();
    let Some(last) = reference.last() else {
        return;
    };
    paced.extend((0..steps).map(|step| {
        let sample = reference.get(step).unwrap_or(last);
        let away_m = sample.position_m - tip_m;
        let (distance_m, reach_m) = (away_m.norm(), (step + 1) as f64 * step_m);
        if distance_m > reach_m {
            let position_m = tip_m + away_m * (reach_m / distance_m);
            ReferenceSample {
                position_m,
                ..*sample
            }
        } else {
            *sample
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_out_of_reach_is_on_the_line_to_it_and_the_others_stay() {
        let tip_m = Vector3::new(0.1, 0.2, 0.3);
        let at = |x_m: f64| ReferenceSample::at(tip_m + Vector3::new(x_m, 0.0, 0.0));
        let mut paced = Vec::new();
        pace(&[at(0.5), at(0.015), at(-0.5)], 5, &tip_m, 0.01, &mut paced);
        assert_eq!(paced[1], at(0.015));
        for (sample, x_m) in paced.iter().zip([0.01, 0.015, -0.03, -0.04, -0.05]) {
            assert!(
                (sample.position_m - at(x_m).position_m).norm() < 1e-15,
                "{x_m}"
            );
        }
        pace(&[], 5, &tip_m, 0.01, &mut paced);
        assert!(paced.is_empty());
    }
}
