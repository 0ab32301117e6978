//! Draws the next actions and executes them.

mod misuse;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, ObstacleSender, ReferenceFeed, monotonic_ns};
use cdcr_shared_types::codes::{ChunkMode, Interpolation, RequestKind};
use cdcr_shared_types::{Obstacle, ReferencePoint, SolverSettings, Telemetry};
use cdcr_tests::driver::{DriverProcess, FAULTS};
use cdcr_tests::{Daemon, ROBOT, TIMEOUT, text, wait_until};
use rustix::process::Signal;

use crate::chaos::action::{Action, ROUND};
use crate::chaos::checker::View;
use crate::chaos::crowd::Crowd;
use crate::chaos::dice::Dice;
use crate::chaos::tally::Tally;
use crate::chaos::{CheckResult, ensure, obstacles};

/// Time limit for an answer: longer than any stall or freeze of the daemon.
const ANSWER: Duration = Duration::from_secs(5);

/// Executes the actions.
pub(crate) struct Director<'a> {
    daemon: &'a Daemon,
    connection: Connection,
    obstacles: ObstacleSender,
    feed: ReferenceFeed,
    first_settings: SolverSettings,
    view: &'a View,
    tally: &'a Tally,
    dice: Dice,
    crowd: Crowd,
    driver: Option<DriverProcess>,
    log: Vec<String>,
    /// Counts of bad points, bad obstacles, bad settings and near obstacles: their kinds come in turn.
    turns: [u32; 4],
}

impl<'a> Director<'a> {
    pub(crate) fn new(
        daemon: &'a Daemon,
        driver: Option<DriverProcess>,
        view: &'a View,
        tally: &'a Tally,
        dice: Dice,
    ) -> Self {
        let connection = daemon.connect();
        Self {
            obstacles: connection.obstacle_sender().unwrap(),
            feed: connection.reference_feed().unwrap(),
            first_settings: connection.status(TIMEOUT).unwrap().settings,
            connection,
            daemon,
            driver,
            view,
            tally,
            dice,
            crowd: Crowd::default(),
            log: Vec::new(),
            turns: [0; 4],
        }
    }

    /// Executes whole rounds for `duration` and until the run has seen everything required, or until
    /// `ending`. Returns the driver, if there is one, without faults.
    pub(crate) fn run(
        mut self,
        duration: Duration,
        ending: &AtomicBool,
    ) -> Result<Option<DriverProcess>, String> {
        let begin = Instant::now();
        let is_broken = || ending.load(Ordering::Relaxed);
        let is_over = |dealt: bool| {
            let passed = begin.elapsed();
            is_broken()
                || dealt && passed >= duration && self.view.has_seen_enough()
                || passed >= duration + TIMEOUT
        };
        self.go_home();
        let mut rounds = 0;
        while !is_over(rounds > 0) {
            for action in self.round() {
                if is_over(rounds > 0) {
                    break;
                }
                self.log.push(format!(
                    "{:8.3} s {action:?}",
                    begin.elapsed().as_secs_f64()
                ));
                self.perform(action)?;
                self.tally.count(format!("action: {action:?}"));
                self.crowd.tend();
                std::thread::sleep(self.dice.duration_ms(0, 120));
            }
            rounds += 1;
        }
        if is_broken() {
            let newest = self.log.iter().rev().take(20).rev().cloned();
            println!(
                "the last actions:\n{}",
                newest.collect::<Vec<_>>().join("\n")
            );
        }
        self.leave(ending);
        Ok(self.driver)
    }

    /// Every mode must occur even in a short run; homing is the rarest.
    fn go_home(&mut self) {
        let ask = |kind| self.connection.request_within(kind, ANSWER).is_ok();
        wait_until("it goes home", || {
            let _ = self.connection.reset_within(true, ANSWER);
            let _ = ask(RequestKind::Hold);
            ask(RequestKind::Home)
        });
    }

    /// All actions of one round, shuffled.
    fn round(&mut self) -> Vec<Action> {
        let has_driver = self.driver.is_some();
        let possible = ROUND
            .iter()
            .filter(|(action, _)| has_driver || !action.needs_driver());
        let mut actions: Vec<_> = possible
            .flat_map(|(action, times)| std::iter::repeat_n(*action, *times))
            .collect();
        self.dice.shuffle(&mut actions);
        actions
    }

    fn perform(&mut self, action: Action) -> CheckResult {
        match action {
            Action::FeedByProcess => self.feed_by_process(),
            Action::Request(kind) => self.request(kind),
            Action::TakeLease => self.take_lease(),
            Action::KillClient => {
                self.need_client();
                self.crowd.kill();
            }
            Action::FreezeClient => {
                self.need_client();
                let duration = self.dice.duration_ms(50, 900);
                self.crowd.freeze(duration);
            }
            Action::FeedWithoutLease => self.send_points(|_, _| {}),
            Action::LatePoints => self.late_points(),
            Action::BadPoints => self.bad_points(),
            Action::Flood => self.flood(),
            Action::ObstacleNear => self.obstacle(obstacles::near),
            Action::ObstacleInside => {
                let turn = self.next_turn(3);
                self.obstacle(|dice, record| obstacles::inside(dice, record, turn));
            }
            Action::ObstacleTowards => self.obstacle(obstacles::towards),
            Action::ObstaclesCleared => drop(self.obstacles.clear().unwrap()),
            Action::TooManyObstacles => self.too_many_obstacles(),
            Action::BadObstacle => {
                let turn = self.next_turn(1);
                self.obstacle(|dice, record| obstacles::bad(dice, record, turn));
            }
            Action::Settings => self.settings(),
            Action::BadSettings => return self.bad_settings(),
            Action::FreezeDaemon => self.freeze_daemon(),
            Action::HogProcessors => self.hog(),
            Action::SecondDaemon => return self.second_daemon(),
            Action::ReaderComesAndGoes => self.reader(),
            Action::ReaderNeverReads => {
                let duration = self.dice.duration_ms(500, 3000);
                self.crowd.idle(&self.connection, duration);
            }
            Action::FaultyDriver | Action::FreezeDriver | Action::KillDriver => {
                self.trouble_driver(action);
            }
        }
        Ok(())
    }

    fn feed_by_process(&mut self) {
        let curve = self.dice.pick(&["spiral", "line", "circle"]);
        let duration = format!("{:.1}s", self.dice.between(0.5, 4.0));
        let mut arguments = vec!["ref", curve, "--duration", &duration];
        if self.dice.chance(85) {
            arguments.push("--track");
        }
        self.crowd.start(self.daemon.place(), &arguments);
    }

    /// Sends the request over its own connection or through a program.
    fn request(&mut self, kind: RequestKind) {
        let command = match kind {
            RequestKind::Track => "track",
            RequestKind::Hold => "hold",
            RequestKind::Home => "home",
            RequestKind::Stop => "stop",
            RequestKind::Reset => "reset",
            _ => "status",
        };
        if self.dice.chance(15) && command != "status" {
            if kind == RequestKind::Stop {
                self.view.count_stop();
            }
            self.crowd.start(self.daemon.place(), &[command]);
            return;
        }
        let answered = if kind == RequestKind::Reset && self.dice.chance(80) {
            self.connection.reset_within(true, ANSWER)
        } else {
            self.connection.request_within(kind, ANSWER)
        };
        let answer = match answered {
            Ok(_) => "accepted",
            Err(cdcr_client::RequestError::Refused { .. }) => "refused",
            Err(_) => "not answered",
        };
        self.tally.count(format!("request: {kind}: {answer}"));
    }

    fn take_lease(&mut self) {
        let expires = self.dice.chance(50);
        let Ok(lease) = self.connection.acquire_lease() else {
            self.tally.count("lease: held by another");
            return;
        };
        std::thread::sleep(self.dice.duration_ms(0, 50));
        if expires {
            std::mem::forget(lease);
            self.tally.count("lease: left to expire");
        } else {
            drop(lease);
            self.tally.count("lease: taken and given back");
        }
    }

    fn need_client(&mut self) {
        if self.crowd.is_empty() {
            self.feed_by_process();
            std::thread::sleep(self.dice.duration_ms(100, 400));
        }
    }

    fn flood(&mut self) {
        let location = self.daemon.place().location().clone();
        let duration = self.dice.duration_ms(100, 800);
        if self.dice.chance(50) {
            self.crowd.busy_with(duration, move || {
                let connection = Connection::open(&location, ROBOT).ok()?;
                let feed = connection.reference_feed().ok()?;
                let point = ReferencePoint {
                    time_ns: monotonic_ns() + 2_000_000_000,
                    ..ReferencePoint::default()
                };
                Some(move || {
                    let _connection = &connection;
                    drop(feed.send(ChunkMode::Replace, Interpolation::Linear, &[point]));
                })
            });
        } else {
            self.crowd.busy_with(duration, move || {
                let connection = Connection::open(&location, ROBOT).ok()?;
                let sender = connection.obstacle_sender().ok()?;
                let mut id = 0;
                Some(move || {
                    let _connection = &connection;
                    id = (id + 1) % 70;
                    drop(sender.upsert(&[obstacles::far(id)]));
                })
            });
        }
    }

    /// Sends an obstacle at the position of the robot.
    fn obstacle(&mut self, make: impl FnOnce(&mut Dice, &Telemetry) -> Obstacle) {
        if let Some(record) = self.view.newest() {
            let obstacle = make(&mut self.dice, &record);
            self.obstacles.upsert_anywhere(&[obstacle]).unwrap();
        }
    }

    fn settings(&mut self) {
        let first = self.first_settings;
        let dice = &mut self.dice;
        let wanted = SolverSettings {
            solver: dice.below(3),
            coordinates: dice.below(2),
            horizon_steps: dice.pick(&[1, 2, 5, 20, 50]),
            control_blocks: dice.below(2),
            swarm_size: dice.pick(&[1, 6, 40, 512]),
            swarm_iterations: dice.pick(&[0, 10, 30, 1000]),
            budget_ns: dice.pick(&[0, 1_000, 200_000, 3_000_000, 5_000_000]),
            safe_distance_m: dice.between(0.01, 0.04),
            seed: u64::from(dice.below(u32::MAX)),
            ..first
        };
        // Without penalties the solver ignores obstacles, so that the guard has to act.
        let wanted = if dice.chance(50) {
            SolverSettings {
                obstacle_step_penalty: 0.0,
                obstacle_slope_penalty: 0.0,
                ..wanted
            }
        } else {
            wanted
        };
        // Sometimes returns to the initial settings.
        let wanted = if self.dice.chance(40) { first } else { wanted };
        let answer = match self.connection.change_settings(wanted) {
            Ok(_) => "accepted",
            Err(_) => "not accepted",
        };
        self.tally.count(format!("settings: {answer}"));
    }

    /// Stops the whole daemon for a while.
    fn freeze_daemon(&mut self) {
        self.daemon.signal(Signal::STOP);
        std::thread::sleep(self.dice.duration_ms(5, 300));
        self.daemon.signal(Signal::CONT);
    }

    fn hog(&mut self) {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        let duration = self.dice.duration_ms(200, 1500);
        for _ in 0..cores {
            self.crowd.busy(duration, std::hint::spin_loop);
        }
    }

    /// A second daemon for the same robot refuses to start, with the reason.
    fn second_daemon(&mut self) -> CheckResult {
        let place = self.daemon.place();
        let mut command = place.command("cdcrd");
        command
            .args(["run", "--config"])
            .arg(place.folder().join("robot.toml"));
        let output = command.output().unwrap();
        let printed = text(&output);
        let refused = !output.status.success() && printed.contains("already running");
        ensure(refused, || format!("a second daemon started: {printed}"))
    }

    fn reader(&mut self) {
        if self.dice.chance(50) {
            let topic = self
                .dice
                .pick(&["telemetry", "command", "status", "reference"]);
            let arguments = ["echo", topic, "--count", "5"];
            self.crowd.start(self.daemon.place(), &arguments);
        } else {
            let connection = Connection::open(self.daemon.place().location(), ROBOT);
            if let Ok(connection) = connection
                && let Ok(mut telemetry) = connection.telemetry()
            {
                let _ = telemetry.next_within(Duration::from_millis(20));
            }
        }
    }

    fn trouble_driver(&mut self, action: Action) {
        let Some(driver) = &mut self.driver else {
            return;
        };
        match action {
            Action::FaultyDriver => {
                let fault = self.dice.pick(&FAULTS);
                driver.be(fault, self.dice.duration_ms(20, 400));
                self.tally.count(format!("driver: {fault}"));
            }
            Action::FreezeDriver => {
                driver.signal(Signal::STOP);
                std::thread::sleep(self.dice.duration_ms(5, 200));
                driver.signal(Signal::CONT);
            }
            _ => {
                // Killed and reaped before the next one starts. Its robot has other flaws, every second time
                // those of a preset.
                self.driver = None;
                std::thread::sleep(self.dice.duration_ms(0, 200));
                let is_mild = self.dice.chance(50);
                let flaws = self.dice.flaws(is_mild);
                self.tally.count(format!("robot: is mild: {is_mild}"));
                self.driver = Some(DriverProcess::with_flaws(self.daemon.place(), flaws));
            }
        }
    }

    /// Leaves the robot without obstacles and the solver with its initial settings.
    fn leave(&mut self, ending: &AtomicBool) {
        self.crowd = Crowd::default();
        let begin = Instant::now();
        while self
            .connection
            .change_settings(self.first_settings)
            .is_err()
        {
            assert!(begin.elapsed() < TIMEOUT, "the settings cannot be changed");
        }
        let cleared_ns = self.obstacles.clear().unwrap().sent_ns;
        // When a sender leaves, its pending messages are lost. A failed run shows no more records.
        let begin = Instant::now();
        while !ending.load(Ordering::Relaxed) {
            let newest = self.view.newest();
            if newest
                .as_ref()
                .is_some_and(|record| record.gather_ns > cleared_ns && record.obstacle_count == 0)
            {
                break;
            }
            assert!(
                begin.elapsed() < TIMEOUT,
                "the obstacles cleared at {cleared_ns} ns are still there: {:?}; the daemon's log:\n{}",
                newest.map(|record| (
                    record.cycle,
                    record.gather_ns,
                    record.mode,
                    record.obstacle_count
                )),
                self.daemon.log()
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
