use crate::robot::{CABLES_MAX, Robot, SECTIONS_MAX};

/// Watches the common mode of each section's three cables: the mean of their lengths. Where they stand at equal angles it is the length of the backbone however that is bent (§2 of
/// docs/model.md); angles that are off by δ change it by r δ Σθ at most. The bends that lengths tell have no part of it, but a cable that broke or came off its drum changes it, and so do cables that go slack together.
#[derive(Debug, Clone, Copy)]
pub struct CommonModeWatch {
    most_m: f64,
    /// When control began, section by section (m).
    begin_m: Option<[f64; SECTIONS_MAX]>,
}

impl CommonModeWatch {
    /// A common mode may change by `most_m` (m); 0: by any amount.
    pub fn new(most_m: f64) -> Self {
        Self {
            most_m,
            begin_m: None,
        }
    }

    /// Control begins: the next lengths are those that count.
    pub fn begin(&mut self) {
        self.begin_m = None;
    }

    /// Whether the common mode of a section is farther than allowed from where it was. That is told once: the next lengths count then.
    pub fn is_broken(&mut self, robot: &Robot, lengths_m: &[f64; CABLES_MAX]) -> bool {
        let (sections_m, _) = lengths_m.as_chunks::<3>();
        let mean_m = core::array::from_fn(|j| sections_m[j].iter().sum::<f64>() / 3.0);
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
