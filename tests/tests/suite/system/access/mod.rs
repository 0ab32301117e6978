//! Another user of the machine cannot read, feed or command, cannot interfere unnoticed, and gets a clear
//! error.
//!
//! The other user is the real user `nobody`. Only root can start programs as another user; elsewhere these
//! tests report that they were skipped.

mod group;
mod planted;
mod refused;
mod stranger;
