//! Asks the daemon for what a key means, each time in a thread of its own: neither the drawing nor a stop waits for another answer.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use cdcr_shared_types::Location;
use cdcr_shared_types::codes::RequestKind;

use crate::{request, wait};

/// What came of a request, in words.
pub(super) type Answer = (RequestKind, Result<String, String>);

#[derive(Debug)]
pub(super) struct Asker {
    location: Location,
    robot: String,
    /// Not answered yet; at most one of each kind.
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

    /// Asks, unless the same is being asked for.
    pub(super) fn ask(&mut self, kind: RequestKind) {
        if self.asked.contains(&kind) {
            return;
        }
        self.asked.push(kind);
        let (location, robot) = (self.location.clone(), self.robot.clone());
        let answers = self.sender.clone();
        thread::spawn(move || {
            let answer = request::ask(&location, &robot, kind);
            let words = answer.map(|response| wait::words(kind, &response));
            // Who asked may have gone.
            let _ = answers.send((kind, words.map_err(|error| format!("{error:#}"))));
        });
    }

    /// The next answer, if one has come.
    pub(super) fn answer(&mut self) -> Option<Answer> {
        let answer = self.answers.try_recv().ok()?;
        self.asked.retain(|kind| *kind != answer.0);
        Some(answer)
    }

    pub(super) fn asked(&self) -> &[RequestKind] {
        &self.asked
    }
}
