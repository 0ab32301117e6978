//! A robot behind a driver, in a process of its own, that has every fault it is told to have.

use std::io::{BufRead, Write as _};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, Driver, monotonic_ns};
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::{Location, Measurement};
use cdcr_tests::{PATIENCE, Place, ROBOT};
use rustix::process::{Pid, Signal, kill_process};

/// What can be wrong with a driver.
pub(crate) const FAULTS: [&str; 5] = ["silent", "late", "frozen", "jumping", "nan"];

/// How old a late measurement is: beyond the timeout of the default configuration, or not.
const LATE_NS: [u64; 2] = [20_000_000, 90_000_000];

/// A driver process.
#[derive(Debug)]
pub(crate) struct DriverProcess(Child);

impl DriverProcess {
    pub(crate) fn start(place: &Place) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args([
                "--exact",
                "driver::drives_a_robot",
                "--ignored",
                "--nocapture",
            ])
            .env("CDCR_CHAOS_PREFIX", place.location().prefix())
            .env("CDCR_CHAOS_ROOT", place.location().root())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        Self(command.spawn().unwrap())
    }

    /// Makes it faulty for a while.
    pub(crate) fn be(&mut self, fault: &str, duration: Duration) {
        let pipe = self.0.stdin.as_mut().unwrap();
        // A driver that is just being killed does not hear it.
        let _ = writeln!(pipe, "{fault} {}", duration.as_millis());
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).unwrap();
    }

    pub(crate) fn runs(&mut self) -> bool {
        self.0.try_wait().unwrap().is_none()
    }
}

impl Drop for DriverProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "the driver process of the randomised run, which starts it itself"]
fn drives_a_robot() {
    let given = |key| std::env::var_os(key);
    let (Some(prefix), Some(root)) = (given("CDCR_CHAOS_PREFIX"), given("CDCR_CHAOS_ROOT")) else {
        println!("skipped: nobody says where the daemon is");
        return;
    };
    let location = Location::new(prefix.to_str().unwrap(), root.as_ref()).unwrap();
    let connection = Connection::open_within(&location, ROBOT, PATIENCE).unwrap();
    let mut robot = RobotBehindDriver::new(&connection);
    let orders = orders();
    let mut fault = (String::new(), Instant::now());
    loop {
        match orders.try_recv() {
            Ok(order) => fault = order,
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {}
        }
        let is_faulty = fault.1 > Instant::now();
        robot.turn(if is_faulty { &fault.0 } else { "" });
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The lines of our input, each a fault and how many milliseconds it lasts; closed when the input is.
fn orders() -> Receiver<(String, Instant)> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let line = line.unwrap();
            let (fault, duration_ms) = line.split_once(' ').unwrap();
            let duration = Duration::from_millis(duration_ms.parse().unwrap());
            let order = (fault.to_owned(), Instant::now() + duration);
            if sender.send(order).is_err() {
                return;
            }
        }
    });
    receiver
}

/// A robot that goes where it is commanded.
struct RobotBehindDriver {
    driver: Driver,
    bend_rad: [f64; 12],
    turns: u32,
}

impl RobotBehindDriver {
    /// It is where the last driver left it, if that was followed by a command lately; else it is straight.
    fn new(connection: &Connection) -> Self {
        let mut driver = connection.driver().unwrap();
        let command = driver.next_command(Duration::from_millis(100)).unwrap();
        Self {
            driver,
            bend_rad: command.map_or([0.0; 12], |command| command.bend_target_rad),
            turns: 0,
        }
    }

    fn turn(&mut self, fault: &str) {
        self.turns += 1;
        let command = self.driver.newest_command().unwrap();
        if let Some(command) = command
            && fault != "frozen"
        {
            self.bend_rad = command.bend_target_rad;
        }
        let mut measurement = Measurement {
            measured_ns: monotonic_ns(),
            kind: MeasurementKind::Configuration.code(),
            sections: 3,
            bend_rad: self.bend_rad,
            ..Measurement::default()
        };
        let odd = self.turns as usize % 2;
        match fault {
            "silent" => return,
            "late" => measurement.measured_ns -= LATE_NS[odd],
            "jumping" => measurement.bend_rad[2] += [-0.9, 0.7][odd],
            "nan" => measurement.bend_rad[self.turns as usize % 6] = f64::NAN,
            _ => {}
        }
        self.driver.send(measurement).unwrap();
    }
}
