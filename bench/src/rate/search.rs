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
