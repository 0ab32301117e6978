//! Fuzzing of external inputs; see `docs/fuzzing.md`.
//!
//! Each target first replays its corpus, then runs new cases. Invariants for all: no panic, and every command
//! is finite and within the limits.

mod configuration;
mod draft;
mod fields;
mod rig;
mod script;
mod services;
mod wire;
