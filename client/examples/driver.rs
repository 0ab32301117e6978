//! A complete driver. Its robot is simulated: put your motors and encoders where `Motors` is (docs/drivers.md).
//!
//! ```sh
//! cdcrd run --set link.kind=driver --set link.interface=position --set realtime.mode=prefer
//! cargo run -p cdcr-client --example driver -- position
//! ```

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{env, error::Error, thread};

use cdcr_client::{CommandedRates, Driver, monotonic_ns, section_lengths_m};
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::CABLES_MAX;
use cdcr_shared_types::{DEFAULT_PREFIX, Location, Measurement};

fn main() -> Result<(), Box<dyn Error>> {
    let interface = match env::args().nth(1).as_deref() {
        Some("velocity") => Interface::Velocity,
        Some("position") => Interface::Position,
        _ => return Err("which interface? velocity or position, as link.interface".into()),
    };
    let ending = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, ending.clone())?;
    }
    let set = |key, default: &str| env::var(key).unwrap_or_else(|_| default.to_owned());
    let root = env::var_os("CDCR_ROOT").map_or_else(Location::default_root, Into::into);
    let location = Location::new(&set("CDCR_PREFIX", DEFAULT_PREFIX), &root)?;
    let (robot, patience) = (set("CDCR_ROBOT", "cdcr"), Duration::from_secs(10));
    let mut driver = Driver::connect_within(&location, &robot, interface, patience)?;
    let mut motors = Motors::straight(&section_lengths_m(driver.robot()));

    let mut last_ns = monotonic_ns();
    while !ending.load(Ordering::Relaxed) {
        // A refused command is reported and counted, and no reason to end: what runs out is rest.
        let update = driver.update()?;
        if let Some(refusal) = update.refused {
            eprintln!("refused: {refusal} ({} so far)", driver.refusals());
        }
        if let Some(daemon) = update.new_daemon {
            eprintln!("another daemon commands: {daemon:#018x}");
        }
        // The motors get their goal in each turn, whether a command came or not.
        let now_ns = monotonic_ns();
        match interface {
            Interface::Position => {
                if let Some(position) = driver.position_at(now_ns) {
                    motors.length_m = position.cable_length_m;
                }
            }
            _ => motors.run(&driver.rates_at(now_ns), (now_ns - last_ns) as f64 * 1e-9),
        }
        last_ns = now_ns;
        // Measured from the first turn on: before that, the daemon commands nothing.
        driver.send(Measurement {
            measured_ns: monotonic_ns(),
            kind: MeasurementKind::CableLengths.code(),
            sections: driver.robot().sections,
            cable_length_m: motors.length_m,
            ..Measurement::default()
        })?;
        thread::sleep(Duration::from_millis(1));
    }
    // Here your motors stop.
    Ok(())
}

/// Motors and encoders without a flaw, one for each cable.
struct Motors {
    length_m: [f64; CABLES_MAX],
}

impl Motors {
    fn straight(section_m: &[f64]) -> Self {
        let mut length_m = [0.0; CABLES_MAX];
        for (j, cables) in length_m.chunks_mut(3).take(section_m.len()).enumerate() {
            cables.fill(section_m[..=j].iter().sum());
        }
        Self { length_m }
    }

    fn run(&mut self, rates: &CommandedRates, dt_s: f64) {
        for (length_m, speed_m_s) in self.length_m.iter_mut().zip(rates.cable_speed_m_s) {
            *length_m += speed_m_s * dt_s;
        }
    }
}
