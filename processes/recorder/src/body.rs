//! How a message's memory becomes the body of a recorded message, and a body the same memory again.
//!
//! Numbers go over as they lie in memory. Text does not: a ROS 2 `string` has the length that it needs, so that what
//! follows it stands elsewhere and is aligned anew.

use crate::cdr::{Cdr, Read};
use crate::text::{bytes_of, string_of};
use messages::Field;

/// The way of one type's messages between memory and recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Body {
    /// Bytes of a message in memory.
    size: usize,
    pieces: Vec<BodyPiece>,
}

/// Bytes that go over together.
#[derive(Clone, Debug, PartialEq, Eq)]
enum BodyPiece {
    /// Numbers, of which the first has the largest alignment: the others keep their distance to it.
    Numbers {
        offset: usize,
        size: usize,
        align: usize,
    },
    /// Zero-padded text.
    Text { offset: usize, size: usize },
}

impl Body {
    /// Of a type with these fields, under [`messages::Message::ros_definition`].
    pub fn of(fields: &[Field]) -> Self {
        let mut body = Self::bare(fields);
        walk(fields, 0, true, &mut body.pieces);
        body
    }

    /// The same under [`messages::Message::definition`], where text is bytes: how versions before this one recorded.
    pub fn of_memory(fields: &[Field]) -> Self {
        let mut body = Self::bare(fields);
        walk(fields, 0, false, &mut body.pieces);
        body
    }

    fn bare(fields: &[Field]) -> Self {
        Self {
            size: fields.iter().map(|field| field.size).sum(),
            pieces: Vec::new(),
        }
    }

    /// Writes a message's memory as a whole CDR body. `memory` has as many bytes as the message.
    pub fn write(&self, memory: &[u8], cdr: &mut Cdr) {
        cdr.start();
        for piece in &self.pieces {
            match *piece {
                BodyPiece::Numbers {
                    offset,
                    size,
                    align,
                } => cdr.numbers(&memory[offset..][..size], align),
                BodyPiece::Text { offset, size } => {
                    cdr.string(&string_of(&memory[offset..][..size]))
                }
            }
        }
    }

    /// The memory of the message that has this body, its encapsulation header included, into `memory`; what is wrong
    /// with the body, if it is none.
    ///
    /// # Errors
    /// Says what does not fit, and where.
    pub fn read(&self, body: &[u8], memory: &mut Vec<u8>) -> Result<(), String> {
        memory.clear();
        memory.resize(self.size, 0);
        let found = body.len();
        let mut body = Read::new(body)
            .ok_or_else(|| format!("{found} bytes without little-endian CDR's mark before them"))?;
        for piece in &self.pieces {
            let taken = match *piece {
                BodyPiece::Numbers {
                    offset,
                    size,
                    align,
                } => body
                    .numbers(size, align)
                    .map(|numbers| memory[offset..][..size].copy_from_slice(numbers)),
                BodyPiece::Text { offset, size } => body
                    .string()
                    .and_then(|text| bytes_of(text, &mut memory[offset..][..size])),
            };
            taken.ok_or_else(|| {
                let at = body.position();
                format!("a message of {found} bytes that is none of its type from byte {at} on")
            })?;
        }
        match body.rest() {
            0 => Ok(()),
            rest => Err(format!(
                "a message of {found} bytes, of which {rest} are too many"
            )),
        }
    }
}

fn walk(fields: &[Field], start: usize, has_strings: bool, pieces: &mut Vec<BodyPiece>) {
    for field in fields {
        let offset = start + field.offset;
        if let Some(inner) = field.nested {
            let count = field.count.unwrap_or(1);
            for index in 0..count {
                let offset = offset + index * (field.size / count);
                walk(inner(), offset, has_strings, pieces);
            }
        } else if field.is_text && has_strings {
            pieces.push(BodyPiece::Text {
                offset,
                size: field.size,
            });
        } else {
            match pieces.last_mut() {
                Some(BodyPiece::Numbers {
                    offset: from,
                    size,
                    align,
                }) if *from + *size == offset && field.align <= *align => *size += field.size,
                _ => pieces.push(BodyPiece::Numbers {
                    offset,
                    size: field.size,
                    align: field.align,
                }),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topics::TOPICS;
    use messages::{Display, HumanBelief, LidarFrame, Message, Report};
    use proptest::prelude::*;

    #[test]
    fn messages_without_text_go_over_in_one_piece() {
        let body = Body::of(LidarFrame::fields());
        assert_eq!(body.pieces.len(), 1);
        let frame = LidarFrame::ZERO;
        let mut cdr = Cdr::default();
        body.write(frame.bytes(), &mut cdr);
        assert_eq!(cdr.bytes()[4..], *frame.bytes());
        assert_eq!(body, Body::of_memory(LidarFrame::fields()));
    }

    /// Worked out by hand from the rules of CDR.
    #[test]
    fn what_follows_a_text_is_aligned_anew() {
        let mut belief = HumanBelief::ZERO;
        belief.kind[..6].copy_from_slice(b"mirror");
        (belief.latent, belief.log_likelihood) = (64, -1.5);
        let mut cdr = Cdr::default();
        Body::of(HumanBelief::fields()).write(belief.bytes(), &mut cdr);
        let kind = core::mem::offset_of!(HumanBelief, kind);
        let mut expected = vec![0, 1, 0, 0];
        expected.extend_from_slice(&belief.bytes()[..kind]);
        expected.extend_from_slice(b"\x07\0\0\0mirror\0\0"); // length, text, its end, padding to four
        expected.extend_from_slice(&64_u32.to_le_bytes());
        expected.extend_from_slice(&(-1.5_f32).to_le_bytes());
        assert_eq!(cdr.bytes(), expected);
    }

    #[test]
    fn a_body_that_is_cut_or_too_long_is_refused() {
        let body = Body::of(Report::fields());
        let mut cdr = Cdr::default();
        body.write(Report::ZERO.bytes(), &mut cdr);
        let (whole, mut memory) = (cdr.bytes().to_vec(), Vec::new());
        assert_eq!(body.read(&whole, &mut memory), Ok(()));
        assert_eq!(memory, Report::ZERO.bytes());
        for length in 0..whole.len() {
            let error = body.read(&whole[..length], &mut memory).expect_err("cut");
            assert!(error.contains(&length.to_string()), "{error}");
        }
        let longer = [&whole[..], &[0]].concat();
        let error = body.read(&longer, &mut memory).expect_err("too long");
        assert!(error.contains("1 are too many"), "{error}");
    }

    proptest! {
        /// Whatever a message's memory holds, text or not: what is recorded of it is the same memory when it is read.
        #[test]
        fn every_message_comes_back_byte_for_byte(
            noise in proptest::collection::vec(any::<u8>(), 200..400),
            zeros in any::<bool>(),
        ) {
            for topic in &TOPICS {
                let mut memory = noise.repeat(topic.size / noise.len() + 1);
                memory.truncate(topic.size);
                if zeros {
                    // Texts with an end.
                    memory.iter_mut().for_each(|byte| *byte = if *byte < 128 { *byte } else { 0 });
                }
                for body in [Body::of((topic.fields)()), Body::of_memory((topic.fields)())] {
                    let (mut cdr, mut back) = (Cdr::default(), Vec::new());
                    body.write(&memory, &mut cdr);
                    prop_assert_eq!(body.read(cdr.bytes(), &mut back), Ok(()));
                    prop_assert_eq!(&back, &memory);
                }
            }
        }
    }

    #[test]
    fn an_utterance_is_text() {
        let mut display = Display::ZERO;
        display.utterances[0].text[..4].copy_from_slice(b"Slow");
        let mut cdr = Cdr::default();
        Body::of(Display::fields()).write(display.bytes(), &mut cdr);
        let header = 4 + size_of::<messages::Header>();
        assert_eq!(cdr.bytes()[header..][..9], *b"\x05\0\0\0Slow\0");
    }
}
