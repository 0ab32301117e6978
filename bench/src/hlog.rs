//! Raw latencies \[ns\] in the log format of HDR histograms, so that other programs can compute percentiles.

use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, anyhow};
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};

use crate::dataset::Recording;

const NS_PER_US: f64 = 1e3;

pub fn log(started: SystemTime, recordings: &[Recording]) -> Result<Option<String>> {
    if recordings.is_empty() {
        return Ok(None);
    }
    // The format requires the intervals in the order of their start.
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
        let tag = &recording.tag;
        let wrong = || format!("the tag {tag:?} must be without spaces, commas and line feeds");
        let tag = Tag::new(tag).with_context(wrong)?;
        let [start, duration] = [recording.start_s, recording.duration_s]
            .map(|seconds| Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let written = writer.write_histogram(&recording.histogram_ns, start, duration, Some(tag));
        written.map_err(|cause| anyhow!("the histogram {}: {cause}", recording.tag))?;
    }
    Ok(Some(String::from_utf8(bytes)?))
}
