//! The shortest of some periods, with few trials.

use anyhow::Result;

/// Index of the shortest period that `holds`, of `count` periods from the longest to the shortest; none when
/// even the longest does not hold. Goes step by step from `first` towards the border, so that a good guess
/// costs two trials.
///
/// It takes for granted what is so in every loop: with more time a period does not hold worse.
pub(super) fn shortest(
    count: usize,
    first: usize,
    mut holds: impl FnMut(usize) -> Result<bool>,
) -> Result<Option<usize>> {
    if count == 0 {
        return Ok(None);
    }
    let mut index = first.min(count - 1);
    if holds(index)? {
        while index + 1 < count && holds(index + 1)? {
            index += 1;
        }
        return Ok(Some(index));
    }
    while index > 0 {
        index -= 1;
        if holds(index)? {
            return Ok(Some(index));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_is_found_from_everywhere_and_no_period_is_tried_twice() {
        for holding in 0..=7_usize {
            for first in 0..9 {
                let mut tried = Vec::new();
                let found = shortest(7, first, |index| {
                    tried.push(index);
                    Ok(index < holding)
                });
                assert_eq!(found.unwrap(), holding.checked_sub(1), "from {first}");
                let all = tried.len();
                assert!(
                    all == 2 || first + 1 != holding || holding == 7,
                    "a good guess"
                );
                tried.sort_unstable();
                tried.dedup();
                assert_eq!(all, tried.len());
            }
        }
    }

    #[test]
    fn an_error_ends_the_search() {
        assert!(shortest(7, 3, |_| anyhow::bail!("no")).is_err());
        assert_eq!(shortest(0, 3, |_| Ok(true)).unwrap(), None);
    }
}
