//! Sends the requests of keys, each in its own thread: neither the screen nor a stop waits for another
//! answer.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use cdcr_shared_types::Location;
use cdcr_shared_types::codes::RequestKind;

use crate::{request, wait};

/// Outcome of a request as text.
pub(super) type Answer = (RequestKind, Result<String, String>);

#[derive(Debug, Clone)]
pub(super) struct Asker {
    location: Location,
    robot: String,
    asked: Asked,
    sender: Sender<Answer>,
}

/// Requests without an answer yet; at most one of each kind.
#[derive(Debug, Default, Clone)]
struct Asked(Arc<Mutex<Vec<RequestKind>>>);

impl Asked {
    /// No holder of the lock waits for anything.
    fn kinds(&self) -> MutexGuard<'_, Vec<RequestKind>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Asker {
    /// Returns it with its answers.
    pub(super) fn new(location: Location, robot: &str) -> (Self, Receiver<Answer>) {
        let (sender, answers) = channel();
        let asker = Self {
            location,
            robot: robot.to_owned(),
            asked: Asked::default(),
            sender,
        };
        (asker, answers)
    }

    /// Sends a request unless the same one is pending.
    pub(super) fn ask(&self, kind: RequestKind) {
        let mut kinds = self.asked.kinds();
        if kinds.contains(&kind) {
            return;
        }
        kinds.push(kind);
        drop(kinds);
        let asker = self.clone();
        let answering = move || {
            let answer = request::ask(&asker.location, &asker.robot, kind);
            let words = answer.map(|response| wait::outcome_text(kind, &response));
            asker.asked.kinds().retain(|asked| *asked != kind);
            // The receiver may have been dropped.
            let _ = asker
                .sender
                .send((kind, words.map_err(|error| format!("{error:#}"))));
        };
        if let Err(error) = thread::Builder::new().spawn(answering) {
            self.asked.kinds().retain(|asked| *asked != kind);
            let _ = self.sender.send((kind, Err(error.to_string())));
        }
    }

    pub(super) fn asked(&self) -> Vec<RequestKind> {
        self.asked.kinds().clone()
    }
}
