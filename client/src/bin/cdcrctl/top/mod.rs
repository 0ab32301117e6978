//! `cdcrctl top`: live view of the robot and its loop in a terminal.
//!
//! It reads telemetry and status, and sends requests, like any other client.
//!
//! Invariant: the thread of the keys never writes to the terminal. Drawing blocks while nobody reads the terminal,
//! and a key stops the robot nevertheless.

mod asker;
mod panels;
mod recent;
mod seen;

use std::io::{self, IsTerminal as _, stdin, stdout};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail, ensure};
use cdcr_client::{Connection, LinkError, TelemetryStream};
use cdcr_shared_types::codes::RequestKind;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use crate::args::{Target, TopOptions};
use crate::done::Done;
use crate::interrupt::{INTERRUPT_INTERVAL, Interrupt, QUIET};
use crate::keys::{self, Keys};
use crate::picture::Signs;
use asker::{Answer, Asker};
use panels::Screen;
use seen::Seen;

const ZOOM_STEP: f64 = 1.25;
const ZOOM_MAX: f64 = 50.0;
const ZOOM_MIN: f64 = 0.25;

/// Action of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    Ask(RequestKind),
    Pause,
    ZoomIn,
    ZoomOut,
    Quit,
}

pub(crate) fn run(target: &Target, options: &TopOptions) -> anyhow::Result<Done> {
    ensure!(
        stdout().is_terminal() && stdin().is_terminal(),
        "top needs a terminal; programs use status or echo with --format json"
    );
    let connection = target.connect()?;
    let telemetry = connection.telemetry()?;
    let (location, robot) = target.location()?;
    let interrupt = Interrupt::catch()?;
    let (asker, answers) = Asker::new(location, robot);
    let mut top = Top {
        connection: &connection,
        telemetry,
        asker: asker.clone(),
        answers,
        seen: Seen::default(),
        paused: None,
        zoom: 1.0,
        signs: if options.ascii {
            Signs::Ascii
        } else {
            Signs::of_terminal()
        },
        heard: Instant::now(),
        silent: None,
    };
    let (sender, actions) = channel();
    thread::spawn(move || read_keys(&asker, &sender));
    // From here on a panic restores the terminal, too.
    let mut terminal = ratatui::try_init().context("the terminal")?;
    let every = Duration::from_secs(1) / u32::from(options.rate);
    let watched = top.watch(&mut terminal, every, &actions, &interrupt);
    let restored = ratatui::try_restore().context("the terminal");
    // A closed terminal cannot be restored; the first error is the relevant one.
    let done = watched?;
    restored.map(|()| done)
}

/// Sends the request of each key, and passes its action to the screen, until the terminal is
/// closed.
fn read_keys(asker: &Asker, actions: &Sender<io::Result<Action>>) {
    let mut keys = Keys::default();
    loop {
        let action = match keys.next_within(QUIET) {
            Ok(key) => key.as_ref().and_then(action).map(Ok),
            Err(error) => Some(Err(error)),
        };
        let Some(action) = action else {
            continue;
        };
        if let Ok(Action::Ask(kind)) = action {
            asker.ask(kind);
        }
        // After a key that quits, too, while the screen stands still.
        let is_last = action.is_err();
        // The receiver may have been dropped.
        if actions.send(action).is_err() || is_last {
            return;
        }
    }
}

struct Top<'a> {
    connection: &'a Connection,
    telemetry: TelemetryStream,
    asker: Asker,
    answers: Receiver<Answer>,
    seen: Seen,
    /// State at the start of the pause.
    paused: Option<Box<Seen>>,
    zoom: f64,
    signs: Signs,
    heard: Instant,
    silent: Option<String>,
}

impl Top<'_> {
    fn watch(
        &mut self,
        terminal: &mut DefaultTerminal,
        every: Duration,
        actions: &Receiver<io::Result<Action>>,
        interrupt: &Interrupt,
    ) -> anyhow::Result<Done> {
        loop {
            let begun = Instant::now();
            self.read_messages()?;
            let asked = self.asker.asked();
            keys::drawn(terminal.draw(|frame| self.screen(&asked).draw(frame)))?;
            // Show each key at once, and draw when the next picture is due.
            loop {
                let left = every.saturating_sub(begun.elapsed());
                let action = actions.recv_timeout(left.min(INTERRUPT_INTERVAL));
                if interrupt.is_raised() {
                    return Ok(Done::Interrupted);
                }
                match action {
                    Ok(action) => match action? {
                        Action::Quit => return Ok(Done::Good),
                        action => self.act(action),
                    },
                    Err(RecvTimeoutError::Timeout) if left > INTERRUPT_INTERVAL => continue,
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => bail!("the keys are no longer read"),
                }
                break;
            }
        }
    }

    /// Processes the messages since the last picture.
    fn read_messages(&mut self) -> anyhow::Result<()> {
        while let Some(record) = self.telemetry.try_next()? {
            self.heard = Instant::now();
            self.silent = None;
            self.seen.note(&record, self.telemetry.lost());
        }
        if let Ok(status) = self.connection.status(Duration::ZERO) {
            self.seen.status = Some(Box::new(status));
        }
        if self.heard.elapsed() > QUIET && self.silent.is_none() {
            self.silent = Some(match self.connection.status(Duration::ZERO) {
                Err(LinkError::Silent { liveness, .. }) => {
                    format!("no cycle for a second: {liveness}")
                }
                Err(error) => error.to_string(),
                Ok(_) => "no cycle for a second, but the daemon publishes its status".to_owned(),
            });
        }
        while let Ok((kind, answer)) = self.answers.try_recv() {
            self.seen.add_answer(kind, answer);
        }
        Ok(())
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Pause => {
                self.paused = match self.paused.take() {
                    Some(_) => None,
                    None => Some(Box::new(self.seen.clone())),
                }
            }
            Action::ZoomIn => self.zoom = (self.zoom * ZOOM_STEP).min(ZOOM_MAX),
            Action::ZoomOut => self.zoom = (self.zoom / ZOOM_STEP).max(ZOOM_MIN),
            Action::Ask(_) | Action::Quit => {}
        }
    }

    fn screen<'s>(&'s self, asked: &'s [RequestKind]) -> Screen<'s> {
        Screen {
            live: &self.seen,
            shown: self.paused.as_deref().unwrap_or(&self.seen),
            is_paused: self.paused.is_some(),
            zoom: self.zoom,
            signs: self.signs,
            asked,
            silent: self.silent.as_deref(),
        }
    }
}

/// Whether a key ends a full-screen program.
pub(crate) fn quits(key: &KeyEvent) -> bool {
    action(key) == Some(Action::Quit)
}

fn action(key: &KeyEvent) -> Option<Action> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
    match key.code {
        KeyCode::Char('c') if is_control => Some(Action::Quit),
        _ if is_control => None,
        KeyCode::Char('q' | 'Q') | KeyCode::Esc => Some(Action::Quit),
        KeyCode::Char('s' | 'S' | ' ') => Some(Action::Ask(RequestKind::Stop)),
        KeyCode::Char('h' | 'H') => Some(Action::Ask(RequestKind::Hold)),
        KeyCode::Char('t' | 'T') => Some(Action::Ask(RequestKind::Track)),
        KeyCode::Char('p' | 'P') => Some(Action::Pause),
        KeyCode::Char('+' | '=') => Some(Action::ZoomIn),
        KeyCode::Char('-' | '_') => Some(Action::ZoomOut),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_always_one_key() {
        let press = |code, modifiers| action(&KeyEvent::new(code, modifiers));
        let plain = |sign| press(KeyCode::Char(sign), KeyModifiers::NONE);
        let stop = Some(Action::Ask(RequestKind::Stop));
        assert_eq!([plain('s'), plain('S'), plain(' ')], [stop; 3]);
        assert_eq!(plain('h'), Some(Action::Ask(RequestKind::Hold)));
        assert_eq!(plain('t'), Some(Action::Ask(RequestKind::Track)));
        assert_eq!(plain('p'), Some(Action::Pause));
        assert_eq!(
            [plain('+'), plain('-')],
            [Some(Action::ZoomIn), Some(Action::ZoomOut)]
        );
        for quit in [
            plain('q'),
            press(KeyCode::Esc, KeyModifiers::NONE),
            press(KeyCode::Char('c'), KeyModifiers::CONTROL),
        ] {
            assert_eq!(quit, Some(Action::Quit));
        }
        for none in [
            plain('x'),
            press(KeyCode::Char('t'), KeyModifiers::CONTROL),
            press(KeyCode::Enter, KeyModifiers::NONE),
        ] {
            assert_eq!(none, None);
        }
    }
}
