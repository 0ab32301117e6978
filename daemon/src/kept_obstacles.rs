//! Obstacles without a lifetime outlive the daemon, in a file of the root folder.
//!
//! The file has two slots of the same layout: version, number, count, checksum, obstacles. A write goes to the
//! older slot. So a process killed meanwhile leaves an invalid slot, and the set before it in the other.

use std::io::Result;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use cdcr_controller::nmpc::OBSTACLES_MAX;
use cdcr_controller::robot::{Obstacle, Shape};
use nalgebra::Vector3;

use crate::mapped;
use crate::obstacles::{KnownObstacle, ObstacleSet};

/// Name and version of the layout; another one gets another word.
const VERSION: u64 = u64::from_le_bytes(*b"cdcrobs1");
const HEAD_WORDS: usize = 4;
const OBSTACLE_WORDS: usize = 13;
const SLOT_WORDS: usize = HEAD_WORDS + OBSTACLES_MAX * OBSTACLE_WORDS;
const FILE_WORDS: usize = 2 * SLOT_WORDS;

/// The kept obstacles of a robot, for every daemon of it. The default keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct KeptObstacles(Option<&'static [AtomicU64; FILE_WORDS]>);

impl KeptObstacles {
    /// Opens the obstacles in the file at `path`; creates a missing file for the user of this process alone.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self(Some(mapped::open(path)?)))
    }

    /// The newest written set. `None` if another version or another program has written the file.
    pub fn read(&self) -> Option<ObstacleSet> {
        let Some(file) = self.0 else {
            return Some(ObstacleSet::default());
        };
        let (_, obstacles) = newest(file)?;
        let words: Vec<u64> = obstacles.iter().map(load).collect();
        let known = words.chunks_exact(OBSTACLE_WORDS).map(obstacle_of);
        known.collect()
    }

    /// Writes the obstacles of `known` that have no lifetime, if they are not those of `before`.
    pub fn update(&self, before: &ObstacleSet, known: &ObstacleSet) {
        if !endless(before).eq(endless(known)) {
            self.write(known);
        }
    }

    /// Writes the obstacles of `known` that have no lifetime.
    pub fn write(&self, known: &ObstacleSet) {
        let Some(file) = self.0 else {
            return;
        };
        let number = newest(file).map(|(number, _)| number);
        if number.is_none() {
            for word in file {
                word.store(0, Ordering::Release);
            }
        }
        let number = number.unwrap_or(0) + 1;
        let mut body = [0; SLOT_WORDS - HEAD_WORDS];
        let mut count = 0;
        for (words, known) in body.chunks_exact_mut(OBSTACLE_WORDS).zip(endless(known)) {
            words.copy_from_slice(&words_of(known));
            count += 1;
        }
        let body = &body[..count * OBSTACLE_WORDS];
        let sum = checksum(number, body.iter().copied());
        let head = [VERSION, number, count as u64, sum];
        let older = number as usize % 2 * SLOT_WORDS;
        for (word, value) in file[older..].iter().zip(head.iter().chain(body)) {
            word.store(*value, Ordering::Release);
        }
    }

    /// Creates a deleted file again, with its folder, if obstacles are kept. Returns true if none are.
    pub(crate) fn leave(&self, path: &Path) -> Result<bool> {
        let is_empty = self.read().is_some_and(|set| set.count() == 0);
        if let Some(file) = self.0.filter(|_| !is_empty) {
            mapped::make_again(path, file)?;
        }
        Ok(is_empty)
    }
}

/// Number and obstacles of the newest whole slot. `None` without one, or if a slot is of another version.
fn newest(file: &[AtomicU64; FILE_WORDS]) -> Option<(u64, &[AtomicU64])> {
    let slots = file.chunks_exact(SLOT_WORDS);
    let is_known = |slot: &[AtomicU64]| [0, VERSION].contains(&load(&slot[0]));
    let whole = slots.clone().all(is_known).then_some(slots)?;
    whole
        .filter_map(whole_slot)
        .max_by_key(|(number, _)| *number)
}

/// Number and obstacles of a slot. `None` if it is torn. One that was never written is empty, with number 0.
fn whole_slot(slot: &[AtomicU64]) -> Option<(u64, &[AtomicU64])> {
    let (head, body) = slot.split_at_checked(HEAD_WORDS)?;
    let [version, number, count, sum] = head.first_chunk::<HEAD_WORDS>()?.each_ref().map(load);
    if version == 0 {
        return Some((0, &[]));
    }
    let body = body.get(..usize::try_from(count).ok()?.checked_mul(OBSTACLE_WORDS)?)?;
    (sum == checksum(number, body.iter().map(load))).then_some((number, body))
}

fn load(word: &AtomicU64) -> u64 {
    word.load(Ordering::Acquire)
}

fn endless(set: &ObstacleSet) -> impl Iterator<Item = &KnownObstacle> {
    set.iter().filter(|known| known.expires_ns.is_none())
}

fn words_of(known: &KnownObstacle) -> [u64; OBSTACLE_WORDS] {
    let (shape, [start_m, end_m]) = match *known.obstacle.shape() {
        Shape::Sphere { centre_m } => (0, [centre_m; 2]),
        Shape::Capsule { start_m, end_m } => (1, [start_m, end_m]),
    };
    let [a, b, v] = [start_m, end_m, known.obstacle.velocity_m_s()].map(|x| x.map(f64::to_bits));
    [
        u64::from(known.id) | shape << 32,
        known.source,
        known.measured_ns,
        known.obstacle.radius_m().to_bits(),
        a.x,
        a.y,
        a.z,
        b.x,
        b.y,
        b.z,
        v.x,
        v.y,
        v.z,
    ]
}

fn obstacle_of(words: &[u64]) -> Option<KnownObstacle> {
    let [kind, source, measured_ns, radius, vectors @ ..] =
        words.first_chunk::<OBSTACLE_WORDS>()?;
    let vector = |at: usize| Vector3::from_fn(|row, _| f64::from_bits(vectors[at + row]));
    let shape = match kind >> 32 {
        0 => Shape::Sphere {
            centre_m: vector(0),
        },
        1 => Shape::Capsule {
            start_m: vector(0),
            end_m: vector(3),
        },
        _ => return None,
    };
    Some(KnownObstacle {
        id: *kind as u32,
        source: *source,
        obstacle: Obstacle::new(shape, f64::from_bits(*radius), vector(6)).ok()?,
        measured_ns: *measured_ns,
        expires_ns: None,
    })
}

/// A sum that depends on the order of the words. Words of two writes give that of neither, but by a rare accident.
fn checksum(number: u64, body: impl Iterator<Item = u64>) -> u64 {
    let words = [VERSION, number].into_iter().chain(body);
    words.fold(0, |sum: u64, word| {
        (sum.rotate_left(5) ^ word).wrapping_mul(0x517c_c1b7_2722_0a95)
    })
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    fn known(id: u32, expires_ns: Option<u64>) -> KnownObstacle {
        let [start_m, end_m] = [0.1, 0.2].map(|x| Vector3::new(x, -x, f64::from(id)));
        let shape = match id % 2 {
            0 => Shape::Sphere { centre_m: start_m },
            _ => Shape::Capsule { start_m, end_m },
        };
        let velocity_m_s = Vector3::new(0.5, 0.0, -0.25);
        KnownObstacle {
            id,
            source: u64::MAX - u64::from(id),
            obstacle: Obstacle::new(shape, 0.02, velocity_m_s).unwrap(),
            measured_ns: 1000,
            expires_ns,
        }
    }

    fn full() -> ObstacleSet {
        (0..64).map(|id| known(id, None)).collect()
    }

    fn in_new_file() -> (Scratch, std::path::PathBuf, KeptObstacles) {
        let folder = Scratch::in_memory().unwrap();
        let path = folder.path().join("a.obstacles");
        let kept = KeptObstacles::open(&path).unwrap();
        (folder, path, kept)
    }

    #[test]
    fn obstacles_without_a_lifetime_are_found_again_until_they_are_removed() {
        let (_folder, path, kept) = in_new_file();
        let empty = ObstacleSet::default();
        assert_eq!(kept.read(), Some(empty));
        assert!(kept.leave(&path).unwrap());
        kept.update(&empty, &full());
        let found = || KeptObstacles::open(&path).unwrap().read();
        assert_eq!(found(), Some(full()));
        let mixed = [known(1, Some(5)), known(2, None), known(3, Some(7))];
        kept.update(&full(), &mixed.into_iter().collect());
        assert_eq!(found(), Some([known(2, None)].into_iter().collect()));
        std::fs::remove_file(&path).unwrap();
        assert!(!kept.leave(&path).unwrap());
        assert_eq!(found(), Some([known(2, None)].into_iter().collect()));
        let again = KeptObstacles::open(&path).unwrap();
        again.update(&mixed.into_iter().collect(), &empty);
        assert_eq!(found(), Some(empty));
        assert_eq!(KeptObstacles::default().read(), Some(empty));
    }

    #[test]
    fn a_write_that_a_kill_tears_anywhere_leaves_the_set_before_it() {
        let (_folder, _path, kept) = in_new_file();
        let file = kept.0.unwrap();
        let values = || file.each_ref().map(|word| word.load(Ordering::Relaxed));
        let mut before = ObstacleSet::default();
        for count in [1, 64, 0, 64, 1] {
            let set: ObstacleSet = (0..count).map(|id| known(id, None)).collect();
            let old = values();
            kept.write(&set);
            let new = values();
            let mut changed: Vec<usize> = (0..FILE_WORDS).filter(|i| old[*i] != new[*i]).collect();
            // The compiler may choose another order than that of the file.
            for _ in 0..2 {
                for (word, value) in file.iter().zip(&old) {
                    word.store(*value, Ordering::Relaxed);
                }
                for (written, at) in changed.iter().enumerate() {
                    assert_eq!(kept.read(), Some(before), "{written} words");
                    file[*at].store(new[*at], Ordering::Relaxed);
                }
                assert_eq!(kept.read(), Some(set));
                changed.reverse();
            }
            before = set;
        }
    }

    #[test]
    fn what_another_version_or_program_wrote_is_no_set() {
        for content in [vec![b'x'; 3], vec![7; 8 * FILE_WORDS], vec![7; 100_000]] {
            let (_folder, path, _) = in_new_file();
            std::fs::write(&path, &content).unwrap();
            let kept = KeptObstacles::open(&path).unwrap();
            assert_eq!(kept.read(), None, "{}", content.len());
            assert!(!kept.leave(&path).unwrap());
            kept.write(&full());
            assert_eq!(KeptObstacles::open(&path).unwrap().read(), Some(full()));
        }
    }
}
