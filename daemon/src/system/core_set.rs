//! Sets of cores in the kernel's notation.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::Deref;

/// No machine has more cores. Limit for `all`, and for invalid lists.
const CORES_MAX: usize = 8192;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct CoreSet(BTreeSet<usize>);

impl CoreSet {
    /// Parses a list such as `0-3,8`. `all` is every core; parts that are not numbers (`(null)`, the flags of
    /// `isolcpus=`) are ignored.
    pub(crate) fn parse(list: &str) -> Self {
        let parts = list.split(',').map(str::trim);
        Self(parts.flat_map(range_of).collect())
    }

    #[must_use]
    pub(crate) fn without(&self, core: usize) -> Self {
        let others = self.iter().filter(|other| **other != core);
        Self(others.copied().collect())
    }
}

impl Deref for CoreSet {
    type Target = BTreeSet<usize>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

fn range_of(part: &str) -> std::ops::Range<usize> {
    if part == "all" {
        return 0..CORES_MAX;
    }
    let (first, last) = part.split_once('-').unwrap_or((part, part));
    match (first.parse::<usize>(), last.parse::<usize>()) {
        (Ok(first), Ok(last)) if last < CORES_MAX => first..last + 1,
        _ => 0..0,
    }
}

/// In the kernel's notation; the empty set is `none`.
impl fmt::Display for CoreSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("none");
        }
        let cores: Vec<usize> = self.iter().copied().collect();
        let runs = cores.chunk_by(|core, next| core + 1 == *next);
        let words = runs.map(|run| match run {
            [first, .., last] => format!("{first}-{last}"),
            _ => run[0].to_string(),
        });
        f.write_str(&words.collect::<Vec<_>>().join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_the_kernel_writes_them_and_nonsense_is_the_empty_set() {
        for list in ["0", "0-3", "0-3,8", "1,3,5-7"] {
            assert_eq!(CoreSet::parse(list).to_string(), list);
        }
        assert_eq!(CoreSet::parse("2,3 ,4\n").to_string(), "2-4");
        assert!(CoreSet::parse("managed_irq,domain,2").contains(&2));
        assert!(CoreSet::parse("all").contains(&5));
        for list in ["", "\n", "(null)", "-", "3-", "9-2", "0-99999999999", "x-y"] {
            assert!(CoreSet::parse(list).is_empty(), "{list:?}");
        }
    }
}
