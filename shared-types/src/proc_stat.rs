//! Texts of the kernel: core times from `/proc/stat`, fields of the `stat` and `status` of a process or thread, a chosen
//! alternative. The one reader for daemon, client and measurements.

use core::str::FromStr;

/// One tick of `/proc/stat` \[ns\]: `USER_HZ` is 100 on every platform on which Linux runs user programs.
pub const TICK_NS: u64 = 10_000_000;

/// Time of a core since the machine started, in ticks of [`TICK_NS`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CoreTicks {
    /// In use.
    pub busy: u64,
    /// Given to other guests by the hypervisor.
    pub steal: u64,
    /// Total, including idle time.
    pub total: u64,
}

impl CoreTicks {
    /// The ticks since an earlier reading. Counters that run backwards (of a core that was off) count as zero.
    #[must_use]
    pub fn since(self, earlier: Self) -> Self {
        Self {
            busy: self.busy.saturating_sub(earlier.busy),
            steal: self.steal.saturating_sub(earlier.steal),
            total: self.total.saturating_sub(earlier.total),
        }
    }

    /// Some ticks as a share of the total, 0 to 1; 0 where the total is 0.
    #[must_use]
    pub fn share(self, ticks: u64) -> f64 {
        (ticks as f64 / self.total.max(1) as f64).min(1.0)
    }
}

/// The times of each core from the text of `/proc/stat`; `None` is the sum of all cores. Lines that do not conform to
/// `proc_stat(5)` are skipped.
pub fn core_ticks(stat: &str) -> impl Iterator<Item = (Option<usize>, CoreTicks)> {
    stat.lines().filter_map(|line| {
        let (name, times) = line.strip_prefix("cpu")?.split_once(' ')?;
        let core = match name {
            "" => None,
            number => Some(number.parse().ok()?),
        };
        // user nice system idle iowait irq softirq steal. The time of guests is included in `user`.
        let mut ticks = [0_u64; 8];
        let mut words = times.split_ascii_whitespace();
        for tick in &mut ticks {
            *tick = words.next()?.parse().ok()?;
        }
        let total = ticks.into_iter().fold(0, u64::saturating_add);
        let [_, _, _, idle, waiting, _, _, steal] = ticks;
        let unused = idle.saturating_add(waiting).saturating_add(steal);
        let busy = total.saturating_sub(unused);
        Some((core, CoreTicks { busy, steal, total }))
    })
}

/// A field of the `stat` of a process or thread, from number 3 on (`proc_pid_stat(5)`). The name in field 2 may
/// contain any character, so fields are counted from its closing parenthesis.
pub fn stat_field<T: FromStr>(stat: &[u8], number: usize) -> Option<T> {
    let end = stat.iter().rposition(|byte| *byte == b')')?;
    let rest = core::str::from_utf8(&stat[end + 1..]).ok()?;
    let mut fields = rest.split_ascii_whitespace();
    fields.nth(number.checked_sub(3)?)?.parse().ok()
}

/// Minor and major page faults since the start of a process or thread, from its `stat`.
pub fn page_faults(stat: &[u8]) -> Option<u64> {
    Some(stat_field::<u64>(stat, 10)? + stat_field::<u64>(stat, 12)?)
}

/// The value of the first line `name: value`, as in the `status` of a process or in `/proc/cpuinfo`.
pub fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == name).then(|| value.trim())
    })
}

/// Whether a bit is set in a mask of the `status` of a process, like `CapEff` or `SigCgt`.
pub fn has_bit(status: &str, mask: &str, bit: u32) -> bool {
    let bits = field(status, mask).and_then(|hex| u64::from_str_radix(hex, 16).ok());
    bits.is_some_and(|bits| bits >> bit & 1 == 1)
}

/// The chosen one of several alternatives: the word in brackets.
pub fn chosen(text: &str, brackets: [char; 2]) -> Option<&str> {
    let (_, rest) = text.split_once(brackets[0])?;
    let (chosen, _) = rest.split_once(brackets[1])?;
    Some(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn core_lines_are_parsed_as_in_proc_stat() {
        let text = "cpu  9 9 9 9 9 9 9 997 0 0\ncpu0 1 2\ncpu1 1 2 3 40 5 6 7 507 9 10\ncpu2 x\n\
                    cpu10 1 2 3 4 5 6 7 1 9 10\nintr 5\ncpu3";
        let read: Vec<_> = core_ticks(text).collect();
        let names: Vec<_> = read.iter().map(|(core, _)| *core).collect();
        assert_eq!(names, [None, Some(1), Some(10)]);
        let expected = CoreTicks {
            busy: 19,
            steal: 507,
            total: 571,
        };
        assert_eq!(read[1].1, expected);
        assert_eq!(read[0].1.steal, 997);
    }

    #[test]
    fn fields_of_a_process_are_counted_from_the_end_of_its_name() {
        let stat = b"18911 (a) b (c) R 18908 18908 18103 0 -1 4194304 123 0 4 0 0 0 0 0 20";
        assert_eq!(stat_field(stat, 3), Some('R'));
        assert_eq!(stat_field::<char>(stat, 2), None);
        assert_eq!(page_faults(stat), Some(127));
        assert_eq!(page_faults(b"18911 (cat) R 1"), None);
        assert_eq!(page_faults(&[0xff, b')', 0xfe]), None);
    }

    #[test]
    fn fields_masks_and_choices_are_found_or_missing() {
        let status = "Name:\tx\nCapEff:\t0000000000004001\nOdd:\tz\nvm size : 5 kB\n";
        assert_eq!(
            (field(status, "vm size"), field(status, "Nam")),
            (Some("5 kB"), None)
        );
        let bits = [
            ("CapEff", 0),
            ("CapEff", 14),
            ("CapEff", 1),
            ("Odd", 0),
            ("None", 0),
        ];
        let set = bits.map(|(mask, bit)| has_bit(status, mask, bit));
        assert_eq!(set, [true, true, false, false, false]);
        let huge_pages = "always [madvise] never";
        assert_eq!(chosen(huge_pages, ['[', ']']), Some("madvise"));
        assert_eq!(
            (chosen(huge_pages, ['(', ')']), chosen("[a", ['[', ']'])),
            (None, None)
        );
    }
}
