//! A driver in a separate process, which can be made faulty and killed.

use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::Duration;

use cdcr_controller::plant::{Flaws, RobotPreset};
use derive_more::{Deref, DerefMut};

use crate::{Place, Running, binary};

/// Faults of a driver.
pub const FAULTS: [&str; 5] = ["silent", "late", "frozen", "jumping", "nan"];

/// Flaws of its robot, each NAME=VALUE; by default those of the laboratory's robot.
const FLAWS: &str = "CDCR_TEST_FLAWS";

/// The flaws in the environment of a driver process.
pub fn given_flaws() -> Flaws {
    let mut flaws = RobotPreset::Laboratory.flaws();
    let given = std::env::var(FLAWS).unwrap_or_default();
    for word in given.split(' ').filter(|word| !word.is_empty()) {
        let (name, value) = word.split_once('=').expect("NAME=VALUE");
        let mut named = flaws.named();
        let flaw = named.iter_mut().find(|(known, ..)| *known == name);
        *flaw.expect("a flaw").1 = value.parse().expect("a number");
    }
    flaws
}

/// A driver process: `cdcr-test-driver`. Dropping it kills it.
#[derive(Debug, Deref, DerefMut)]
pub struct DriverProcess(Running);

impl DriverProcess {
    /// Starts a driver for the daemon of `place`. Its robot is where the last driver left it.
    pub fn start(place: &Place) -> Self {
        Self::spawn(Self::command(place))
    }

    /// The same with a straight robot whose first section is bent by `bend_rad`.
    pub fn start_at(place: &Place, bend_rad: f64) -> Self {
        let mut command = Self::command(place);
        command.arg(bend_rad.to_string());
        Self::spawn(command)
    }

    /// The same with these flaws, where the last driver left its robot.
    pub fn with_flaws(place: &Place, mut flaws: Flaws) -> Self {
        let named = flaws.named();
        let words = named.map(|(name, value, _)| format!("{name}={value}"));
        let mut command = Self::command(place);
        command.env(FLAWS, words.join(" "));
        Self::spawn(command)
    }

    fn command(place: &Place) -> Command {
        let mut command = Command::new(binary("cdcr-test-driver"));
        command
            .arg(place.location().prefix())
            .arg(place.location().root());
        command
    }

    fn spawn(mut command: Command) -> Self {
        command.stdin(Stdio::piped()).stdout(Stdio::null());
        Self(Running::start(&mut command))
    }

    /// Makes the driver faulty for `duration`.
    pub fn be(&mut self, fault: &str, duration: Duration) {
        let pipe = self.0.0.stdin.as_mut().expect("its input is a pipe");
        // Fails if the driver is just being killed.
        let _ = writeln!(pipe, "{fault} {}", duration.as_millis());
    }
}
