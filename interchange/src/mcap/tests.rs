use std::io::{Cursor, Read};

use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;

fn channel(topic: &str) -> Channel {
    Channel {
        topic: topic.to_owned(),
        schema: "cdcr_msgs/msg/Header".to_owned(),
        text: "uint64 sender_id\n".to_owned(),
        metadata: [("offset_ns".to_owned(), "7".to_owned())].into(),
    }
}

fn stamp(sequence: u32) -> Stamp {
    Stamp {
        sequence,
        log_ns: 1_000 + u64::from(sequence),
        publish_ns: 2_000,
    }
}

/// A file with `count` messages of 1 kB, and the number of complete bytes after each flush.
fn file(count: u32) -> (Vec<u8>, Vec<u64>) {
    let mut writer = Writer::new(Vec::new(), "ros2", "test").unwrap();
    let ids = ["/a", "/b"].map(|topic| writer.add_channel(&channel(topic)).unwrap());
    writer
        .attach("note.txt", "text/plain", 5, b"hello")
        .unwrap();
    writer
        .add_metadata("about", [("x".to_owned(), "1".to_owned())].into())
        .unwrap();
    let mut flushed = Vec::new();
    for sequence in 0..count {
        let data = [sequence as u8; 1000];
        let id = ids[sequence as usize % 2];
        writer.write(id, stamp(sequence), &data).unwrap();
        if sequence % 10 == 9 {
            writer.flush().unwrap();
            flushed.push(writer.whole_bytes());
        }
    }
    let Ok(bytes) = writer.finish() else {
        panic!("memory takes it all");
    };
    (bytes, flushed)
}

/// Messages, number of other items, and the result of reading.
fn read(bytes: &[u8]) -> (Vec<u32>, usize, Result<(), ReadError>) {
    match Reader::new(bytes) {
        Ok(mut reader) => read_all(&mut reader),
        Err(error) => (Vec::new(), 0, Err(error)),
    }
}

/// The same of everything that is whole, and the losses.
fn read_around(bytes: &[u8]) -> (Vec<u32>, usize, Vec<Loss>) {
    let mut reader = Reader::around_damage(Cursor::new(bytes)).unwrap();
    let (messages, others, end) = read_all(&mut reader);
    assert!(matches!(end, Ok(()) | Err(ReadError::Cut)), "{end:?}");
    (messages, others, reader.whole().losses().to_vec())
}

fn read_all(reader: &mut Reader<impl Read>) -> (Vec<u32>, usize, Result<(), ReadError>) {
    let (mut messages, mut others) = (Vec::new(), 0);
    loop {
        match reader.next_item() {
            Ok(Some(Item::Message(message))) => {
                let topic = ["/a", "/b"][message.sequence as usize % 2];
                assert_eq!(*message.channel, channel(topic));
                assert_eq!(message.data, [message.sequence as u8; 1000]);
                assert_eq!(
                    (message.log_ns, message.publish_ns),
                    (1_000 + u64::from(message.sequence), 2_000)
                );
                messages.push(message.sequence);
            }
            Ok(Some(Item::Attachment { name, data, .. })) => {
                assert_eq!((name.as_str(), &data[..]), ("note.txt", &b"hello"[..]));
                others += 1;
            }
            Ok(Some(Item::Metadata { name, values })) => {
                assert_eq!(name, "about");
                assert_eq!(values, [("x".to_owned(), "1".to_owned())].into());
                others += 1;
            }
            Ok(None) => return (messages, others, Ok(())),
            Err(error) => return (messages, others, Err(error)),
        }
    }
}

#[test]
fn what_is_written_is_read_again() {
    let (bytes, _) = file(100);
    let (messages, others, end) = read(&bytes);
    end.unwrap();
    assert_eq!(messages, (0..100).collect::<Vec<_>>());
    assert_eq!(others, 2);
}

#[test]
fn a_file_that_is_cut_anywhere_has_all_that_was_flushed() {
    let (bytes, flushed) = file(40);
    for end in (0..bytes.len() - 1).step_by(37) {
        let (messages, _, result) = read(&bytes[..end]);
        let whole = flushed.iter().filter(|at| **at <= end as u64).count();
        assert!(messages.len() >= 10 * whole, "{end}");
        assert!(messages.iter().copied().eq(0..messages.len() as u32));
        match result {
            Err(ReadError::Cut) => {}
            Err(ReadError::Empty) => assert_eq!(end, 0),
            // All messages were read; only the index is missing.
            Ok(()) => assert_eq!(messages.len(), 40),
            Err(ReadError::Foreign) => assert!(end < mcap::MAGIC.len()),
            Err(other) => panic!("{end}: {other}"),
        }
    }
}

#[test]
fn what_is_no_recording_is_refused() {
    assert!(matches!(read(b"").2, Err(ReadError::Empty)));
    assert!(matches!(
        read(b"time_s,x_m\n0,1\n").2,
        Err(ReadError::Foreign)
    ));
    let (bytes, _) = file(40);
    for at in (9..bytes.len()).step_by(101) {
        let mut wrong = bytes.clone();
        wrong[at] ^= 0xFF;
        // No panic, whatever the content.
        let Ok(mut reader) = Reader::new(&wrong[..]) else {
            continue;
        };
        while let Ok(Some(_)) = reader.next_item() {}
    }
    // An attachment without room for its checksum.
    let note = bytes.windows(8).position(|part| part == b"note.txt");
    let attachment = note.unwrap() - 4 - 16 - 9;
    let mut wrong = bytes.clone();
    wrong[attachment + 1] = 16 + 4 + 8 + 4 + 10 + 8 + 1;
    assert!(read(&wrong).2.is_err());
    let chunk = bytes
        .windows(4)
        .position(|window| window == [39; 4])
        .unwrap();
    let mut wrong = bytes.clone();
    wrong[chunk] ^= 1;
    assert!(matches!(read(&wrong).2, Err(ReadError::Damaged { .. })));
}

/// Each bit of a byte costs at most the ten messages of its chunk, and is found wherever it is.
#[test]
fn a_wrong_bit_costs_no_more_than_its_chunk() {
    let (bytes, flushed) = file(40);
    assert_eq!(read_around(&bytes), (read(&bytes).0, 2, Vec::new()));
    let data_end = flushed[3] as usize;
    let about = bytes.windows(5).position(|part| part == b"about").unwrap();
    let metadata = about..about + 20;
    for at in 8..bytes.len() {
        let mut wrong = bytes.clone();
        wrong[at] ^= 1 << (at % 8);
        // The metadata has no checksum; its wrong content would fail in `read_all`.
        if metadata.contains(&at) {
            continue;
        }
        let (messages, others, losses) = read_around(&wrong);
        assert!(messages.len() >= 30 && others >= 1, "{at}: {losses:?}");
        assert!(
            messages.is_sorted() && losses.len() <= 1,
            "{at}: {losses:?}"
        );
        let is_less = messages.len() < 40 || others < 2;
        if is_less {
            assert!(
                at < data_end && losses[0].bytes.contains(&(at as u64)),
                "{at}"
            );
        }
    }
}

/// A disk with a limited number of bytes.
struct Disk(Vec<u8>, usize);

impl std::io::Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let room = self.1.saturating_sub(self.0.len()).min(bytes.len());
        self.0.extend(&bytes[..room]);
        if room == 0 && !bytes.is_empty() {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        Ok(room)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Bytes that cannot be compressed.
fn noise(seed: u32) -> [u8; 1000] {
    let mut bytes = [0; 1000];
    Xoshiro256PlusPlus::seed_from_u64(seed.into()).fill_bytes(&mut bytes);
    bytes
}

#[test]
fn a_full_disk_keeps_what_is_whole() {
    let mut writer = Writer::new(Disk(Vec::new(), 50_500), "ros2", "test").unwrap();
    let id = writer.add_channel(&channel("/a")).unwrap();
    let mut written = 0;
    let full = (0..).step_by(2).find(|sequence| {
        let data = noise(*sequence);
        writer.write(id, stamp(*sequence), &data).unwrap();
        let is_full = writer.flush().is_err();
        written += usize::from(!is_full);
        is_full
    });
    assert!(full.is_some());
    let whole = writer.whole_bytes() as usize;
    let mut disk = writer.abandon();
    disk.0.truncate(whole);
    end(&mut disk).unwrap();
    let mut reader = Reader::new(&disk.0[..]).unwrap();
    for sequence in (0..).step_by(2).take(written) {
        let Some(Item::Message(message)) = reader.next_item().unwrap() else {
            panic!("{sequence} of {written}");
        };
        assert_eq!(message.data, noise(sequence));
    }
    assert!(reader.next_item().unwrap().is_none() && written > 10);
}
