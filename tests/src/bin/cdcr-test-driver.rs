//! A robot behind a driver, in a process of its own, that has every fault it is told to have: the other end of
//! `cdcr_tests::driver`. It obeys the interface that the daemon has it obey. Arguments: prefix, root, and, if it is not where the last driver left it, the bend of its
//! first section \[rad\]. It ends when its input does.

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
use cdcr_tests::driver::told_flaws;
use cdcr_tests::robot::{DrivenRobot, interface_of};
use cdcr_tests::{ROBOT, TIMEOUT};

/// How old a late measurement is: beyond the timeout of the default configuration, or not.
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

struct RobotBehindDriver {
    robot: DrivenRobot,
    measured: Measurement,
    turns: u32,
}

impl RobotBehindDriver {
    /// Its first section is bent as said. Else it is where the daemon takes it to be: straight, or where the last driver left
    /// it.
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
                told_flaws(),
            ),
            measured: Measurement::default(),
            turns: 0,
        }
    }

    fn turn(&mut self, fault: &str) {
        self.turns += 1;
        self.robot.follow();
        // A frozen sensor says for ever what it last said; its stamps and the robot go on.
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
