//! What the sources below a folder must not name.

use std::collections::BTreeSet;
use std::path::Path;

use super::modules::{Names, imports, module_of, named_below};
use super::{SOURCES, code, sources, workspace};

/// Words that are forbidden in the sources below paths: paths | word | reason.
const FORBIDDEN: &str = "\
controller/src | iceoryx2 | the mathematics knows no shared memory
controller/src | std::time | the mathematics knows no clock
controller/src | std::thread | the mathematics starts no thread
controller/src | std::fs | the mathematics reads no file
controller/src | tracing | the mathematics does not log
controller/src | log:: | the mathematics does not log
controller/src/optimizer | crate::robot | a minimiser knows no robot
controller/src/safety | crate::nmpc | the safety checks know no optimisation
controller/src/safety | crate::optimizer | the safety checks know no optimisation
controller/src/plant | crate::nmpc | a simulated robot knows no controller
controller/src/plant | crate::safety | a simulated robot knows no controller
daemon/src/rt | cdcr_controller | rt knows no robot
daemon/src/rt | crate::config | rt knows no configuration
daemon/src/rt | iceoryx2 | rt knows no shared memory
daemon/src/config | crate::rt | a configuration knows no thread
daemon/src/config | std::thread | a configuration knows no thread
daemon/src/config | codes:: | a configuration knows no message
daemon/src/config | iceoryx2 | a configuration knows no shared memory
daemon/src/cycle | iceoryx2 | the cycle knows no shared memory
daemon/src/cycle | cdcr_shared_types | the cycle knows no message
daemon/src/cycle | tracing:: | the cycle does not log
daemon/src/cycle | std::fs | the cycle knows no file
daemon/src/cycle | rustix | the cycle knows no system
daemon/src/cycle | crate::system | the cycle knows no system
daemon/src/link | cdcr_shared_types | the cycle's robot knows no message
daemon/src/obstacles | cdcr_shared_types | the known obstacles know no message
daemon/src/kept_obstacles | cdcr_shared_types | the kept obstacles know no message
daemon/src/core_budget | cdcr_shared_types | the solver's time knows no message
daemon/src/reporter | crate::cycle | the reporter cannot act on the cycle
daemon/src/reporter | crate::exchange | the reporter cannot act on the exchange
interchange/src | iceoryx2 | what leaves the machine knows no shared memory
interchange/src | std::time | what leaves the machine knows no clock
interchange/src | std::fs | what leaves the machine knows no file
interchange/src | Location | what leaves the machine knows no service
interchange/src | presence | what leaves the machine knows no service
interchange/src | shm_space | what leaves the machine knows no service
chart/src | cdcr_ | a chart knows no robot
c/src | iceoryx2 | what C calls is the client library
python/src | iceoryx2 | what Python calls is the client library
python/src/wire, python/src/recording | .header | messages are unpacked by their declared fields
view/src | cdcr_controller | the viewer knows no mathematics
packaging/src | cdcr_ | a generator gets the command lines that it describes
testbed/scratch/src | use cdcr_ | a folder knows no robot
testbed/process/src | iceoryx2 | who starts programs knows no shared memory
testbed/process/src | cdcr_client | what starts programs is not a client
testbed/src | cdcr_controller | a load knows no mathematics
client/src | cdcr_daemon | a client knows messages, not the daemon
python/src | cdcr_daemon | a client knows messages, not the daemon
c/src | cdcr_daemon | a client knows messages, not the daemon
view/src | cdcr_daemon | a client knows messages, not the daemon
testbed/src | cdcr_daemon | the daemon is started as a program
bench/src | cdcr_daemon | the daemon is measured as a program
bench/src/deadline, bench/src/footprint, bench/src/latency, bench/src/quality, bench/src/rate, bench/src/robustness, \
bench/src/solver | serde_json::to_ | a dataset writes the results
bench/src/deadline, bench/src/footprint, bench/src/latency, bench/src/quality, bench/src/rate, bench/src/robustness, \
bench/src/solver | csv:: | a dataset writes the results
daemon/src | cdcr_client | the daemon knows messages, not its clients
daemon/src/handover | iceoryx2 | what threads exchange knows no shared memory
daemon/src/bare | iceoryx2 | the bare loop knows no shared memory
daemon/src/bare | cdcr_controller | the bare loop knows no robot
daemon/src/exchange | cdcr_controller::nmpc | the exchange knows no computation of a cycle
daemon/src/exchange | crate::cycle | the exchange knows no computation of a cycle
daemon/src/supervisor | crate::cycle | the supervisor knows no control path
daemon/src/supervisor | crate::exchange | the supervisor knows no control path
daemon/src/cli | crate::cycle | the command line knows no cycle
daemon/src/convert | std::time | a conversion knows no time of sending
daemon/src/convert | crate::services | a conversion knows no sender
daemon/src/services | cdcr_controller | services know no meaning of a message
daemon/src/service_manager | cdcr_controller | notifications know no computation of a cycle
client/src/replay | std::fs | a replay knows no file
client/src/replay | monotonic_ns | a replay knows no clock
client/src/replay | Location | a replay knows no daemon
client/src/channels | std::fs | a channel knows no file
client/src/channels | std::net | a channel knows no socket
client/src/trajectory | monotonic_ns | a curve knows no clock
client/src/trajectory | Connection | a curve knows no daemon
client/src/bin/cdcrctl/picture | cdcr_shared_types | a picture knows no message
bench/src/environment | hostname | a result does not name its machine
testbed/src/system | hostname | a result does not name its machine
";

/// The module of a file in its crate.
fn module_in(file: &Path) -> Names {
    let file = file.strip_prefix(workspace()).unwrap();
    let crates = SOURCES
        .iter()
        .filter_map(|root| file.strip_prefix(root).ok());
    // A program in the folder of a library is a crate of its own.
    let shortest = crates.min_by_key(|path| path.components().count());
    module_of(shortest.unwrap_or(file))
}

/// Whether the code of a module has a word, or names that path in another spelling: below `super`, in braces, or of `core`.
fn names(code: &str, module: &[String], word: &str) -> bool {
    let mut path = word.split("::");
    let paths = match path.next() {
        Some("crate") => imports(code, module),
        Some("std") => ["std", "core"]
            .iter()
            .flat_map(|root| named_below(code, root))
            .collect(),
        Some(root) => named_below(code, root),
        None => BTreeSet::new(),
    };
    let path: Vec<&str> = path.collect();
    let below = |named: &Names| {
        named.len() >= path.len() && path.iter().zip(named).all(|(one, other)| one == other)
    };
    code.contains(word) || !path.is_empty() && paths.iter().any(below)
}

#[test]
fn a_forbidden_path_is_found_in_every_spelling() {
    let module = ["reporter".to_owned()];
    for (code, word) in [
        ("use std::time::Instant;", "std::time"),
        ("use std::{sync::Arc, time::Instant};", "std::time"),
        ("let x = core::time::Duration::ZERO;", "std::time"),
        ("use super::cycle::Cycle;", "crate::cycle"),
        ("use crate::{link, cycle::Cycle};", "crate::cycle"),
        (
            "use cdcr_controller::{nmpc::Nmpc, robot};",
            "cdcr_controller::nmpc",
        ),
    ] {
        assert!(names(code, &module, word), "{code}");
    }
    for (code, word) in [
        ("use std::{sync::Arc, fmt};", "std::time"),
        ("use super::link::cycle;", "crate::cycle"),
        (
            "use cdcr_controller::{robot, plant::nmpc};",
            "cdcr_controller::nmpc",
        ),
    ] {
        assert!(!names(code, &module, word), "{code}");
    }
}

#[test]
fn no_folder_knows_what_it_must_not() {
    for row in FORBIDDEN.lines() {
        let [places, word, why] = row.split(" | ").collect::<Vec<_>>()[..] else {
            panic!("no places, word and reason: {row}");
        };
        for place in places.split(", ") {
            let files = sources(place);
            assert!(!files.is_empty(), "{place} is not there");
            for file in files {
                let is_named = names(&code(&file), &module_in(&file), word);
                assert!(!is_named, "{}: {word}: {why}", file.display());
            }
        }
    }
}
