//! Threads that load caches and memory.

use std::hint::black_box;

use super::Done;
use super::task::Signals;

const MEBIBYTE: usize = 1 << 20;
/// Size of a buffer, far larger than a shared cache.
const BUFFER_BYTES: usize = 64 * MEBIBYTE;
/// Upper bound for all source buffers together, and for all destination buffers, on a machine with many
/// cores.
const TOGETHER_BYTES: usize = 512 * MEBIBYTE;
/// Bytes copied between two checks for the end.
const PIECE_BYTES: usize = MEBIBYTE;

/// Size of each of the two buffers of a thread. The buffers of all threads always exceed the shared caches.
pub(super) fn buffer_bytes(threads: usize) -> usize {
    let share = TOGETHER_BYTES / threads.max(1);
    share.clamp(PIECE_BYTES, BUFFER_BYTES) / PIECE_BYTES * PIECE_BYTES
}

/// Copies one buffer into the other and back, piece by piece, until the load ends.
pub(super) fn copy(bytes: usize, signals: &Signals) -> Done {
    // Not zero: the kernel would map all zero pages to one page.
    let (mut from, mut to) = (vec![1_u8; bytes], vec![2_u8; bytes]);
    signals.works();
    let mut done = Done::default();
    while !signals.is_ending() {
        let pieces = from.chunks(PIECE_BYTES).zip(to.chunks_mut(PIECE_BYTES));
        for (source, target) in pieces {
            target.copy_from_slice(source);
            done.copied_bytes += target.len() as u64;
            if signals.is_ending() {
                break;
            }
        }
        std::mem::swap(&mut from, &mut to);
        black_box(&from);
    }
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_threads_share_a_bounded_memory() {
        assert_eq!(buffer_bytes(1), BUFFER_BYTES);
        assert_eq!(buffer_bytes(8), BUFFER_BYTES);
        assert_eq!(buffer_bytes(63), 8 * MEBIBYTE);
        assert_eq!(buffer_bytes(10_000), MEBIBYTE);
    }
}
