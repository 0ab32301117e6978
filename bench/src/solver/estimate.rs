//! Time of the estimate beside that of the following solve: three sections on the figure eight.

use std::time::Instant;

use anyhow::{Context, Result};
use cdcr_controller::closed_loop::FigureEight;
use cdcr_controller::estimator::{Actuator, Estimator, Measurement};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::cycle_seed;
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters};
use serde_json::{Value, json};

use crate::closed_loop::{End, timed_solve};
use crate::dataset::number;
use crate::named::named;
use crate::numbers::Numbers;
use crate::quantiles::{histogram, quantile_us};

const SECTIONS: usize = 3;
const CYCLES: u64 = 2000;
const WARM_UP: u64 = 50;
const CABLE_NOISE_M: f64 = 3e-5;
const TIP_NOISE_M: f64 = 3e-4;
const TIME_CONSTANT_S: f64 = 0.18;
const LAG_AND_PLAY: Actuator = Actuator {
    delay_s: 0.01,
    time_constant_s: 0.03,
    play_m: 5e-4,
};

named! {
    /// The measured quantities and the state of the motors.
    pub enum Sensed {
        /// Without a filter, with ideal motors.
        AtOnce = "cables, believed at once",
        Cables = "cables",
        CablesAndTip = "cables and tip",
        Tip = "tip alone",
        Play = "cables and tip, lag and play",
    }
}

/// `more_p50_us`: beyond the first kind, the controller without filters and models.
pub fn measure(divisor: u64) -> Result<Vec<Value>> {
    let rows = Sensed::ALL.map(|sensed| sensed.measure(CYCLES / divisor));
    let mut rows: Vec<Value> = rows.into_iter().collect::<Result<_>>()?;
    let both_us = |row: &Value| number(row, "both_p50_us").context("no time was measured");
    let of_first_us = both_us(&rows[0])?;
    for row in &mut rows {
        row["more_p50_us"] = json!(both_us(row)? - of_first_us);
    }
    Ok(rows)
}

impl Sensed {
    fn estimator(self, robot: &Robot, begin: Configuration) -> Estimator {
        let estimator = Estimator::new(begin);
        match self {
            Self::AtOnce => return estimator,
            Self::Play => estimator.with_actuator(robot, LAG_AND_PLAY),
            _ => estimator,
        }
        .with_time_constant(TIME_CONSTANT_S)
    }

    fn measure(self, cycles: u64) -> Result<Value> {
        let robot = Robot::new(&RobotParameters::paper(SECTIONS))?;
        let settings = NmpcSettings::default();
        let mut nmpc = Nmpc::new(robot.clone(), FigureEight::PERIOD_S, settings)?;
        let mut truth = Configuration::from_bend_angles(&[[0.4, 0.0]; SECTIONS]);
        let mut estimator = self.estimator(&robot, truth);
        let mut rates = BendRates::zero(SECTIONS);
        let mut numbers = Numbers::new(1);
        let mut times = [histogram(), histogram(), histogram()];
        for cycle in 0..WARM_UP + cycles {
            truth = truth.advanced(&rates, FigureEight::PERIOD_S);
            let mut noise_m = |most_m: f64| numbers.between(-most_m, most_m);
            let lengths_m = robot.cable_lengths(&truth);
            let lengths_m = lengths_m.map(|m| m + noise_m(CABLE_NOISE_M));
            let tip_m = robot.tip_position(&truth).map(|m| m + noise_m(TIP_NOISE_M));
            let first = match self {
                Self::Tip => Measurement::TipPosition(tip_m),
                _ => Measurement::CableLengths(lengths_m),
            };
            let time_s = |step: u64| (cycle + step) as f64 * FigureEight::PERIOD_S;
            let steps = (1..=u64::from(settings.horizon_steps)).map(time_s);
            let reference: Vec<_> = steps.map(FigureEight::reference).collect();
            let begin = Instant::now();
            estimator.predict(&rates, FigureEight::PERIOD_S);
            estimator.correct(&robot, &first, 0.0);
            if matches!(self, Self::CablesAndTip | Self::Play) {
                let _ = estimator.correct_tip(&robot, &tip_m, 0.0);
            }
            let estimate_time = begin.elapsed();
            let input = SolveInput {
                configuration: estimator.configuration(),
                previous_rates: &rates,
                reference: &reference,
                obstacles: &[],
                tip_offset_m: 0.0,
                elapsed_periods: 1,
                seed: cycle_seed(settings.seed, cycle),
            };
            let (next, _, solve_time) = timed_solve(&mut nmpc, &input, End::Never);
            rates = next;
            if cycle >= WARM_UP {
                let whole = [estimate_time, solve_time, estimate_time + solve_time];
                for (times, time) in times.iter_mut().zip(whole) {
                    times.saturating_record(time.as_nanos() as u64);
                }
            }
        }
        let [estimates, solves, both] = times;
        Ok(json!({
            "sensed": self,
            "cycles": cycles,
            "estimate_p50_us": quantile_us(&estimates, 0.5),
            "estimate_p99_us": quantile_us(&estimates, 0.99),
            "solve_p50_us": quantile_us(&solves, 0.5),
            "both_p50_us": quantile_us(&both, 0.5),
        }))
    }
}
