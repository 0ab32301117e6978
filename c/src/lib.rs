//! The client of `cdcrd` for C, C++ and everything that calls C. What each function does, who owns what, threads and return
//! codes: `include/cdcr.h`. How to build and link: `docs/c.md`.
//!
//! | module | is |
//! |---|---|
//! | `abi` | the functions of `cdcr.h`: pointers in, pointers out, and every unsafe line |
//! | `guard` | what each call has around it: panics end here, and the text of the last error is kept |
//! | `handles` | connections and drivers by number, one table for each thread |
//! | `session` | a connection with the ports that it has opened |
//! | `place` | where a daemon is looked for |
//! | `failure` | what went wrong, as a code and a text |
//! | [`code`], [`layout`] | codes and structs of the border, as the header has to say them |
//!
//! Invariant: nothing here computes control; a function is one call of `cdcr_client`.

#![deny(unsafe_code)]

mod abi;
pub mod code;
mod failure;
mod guard;
mod handles;
pub mod layout;
mod place;
mod session;
