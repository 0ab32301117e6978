use nalgebra::Vector3;

use super::{CONTROL_BLOCKS_MAX, Horizon, NmpcSettings, SolveInput};
use crate::optimizer::{Budget, LinearModel, Problem};
use crate::reference::{ReferenceSample, ReferenceState};
use crate::robot::{COORDINATES_MAX, Configuration, Jacobian, Robot};
use crate::wide::Wide;

/// The optimal control problem of one cycle: Eq. 4-5 over the horizon, in the rates of every block.
pub(super) struct TrackingProblem<'a> {
    robot: &'a Robot,
    period_s: f64,
    settings: &'a NmpcSettings,
    horizon: &'a Horizon,
    configuration: &'a Configuration,
    previous_rates: &'a [f64],
    reference: &'a [ReferenceSample],
}

/// Nominal time of one section at W points side by side \[ns\].
const SECTION_NS: u32 = 15;

impl<'a> TrackingProblem<'a> {
    pub(super) fn new(
        robot: &'a Robot,
        period_s: f64,
        settings: &'a NmpcSettings,
        horizon: &'a Horizon,
        input: &SolveInput<'a>,
    ) -> Self {
        Self {
            robot,
            period_s,
            settings,
            horizon,
            configuration: input.configuration,
            previous_rates: input.previous_rates.as_slice(),
            reference: input.reference,
        }
    }

    /// Whether there is a reference to follow.
    pub(super) fn is_posed(&self) -> bool {
        self.reference
            .iter()
            .any(|sample| sample.state != ReferenceState::None)
    }

    fn width(&self) -> usize {
        self.robot.coordinate_count()
    }

    /// Reference position after step `step` (0-based); the last known one past the end.
    fn target(&self, step: usize) -> Option<Vector3<f64>> {
        let sample = self.reference.get(step).or(self.reference.last())?;
        (sample.state != ReferenceState::None).then_some(sample.position_m)
    }

    /// Weight of the position error after step `step`: with ω on the last.
    fn position_weight(&self, step: usize) -> f64 {
        let last = step + 1 == self.horizon.steps();
        self.settings.position_weight
            * if last {
                self.settings.terminal_weight
            } else {
                1.0
            }
    }

    /// Eq. 4 for W plans side by side.
    #[inline(always)]
    fn advance_wide<const W: usize>(
        &self,
        bend_rad: &mut [Wide<W>; COORDINATES_MAX],
        z: &impl Fn(usize) -> Wide<W>,
        step: usize,
    ) {
        let width = self.width();
        let first = self.horizon.block_of(step) * width;
        for (i, bend) in bend_rad[..width].iter_mut().enumerate() {
            *bend = *bend + z(first + i) * self.period_s;
        }
    }

    /// Eq. 4: one period with the rates of the step's block.
    fn advance(&self, bend_rad: &mut [f64], z: &[f64], step: usize) {
        let rates = &z[self.horizon.block_of(step) * self.width()..][..self.width()];
        for (bend, rate) in bend_rad.iter_mut().zip(rates) {
            *bend += self.period_s * rate;
        }
    }

    fn start(&self) -> [f64; COORDINATES_MAX] {
        let mut bend_rad = [0.0; COORDINATES_MAX];
        bend_rad[..self.width()].copy_from_slice(self.configuration.as_slice());
        bend_rad
    }

    /// Weights on the rates and on their change from block to block.
    #[inline(always)]
    fn regularisation<const W: usize>(&self, z: &impl Fn(usize) -> Wide<W>) -> Wide<W> {
        let NmpcSettings {
            rate_weight,
            rate_change_weight,
            ..
        } = *self.settings;
        let mut cost = Wide::splat(0.0);
        if rate_weight > 0.0 {
            for i in 0..self.dimension() {
                cost = cost + z(i) * z(i) * rate_weight;
            }
        }
        if rate_change_weight > 0.0 {
            for i in 0..self.dimension() {
                let earlier = i.checked_sub(self.width());
                let before = earlier.map_or_else(|| Wide::splat(self.previous_rates[i]), z);
                let change = z(i) - before;
                cost = cost + change * change * rate_change_weight;
            }
        }
        cost
    }

    /// Rows of the position error after `step`, and its derivatives with respect to every block.
    fn push_position_rows(
        &self,
        step: usize,
        error: Vector3<f64>,
        jacobian: &Jacobian,
        block_periods: &[f64],
        model: &mut LinearModel,
    ) {
        let scale = self.position_weight(step).sqrt();
        for axis in 0..3 {
            let row = model.push(scale * error[axis]);
            for (block, &periods) in block_periods.iter().enumerate() {
                let factor = scale * self.period_s * periods;
                for (i, derivative) in row[block * self.width()..][..self.width()]
                    .iter_mut()
                    .enumerate()
                {
                    *derivative = factor * jacobian.column(i)[axis];
                }
            }
        }
    }

    fn push_regularisation_rows(&self, z: &[f64], model: &mut LinearModel) {
        let NmpcSettings {
            rate_weight,
            rate_change_weight,
            ..
        } = *self.settings;
        if rate_weight > 0.0 {
            let scale = rate_weight.sqrt();
            for (i, rate) in z.iter().enumerate() {
                model.push(scale * rate)[i] = scale;
            }
        }
        if rate_change_weight > 0.0 {
            let scale = rate_change_weight.sqrt();
            for i in 0..z.len() {
                let earlier = i.checked_sub(self.width());
                let before = earlier.map_or_else(|| self.previous_rates[i], |k| z[k]);
                let row = model.push(scale * (z[i] - before));
                row[i] = scale;
                if let Some(k) = earlier {
                    row[k] = -scale;
                }
            }
        }
    }
}

impl Problem for TrackingProblem<'_> {
    fn dimension(&self) -> usize {
        self.width() * self.horizon.blocks()
    }

    fn rows(&self) -> usize {
        3 * self.horizon.steps() + 2 * self.dimension()
    }

    #[inline(always)]
    fn cost<const W: usize>(&self, z: impl Fn(usize) -> Wide<W>) -> Wide<W> {
        let mut bend_rad = [Wide::splat(0.0); COORDINATES_MAX];
        for (wide, &bend) in bend_rad.iter_mut().zip(self.configuration.as_slice()) {
            *wide = Wide::splat(bend);
        }
        let mut cost = self.regularisation(&z);
        for step in 0..self.horizon.steps() {
            self.advance_wide(&mut bend_rad, &z, step);
            if let Some(target) = self.target(step) {
                let tip = self.robot.tip_position_wide(|i| bend_rad[i]);
                let [ex, ey, ez] = [0, 1, 2].map(|axis| tip[axis] + -target[axis]);
                let squared = ex * ex + ey * ey + ez * ez;
                cost = cost + squared * self.position_weight(step);
            }
        }
        cost
    }

    fn linearise<F: FnMut() -> bool>(
        &self,
        z: &[f64],
        model: &mut LinearModel,
        budget: &mut Budget<F>,
    ) -> bool {
        let mut state = self.start();
        let bend_rad = &mut state[..self.width()];
        let mut jacobian = Jacobian::default();
        let mut block_periods = [0.0; CONTROL_BLOCKS_MAX];
        for step in 0..self.horizon.steps() {
            self.advance(bend_rad, z, step);
            block_periods[self.horizon.block_of(step)] += 1.0;
            let Some(target) = self.target(step) else {
                continue;
            };
            if !budget.spend(self.linearise_step_ns()) {
                return false;
            }
            let tip = self.robot.tip_jacobian(bend_rad, &mut jacobian);
            let periods = &block_periods[..=self.horizon.block_of(step)];
            self.push_position_rows(step, tip.position_m - target, &jacobian, periods, model);
        }
        self.push_regularisation_rows(z, model);
        true
    }

    fn evaluation_ns(&self) -> u32 {
        let sections = self.horizon.steps() * self.robot.section_count();
        SECTION_NS * sections as u32
    }
}

impl TrackingProblem<'_> {
    /// Nominal time of one step of [`Problem::linearise`]: the Jacobian, and three rows.
    fn linearise_step_ns(&self) -> u32 {
        3 * SECTION_NS * self.robot.section_count() as u32 + self.dimension() as u32
    }
}
