//! The client of `cdcrd` for C, C++ and languages that call C. `include/cdcr.h` documents functions,
//! ownership, threads and return codes; `docs/c.md` describes building and linking.
//!
//! | module | content |
//! |---|---|
//! | `abi` | the functions of `cdcr.h`: conversion of pointers, and all unsafe code |
//! | `guard` | wrapper of each call: catches panics, and stores the text of the last error |
//! | `handles` | connections and drivers by number, one table per thread |
//! | `session` | a connection with its open ports |
//! | `place` | location of a daemon |
//! | `failure` | an error as a code and a text |
//! | [`code`], [`layout`] | codes and structs of the C interface, for comparison with the header |
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
