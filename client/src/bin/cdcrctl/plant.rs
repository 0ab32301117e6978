//! A simulated robot in its own process, in place of a driver.

use std::io::Write;
use std::mem::discriminant;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use cdcr_client::{PlantDriver, STATUS_TIMEOUT, counted, events, remedy};
use cdcr_shared_types::codes::{EventKind, Interface, Mode, Outcome, Reason};
use cdcr_shared_types::{InputEvent, Telemetry};

use crate::args::{PlantOptions, Target};
use crate::done::Done;
use crate::interrupt::Interrupt;
use crate::tell;

/// Interval of the cable measurements.
const TURN: Duration = Duration::from_millis(1);

/// Interval at which a refusal of the same kind is printed again: each command may be refused.
const REPEAT_INTERVAL: Duration = Duration::from_secs(10);

/// Time for which the daemon's acceptance of the measurements is checked.
const CHECK_DURATION: Duration = Duration::from_secs(1);

pub(crate) fn run(target: &Target, options: &PlantOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let status = connection.status(STATUS_TIMEOUT)?;
    // A daemon may also be stopped before its first measurement.
    let is_unmeasured = status.mode == Mode::Starting.code()
        || status.mode == Mode::Stopped.code()
            && status.reset_refused_by == Reason::MeasurementLost.code();
    if !is_unmeasured && !options.force {
        bail!(
            "the robot is already measured, by a driver or a simulating daemon (the daemon is {}): its motors would \
             follow the commands to the simulated robot\n\
             use --force only if no motors are connected, or to restart a simulated robot",
            Mode::text_of(status.mode)
        );
    }
    let configured = Interface::try_from(status.interface).ok();
    let interface = options.interface.or(configured);
    let interface = interface.context("the daemon's interface is unknown: use --interface")?;
    let mut telemetry = connection.telemetry()?;
    let (preset, seed, mut flaws) = (options.preset, options.seed, options.preset.flaws());
    for (name, value) in &options.flaws {
        flaws = flaws.with(name, *value)?;
    }
    let mut robot = PlantDriver::new(&connection, interface, None, flaws, seed)?;
    if !options.sections.is_empty() {
        robot = robot.with_geometry(&options.sections)?;
    }
    let interrupt = Interrupt::catch()?;
    writeln!(
        std::io::stdout(),
        "a simulated robot with {} drives robot \"{}\": preset {}, {}; Ctrl-C to end",
        counted(status.robot.sections, "section"),
        target.location()?.1,
        preset.name(),
        interface.text()
    )?;
    let tip_every = match options.tip {
        Some(rate_hz) => Some(Duration::from_secs_f64(1.0 / rate_hz)),
        None => preset.measures_tip().then_some(TURN),
    };
    let begun = Instant::now();
    let mut tip_due = begun;
    let mut reported = Vec::new();
    while !interrupt.is_raised() {
        let update = robot.follow()?;
        if let Some(refusal) = update.refused {
            let kind = discriminant(&refusal);
            reported.retain(|(_, at): &(_, Instant)| at.elapsed() < REPEAT_INTERVAL);
            if reported.iter().all(|(other, _)| *other != kind) {
                reported.push((kind, Instant::now()));
                let count = robot.driver().refusals();
                tell::later(format!("refused: {refusal} ({count} so far)"));
            }
        }
        if !preset.measures_tip() {
            robot.send_cables()?;
        }
        if let Some(every) = tip_every
            && Instant::now() >= tip_due
        {
            tip_due = (tip_due + every).max(Instant::now());
            robot.send_tip()?;
        }
        if begun.elapsed() < CHECK_DURATION {
            while let Some(record) = telemetry.try_next()? {
                check(&record, connection.sender_id())?;
            }
        }
        thread::sleep(TURN);
    }
    Ok(Done::Good)
}

/// Fails when a record contains a refused measurement of `sender_id`.
fn check(record: &Telemetry, sender_id: u64) -> anyhow::Result<()> {
    let ours = |event: &&InputEvent| {
        event.kind == EventKind::Measurement.code() && event.sender_id == sender_id
    };
    for event in events(record).iter().filter(ours) {
        match Outcome::try_from(event.outcome) {
            Ok(Outcome::Accepted) => {}
            Ok(Outcome::Unsupported) => bail!(
                "the daemon simulates its robot itself: start it with link.kind = \"driver\", or do not use plant"
            ),
            Ok(outcome) => bail!(
                "the daemon rejects this robot: {}\n{}",
                outcome.text(),
                remedy(outcome)
            ),
            Err(_) => bail!(
                "the daemon rejects this robot with the unknown code {}",
                event.outcome
            ),
        }
    }
    Ok(())
}
