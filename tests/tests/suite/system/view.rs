//! `cdcr-view`: the data that a viewer gets from a daemon.

use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::Duration;

use cdcr_client::channels::{Drawn, Topic};
use cdcr_interchange::standard::{MarkerArray, PoseStamped};
use cdcr_interchange::{cdr, decode, mcap};
use cdcr_shared_types::Telemetry;
use cdcr_tests::{Daemon, Program, STALL_TOLERANT, TIMEOUT, assert_output, wait_until};
use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

/// Operation code of a message with data; subscription and time stamp precede the data.
const MESSAGE_DATA: u8 = 1;
const BEFORE_DATA: usize = 1 + 4 + 8;

/// A viewer that connects like Foxglove and Lichtblick.
fn viewer(port: u16) -> WebSocket<TcpStream> {
    let mut request = format!("ws://127.0.0.1:{port}")
        .into_client_request()
        .unwrap();
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request
        .headers_mut()
        .insert("Sec-WebSocket-Protocol", protocol.clone());
    let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let (socket, answer) = tungstenite::client(request, stream).unwrap();
    assert_eq!(answer.headers()["Sec-WebSocket-Protocol"], protocol);
    socket
}

/// Starts `cdcr-view` on a free port.
fn serve(daemon: &Daemon) -> (Program, u16) {
    let view = daemon.place().start("cdcr-view --port 0");
    wait_until("it serves", || view.lines() > 0);
    let reported = view.printed();
    let port = reported
        .split("127.0.0.1:")
        .nth(1)
        .unwrap()
        .split(';')
        .next()
        .unwrap();
    let port = port.parse().unwrap();
    (view, port)
}

/// All advertised channels by topic.
fn channels(socket: &mut WebSocket<TcpStream>, count: usize) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
    while found.len() < count {
        let Message::Text(text) = socket.read().unwrap() else {
            continue;
        };
        let message: Value = serde_json::from_str(&text).unwrap();
        for channel in message["channels"].as_array().into_iter().flatten() {
            found.insert(
                channel["topic"].as_str().unwrap().to_owned(),
                channel.clone(),
            );
        }
    }
    found
}

/// The next message of a subscription: the time of the channel, and its bytes.
fn next(socket: &mut WebSocket<TcpStream>, subscription: u32) -> (u64, Vec<u8>) {
    loop {
        let Message::Binary(bytes) = socket.read().unwrap() else {
            continue;
        };
        let is_ours = bytes[0] == MESSAGE_DATA && bytes[1..5] == subscription.to_le_bytes();
        if is_ours {
            let time_ns = u64::from_le_bytes(bytes[5..BEFORE_DATA].try_into().unwrap());
            return (time_ns, bytes[BEFORE_DATA..].to_vec());
        }
    }
}

#[test]
fn a_viewer_gets_the_channels_of_a_recording_and_what_they_hold() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let (mut view, port) = serve(&daemon);
    let mut socket = viewer(port);
    let channels = channels(&mut socket, Topic::ALL.len() + Drawn::ALL.len());
    let robot = "/cdcr/".to_owned() + cdcr_tests::ROBOT;
    let subscribed = ["telemetry", "view/scene", "view/tip"].map(|name| format!("{robot}/{name}"));
    let mut subscriptions = Vec::new();
    for (id, topic) in subscribed.iter().enumerate() {
        let channel = &channels[topic];
        assert_eq!(channel["encoding"], mcap::MESSAGE_ENCODING, "{channel}");
        assert_eq!(
            channel["schemaEncoding"],
            mcap::SCHEMA_ENCODING,
            "{channel}"
        );
        subscriptions.push(json!({"id": id, "channelId": channel["id"]}));
    }
    let telemetry = &channels[&subscribed[0]];
    assert_eq!(telemetry["schemaName"], "cdcr_msgs/msg/Telemetry");
    let expected = Topic::Telemetry.channel(cdcr_tests::ROBOT).unwrap();
    assert_eq!(telemetry["schema"], expected.text);
    let subscribe = json!({"op": "subscribe", "subscriptions": subscriptions});
    socket.send(Message::text(subscribe.to_string())).unwrap();

    let mut last: Option<Telemetry> = None;
    for _ in 0..100 {
        let (time_ns, bytes) = next(&mut socket, 0);
        let mut record = Telemetry::default();
        decode(&bytes, &mut record).unwrap();
        // Since 1970, not since the start of the machine.
        assert!(time_ns > record.header.sent_ns + 1_000_000_000);
        if let Some(last) = last {
            assert_eq!(record.header.sequence, last.header.sequence + 1);
        }
        last = Some(record);
    }
    let (_, bytes) = next(&mut socket, 1);
    let scene: MarkerArray = cdr::from_bytes(&bytes).unwrap();
    assert!(scene.markers.iter().any(|marker| marker.ns == "body"));
    let (_, bytes) = next(&mut socket, 2);
    let tip: PoseStamped = cdr::from_bytes(&bytes).unwrap();
    assert!(tip.pose.position.z > 0.5, "{tip:?}");

    // The records of the next daemon follow.
    daemon.stop();
    std::thread::sleep(Duration::from_millis(100));
    view.signal(Signal::INT);
    assert_output(&view.output(), 0, &["serving"]);
}

#[test]
fn what_it_was_too_slow_for_is_reported() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let (mut view, port) = serve(&daemon);
    let mut socket = viewer(port);
    let channels = channels(&mut socket, Topic::ALL.len() + Drawn::ALL.len());
    let channel = &channels[&format!("/cdcr/{}/telemetry", cdcr_tests::ROBOT)];
    let subscriptions = [json!({"id": 0, "channelId": channel["id"]})];
    let subscribe = json!({"op": "subscribe", "subscriptions": subscriptions});
    socket.send(Message::text(subscribe.to_string())).unwrap();
    let mut telemetry = daemon.connect().telemetry().unwrap();
    view.signal(Signal::STOP);
    // More than its queue holds.
    let missed = (0..300).map(|_| telemetry.next_within(TIMEOUT).unwrap().unwrap());
    let newest = missed.last().unwrap().header.sequence;
    view.signal(Signal::CONT);
    // Until the reader has caught up.
    let mut record = Telemetry::default();
    while record.header.sequence <= newest {
        decode(&next(&mut socket, 0).1, &mut record).unwrap();
    }
    view.signal(Signal::INT);
    assert_output(&view.output(), 0, &["lost ", "too slow"]);
}

#[test]
fn a_port_that_is_taken_is_named() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let (_view, port) = serve(&daemon);
    let line = format!("cdcr-view --port {port}");
    let says = ["error: cannot listen on 127.0.0.1", "--port names another"];
    daemon.place().checked(&line, 1, &says);
}

/// There is no viewer here to open the layouts; at least, each message and field in them exists.
#[test]
fn the_layouts_name_topics_and_fields_that_there_are() {
    let configs = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/");
    let mut channels = Drawn::ALL.map(|drawn| drawn.channel("cdcr")).to_vec();
    channels.extend(Topic::ALL.map(|topic| topic.channel("cdcr").unwrap()));
    for (file, between) in [("view.json", '.'), ("view.plotjuggler.xml", '/')] {
        let text = std::fs::read_to_string(configs.to_owned() + file).unwrap();
        let names = text.split('"').filter(|word| word.starts_with("/cdcr/"));
        let mut count = 0;
        for name in names {
            let found = channels.iter().find_map(|channel| {
                let rest = name.strip_prefix(&channel.topic)?;
                (rest.is_empty() || rest.starts_with(between)).then_some((channel, rest))
            });
            let (channel, rest) = found.unwrap_or_else(|| panic!("{file}: no topic {name}"));
            for field in rest.split(between).filter(|field| !field.is_empty()) {
                let field = field.split('[').next().unwrap();
                let is_there = |line: &str| {
                    line.split('#').next().unwrap().split_whitespace().nth(1) == Some(field)
                };
                assert!(
                    channel.text.lines().any(is_there),
                    "{file}: {name}: no {field}"
                );
            }
            count += 1;
        }
        assert!(count > 5, "{file}: {count}");
    }
}
