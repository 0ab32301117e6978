//! Measures message rates.

use std::io::Write;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, Message, Stream, monotonic_ns};
use cdcr_shared_types::message::Struct;

use crate::args::{HzOptions, Target};
use crate::done::Done;
use crate::echo::{LineFormat, MessageHandler, each, watch};

/// Interval of the printed lines.
const LINE: Duration = Duration::from_secs(1);

pub(crate) fn run(target: &Target, options: &HzOptions) -> anyhow::Result<Done> {
    watch(target, options.topic, options)
}

impl MessageHandler for HzOptions {
    fn watch<T: Message + Struct>(
        &self,
        connection: &Connection,
        mut stream: Stream<T>,
        _: &LineFormat<T>,
    ) -> anyhow::Result<Done> {
        let mut out = std::io::stdout().lock();
        writeln!(out, "{HEADING}")?;
        let (mut printed, mut lost, mut last) = (0, 0, None);
        while self.count.is_none_or(|count| printed < count) {
            let mut gaps = Gaps::default();
            let (begin, begin_ns, mut lives) = (Instant::now(), monotonic_ns(), false);
            each(connection, &mut stream, |message| {
                // Silence means nothing for a daemon that was suspended, or that has not noticed this reader
                // yet. So the messages are read once more before silence is reported.
                let lived = lives;
                if message.is_none() {
                    let status = connection.status(Duration::ZERO);
                    lives |= status.is_ok_and(|status| status.header.sent_ns > begin_ns);
                }
                if let Some(header) = message.map(Message::header) {
                    gaps.count += 1;
                    // A line covers one sender only.
                    if let Some((sender_id, sent_ns)) = last
                        && sender_id == header.sender_id
                    {
                        gaps.take(header.sent_ns.saturating_sub(sent_ns) as f64 * 1e-6);
                    }
                    last = Some((header.sender_id, header.sent_ns));
                }
                Ok(begin.elapsed() < LINE || gaps.count == 0 && !lived)
            })?;
            let span = begin.elapsed();
            if span < LINE {
                break;
            }
            let missing = stream.lost() - lost;
            lost = stream.lost();
            writeln!(out, "{}", gaps.line(span, missing))?;
            out.flush()?;
            printed += 1;
        }
        Ok(Done::Good)
    }
}

const HEADING: &str = "messages/s  between ms: mean       min       max  deviation  lost";

/// Intervals between the stamps of messages \[ms\].
#[derive(Debug, Default)]
struct Gaps {
    count: u64,
    all_ms: Vec<f64>,
}

impl Gaps {
    fn take(&mut self, gap_ms: f64) {
        self.all_ms.push(gap_ms);
    }

    fn line(&self, span: Duration, lost: u64) -> String {
        let rate = self.count as f64 / span.as_secs_f64();
        if self.all_ms.is_empty() {
            return format!(
                "{rate:>10.2}{:>18}{:>10}{:>10}{:>11}{lost:>6}",
                "-", "-", "-", "-"
            );
        }
        let count = self.all_ms.len() as f64;
        let mean = self.all_ms.iter().sum::<f64>() / count;
        let squares = self.all_ms.iter().map(|ms| (ms - mean).powi(2));
        let deviation = (squares.sum::<f64>() / count).sqrt();
        let min = self.all_ms.iter().copied().fold(f64::INFINITY, f64::min);
        let max = self.all_ms.iter().copied().fold(0.0, f64::max);
        format!("{rate:>10.2}{mean:>18.3}{min:>10.3}{max:>10.3}{deviation:>11.3}{lost:>6}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_its_numbers_below_their_heads() {
        let gaps = Gaps {
            count: 4,
            all_ms: vec![4.0, 6.0, 5.0, 5.0],
        };
        let line = gaps.line(Duration::from_secs(2), 3);
        let words: Vec<_> = line.split_whitespace().collect();
        assert_eq!(words, ["2.00", "5.000", "4.000", "6.000", "0.707", "3"]);
        assert_eq!(line.len(), HEADING.len());
        let none = Gaps::default().line(Duration::from_secs(1), 0);
        assert!(none.trim_start().starts_with("0.00") && none.len() == HEADING.len());
    }
}
