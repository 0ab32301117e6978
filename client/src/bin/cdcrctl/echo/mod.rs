//! Prints messages as they arrive.

pub(crate) mod field;
pub(crate) mod json;
pub(crate) mod line;

use std::io::Write;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, DURATION_MAX_S, Message, Stream, counted};
use cdcr_shared_types::Service;
use cdcr_shared_types::message::Struct;

use crate::args::{EchoOptions, EchoTopic, Format, Target};
use crate::done::Done;
use crate::interrupt::{INTERRUPT_INTERVAL, Interrupt, QUIET};

/// Text format of one kind of message.
pub(crate) struct LineFormat<T> {
    heading: &'static str,
    line: fn(&T) -> String,
}

/// Handler for the messages of a service.
pub(crate) trait MessageHandler {
    /// Handles messages until it has enough of them.
    fn watch<T: Message + Struct>(
        &self,
        connection: &Connection,
        stream: Stream<T>,
        format: &LineFormat<T>,
    ) -> anyhow::Result<Done>;
}

/// Passes the messages of a topic to `watch`.
pub(crate) fn watch(
    target: &Target,
    topic: EchoTopic,
    watch: &impl MessageHandler,
) -> anyhow::Result<Done> {
    let connection = &target.connect()?;
    macro_rules! shown {
        ($messages:ident, $heading:ident, $line:ident) => {{
            let (heading, line) = (line::$heading, line::$line);
            watch.watch(
                connection,
                connection.$messages()?,
                &LineFormat { heading, line },
            )
        }};
    }
    match topic {
        EchoTopic::Telemetry => shown!(telemetry, TELEMETRY_HEADING, telemetry),
        EchoTopic::Command => shown!(commands, COMMAND_HEADING, command),
        EchoTopic::Status => shown!(statuses, STATUS_HEADING, status),
        EchoTopic::Incidents => shown!(incidents, INCIDENT_HEADING, incident),
        EchoTopic::Reference => shown!(references, REFERENCE_HEADING, reference),
        EchoTopic::Obstacles => shown!(obstacle_updates, OBSTACLES_HEADING, obstacles),
    }
}

/// Passes each message to `take`, and `None` at intervals without messages, until `take` ends it or an
/// interrupt arrives.
pub(crate) fn each<T: Message>(
    connection: &Connection,
    stream: &mut Stream<T>,
    mut take: impl FnMut(Option<&T>) -> anyhow::Result<bool>,
) -> anyhow::Result<()> {
    let interrupt = Interrupt::catch()?;
    let mut heard = Instant::now();
    while !interrupt.is_raised() {
        let message = stream.next_within(INTERRUPT_INTERVAL)?;
        if message.is_some() {
            heard = Instant::now();
        } else if heard.elapsed() > QUIET {
            connection.status(QUIET)?;
            heard = Instant::now();
        }
        if !take(message.as_ref())? {
            break;
        }
    }
    Ok(())
}

/// Passes `count` messages to `take`, or all, at no more than this rate \[Hz\].
pub(crate) fn paced<T: Message>(
    connection: &Connection,
    stream: &mut Stream<T>,
    (rate, count): (Option<f64>, Option<u64>),
    mut take: impl FnMut(&T) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let (mut pace, mut taken) = (Pace::new(rate), 0);
    each(connection, stream, |message| {
        if let Some(message) = message.filter(|_| pace.is_due(Instant::now())) {
            take(message)?;
            taken += 1;
        }
        Ok(count != Some(taken))
    })
}

pub(crate) fn run(target: &Target, options: &EchoOptions) -> anyhow::Result<Done> {
    watch(target, options.topic, options)
}

impl MessageHandler for EchoOptions {
    fn watch<T: Message + Struct>(
        &self,
        connection: &Connection,
        mut stream: Stream<T>,
        format: &LineFormat<T>,
    ) -> anyhow::Result<Done> {
        let mut out = std::io::stdout().lock();
        let mut heading = None;
        match (self.format, &*self.field) {
            (Format::Text, []) => writeln!(out, "{}", format.heading)?,
            // Above the first message, which shows whether the fields exist.
            (Format::Text, fields) => heading = Some(fields.join("\t")),
            (Format::Json, _) => {}
        }
        let limits = (self.rate, self.count);
        paced(connection, &mut stream, limits, |message| {
            field::check(message, &self.field)?;
            let shown = match (self.format, &*self.field) {
                (Format::Text, []) => (format.line)(message),
                (Format::Text, fields) => field::line(&json::message(message), fields)?,
                (Format::Json, []) => json::message(message).to_string(),
                (Format::Json, fields) => {
                    field::select(&json::message(message), fields)?.to_string()
                }
            };
            let heading = heading.take().map(|heading| heading + "\n");
            writeln!(out, "{}{shown}", heading.unwrap_or_default())?;
            Ok(out.flush()?)
        })?;
        warn_of_loss(T::SERVICE, stream.lost());
        Ok(Done::Good)
    }
}

fn warn_of_loss(service: Service, lost: u64) {
    if lost > 0 {
        tell!(
            "lost {} of the {} service: this program was too slow",
            counted(lost, "message"),
            service.key()
        );
    }
}

/// Limits the rate of messages.
struct Pace {
    every: Duration,
    next: Option<Instant>,
}

impl Pace {
    pub(crate) fn new(rate_hz: Option<f64>) -> Self {
        // The lowest rate is once a day.
        let period_s = rate_hz.map_or(0.0, |rate_hz| (1.0 / rate_hz).min(DURATION_MAX_S));
        Self {
            every: Duration::from_secs_f64(period_s),
            next: None,
        }
    }

    pub(crate) fn is_due(&mut self, now: Instant) -> bool {
        let due = self.next.is_none_or(|next| now >= next);
        if due {
            // On a grid, for a correct average rate; no burst after a pause.
            let on_grid = self.next.unwrap_or(now) + self.every;
            self.next = Some(on_grid.max(now + self.every / 2));
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_hertz_of_200() {
        let start = Instant::now();
        let mut pace = Pace::new(Some(10.0));
        let due = (0..400_u32).filter(|&i| pace.is_due(start + i * Duration::from_millis(5)));
        assert_eq!(due.count(), 20);
    }

    #[test]
    fn without_a_rate_all_pass() {
        let now = Instant::now();
        let mut pace = Pace::new(None);
        assert!((0..10).all(|_| pace.is_due(now)));
    }
}
