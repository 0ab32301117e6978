//! Another user of the machine: cannot read, feed or command, cannot get in the way unseen, and is told so.
//!
//! The other user is a real one, `nobody`. Only root can start programs as another user; elsewhere these tests
//! say that they were skipped.

mod group;
mod planted;
mod refused;
mod stranger;
