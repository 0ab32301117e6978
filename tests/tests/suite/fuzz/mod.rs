//! Fuzzing of what comes from outside; see `docs/fuzzing.md`.
//!
//! Each target first replays the kept corpus, then tries cases of its own. What holds for all: no panic, and
//! no command that is not finite or beyond a limit.

mod cases;
mod configuration;
mod corpus;
mod csv;
mod draft;
mod fields;
mod rig;
mod script;
mod services;
mod wire;
