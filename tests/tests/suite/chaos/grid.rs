//! Invariant: numbers and times only increase, and lie on the grid.

use cdcr_shared_types::Telemetry;

use crate::chaos::{CheckResult, ensure};

/// Checks one record: it lies on the grid of `origin_ns`, and its times are in order.
pub(crate) fn check(record: &Telemetry, origin_ns: u64) -> CheckResult {
    let due = origin_ns + record.cycle * record.period_ns;
    ensure(record.release_ns == due, || {
        format!("released at {} instead of {due} ns", record.release_ns)
    })?;
    let times = [
        record.due_ns,
        record.release_ns,
        record.start_ns,
        record.solve_start_ns,
        record.solve_end_ns,
        record.handed_over_ns,
        record.header.sent_ns,
    ];
    ensure(times.is_sorted(), || format!("times go back: {times:?}"))?;
    let whole = record.elapsed_ns > 0 && record.elapsed_ns.is_multiple_of(record.period_ns);
    ensure(whole, || {
        format!("{} ns are not a whole number of periods", record.elapsed_ns)
    })
}

/// Checks a record against the previous one. Returns whether they are consecutive, with nothing lost in
/// between.
pub(crate) fn check_pair(before: &Telemetry, record: &Telemetry) -> Result<bool, String> {
    let forward = |what: &str, before: u64, now: u64, least: u64| {
        ensure(now >= before + least, || {
            format!("{what} goes from {before} to {now}")
        })
    };
    ensure(record.header.sender_id == before.header.sender_id, || {
        "another daemon sends".to_owned()
    })?;
    let (last, header) = (&before.header, &record.header);
    forward("header.sequence", last.sequence, header.sequence, 1)?;
    forward("header.sent_ns", last.sent_ns, header.sent_ns, 0)?;
    forward("cycle", before.cycle, record.cycle, 1)?;
    forward("gather", before.gather, record.gather, 0)?;
    forward("gather_ns", before.gather_ns, record.gather_ns, 0)?;
    let (misses, skipped) = (before.deadline_misses_total, before.skipped_periods_total);
    forward("deadline misses", misses, record.deadline_misses_total, 0)?;
    forward("skipped periods", skipped, record.skipped_periods_total, 0)?;
    if header.sequence > last.sequence + 1 {
        return Ok(false);
    }
    let skipped = u64::from(record.skipped_periods);
    if record.cycle != before.cycle + 1 + skipped {
        // The daemon itself lost records; it counts them, and the end of the run compares the counts.
        return Ok(false);
    }
    let elapsed_ns = record.release_ns - before.release_ns;
    ensure(record.elapsed_ns == elapsed_ns, || {
        format!("{elapsed_ns} ns passed, {} are reported", record.elapsed_ns)
    })?;
    ensure(
        record.skipped_periods_total == before.skipped_periods_total + skipped,
        || "skipped periods are counted wrongly".to_owned(),
    )?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cycle: u64) -> Telemetry {
        let release_ns = 1000 + 5 * cycle;
        let mut record = Telemetry {
            cycle,
            period_ns: 5,
            elapsed_ns: 5,
            release_ns,
            due_ns: release_ns,
            start_ns: release_ns,
            solve_start_ns: release_ns + 1,
            solve_end_ns: release_ns + 2,
            handed_over_ns: release_ns + 3,
            ..Telemetry::default()
        };
        record.header.sequence = cycle;
        record.header.sent_ns = release_ns + 4;
        record
    }

    #[test]
    fn what_goes_back_or_leaves_the_grid_is_found() {
        assert_eq!(check(&record(7), 1000), Ok(()));
        assert!(check(&record(7), 999).is_err());
        let late = Telemetry {
            start_ns: 1034,
            ..record(7)
        };
        assert!(check(&late, 1000).is_err(), "solved before it started");
        assert_eq!(check_pair(&record(7), &record(8)), Ok(true));
        assert!(check_pair(&record(8), &record(7)).is_err());
        assert!(check_pair(&record(8), &record(8)).is_err());
        assert_eq!(check_pair(&record(7), &record(9)), Ok(false), "one is lost");
    }
}
