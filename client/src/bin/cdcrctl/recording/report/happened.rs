use cdcr_client::{counted, events};
use cdcr_shared_types::codes::{EventKind, Mode, Outcome, Reason, RequestKind};
use cdcr_shared_types::{InputEvent, SolverSettings, Telemetry};
use serde_json::{Value, json};

/// Maximum number of listed and marked events; further ones are counted. At most half a megabyte of the page.
const LISTED_MAX: usize = 4096;

/// Events of robot and daemon, in order.
#[derive(Debug, Default)]
pub(super) struct Happened {
    listed: Vec<Value>,
    left_out: u64,
    before: Option<Before>,
}

/// State of the previous cycle.
#[derive(Debug)]
struct Before {
    mode: (u32, u32),
    obstacles: u32,
    settings: SolverSettings,
}

impl Happened {
    pub(super) fn take(&mut self, record: &Telemetry, time_s: f64) {
        for event in events(record) {
            if let Some((kind, text)) = event_text(event) {
                self.list(time_s, kind, &text);
            }
        }
        let now = Before {
            mode: (record.mode, record.reason),
            obstacles: record.obstacle_count,
            settings: record.settings,
        };
        let before = self.before.as_ref();
        let is_new_mode = before.is_none_or(|before| before.mode != now.mode);
        let obstacles = before.map_or(0, |before| before.obstacles);
        let is_new_settings = before.is_some_and(|before| before.settings != now.settings);
        if is_new_mode {
            let kind = if Mode::is_latched(record.mode) {
                "stop"
            } else {
                "mode"
            };
            let [mode, reason] = [Mode::text_of(record.mode), Reason::text_of(record.reason)];
            self.list(time_s, kind, &format!("{mode}: {reason}"));
        }
        if obstacles != now.obstacles {
            let text = counted(now.obstacles, "obstacle") + " known";
            self.list(time_s, "obstacles", &text);
        }
        if is_new_settings {
            self.list(time_s, "settings", "settings changed");
        }
        self.before = Some(now);
    }

    fn list(&mut self, time_s: f64, kind: &str, text: &str) {
        if self.listed.len() == LISTED_MAX {
            self.left_out += 1;
            return;
        }
        self.listed
            .push(json!({"t_s": time_s, "kind": kind, "text": text}));
    }

    /// The list, and the number of omitted events.
    pub(super) fn json(&self) -> (Value, u64) {
        (json!(self.listed), self.left_out)
    }
}

/// Kind and text of a request or of a refusal.
fn event_text(event: &InputEvent) -> Option<(&'static str, String)> {
    let is_accepted = event.outcome == Outcome::Accepted.code();
    let is_request = event.kind == EventKind::Request.code();
    // Leases are renewed all the time.
    let leases = [RequestKind::AcquireLease, RequestKind::ReleaseLease].map(RequestKind::code);
    if is_accepted && (!is_request || leases.contains(&event.detail)) {
        return None;
    }
    let what = if is_request {
        RequestKind::text_of(event.detail)
    } else {
        EventKind::text_of(event.kind)
    };
    if is_accepted {
        return Some(("request", format!("request: {what}")));
    }
    let why = Outcome::text_of(event.outcome);
    Some(("refused", format!("refused: {what}: {why}")))
}
