//! Writes and reads plain CDR (little endian), the body format of ROS 2 messages.

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

    /// Encapsulation header and body.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Numbers as they lie in memory, the first aligned to `align` and none of them to more.
    pub fn numbers(&mut self, little_endian: &[u8], align: usize) {
        let written = self.bytes.len() - ENCAPSULATION.len();
        let start = written.next_multiple_of(align);
        self.bytes.resize(start + ENCAPSULATION.len(), 0);
        self.bytes.extend_from_slice(little_endian);
    }

    fn number(&mut self, little_endian: &[u8]) {
        self.numbers(little_endian, little_endian.len());
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

/// A body being read.
#[derive(Clone, Copy, Debug)]
pub struct Read<'a> {
    body: &'a [u8],
    position: usize,
}

impl<'a> Read<'a> {
    /// Of a message with its encapsulation header; none if that is not [`ENCAPSULATION`].
    pub fn new(message: &'a [u8]) -> Option<Self> {
        let body = message.strip_prefix(ENCAPSULATION.as_slice())?;
        Some(Self { body, position: 0 })
    }

    /// Bytes of the body that have been read.
    pub fn position(&self) -> usize {
        self.position
    }

    /// Bytes of the body that have not.
    pub fn rest(&self) -> usize {
        self.body.len() - self.position
    }

    /// The next `size` bytes, the first aligned to `align`; none if the body is shorter.
    pub fn numbers(&mut self, size: usize, align: usize) -> Option<&'a [u8]> {
        let start = self.position.next_multiple_of(align);
        let bytes = self.body.get(start..start.checked_add(size)?)?;
        self.position = start + size;
        Some(bytes)
    }

    /// A `string`; none if there is none.
    pub fn string(&mut self) -> Option<&'a str> {
        let length = u32::from_le_bytes(self.numbers(4, 4)?.try_into().ok()?);
        let (end, text) = self.numbers(length as usize, 1)?.split_last()?;
        (*end == 0).then(|| str::from_utf8(text).ok())?
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
    fn what_was_written_is_read() {
        let mut cdr = Cdr::default();
        cdr.start();
        cdr.string("größer");
        cdr.f64(0.5);
        let mut read = Read::new(cdr.bytes()).expect("ours");
        assert_eq!(read.string(), Some("größer"));
        assert_eq!(read.numbers(8, 8), Some(&0.5_f64.to_le_bytes()[..]));
        assert_eq!((read.rest(), read.numbers(1, 1)), (0, None));
    }

    #[test]
    fn what_is_no_string_is_none() {
        let string = |body: &[u8]| Read::new(body).expect("ours").string().map(str::to_owned);
        assert_eq!(
            string(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]),
            Some("a".to_owned())
        );
        assert_eq!(
            string(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', b'b']),
            None,
            "no end"
        );
        assert_eq!(string(&[0, 1, 0, 0, 3, 0, 0, 0, b'a', 0]), None, "cut");
        assert_eq!(string(&[0, 1, 0, 0, 0, 0, 0, 0]), None, "not even an end");
        assert_eq!(string(&[0, 1, 0, 0, 2, 0, 0, 0, 0xff, 0]), None, "no UTF-8");
        assert!(Read::new(&[0, 0, 0, 0]).is_none(), "big endian");
    }

    #[test]
    fn memory_is_reused_and_the_last_body_forgotten() {
        let mut cdr = Cdr::default();
        cdr.start();
        cdr.numbers(&[7; 64], 1);
        cdr.start();
        cdr.u32(1);
        assert_eq!(cdr.bytes(), [0, 1, 0, 0, 1, 0, 0, 0]);
    }
}
