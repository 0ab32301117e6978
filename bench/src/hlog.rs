//! Raw latencies in the log format of HDR histograms, which others can read: whoever doubts a percentile
//! computes it again.
//!
//! A value is in nanoseconds; the column of the largest value, which is for people, in microseconds.

use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, anyhow};
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};

use crate::dataset::Recording;

/// From the recorded nanoseconds to the microseconds of the column for people.
const NS_PER_US: f64 = 1e3;

/// The log of one benchmark, whose run began at `started`; none when it recorded nothing.
pub fn log(started: SystemTime, recordings: &[Recording]) -> Result<Option<String>> {
    if recordings.is_empty() {
        return Ok(None);
    }
    // The format wants the intervals in the order of their begin.
    let mut ordered: Vec<&Recording> = recordings.iter().collect();
    ordered.sort_by(|one, other| one.start_s.total_cmp(&other.start_s));
    let (mut bytes, mut serializer) = (Vec::new(), V2DeflateSerializer::new());
    let mut writer = IntervalLogWriterBuilder::new()
        .add_comment("[Histogram log format version 1.3]")
        .add_comment("[cdcr-bench: values in ns, the column Interval_Max in µs]")
        .with_start_time(started)
        .with_base_time(started)
        .with_max_value_divisor(NS_PER_US)
        .begin_log_with(&mut bytes, &mut serializer)?;
    for recording in ordered {
        let tag = Tag::new(&recording.tag).with_context(|| {
            let tag = &recording.tag;
            format!("the tag {tag:?} of a histogram must be without spaces, commas and line feeds")
        })?;
        let (start, duration) = (seconds(recording.start_s), seconds(recording.duration_s));
        writer
            .write_histogram(&recording.histogram_ns, start, duration, Some(tag))
            .map_err(|cause| anyhow!("the histogram {}: {cause}", recording.tag))?;
    }
    Ok(Some(String::from_utf8(bytes)?))
}

fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use hdrhistogram::Histogram;
    use hdrhistogram::serialization::Deserializer;
    use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};

    use super::*;
    use crate::quantiles::histogram;

    fn recording(tag: &str, start_s: f64, histogram: &Histogram<u64>) -> Recording {
        Recording {
            tag: tag.to_owned(),
            start_s,
            duration_s: 2.5,
            histogram_ns: histogram.clone(),
        }
    }

    #[test]
    fn what_was_recorded_is_read_again() {
        let (mut one, mut other) = (histogram().expect("bounds"), histogram().expect("bounds"));
        for ns in [1, 950, 20_000, 20_000, 7_000_000] {
            one.record(ns).expect("within the bounds");
        }
        other.record_n(123_456, 1000).expect("within the bounds");
        let started = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000);
        let recordings = [
            recording("none.daemon.wake", 60.0, &one),
            recording("none.bare.wake", 0.5, &other),
        ];
        let text = log(started, &recordings).expect("written").expect("a log");
        let (mut found, mut base) = (0, None);
        for entry in IntervalLogIterator::new(text.as_bytes()) {
            match entry.expect("an entry") {
                LogEntry::BaseTime(time) => base = Some(time),
                LogEntry::Interval(interval) => {
                    // In the order of time, whatever the order of the recordings.
                    let expected = &recordings[1 - found];
                    found += 1;
                    assert_eq!(interval.tag().expect("a tag").as_str(), expected.tag);
                    assert_eq!(interval.start_timestamp(), seconds(expected.start_s));
                    assert_eq!(interval.duration(), Duration::from_millis(2500));
                    let bytes = STANDARD
                        .decode(interval.encoded_histogram())
                        .expect("base64");
                    let again: Result<Histogram<u64>, _> =
                        Deserializer::new().deserialize(&mut &*bytes);
                    assert_eq!(again.expect("a histogram"), expected.histogram_ns);
                }
                LogEntry::StartTime(_) => {}
            }
        }
        assert_eq!((found, base), (2, Some(Duration::from_secs(1_000_000))));
    }

    #[test]
    fn nothing_leaves_no_log_and_a_tag_with_a_space_is_refused() {
        assert_eq!(log(SystemTime::UNIX_EPOCH, &[]).expect("nothing"), None);
        let empty = histogram().expect("bounds");
        let refused = log(SystemTime::UNIX_EPOCH, &[recording("a b", 0.0, &empty)]);
        let error = refused.expect_err("a space").to_string();
        assert!(error.contains("\"a b\""), "{error}");
    }
}
