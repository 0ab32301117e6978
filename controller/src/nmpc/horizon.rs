use super::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, NmpcSettings, PLAN_MAX, TIED_BLOCKS_MAX};

/// N prediction steps in M ≤ N blocks; the rates are constant over a block.
///
/// Block lengths differ by at most one step, and the longer blocks are spread among the others. With the
/// longer blocks last, the error on the paper's spiral was 200 times larger (50 steps, 20 blocks).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Horizon {
    steps: usize,
    blocks: usize,
    /// Block of each step.
    block_of: [u8; HORIZON_STEPS_MAX],
    /// First step of each block.
    first_step: [u8; CONTROL_BLOCKS_MAX],
}

impl Horizon {
    /// The horizon of validated settings, for a robot of `width` coordinates; M = 0 stands for M = N. M is
    /// limited to [`PLAN_MAX`] scalars, or to 20 blocks where the change of rates has a weight.
    pub fn new(settings: &NmpcSettings, width: usize) -> Self {
        let steps = (settings.horizon_steps as usize).clamp(1, HORIZON_STEPS_MAX);
        let desired = match settings.control_blocks as usize {
            0 => steps,
            blocks => blocks,
        };
        let most = if settings.rate_change_weight > 0.0 {
            TIED_BLOCKS_MAX
        } else {
            PLAN_MAX / width.max(1)
        };
        let blocks = desired.clamp(1, steps.min(most));
        let mut horizon = Self {
            steps,
            blocks,
            block_of: [0; HORIZON_STEPS_MAX],
            first_step: [0; CONTROL_BLOCKS_MAX],
        };
        for block in 0..blocks {
            let (first, end) = (block * steps / blocks, (block + 1) * steps / blocks);
            horizon.first_step[block] = first as u8;
            horizon.block_of[first..end].fill(block as u8);
        }
        horizon
    }

    /// Prediction steps N.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Control blocks M.
    pub fn blocks(&self) -> usize {
        self.blocks
    }

    /// Steps of each block.
    pub(super) fn lengths(&self) -> impl Iterator<Item = u8> {
        let firsts = self.first_step[..self.blocks].iter().copied();
        let ends = firsts.clone().skip(1).chain([self.steps as u8]);
        firsts.zip(ends).map(|(first, end)| end - first)
    }

    /// The block that controls step `step` (0-based).
    pub fn block_of(&self, step: usize) -> usize {
        usize::from(self.block_of[step])
    }

    /// Number of steps up to and including the first step of a block.
    pub(super) fn steps_into(&self, block: usize) -> usize {
        usize::from(self.first_step[block]) + 1
    }

    /// Shifts the plan by `elapsed` periods into `into`, which has the length of `plan`. Steps past the end
    /// of the plan get its last block.
    pub(super) fn shift(&self, plan: &[f64], elapsed: u64, into: &mut [f64]) {
        let width = plan.len() / self.blocks;
        let elapsed = elapsed.min(HORIZON_STEPS_MAX as u64) as usize;
        for (block, target) in into.chunks_exact_mut(width).enumerate() {
            let step = usize::from(self.first_step[block]) + elapsed;
            let source = if step < self.steps {
                self.block_of(step)
            } else {
                self.blocks - 1
            };
            target.copy_from_slice(&plan[source * width..][..width]);
        }
    }

    /// Sets to zero the rates past the end of the last solved horizon, in a plan that was shifted by
    /// `periods` and not evaluated since.
    ///
    /// With blocks of several steps a shift does not move every block. Such a plan keeps its first block for
    /// one period and then has zero rates.
    pub(super) fn zero_past_horizon(&self, plan: &mut [f64], periods: u64) {
        if periods == 0 {
            return;
        }
        let width = plan.len() / self.blocks;
        let kept = if self.blocks == self.steps {
            self.blocks - periods.min(self.blocks as u64) as usize
        } else {
            usize::from(plan[width..].iter().any(|rate| *rate != 0.0))
        };
        plan[kept * width..].fill(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn horizon(steps: u32, blocks: u32) -> Horizon {
        let settings = NmpcSettings {
            horizon_steps: steps,
            control_blocks: blocks,
            ..NmpcSettings::default()
        };
        Horizon::new(&settings, 1)
    }

    #[test]
    fn every_step_has_a_block_as_far_as_the_plan_has_room() {
        let blocks = |steps, sections: usize, rate_change_weight| {
            let settings = NmpcSettings {
                horizon_steps: steps,
                rate_change_weight,
                ..NmpcSettings::default()
            };
            Horizon::new(&settings, 2 * sections).blocks()
        };
        for (sections, most) in [(1, 50), (2, 50), (3, 50), (4, 37), (5, 30), (6, 25)] {
            assert_eq!([10, 50].map(|n| blocks(n, sections, 0.0)), [10, most]);
            assert_eq!([10, 50].map(|n| blocks(n, sections, 1e-9)), [10, 20]);
        }
    }

    #[test]
    fn blocks_cover_all_steps_in_order() {
        for steps in 1..=50 {
            for blocks in 0..=steps {
                let horizon = horizon(steps, blocks);
                let of: Vec<_> = (0..horizon.steps())
                    .map(|step| horizon.block_of(step))
                    .collect();
                assert_eq!(of[0], 0);
                assert_eq!(of[of.len() - 1], horizon.blocks() - 1);
                assert!(
                    of.windows(2)
                        .all(|pair| pair[1] == pair[0] || pair[1] == pair[0] + 1)
                );
            }
        }
    }

    #[test]
    fn shifting_moves_the_plan_on_in_time() {
        let mut into = [0.0; 4];
        horizon(4, 4).shift(&[1.0, 2.0, 3.0, 4.0], 1, &mut into);
        assert_eq!(into, [2.0, 3.0, 4.0, 4.0]);
        horizon(4, 4).shift(&[1.0, 2.0, 3.0, 4.0], 99, &mut into);
        assert_eq!(into, [4.0; 4]);
        let mut into = [0.0; 2];
        horizon(4, 2).shift(&[1.0, 2.0], 1, &mut into);
        assert_eq!(into, [1.0, 2.0]);
        horizon(4, 2).shift(&[1.0, 2.0], 2, &mut into);
        assert_eq!(into, [2.0, 2.0]);
    }

    #[test]
    fn what_no_solve_has_foreseen_rests() {
        let rested = |horizon: Horizon, periods: u64, plan: &[f64]| {
            let mut plan = plan.to_vec();
            horizon.zero_past_horizon(&mut plan, periods);
            plan
        };
        let four = [2.0, 3.0, 4.0, 4.0];
        assert_eq!(rested(horizon(4, 4), 0, &four), four);
        assert_eq!(rested(horizon(4, 4), 1, &four), [2.0, 3.0, 4.0, 0.0]);
        assert_eq!(rested(horizon(4, 4), 3, &[4.0; 4]), [4.0, 0.0, 0.0, 0.0]);
        assert_eq!(rested(horizon(4, 4), 1, &[5.0; 4]), [5.0, 5.0, 5.0, 0.0]);
        assert_eq!(rested(horizon(2, 2), 9, &[2.0, 2.0]), [0.0, 0.0]);
        assert_eq!(rested(horizon(1, 1), 1, &[1.0]), [0.0]);
        // A shift leaves this plan unchanged, so without the rule it would continue for ever.
        assert_eq!(rested(horizon(4, 2), 1, &[1.0, 2.0]), [1.0, 0.0]);
        assert_eq!(rested(horizon(4, 2), 1, &[1.0, 0.0]), [0.0, 0.0]);
        assert_eq!(rested(horizon(4, 1), 1, &[1.0]), [0.0]);
    }
}
