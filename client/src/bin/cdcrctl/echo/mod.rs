//! Prints messages as they pass.

pub(crate) mod json;
pub(crate) mod line;

use std::io::Write;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, Message, Stream};
use cdcr_shared_types::Service;
use cdcr_shared_types::message::Struct;

use crate::Done;
use crate::args::{EchoOptions, Format, Target, Topic};
use crate::interrupt::Interrupt;

/// After this long without a message, see whether the daemon still lives.
const QUIET: Duration = Duration::from_secs(1);
/// How often an interrupt is looked for.
const LOOK: Duration = Duration::from_millis(100);

/// How one kind of message is printed.
struct Look<T> {
    heading: &'static str,
    line: fn(&T) -> String,
}

pub(crate) fn run(target: &Target, options: &EchoOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    match options.topic {
        Topic::Telemetry => {
            let look = Look {
                heading: line::TELEMETRY_HEADING,
                line: line::telemetry,
            };
            print_all(&connection, connection.telemetry()?, options, &look)
        }
        Topic::Command => {
            let look = Look {
                heading: line::COMMAND_HEADING,
                line: line::command,
            };
            print_all(&connection, connection.commands()?, options, &look)
        }
        Topic::Status => {
            let look = Look {
                heading: line::STATUS_HEADING,
                line: line::status,
            };
            print_all(&connection, connection.statuses()?, options, &look)
        }
        Topic::Incidents => {
            let look = Look {
                heading: line::INCIDENT_HEADING,
                line: line::incident,
            };
            print_all(&connection, connection.incidents()?, options, &look)
        }
        Topic::Reference => {
            let look = Look {
                heading: line::REFERENCE_HEADING,
                line: line::reference,
            };
            print_all(&connection, connection.references()?, options, &look)
        }
        Topic::Obstacles => {
            let look = Look {
                heading: line::OBSTACLES_HEADING,
                line: line::obstacles,
            };
            print_all(&connection, connection.obstacle_updates()?, options, &look)
        }
    }
}

fn print_all<T: Message + Struct>(
    connection: &Connection,
    mut stream: Stream<T>,
    options: &EchoOptions,
    look: &Look<T>,
) -> anyhow::Result<Done> {
    let interrupt = Interrupt::catch()?;
    let mut out = std::io::stdout().lock();
    if options.format == Format::Text {
        writeln!(out, "{}", look.heading)?;
    }
    let mut pace = Pace::new(options.rate);
    let mut printed = 0;
    let mut heard = Instant::now();
    while !interrupt.is_raised() && options.count.is_none_or(|count| printed < count) {
        let Some(message) = stream.next_within(LOOK)? else {
            if heard.elapsed() > QUIET {
                connection.status(QUIET)?;
                heard = Instant::now();
            }
            continue;
        };
        heard = Instant::now();
        if pace.is_due(heard) {
            match options.format {
                Format::Text => writeln!(out, "{}", (look.line)(&message))?,
                Format::Json => writeln!(out, "{}", json::message(&message))?,
            }
            out.flush()?;
            printed += 1;
        }
    }
    warn_of_loss(T::SERVICE, stream.lost());
    Ok(Done::Good)
}

fn warn_of_loss(service: Service, lost: u64) {
    if lost > 0 {
        eprintln!(
            "{lost} messages of the {} service were lost: this program was too slow",
            service.key()
        );
    }
}

/// Lets at most so many messages a second through.
struct Pace {
    every: Duration,
    next: Option<Instant>,
}

impl Pace {
    fn new(rate_hz: Option<f64>) -> Self {
        // Slower than once a day is once a day.
        let period_s = rate_hz.map_or(0.0, |rate_hz| (1.0 / rate_hz).min(86_400.0));
        Self {
            every: Duration::from_secs_f64(period_s),
            next: None,
        }
    }

    fn is_due(&mut self, now: Instant) -> bool {
        let due = self.next.is_none_or(|next| now >= next);
        if due {
            // On a grid, so that the average rate is right; never a burst after a pause.
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
