//! A complete driver: replace `length_m` by your motors and encoders (docs/drivers.md).
//!
//! ```sh
//! cdcrd run --set link.kind=driver --set link.interface=position --set realtime.mode=prefer
//! cargo run -p cdcr-client --example driver -- position
//! ```

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{env, error::Error, thread};

use cdcr_client::{Driver, monotonic_ns, straight_cable_lengths_m};
use cdcr_shared_types::{Location, codes::Interface};

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
    let (location, timeout) = (Location::from_environment()?, Duration::from_secs(10));
    let robot = env::var("CDCR_ROBOT").unwrap_or("cdcr".to_owned());
    let mut driver = Driver::connect_within(&location, &robot, interface, timeout)?;
    // Ideal motors and encoders, one for each cable of a straight robot.
    let mut length_m = straight_cable_lengths_m(driver.robot());
    let mut last_ns = monotonic_ns();
    while !ending.load(Ordering::Relaxed) {
        // Report the 1st, 2nd, 4th, 8th … refusal and continue: the robot rests when commands expire.
        let update = driver.update()?;
        if let Some(refusal) = update.refused
            && driver.refusals().is_power_of_two()
        {
            eprintln!("refused: {refusal} ({} so far)", driver.refusals());
        }
        if let Some(daemon) = update.new_daemon {
            eprintln!("another daemon commands: {daemon:#018x}");
        }
        // The motors get a set point in each iteration, with or without a new command.
        let now_ns = monotonic_ns();
        if interface == Interface::Velocity {
            let speeds_m_s = driver.rates_at(now_ns).cable_speed_m_s;
            for (length_m, speed_m_s) in length_m.iter_mut().zip(speeds_m_s) {
                *length_m += speed_m_s * (now_ns - last_ns) as f64 * 1e-9;
            }
        } else if let Some(position) = driver.position_at(now_ns) {
            length_m = position.cable_length_m;
        }
        last_ns = now_ns;
        // Measure from the first iteration on: the daemon sends no command before.
        driver.send_cable_lengths(monotonic_ns(), length_m)?;
        thread::sleep(Duration::from_millis(1));
    }
    // Stop your motors here.
    Ok(())
}
