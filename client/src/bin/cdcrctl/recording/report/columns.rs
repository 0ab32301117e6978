/// Data of a stretch of time that can be merged with the next one.
pub(super) trait Merge {
    /// Merges the following stretch.
    fn merge(&mut self, later: Self);
}

/// Values in columns of equal duration. When the recording needs more columns than `count_max`, their width
/// doubles. So any recording takes the same memory and is read once.
#[derive(Debug)]
pub(super) struct Columns<T> {
    count_max: usize,
    first_ns: u64,
    width_ns: u64,
    filled: Vec<Option<T>>,
}

impl<T: Merge> Columns<T> {
    /// `count_max` columns (1 or more) from `first_ns` on, with an initial width of `width_ns`.
    pub(super) fn new(count_max: usize, first_ns: u64, width_ns: u64) -> Self {
        Self {
            count_max,
            first_ns,
            width_ns: width_ns.max(1),
            filled: Vec::new(),
        }
    }

    /// Adds a value. A value before the first column is added to that column.
    pub(super) fn take(&mut self, time_ns: u64, value: T) {
        let since_ns = time_ns.saturating_sub(self.first_ns);
        while since_ns / self.width_ns >= self.count_max as u64 {
            self.widen();
        }
        let index = (since_ns / self.width_ns) as usize;
        if self.filled.len() <= index {
            self.filled.resize_with(index + 1, || None);
        }
        match &mut self.filled[index] {
            Some(column) => column.merge(value),
            empty => *empty = Some(value),
        }
    }

    fn widen(&mut self) {
        self.width_ns *= 2;
        let mut narrow = std::mem::take(&mut self.filled).into_iter();
        while let Some(first) = narrow.next() {
            let wide = match (first, narrow.next().flatten()) {
                (Some(mut first), Some(second)) => {
                    first.merge(second);
                    Some(first)
                }
                (first, second) => first.or(second),
            };
            self.filled.push(wide);
        }
    }

    pub(super) fn width_ns(&self) -> u64 {
        self.width_ns
    }

    /// The columns with values, in order.
    pub(super) fn iter(&self) -> impl Iterator<Item = &T> {
        self.filled.iter().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Merge for (u64, u64) {
        fn merge(&mut self, later: Self) {
            assert!(self.1 < later.0, "in order");
            self.1 = later.1;
        }
    }

    #[test]
    fn a_long_recording_has_wider_columns_and_no_fewer_values() {
        for count in [1, 8, 9, 1000] {
            let mut columns = Columns::new(8, 100, 5);
            for k in 0..count {
                columns.take(100 + 5 * k, (k, k));
            }
            let kept: Vec<_> = columns.iter().copied().collect();
            assert!(kept.len() <= 8 && kept.len() as u64 >= count.min(5));
            assert_eq!((kept[0].0, kept[kept.len() - 1].1), (0, count - 1));
            assert!(kept.windows(2).all(|pair| pair[0].1 + 1 == pair[1].0));
        }
    }

    #[test]
    fn a_gap_stays_a_gap_and_a_leap_ends() {
        let mut columns = Columns::new(8, 0, 5);
        columns.take(0, (0, 0));
        columns.take(20, (4, 4));
        assert_eq!(columns.iter().count(), 2);
        columns.take(u64::MAX, (9, 9));
        assert_eq!(columns.iter().count(), 2);
    }
}
