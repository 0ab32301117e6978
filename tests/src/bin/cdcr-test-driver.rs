//! A robot behind a driver, as a separate process with faults on request: the counterpart of
//! `cdcr_tests::driver`. It obeys the interface of the daemon's configuration. Arguments: prefix, root and,
//! unless the robot is where the last driver left it, the bend of its first section \[rad\]. It ends when its
//! input does.

#![allow(
    clippy::unwrap_used,
    reason = "in a helper of a test a panic is the report"
)]

use std::io::BufRead;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, monotonic_ns};
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::{Location, Measurement};
use cdcr_tests::driver::given_flaws;
use cdcr_tests::robot::{DrivenRobot, interface_of};
use cdcr_tests::{ROBOT, TIMEOUT};

/// Ages of a late measurement: within the timeout of the default configuration, and beyond it.
const LATE_NS: [u64; 2] = [20_000_000, 90_000_000];

fn main() {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let [prefix, root, bend @ ..] = given.as_slice() else {
        panic!("prefix and root are missing");
    };
    let location = Location::new(prefix, root.as_ref()).unwrap();
    let connection = Connection::open_within(&location, ROBOT, TIMEOUT).unwrap();
    let bend_rad = bend.first().map(|bend| bend.parse().unwrap());
    let mut robot = RobotBehindDriver::new(&connection, bend_rad);
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

/// Input lines, each with a fault and its duration in milliseconds; closed with the input.
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

struct RobotBehindDriver {
    robot: DrivenRobot,
    measured: Measurement,
    turns: u32,
}

impl RobotBehindDriver {
    /// With `bend_rad`, the first section is bent. Otherwise the robot has the daemon's configuration:
    /// straight, or as the last driver left it.
    fn new(connection: &Connection, bend_rad: Option<f64>) -> Self {
        let mut bends = [0.0; 12];
        if let Some(bend_rad) = bend_rad {
            bends[0] = bend_rad;
        } else {
            let mut telemetry = connection.telemetry().unwrap();
            let record = telemetry.next_within(Duration::from_millis(100)).unwrap();
            bends = record.map_or(bends, |record| record.bend_rad);
        }
        Self {
            robot: DrivenRobot::with_flaws(
                connection,
                interface_of(connection),
                bends,
                given_flaws(),
            ),
            measured: Measurement::default(),
            turns: 0,
        }
    }

    fn turn(&mut self, fault: &str) {
        self.turns += 1;
        self.robot.follow();
        // A frozen sensor repeats its last value; time stamps and robot go on.
        if fault != "frozen" {
            let Some(measured) = self.robot.sensed(MeasurementKind::Configuration) else {
                return;
            };
            self.measured = measured;
        }
        let mut measurement = Measurement {
            measured_ns: monotonic_ns(),
            ..self.measured
        };
        let odd = self.turns as usize % 2;
        match fault {
            "silent" => return,
            "late" => measurement.measured_ns -= LATE_NS[odd],
            "jumping" => measurement.bend_rad[2] += [-0.9, 0.7][odd],
            "nan" => measurement.bend_rad[self.turns as usize % 6] = f64::NAN,
            _ => {}
        }
        self.robot.send(&measurement);
    }
}
