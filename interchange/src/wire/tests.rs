use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{Header, ReferenceChunk};

use super::*;
use crate::sample;

#[test]
fn a_header_is_three_numbers_behind_the_encapsulation() {
    let header = Header {
        sender_id: 0x0102,
        sequence: 3,
        sent_ns: u64::MAX,
    };
    let mut bytes = vec![0, 1, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0];
    bytes.extend([0xff; 8]);
    assert_eq!(encode(&header), Ok(bytes));
}

#[test]
fn what_is_written_is_read_again_to_the_bit() {
    for seed in 0..20 {
        let messages = sample::random(seed).into_iter();
        for (message, mut again) in messages.zip(sample::zeros()) {
            let name = message.layout().name;
            let bytes = encode(&*message).expect(name);
            decode(&bytes, &mut *again).expect(name);
            assert_eq!(encode(&*again).as_ref(), Ok(&bytes), "{name}");
            let cut = decode(&bytes[..bytes.len() - 1], &mut *again);
            assert!(matches!(cut, Err(CdrError::Content(_))), "{name}: {cut:?}");
            let long = decode(&[&*bytes, &[0]].concat(), &mut *again);
            assert!(long.is_err(), "{name}");
        }
    }
}

#[test]
fn what_is_not_a_message_is_refused() {
    let mut chunk = ReferenceChunk {
        count: 2,
        ..ReferenceChunk::default()
    };
    let mut bytes = encode(&chunk).expect("it is one");
    // Header, three numbers, and the number of points.
    let count_at = 4 + 24 + 12;
    assert_eq!(bytes[count_at], 2);
    bytes[count_at..count_at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    bytes.resize(1 << 20, 0);
    let error = decode(&bytes, &mut chunk).expect_err("too many points");
    let most = format!("more than {CHUNK_POINTS_MAX} elements of points");
    assert!(error.to_string().contains(&most), "{error}");
    for head in [&[][..], &[0, 1], &[0, 0, 0, 0, 1], &[0, 3, 0, 0]] {
        let error = decode(head, &mut chunk);
        assert!(matches!(error, Err(CdrError::Encapsulation(_))), "{head:?}");
    }
}
