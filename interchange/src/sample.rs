//! Messages for tests: zeros and random values of all fields.

use cdcr_shared_types::message::{Field, Kind, Meaning, Struct, ValueMut};
use cdcr_shared_types::{
    Command, Incident, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response, Status,
    Telemetry,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// One of each message of the wire.
pub fn zeros() -> Vec<Box<dyn Struct>> {
    vec![
        Box::new(ReferenceChunk::default()),
        Box::new(ObstacleUpdate::default()),
        Box::new(Measurement::default()),
        Box::new(Command::default()),
        Box::new(Request::default()),
        Box::new(Response::default()),
        Box::new(Status::default()),
        Box::new(Telemetry::default()),
        Box::new(Incident::default()),
    ]
}

/// The same with random values.
pub fn random(seed: u64) -> Vec<Box<dyn Struct>> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut messages = zeros();
    for message in &mut messages {
        draw(&mut **message, &mut random);
    }
    messages
}

fn draw(message: &mut dyn Struct, random: &mut impl Rng) {
    // A used length is a field of this message or of a part of it: at most the size of the smallest array
    // that it counts.
    let fields = message.layout().fields;
    let most = |path: &str| {
        let counted = fields
            .iter()
            .filter_map(|field| match (field.used, field.kind) {
                (Some(used), Kind::Array(_, elements)) if used.count == path => {
                    Some(elements / used.each)
                }
                _ => None,
            });
        counted.min()
    };
    message.visit_mut(&mut |field, value| match value {
        ValueMut::U32(number) => {
            *number = match most(field.name) {
                Some(most) => random.random_range(0..=most as u32),
                None => random.random(),
            }
        }
        value => draw_value(field, value, random),
    });
    for field in fields {
        let Some((part, name)) = field.used.and_then(|used| used.count.split_once('.')) else {
            continue;
        };
        let most = most(&format!("{part}.{name}")).unwrap_or(0) as u32;
        message.visit_mut(&mut |inner, value| {
            if let ValueMut::Struct(inner_message) = value
                && inner.name == part
            {
                inner_message.visit_mut(&mut |counter, value| {
                    if let ValueMut::U32(number) = value
                        && counter.name == name
                    {
                        *number = (*number).min(most);
                    }
                });
            }
        });
    }
}

fn draw_value(field: &Field, value: ValueMut<'_>, random: &mut impl Rng) {
    match value {
        ValueMut::U8(byte) => *byte = random.random(),
        ValueMut::U32(number) => *number = random.random(),
        ValueMut::U64(number) => *number = random.random(),
        ValueMut::F64(number) => {
            *number = match random.random_range(0..8) {
                0 => f64::NAN,
                1 => f64::INFINITY,
                2 => -0.0,
                _ => random.random_range(-1e3..1e3),
            }
        }
        ValueMut::Struct(message) => draw(message, random),
        ValueMut::Array(array) => {
            let is_text = matches!(field.meaning, Meaning::Text);
            let letters = random.random_range(0..=array.count());
            for i in 0..array.count() {
                match array.element_mut(i) {
                    ValueMut::U8(byte) if is_text => {
                        *byte = if i < letters {
                            random.random_range(b'a'..=b'z')
                        } else {
                            0
                        };
                    }
                    element => draw_value(field, element, random),
                }
            }
        }
    }
}
