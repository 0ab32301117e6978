use cdcr_controller::robot::{BendRates, Configuration, Robot};

/// Turns of each bend per round. All differ, so that every bend meets every other in many combinations.
const TURNS: [f64; 12] = [
    1.0, 1.236, 0.854, 1.382, 1.09, 0.764, 1.326, 0.944, 1.18, 0.798, 1.416, 1.034,
];
/// Shortest duration of a round (s).
const ROUND_MIN_S: f64 = 4.0;
/// Share of the time in which the path fades in, and out.
const FADE: f64 = 0.1;
/// Samples for the largest rate and stroke.
const SAMPLES: u32 = 4000;

/// A path that starts and ends at rest in the straight robot and excites all parameters of a calibration.
/// Every section bends in every direction, and no two alike.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ExcitingPath {
    amplitude_rad: Vec<f64>,
    rounds: f64,
    duration_s: f64,
}

impl ExcitingPath {
    /// A path of `duration_s` (s) that uses these shares (0 to 1) of the robot's limits of bends and strokes,
    /// and of speeds.
    pub(crate) fn new(robot: &Robot, bend_share: f64, speed_share: f64, duration_s: f64) -> Self {
        let amplitudes = robot
            .sections()
            .iter()
            .map(|section| bend_share * section.bend_max_rad * core::f64::consts::FRAC_1_SQRT_2);
        let mut path = Self {
            amplitude_rad: amplitudes.collect(),
            rounds: 1.0,
            duration_s,
        };
        // The last cables pass all sections; in the worst case all bend the same way.
        let sections = robot.sections().iter().zip(&path.amplitude_rad);
        let longest_m: f64 = sections
            .map(|(section, a)| core::f64::consts::SQRT_2 * a * section.cable_radius_m)
            .sum();
        let too_much = (longest_m / (bend_share * robot.cable_stroke_max_m())).max(1.0);
        path.amplitude_rad.iter_mut().for_each(|a| *a /= too_much);
        let least_s = (duration_s * path.rate_share(robot) / speed_share).max(ROUND_MIN_S);
        assert!(duration_s >= least_s, "it takes {least_s} s");
        path.rounds = duration_s / ROUND_MIN_S;
        while path.rounds > 1.0 && path.rate_share(robot) > speed_share {
            path.rounds = (0.95 * path.rounds).max(1.0);
        }
        path
    }

    /// Configuration at `time_s`, 0 to the duration.
    pub(crate) fn bends(&self, time_s: f64) -> Configuration {
        let part = (time_s / self.duration_s).clamp(0.0, 1.0);
        let edge = (part.min(1.0 - part) / FADE).min(1.0);
        // Continuous in position, speed and acceleration.
        let swell = edge.powi(3) * (10.0 - 15.0 * edge + 6.0 * edge * edge);
        let mut bends = Configuration::straight(self.amplitude_rad.len());
        for (i, bend) in bends.as_mut_slice().iter_mut().enumerate() {
            let turn = core::f64::consts::TAU * self.rounds * TURNS[i] * part;
            *bend = swell * self.amplitude_rad[i / 2] * turn.sin();
        }
        bends
    }

    /// The largest rate or cable speed, as a share of its limit.
    fn rate_share(&self, robot: &Robot) -> f64 {
        let step_s = self.duration_s / f64::from(SAMPLES);
        let mut share = 0.0_f64;
        let mut before = self.bends(0.0);
        for sample in 1..=SAMPLES {
            let here = self.bends(f64::from(sample) * step_s);
            let mut rates = BendRates::zero(robot.section_count());
            let moves = here.as_slice().iter().zip(before.as_slice());
            for (i, (rate, (to, from))) in rates.as_mut_slice().iter_mut().zip(moves).enumerate() {
                *rate = (to - from) / step_s;
                share = share.max(rate.abs() / robot.sections()[i / 2].rate_max_rad_s);
            }
            for speed_m_s in robot.cable_speeds(&rates) {
                share = share.max(speed_m_s.abs() / robot.cable_speed_max_m_s());
            }
            before = here;
        }
        share
    }
}
