//! Mutations of files, the same for the same number: flipped bits, cuts, repetitions, lost lines, exchanged parts, and
//! numbers put where they hurt.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Numbers that readers have to expect in a text.
const NUMBERS: [&[u8]; 16] = [
    b"1e39",
    b"-1",
    b"NaN",
    b"inf",
    b"-inf",
    b"0",
    b"-0.0",
    b"1e-320",
    b"1e308",
    b"1e999",
    b"9223372036854775808",
    b"18446744073709551616",
    b"4294967295",
    b"1152921504606846976",
    b"340282366920938463463374607431768211456",
    b"1_000",
];

/// And in eight bytes of a binary file.
const WORDS: [u64; 8] = [
    0,
    1,
    1 << 32,
    1 << 60,
    1 << 63,
    u64::MAX,
    (1 << 53) + 1,
    0x7ff8_0000_7fc0_0000,
];

/// Mutates files, by number.
pub struct Mutator {
    rng: ChaCha8Rng,
}

impl Mutator {
    /// The mutations of this number.
    pub fn new(number: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(number),
        }
    }

    fn below(&mut self, end: usize) -> usize {
        (self.rng.next_u64() % end.max(1) as u64) as usize
    }

    /// A piece of a file, seldom a long one.
    fn piece(&mut self, length: usize) -> std::ops::Range<usize> {
        let from = self.below(length);
        let most = (length - from).min(1 << self.below(12));
        from..from + self.below(most + 1)
    }

    /// A file whose text is whole but for one to three numbers; of a safetensors file, in its head, whose length is then that of
    /// the new one.
    pub fn renumber(&mut self, original: &[u8]) -> Vec<u8> {
        let length: Option<[u8; 8]> = original.first_chunk().copied();
        let head = length.map_or(0, u64::from_le_bytes) as usize;
        let is_safetensors = original.get(8) == Some(&b'{') && head < original.len();
        let (from, to) = match is_safetensors {
            true => (8, 8 + head),
            false => (0, original.len()),
        };
        let mut text = original[from..to].to_vec();
        for _ in 0..=self.below(3) {
            self.put_number(&mut text);
        }
        let length = (text.len() as u64).to_le_bytes();
        let before = if is_safetensors { &length[..] } else { &[] };
        [before, &text, &original[to..]].concat()
    }

    /// One to three mutations of a file; of a long one, half the time within its head, which says what follows.
    pub fn mutate(&mut self, original: &[u8]) -> Vec<u8> {
        let head = original.len().min(4096);
        let (mut bytes, tail) = match self.below(2) {
            0 => (original[..head].to_vec(), &original[head..]),
            _ => (original.to_vec(), &[][..]),
        };
        for _ in 0..=self.below(3) {
            if bytes.is_empty() {
                break;
            }
            self.once(&mut bytes);
        }
        bytes.extend_from_slice(tail);
        bytes
    }

    fn once(&mut self, bytes: &mut Vec<u8>) {
        let length = bytes.len();
        match self.below(10) {
            0 => {
                for _ in 0..=self.below(4) {
                    let at = self.below(length);
                    bytes[at] ^= 1 << self.below(8);
                }
            }
            1 => bytes.truncate(self.below(length)),
            2 => {
                let piece = bytes[self.piece(length)].to_vec();
                let at = self.below(length);
                bytes.splice(at..at, piece);
            }
            3 => drop(bytes.drain(self.piece(length))),
            4 => {
                let (from, to) = (self.piece(length), self.below(length));
                let piece: Vec<u8> = bytes.drain(from).collect();
                let to = to.min(bytes.len());
                bytes.splice(to..to, piece);
            }
            5 => {
                // A word at the beginning, where lengths stand, as often as anywhere else.
                let start = match self.below(2) {
                    0 => self.below(length.min(64)),
                    _ => self.below(length),
                };
                let word = WORDS[self.below(WORDS.len())].to_le_bytes();
                let end = (start + 8).min(length);
                bytes[start..end].copy_from_slice(&word[..end - start]);
            }
            6 => self.lose_lines(bytes),
            7 => {
                let at = self.below(length);
                let noise: Vec<u8> = (0..=self.below(16))
                    .map(|_| self.rng.next_u32() as u8)
                    .collect();
                bytes.splice(at..at, noise);
            }
            _ => self.put_number(bytes),
        }
    }

    fn lose_lines(&mut self, bytes: &mut Vec<u8>) {
        let lines: Vec<&[u8]> = bytes.split_inclusive(|byte| *byte == b'\n').collect();
        let from = self.below(lines.len());
        let to = (from + 1 + self.below(3)).min(lines.len());
        *bytes = [lines[..from].concat(), lines[to..].concat()].concat();
    }

    /// Puts one of [`NUMBERS`] in the place of a number in a text.
    fn put_number(&mut self, bytes: &mut Vec<u8>) {
        let is_part = |byte: u8| byte.is_ascii_digit() || b"+-.".contains(&byte);
        let start = self.below(bytes.len());
        let Some(from) = (start..bytes.len()).find(|at| bytes[*at].is_ascii_digit()) else {
            return;
        };
        // Its beginning may lie before.
        let from = (0..from)
            .rev()
            .take_while(|at| is_part(bytes[*at]))
            .last()
            .unwrap_or(from);
        let to = (from..bytes.len())
            .find(|at| !is_part(bytes[*at]))
            .unwrap_or(bytes.len());
        let number = NUMBERS[self.below(NUMBERS.len())];
        bytes.splice(from..to, number.iter().copied());
    }
}
