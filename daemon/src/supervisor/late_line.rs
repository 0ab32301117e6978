use cdcr_shared_types::codes::LateCause;

use crate::handover::Summary;

/// Text of the log line of a late cycle. There is one line a second at most, so it may come up to a second after its cycle,
/// and the stamp of the log is that of the line.
pub(super) fn text(late: &Summary, newest: &Summary) -> String {
    let cause = LateCause::text_of(late.late_cause);
    match newest.due_ns.saturating_sub(late.due_ns) / 1_000_000 {
        0 => format!("late: {cause}"),
        ago_ms => format!("late: {cause}, {ago_ms} ms ago"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_held_back_says_when_its_cycle_was() {
        let summary = |due_ns| Summary {
            due_ns,
            late_cause: LateCause::Compute.code(),
            ..Summary::default()
        };
        let late = summary(1_000_000_000);
        assert_eq!(text(&late, &late), "late: compute");
        let newest = summary(1_935_000_000);
        assert_eq!(text(&late, &newest), "late: compute, 935 ms ago");
    }
}
