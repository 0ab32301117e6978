//! The whole system: real processes over real shared memory, each test on a prefix of its own.

mod access;
mod bad_input;
mod bare;
mod demo;
mod driver;
mod ending;
mod feeding;
mod lease;
mod lifecycle;
mod modes;
mod obstacles;
mod program;
mod reconnect;
mod replay;
mod silence;
mod strangers;
mod timing;
