//! The tables of `docs/wire-protocol.md` come from the declarations of services and messages; `CDCR_GENERATE=1` writes them anew.

use std::fmt::Write as _;

use cdcr_shared_types::declared::{self, words};
use cdcr_shared_types::message::{Field, Kind, Meaning, MessageLayout};
use cdcr_shared_types::{
    Command, Incident, LAYOUTS, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response,
    Service, Status, Telemetry, limits,
};

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/wire-protocol.md");
const BEGIN: &str = "<!-- generated from the declarations: ";
const END: &str = "<!-- end of what is generated -->";
const HOW: &str = "CDCR_GENERATE=1 cargo test -p cdcr-shared-types wire_protocol";

fn messages(service: Service) -> Vec<&'static MessageLayout> {
    match service {
        Service::Reference => vec![ReferenceChunk::LAYOUT],
        Service::Obstacles => vec![ObstacleUpdate::LAYOUT],
        Service::Measurement => vec![Measurement::LAYOUT],
        Service::Command => vec![Command::LAYOUT],
        Service::Telemetry => vec![Telemetry::LAYOUT],
        Service::Status => vec![Status::LAYOUT],
        Service::Incidents => vec![Incident::LAYOUT],
        Service::Control => vec![Request::LAYOUT, Response::LAYOUT],
    }
}

fn services() -> String {
    let mut text = String::from(
        "| service `cdcr/ROBOT/…` | type and version | bytes | writers | readers | waiting for one reader | for a late joiner | open at one time |\n\
         |---|---|---:|---:|---:|---:|---:|---:|\n",
    );
    for service in Service::ALL {
        let layouts = messages(service);
        let each = |of: &dyn Fn(&MessageLayout) -> String| {
            let all: Vec<_> = layouts.iter().map(|layout| of(layout)).collect();
            all.join(", ")
        };
        let types = each(&|layout| format!("`{}`", layout.type_name));
        let bytes = each(&|layout| layout.size.to_string());
        let queues = if service == Service::Control {
            let (clients, waiting) = (Service::CONTROL_CLIENTS, Service::CONTROL_REQUESTS);
            format!("{clients} clients | the daemon | {waiting} requests of one client | 0")
        } else {
            let queues = service.queues();
            let (writers, readers) = (queues.publishers, queues.subscribers);
            let (queue, history) = (queues.queue, queues.history);
            format!("{writers} | {readers} | {queue} | {history}")
        };
        let key = service.key();
        let nodes = service.nodes();
        writeln!(text, "| `{key}` | {types} | {bytes} | {queues} | {nodes} |")
            .expect("a text has room");
    }
    text
}

fn kind(kind: &Kind) -> String {
    match kind {
        Kind::U8 => "u8".to_owned(),
        Kind::U32 => "u32".to_owned(),
        Kind::U64 => "u64".to_owned(),
        Kind::F64 => "f64".to_owned(),
        Kind::Array(each, count) => format!("{} × {count}", self::kind(each)),
        Kind::Struct(layout) => format!("[{0}](#{1})", layout.name, layout.name.to_lowercase()),
    }
}

/// A documentation comment as Markdown.
fn plain(doc: &str) -> String {
    words(doc).replace('|', "\\|")
}

fn meaning(field: &Field) -> String {
    let codes = |name: &str| format!("[{name}](#{})", name.to_lowercase());
    let mut parts = Vec::new();
    match field.meaning {
        Meaning::Code(of) => parts.push(codes(of.name)),
        Meaning::Bits(_) => parts.push(codes(field.name)),
        Meaning::Per(of, _) => parts.push(format!("one for each {}", codes(of.name))),
        Meaning::Yes => parts.push("1: yes, 0: no".to_owned()),
        Meaning::OrNone => parts.push("largest value: none".to_owned()),
        Meaning::Text => parts.push("UTF-8, padded with zeros".to_owned()),
        Meaning::Reserved => parts.push("zero".to_owned()),
        Meaning::Quantity | Meaning::Length | Meaning::Sum(_) | Meaning::Max(_) => {}
    }
    if !field.unit.is_empty() {
        parts.push(field.unit.to_owned());
    }
    if let Some(used) = field.used {
        let each = if used.each == 1 {
            String::new()
        } else {
            format!("{} · ", used.each)
        };
        parts.push(format!("used: {each}`{}`", used.count));
    }
    if let Some((other, code)) = field.when {
        parts.push(format!("where `{other}` is {code}"));
    }
    parts.join("; ")
}

fn tables() -> String {
    let mut text = String::new();
    for layout in LAYOUTS {
        let (name, type_name, size) = (layout.name, layout.type_name, layout.size);
        writeln!(text, "### {name}\n\n`{type_name}`, {size} bytes.\n").expect("a text has room");
        text.push_str("| offset | field | type | unit, values | what |\n|---:|---|---|---|---|\n");
        for field in layout.fields {
            let (offset, name) = (field.offset, field.name);
            let (kind, meaning, doc) = (kind(&field.kind), meaning(field), plain(field.doc));
            writeln!(text, "| {offset} | `{name}` | {kind} | {meaning} | {doc} |")
                .expect("a text has room");
        }
        text.push('\n');
    }
    text
}

/// Enumerations by their names, and bits by those of their fields.
fn codes() -> String {
    let mut text = String::new();
    for (name, values) in declared::codes() {
        let is_bits = declared::is_bits(name);
        let head = if is_bits { "bit" } else { "value" };
        writeln!(text, "### {name}\n\n| {head} | meaning |\n|---:|---|").expect("a text has room");
        for (value, name, meaning) in values {
            let words = if is_bits { name } else { meaning };
            writeln!(text, "| {value} | {words} |").expect("a text has room");
        }
        text.push('\n');
    }
    text
}

fn limits() -> String {
    let mut text = String::from("| limit | value | what |\n|---|---:|---|\n");
    for (name, value, doc) in limits::ALL {
        writeln!(text, "| `{name}` | {value} | {} |", plain(doc)).expect("a text has room");
    }
    text
}

#[test]
fn the_page_is_what_is_declared() {
    let page = std::fs::read_to_string(PAGE).unwrap();
    let mut made = page.clone();
    for (name, text) in [
        ("services", services()),
        ("messages", tables()),
        ("codes", codes()),
        ("limits", limits()),
    ] {
        let begin = format!("{BEGIN}{name} -->\n");
        let (before, rest) = made.split_once(&begin).unwrap();
        let (_, after) = rest.split_once(END).unwrap();
        made = format!("{before}{begin}\n{}\n\n{END}{after}", text.trim_end());
    }
    if std::env::var_os("CDCR_GENERATE").is_some() {
        std::fs::write(PAGE, made).unwrap();
        return;
    }
    assert!(page == made, "docs/wire-protocol.md is out of date: {HOW}");
}

#[test]
fn the_page_about_security_states_the_numbers_of_connections() {
    const SECURITY: &str = include_str!("../../docs/security.md");
    let words: Vec<_> = SECURITY.split_whitespace().collect();
    let (others, drivers) = (Service::NODES - 1, Service::DRIVERS);
    let for_requests = Service::Control.nodes() - Service::NODES;
    let (clients, kept) = (Service::CONTROL_CLIENTS, Service::CONTROL_KEPT);
    let text = format!(
        "{others} programs may open all services, {drivers} more the services of a driver, and {for_requests} more the service for \
         requests; {clients} may send requests. Each program of `cdcr_client` leaves {kept} of these {clients} free"
    );
    assert!(words.join(" ").contains(&text), "{text}");
}

/// What the page says in its own words names each service, and says nothing of one that there is not.
#[test]
fn every_service_is_described() {
    let page = std::fs::read_to_string(PAGE).unwrap();
    let (_, rest) = page.split_once("## Who sends what, and when").unwrap();
    let (table, _) = rest.split_once("\n## ").unwrap();
    let rows = table.lines().filter_map(|line| line.strip_prefix("| `"));
    let named: Vec<_> = rows.filter_map(|row| row.split_once('`')).collect();
    let named: Vec<_> = named.iter().map(|(name, _)| *name).collect();
    assert_eq!(named, Service::ALL.map(Service::key));
}
