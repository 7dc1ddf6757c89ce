//! Writes plain CDR (little endian), the body format of ROS 2 messages, for the few standard types that the recorder
//! derives. MIRROR's own messages need none of this: their memory is their body.

/// The encapsulation header before every body: plain CDR, little endian, no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A body being written into a buffer that keeps its memory from message to message.
///
/// Every number is aligned to its own size, counted from the body's first byte, which lies behind [`ENCAPSULATION`].
#[derive(Debug, Default)]
pub struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    /// Starts a new body in the same memory.
    pub fn start(&mut self) {
        self.bytes.clear();
        self.bytes.extend_from_slice(&ENCAPSULATION);
    }

    /// Starts a new body and fills it with a message that already is CDR.
    pub fn copy(&mut self, body: &[u8]) {
        self.start();
        self.bytes.extend_from_slice(body);
    }

    /// Encapsulation header and body.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn number(&mut self, little_endian: &[u8]) {
        let written = self.bytes.len() - ENCAPSULATION.len();
        let start = written.next_multiple_of(little_endian.len());
        self.bytes.resize(start + ENCAPSULATION.len(), 0);
        self.bytes.extend_from_slice(little_endian);
    }

    /// A `bool`.
    pub fn bool(&mut self, value: bool) {
        self.bytes.push(u8::from(value));
    }

    /// An `int32`.
    pub fn i32(&mut self, value: i32) {
        self.number(&value.to_le_bytes());
    }

    /// A `uint32`, or the length of a sequence.
    pub fn u32(&mut self, value: u32) {
        self.number(&value.to_le_bytes());
    }

    /// A `float32`.
    pub fn f32(&mut self, value: f32) {
        self.number(&value.to_le_bytes());
    }

    /// A `float64`.
    pub fn f64(&mut self, value: f64) {
        self.number(&value.to_le_bytes());
    }

    /// A `string`: its length with the closing zero, its bytes, the zero.
    pub fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// A sequence's length and its elements, each written by `write`.
    pub fn sequence<T>(&mut self, items: &[T], write: impl Fn(&mut Self, &T)) {
        self.u32(items.len() as u32);
        for item in items {
            write(self, item);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Worked out by hand from the rules of CDR; `tests/recording.rs` compares with an encoder that we did not write.
    #[test]
    fn numbers_are_aligned_from_the_start_of_the_body() {
        let mut cdr = Cdr::default();
        cdr.start();
        cdr.string("map");
        cdr.bool(true);
        cdr.f64(1.0);
        cdr.bool(false);
        cdr.i32(-2);
        assert_eq!(
            cdr.bytes(),
            [
                0, 1, 0, 0, // encapsulation
                4, 0, 0, 0, b'm', b'a', b'p', 0, // string
                1, 0, 0, 0, 0, 0, 0, 0, // bool at 8, padding to 16
                0, 0, 0, 0, 0, 0, 0xf0, 0x3f, // float64 at 16
                0, 0, 0, 0, // bool at 24, padding to 28
                0xfe, 0xff, 0xff, 0xff, // int32 at 28
            ]
        );
    }

    #[test]
    fn an_empty_sequence_takes_its_length_and_no_padding() {
        let mut cdr = Cdr::default();
        cdr.start();
        cdr.sequence::<f64>(&[], |cdr, value| cdr.f64(*value));
        cdr.f32(1.0);
        assert_eq!(cdr.bytes()[4..], [0, 0, 0, 0, 0, 0, 0x80, 0x3f]);
    }

    #[test]
    fn memory_is_reused_and_the_last_body_forgotten() {
        let mut cdr = Cdr::default();
        cdr.copy(&[7; 64]);
        cdr.start();
        cdr.u32(1);
        assert_eq!(cdr.bytes(), [0, 1, 0, 0, 1, 0, 0, 0]);
    }
}
