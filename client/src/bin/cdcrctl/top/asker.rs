//! Sends the requests of keys, each in its own thread: neither the screen nor a stop waits for another
//! answer.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use cdcr_shared_types::Location;
use cdcr_shared_types::codes::RequestKind;

use crate::{request, wait};

/// Outcome of a request as text.
pub(super) type Answer = (RequestKind, Result<String, String>);

#[derive(Debug)]
pub(super) struct Asker {
    location: Location,
    robot: String,
    /// Requests without an answer yet; at most one of each kind.
    asked: Vec<RequestKind>,
    sender: Sender<Answer>,
    answers: Receiver<Answer>,
}

impl Asker {
    pub(super) fn new(location: Location, robot: &str) -> Self {
        let (sender, answers) = channel();
        Self {
            location,
            robot: robot.to_owned(),
            asked: Vec::new(),
            sender,
            answers,
        }
    }

    /// Sends a request unless the same one is pending.
    pub(super) fn ask(&mut self, kind: RequestKind) {
        if self.asked.contains(&kind) {
            return;
        }
        self.asked.push(kind);
        let (location, robot) = (self.location.clone(), self.robot.clone());
        let answers = self.sender.clone();
        thread::spawn(move || {
            let answer = request::ask(&location, &robot, kind);
            let words = answer.map(|response| wait::outcome_text(kind, &response));
            // The receiver may have been dropped.
            let _ = answers.send((kind, words.map_err(|error| format!("{error:#}"))));
        });
    }

    pub(super) fn answer(&mut self) -> Option<Answer> {
        let answer = self.answers.try_recv().ok()?;
        self.asked.retain(|kind| *kind != answer.0);
        Some(answer)
    }

    pub(super) fn asked(&self) -> &[RequestKind] {
        &self.asked
    }
}
