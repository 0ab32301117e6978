//! A simulated robot in a process of its own, where a driver would be.

use std::io::Write;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use cdcr_client::PlantDriver;
use cdcr_shared_types::codes::Interface;

use crate::Done;
use crate::args::{PlantOptions, Target};
use crate::interrupt::Interrupt;

/// It measures so often.
const TURN: Duration = Duration::from_millis(1);

/// `cdcrctl plant`
pub(crate) fn run(target: &Target, options: &PlantOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let status = connection.status(Duration::from_secs(1))?;
    let configured = Interface::try_from(status.interface).ok();
    let interface = options.interface.or(configured);
    let interface = interface.context("the daemon's interface is not known: give --interface")?;
    let (preset, seed) = (options.preset, options.seed);
    let mut robot = PlantDriver::new(&connection, interface, None, preset.flaws(), seed)?;
    let interrupt = Interrupt::catch()?;
    writeln!(
        std::io::stdout(),
        "a simulated robot with {} sections drives robot \"{}\": preset {}, {}; Ctrl-C ends it",
        status.robot.sections,
        target.location()?.1,
        preset.name(),
        interface.text()
    )?;
    let tip_every = options.tip.map(|rate| Duration::from_secs_f64(1.0 / rate));
    let mut tip_due = Instant::now();
    while !interrupt.is_raised() {
        let update = robot.follow()?;
        if let Some(refusal) = update.refused {
            eprintln!("refused: {refusal} ({} so far)", robot.driver().refusals());
        }
        if preset.measures_tip() {
            robot.send_tip()?;
        } else {
            robot.send_cables()?;
        }
        if let Some(every) = tip_every
            && Instant::now() >= tip_due
        {
            tip_due = (tip_due + every).max(Instant::now());
            robot.send_tip()?;
        }
        thread::sleep(TURN);
    }
    Ok(Done::Good)
}
