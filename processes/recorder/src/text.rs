//! A message's zero-padded text as a string that every viewer can show, and back to exactly the same bytes.
//!
//! Text that is what it should be, UTF-8 with nothing behind its end, is the string itself. Bytes that are not (of a
//! foreign program, or cut within a character) follow a mark: valid characters as they are, the others as `\xNN`.

use std::borrow::Cow;

/// Begins a string that stands for other bytes than its own: U+FFFD, the sign for what is no character.
const MARK: char = char::REPLACEMENT_CHARACTER;

/// The string for these bytes.
pub fn string_of(padded: &[u8]) -> Cow<'_, str> {
    let end = padded.iter().rposition(|byte| *byte != 0);
    let bytes = &padded[..end.map_or(0, |last| last + 1)];
    match str::from_utf8(bytes) {
        Ok(text) if !text.contains('\0') && !text.starts_with(MARK) => Cow::Borrowed(text),
        _ => Cow::Owned(marked(bytes)),
    }
}

fn marked(bytes: &[u8]) -> String {
    let mut out = String::from(MARK);
    for chunk in bytes.utf8_chunks() {
        for character in chunk.valid().chars() {
            match character {
                '\\' => out.push_str("\\\\"),
                '\0' => out.push_str("\\x00"),
                other => out.push(other),
            }
        }
        for byte in chunk.invalid() {
            out.push_str(&format!("\\x{byte:02x}"));
        }
    }
    out
}

/// Writes the bytes that a string stands for into `padded`, and zeros behind them; none if they do not fit or the
/// string is none that [`string_of`] makes.
pub fn bytes_of(text: &str, padded: &mut [u8]) -> Option<()> {
    let bytes = match text.strip_prefix(MARK) {
        None => Cow::Borrowed(text.as_bytes()),
        Some(text) => Cow::Owned(unmarked(text.as_bytes())?),
    };
    let (place, rest) = padded.split_at_mut_checked(bytes.len())?;
    place.copy_from_slice(&bytes);
    rest.fill(0);
    Some(())
}

fn unmarked(mut text: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len());
    loop {
        text = match text {
            [] => return Some(bytes),
            [b'\\', b'\\', rest @ ..] => {
                bytes.push(b'\\');
                rest
            }
            [b'\\', b'x', high, low, rest @ ..] => {
                bytes.push(digit(*high)? << 4 | digit(*low)?);
                rest
            }
            [b'\\', ..] => return None,
            [byte, rest @ ..] => {
                bytes.push(*byte);
                rest
            }
        };
    }
}

fn digit(letter: u8) -> Option<u8> {
    char::from(letter)
        .to_digit(16)
        .and_then(|digit| u8::try_from(digit).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn round_trip(padded: &[u8]) -> Vec<u8> {
        let mut back = vec![7; padded.len()];
        bytes_of(&string_of(padded), &mut back).expect("of our own making");
        back
    }

    #[test]
    fn good_text_is_the_string_itself() {
        for text in ["", "Fast car behind", "Blaulicht, größer", "a\\b"] {
            let mut padded = [0; 64];
            padded[..text.len()].copy_from_slice(text.as_bytes());
            assert_eq!(string_of(&padded), text);
            assert_eq!(round_trip(&padded), padded);
        }
        assert_eq!(string_of(&[b'x'; 64]), "x".repeat(64), "no padding at all");
    }

    #[test]
    fn other_bytes_are_marked_and_as_legible_as_can_be() {
        assert_eq!(string_of(b"slow gr\xc3"), "\u{fffd}slow gr\\xc3");
        assert_eq!(string_of(b"a\0b\\\0\0"), "\u{fffd}a\\x00b\\\\");
        assert_eq!(string_of("\u{fffd}".as_bytes()), "\u{fffd}\u{fffd}");
        for odd in [&b"slow gr\xc3"[..], b"a\0b\\\0\0", "\u{fffd}".as_bytes()] {
            assert_eq!(round_trip(odd), odd);
        }
    }

    #[test]
    fn what_was_not_made_here_is_refused() {
        for bad in [
            "\u{fffd}\\",
            "\u{fffd}\\y",
            "\u{fffd}\\x4",
            "\u{fffd}\\xg0",
            "12345",
        ] {
            assert_eq!(bytes_of(bad, &mut [0; 4]), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn every_byte_comes_back(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            prop_assert_eq!(round_trip(&bytes), bytes);
        }

        #[test]
        fn text_comes_back(text in "\\PC{0,20}", padding in 0_usize..9) {
            let mut bytes = text.into_bytes();
            bytes.resize(bytes.len() + padding, 0);
            prop_assert_eq!(round_trip(&bytes), bytes);
        }
    }
}
