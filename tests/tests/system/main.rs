//! The whole system: real processes over real shared memory, each test on a prefix of its own.

mod bad_input;
mod demo;
mod driver;
mod lease;
mod lifecycle;
mod modes;
mod replay;
