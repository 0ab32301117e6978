//! A client in this process that feeds one curve after the other.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use cdcr_client::{Circle, Connection, FeedEnd, FeedEvent, FeedOptions, Line, Spiral, Trajectory};

use crate::chaos::dice::Dice;
use crate::chaos::tally::Tally;

const SECTIONS_M: [f64; 3] = [0.3; 3];

/// Feeds until `ending`. Errors of a feed are expected, and only counted.
pub(crate) fn feed(connection: &Connection, mut dice: Dice, tally: &Tally, ending: &AtomicBool) {
    while !ending.load(Ordering::Relaxed) {
        if dice.chance(80) {
            // Tracking requires a reset first.
            let _ = connection.reset(dice.chance(80));
        }
        let curve = curve(&mut dice);
        let options = FeedOptions {
            lead: dice.duration_ms(60, 300),
            track: dice.chance(80),
            ..FeedOptions::default()
        };
        let until = Instant::now() + dice.duration_ms(200, 4000);
        let result = connection.feed(&*curve, options).and_then(|feeder| {
            feeder.run(|event| {
                let is_over = matches!(event, FeedEvent::Progress(_))
                    && (Instant::now() > until || ending.load(Ordering::Relaxed));
                if is_over {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            })
        });
        tally.count(match result {
            Ok(report) if report.end == FeedEnd::Played => "feeds of a thread: played to the end",
            Ok(_) => "feeds of a thread: left in the middle",
            Err(_) => "feeds of a thread: refused, or ended by what happened",
        });
        std::thread::sleep(dice.duration_ms(20, 400));
    }
}

fn curve(dice: &mut Dice) -> Box<dyn Trajectory> {
    let duration_s = dice.between(0.5, 3.0);
    match dice.below(3) {
        0 => Box::new(Spiral {
            duration_s,
            ..Spiral::for_sections(&SECTIONS_M)
        }),
        1 => Box::new(Line {
            velocity_m_s: dice.vector(0.1),
            start_m: [0.1, dice.between(-0.2, 0.2), 0.5],
            duration_s,
            ..Line::for_sections(&SECTIONS_M)
        }),
        _ => Box::new(Circle {
            duration_s,
            ..Circle::for_sections(&SECTIONS_M)
        }),
    }
}
