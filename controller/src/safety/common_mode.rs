use crate::robot::{CABLES_MAX, Robot, SECTIONS_MAX, common_modes_m};

/// Supervision of the common mode of each section: the mean length of its three cables. With cables at equal
/// angles it is the length of the backbone, independent of the bend (§2 of docs/model.md); angles that are
/// off by δ change it by at most r δ Σθ. The bends computed from lengths do not contain it. A cable that
/// breaks or comes off its drum changes it, and so do cables that go slack together.
#[derive(Debug, Clone, Copy)]
pub struct CommonModeWatch {
    most_m: f64,
    /// Value when control began, by section \[m\].
    begin_m: Option<[f64; SECTIONS_MAX]>,
}

impl CommonModeWatch {
    /// A common mode may change by `most_m` \[m\]; 0: no limit.
    pub fn new(most_m: f64) -> Self {
        Self {
            most_m,
            begin_m: None,
        }
    }

    /// Restarts: the next lengths are the new reference.
    pub fn begin(&mut self) {
        self.begin_m = None;
    }

    /// Whether the common mode of a section left its permitted range. Reported once: the next lengths then
    /// are the new reference.
    pub fn is_broken(&mut self, robot: &Robot, lengths_m: &[f64; CABLES_MAX]) -> bool {
        let mean_m = common_modes_m(lengths_m);
        let begin_m = *self.begin_m.get_or_insert(mean_m);
        let mut changes_m = mean_m.iter().zip(begin_m).take(robot.section_count());
        let is_broken = self.most_m > 0.0
            && changes_m.any(|(mean_m, begin_m)| (mean_m - begin_m).abs() > self.most_m);
        if is_broken {
            self.begin();
        }
        is_broken
    }
}
