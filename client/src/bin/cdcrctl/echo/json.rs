//! Converts every message to JSON: its fields, codes as words, only the used part of each array.

use cdcr_client::text;
use cdcr_shared_types::message::{Array, Field, Meaning, Struct, Value as FieldValue};
use serde_json::{Map, Value, json};

pub(crate) fn message(message: &dyn Struct) -> Value {
    let mut object = Map::new();
    message.visit(&mut |field, part| {
        if let Some(used) = message.used(field) {
            insert(&mut object, field, part, used);
        }
    });
    Value::Object(object)
}

fn insert(object: &mut Map<String, Value>, field: &Field, part: FieldValue<'_>, used: usize) {
    let value = match (field.meaning, part) {
        (Meaning::Reserved | Meaning::Length, _) => return,
        (Meaning::Code(codes), FieldValue::U32(code)) => json!(codes.text(code)),
        (Meaning::Yes, FieldValue::U32(yes)) => json!(yes != 0),
        (Meaning::OrNone, FieldValue::U32(u32::MAX)) => Value::Null,
        (Meaning::Bits(all), FieldValue::U32(bits)) => {
            return insert_bits(object, field.name, all, bits);
        }
        (Meaning::Text, FieldValue::Array(bytes)) => json!(text_of(bytes)),
        (Meaning::Per(codes, first), FieldValue::Array(counts)) => {
            let named = codes.values.iter().enumerate().skip(first);
            let named =
                named.map(|(at, (_, _, text))| ((*text).to_owned(), plain(counts.element(at), 0)));
            Value::Object(named.collect())
        }
        (_, part) => plain(part, used),
    };
    object.insert(shown_name(field).to_owned(), value);
}

/// Name of a field; the field with the length of the sections has the plural.
pub(super) fn shown_name(field: &Field) -> &'static str {
    match field.name {
        "section" => "sections",
        name => name,
    }
}

/// Limits and real-time properties by the names of their bits, timing as one flag each.
fn insert_bits(object: &mut Map<String, Value>, name: &str, all: &[(u32, &str, &str)], bits: u32) {
    let set = all.iter().filter(|(bit, ..)| bits & bit != 0);
    let names: Vec<_> = set.map(|(_, name, _)| *name).collect();
    match name {
        "realtime_missing" => {
            object.insert("realtime".to_owned(), json!(bits == 0));
            object.insert(name.to_owned(), json!(names));
        }
        "guard_flags" => {
            object.insert(name.to_owned(), json!(bits));
            object.insert("guards".to_owned(), json!(names));
        }
        _ => {
            object.insert(name.to_owned(), json!(bits));
            let flags = all
                .iter()
                .map(|(bit, name, _)| (name.replace(' ', "_"), json!(bits & bit != 0)));
            object.extend(flags);
        }
    }
}

pub(crate) fn text_of(bytes: &dyn Array) -> String {
    let bytes = (0..bytes.count()).map(|at| match bytes.element(at) {
        FieldValue::U8(byte) => byte,
        _ => 0,
    });
    text(&bytes.collect::<Vec<_>>())
}

/// Numbers, with null for NaN and infinity; the first `used` elements of an array.
fn plain(part: FieldValue<'_>, used: usize) -> Value {
    match part {
        FieldValue::U8(number) => json!(number),
        FieldValue::U32(number) => json!(number),
        FieldValue::U64(number) => json!(number),
        FieldValue::F64(number) => json!(number),
        FieldValue::Array(array) => (0..used).map(|at| plain(array.element(at), 0)).collect(),
        FieldValue::Struct(part) => message(part),
    }
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::{
        LateCause, MeasurementKind, MeasurementState, Outcome, guard, timing,
    };
    use cdcr_shared_types::{Incident, Measurement, Status, Telemetry};

    use super::message as shown;
    use super::*;

    #[test]
    fn arrays_are_cut_to_what_is_used_and_nan_is_null() {
        let mut record = Telemetry {
            plan_length: 4,
            position_error_m: f64::NAN,
            clearance_m: f64::INFINITY,
            obstacle_count: 2,
            guard_flags: guard::CLEARANCE | guard::BEND,
            ..Telemetry::default()
        };
        record.command.sections = 2;
        let value = shown(&record);
        assert_eq!(value["bend_rad"].as_array().map(Vec::len), Some(4));
        assert_eq!(value["plan"].as_array().map(Vec::len), Some(4));
        assert!(value["position_error_m"].is_null() && value["clearance_m"].is_null());
        assert_eq!(value["obstacles"].as_array().map(Vec::len), Some(2));
        assert_eq!(value["guards"], json!(["bend", "clearance"]));
        assert_eq!(
            value["command"]["cable_length_m"].as_array().map(Vec::len),
            Some(6)
        );
    }

    #[test]
    fn counters_have_the_names_of_their_outcomes() {
        let mut status_record = Status::default();
        status_record.outcomes[Outcome::NotFinite.code() as usize] = 5;
        let value = shown(&status_record);
        assert_eq!(value["outcomes"]["a value is not a finite number"], 5);
        assert_eq!(value["realtime"], true);
        assert_eq!(value["misses_tolerated"], 0);
    }

    #[test]
    fn statistics_name_their_causes_and_a_record_has_the_cause_of_its_lateness() {
        let mut snapshot = Status::default();
        snapshot.last_minute.causes[LateCause::Load.code() as usize] = 7;
        snapshot.since_reset.gather.p99_ns = 8;
        let value = shown(&snapshot);
        let causes = &value["last_minute"]["causes"];
        assert_eq!(causes["another task had the core"], 7);
        assert_eq!(causes.as_object().map(Map::len), Some(LateCause::COUNT - 1));
        assert_eq!(value["since_reset"]["gather"]["p99_ns"], 8);

        let mut bad = Incident::default();
        bad.telemetry.scheduling.late_cause = LateCause::PageFault.code();
        bad.telemetry.timing_flags = timing::DEADLINE_MISS;
        bad.telemetry.measurement_state = MeasurementState::Repeated.code();
        let value = shown(&bad);
        let record = &value["telemetry"];
        assert_eq!(record["scheduling"]["late_cause"], "page fault");
        assert_eq!(record["deadline_miss"], true);
        assert_eq!(record["late_start"], false);
        assert_eq!(record["measurement_state"], "repeated");
    }

    #[test]
    fn a_measurement_shows_only_what_was_measured() {
        let tip = Measurement {
            kind: MeasurementKind::TipPose.code(),
            sections: 2,
            ..Measurement::default()
        };
        let value = shown(&tip);
        assert_eq!(value["kind"], "tip pose");
        assert_eq!(value["tip_position_m"], json!([0.0, 0.0, 0.0]));
        assert!(value.get("bend_rad").is_none() && value.get("reserved").is_none());
    }
}
