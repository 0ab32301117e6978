//! Sends messages as JSON datagrams to plotters.

use std::net::{ToSocketAddrs, UdpSocket};

use anyhow::{Context, bail};
use cdcr_client::{Connection, Message, Stream};
use cdcr_shared_types::message::Struct;
use serde_json::{Value, json};

use crate::args::{EchoTopic, PlotOptions, Target};
use crate::done::Done;
use crate::echo::field::{check, select, without_null};
use crate::echo::{LineFormat, MessageHandler, json, paced, watch};

/// Maximum size of a datagram, so that no receiver truncates it.
const BYTES_MAX: usize = 2000;
/// Fields of each topic without --field, which fit of the largest robot, too. None: the whole message.
fn usual_fields(topic: EchoTopic) -> Vec<String> {
    let names: &[&str] = match topic {
        EchoTopic::Telemetry => &[
            "cycle",
            "mode",
            "tip_position_m",
            "position_error_m",
            "reference.position_m",
            "bend_rad",
            "command.bend_rate_rad_s",
            "clearance_m",
        ],
        EchoTopic::Command => &[],
        EchoTopic::Status => &[
            "mode",
            "cycles",
            "deadline_misses",
            "tip_position_m",
            "position_error_m",
            "reference_position_m",
            "measured_error_m",
            "clearance_m",
            "following_error_rad",
            "last_minute.response",
        ],
        EchoTopic::Incidents => &[
            "steal_ns",
            "telemetry.cycle",
            "telemetry.mode",
            "telemetry.scheduling",
        ],
        EchoTopic::Reference => &["mode", "points.0"],
        EchoTopic::Obstacles => &["action", "obstacles.0"],
    };
    names.iter().map(|&name| name.to_owned()).collect()
}

pub(crate) fn run(target: &Target, options: &PlotOptions) -> anyhow::Result<Done> {
    watch(target, options.topic, options)
}

impl MessageHandler for PlotOptions {
    fn watch<T: Message + Struct>(
        &self,
        connection: &Connection,
        mut stream: Stream<T>,
        _: &LineFormat<T>,
    ) -> anyhow::Result<Done> {
        let expected = || format!("--udp {}: expected HOST:PORT", self.udp);
        let mut all = self.udp.to_socket_addrs().with_context(expected)?;
        let to = all.next().with_context(expected)?;
        let any = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
        let socket = UdpSocket::bind(any).context("cannot open a socket")?;
        let fields = match &*self.field {
            [] => usual_fields(self.topic),
            fields => fields.to_vec(),
        };
        let limits = (self.rate, self.count);
        let mut is_first = true;
        paced(connection, &mut stream, limits, |message| {
            check(message, &fields)?;
            let packet = packet(message.header().sent_ns, json::message(message), &fields)?;
            // A plotter that does not listen yet is not an error: UDP has no answer. A network may go down
            // and come back.
            let sent = socket.send_to(packet.as_bytes(), to);
            if std::mem::take(&mut is_first) {
                sent.with_context(|| format!("cannot send to {to}"))?;
            }
            Ok(())
        })?;
        Ok(Done::Good)
    }
}

/// One datagram: the chosen fields, or all, and the time in seconds.
fn packet(sent_ns: u64, message: Value, fields: &[String]) -> anyhow::Result<String> {
    let chosen = if fields.is_empty() {
        message
    } else {
        select(&message, fields)?
    };
    let mut chosen = without_null(chosen).unwrap_or_else(|| json!({}));
    chosen["timestamp"] = json!(sent_ns as f64 * 1e-9);
    let text = chosen.to_string();
    if text.len() >= BYTES_MAX {
        bail!(
            "a message takes {} bytes, a datagram holds less than {BYTES_MAX}: select fields with --field",
            text.len()
        );
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, OBSTACLES_MAX, SECTIONS_MAX};
    use cdcr_shared_types::{Command, Incident, ObstacleUpdate, ReferenceChunk, Status, Telemetry};

    #[test]
    fn the_usual_fields_of_the_largest_robot_fit_and_nan_is_absent() {
        let mut record = Telemetry {
            position_error_m: f64::NAN,
            clearance_m: f64::INFINITY,
            bend_rad: [-1.234_567_890_123_456_7e-3; 2 * SECTIONS_MAX],
            ..Telemetry::default()
        };
        record.command.sections = SECTIONS_MAX as u32;
        record.command.bend_rate_rad_s = record.bend_rad;
        let fields = usual_fields(EchoTopic::Telemetry);
        let text = packet(2_500_000_000, json::message(&record), &fields).expect("it fits");
        let value: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(value["timestamp"], 2.5);
        assert_eq!(value["bend_rad"].as_array().map(Vec::len), Some(12));
        for absent in ["position_error_m", "clearance_m"] {
            assert!(value.get(absent).is_none(), "{text}");
        }
        let error = packet(0, json::message(&record), &[]).expect_err("too large");
        assert!(error.to_string().contains("select fields"), "{error}");
    }

    #[test]
    fn the_usual_fields_of_every_topic_exist_and_fit() {
        let sends = |topic: EchoTopic, message: &dyn Struct| {
            let fields = usual_fields(topic);
            check(message, &fields).expect("they exist");
            let text = packet(1, json::message(message), &fields).expect("they fit");
            assert!(text.len() > 30, "{topic:?}: {text}");
        };
        let long = -1.234_567_890_123_456_7e-3;
        let mut incident = Incident::default();
        incident.telemetry.cycle = u64::MAX;
        sends(EchoTopic::Incidents, &incident);
        let mut status = Status {
            tip_position_m: [long; 3],
            reference_position_m: [long; 3],
            following_error_rad: [long; SECTIONS_MAX],
            ..Status::default()
        };
        status.robot.sections = SECTIONS_MAX as u32;
        sends(EchoTopic::Status, &status);
        let mut command = Command {
            sections: SECTIONS_MAX as u32,
            bend_target_rad: [long; 2 * SECTIONS_MAX],
            bend_rate_rad_s: [long; 2 * SECTIONS_MAX],
            cable_length_m: [long; 3 * SECTIONS_MAX],
            cable_speed_m_s: [long; 3 * SECTIONS_MAX],
            ..Command::default()
        };
        command.header.sequence = u64::MAX;
        sends(EchoTopic::Command, &command);
        let mut chunk = ReferenceChunk {
            count: CHUNK_POINTS_MAX as u32,
            ..ReferenceChunk::default()
        };
        chunk.points[0].position_m = [long; 3];
        sends(EchoTopic::Reference, &chunk);
        let mut update = ObstacleUpdate {
            count: OBSTACLES_MAX as u32,
            ..ObstacleUpdate::default()
        };
        update.obstacles[0].start_m = [long; 3];
        sends(EchoTopic::Obstacles, &update);
        // The others have none, a clearing obstacle message for example.
        sends(EchoTopic::Obstacles, &ObstacleUpdate::default());
    }
}
