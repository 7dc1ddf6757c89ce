//! Owned f32 matrices: features × batch, column-major, contiguous, 64-byte aligned.

/// One cache line of numbers; a vector of these is 64-byte aligned.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; LANES]);

/// Numbers in a cache line.
pub(crate) const LANES: usize = 16;

/// Growable 64-byte-aligned memory for f32; never shrinks.
#[derive(Clone, Default)]
pub(crate) struct Buffer {
    lines: Vec<Line>,
}

impl Buffer {
    /// Makes room for at least `length` numbers; new memory is zero, old contents stay.
    pub(crate) fn reserve(&mut self, length: usize) {
        let lines = length.div_ceil(LANES);
        if lines > self.lines.len() {
            // Doubling keeps the copies while warming up proportional to the final size.
            let grown = if self.lines.is_empty() {
                lines
            } else {
                lines.max(2 * self.lines.len())
            };
            self.lines.reserve_exact(grown - self.lines.len());
            self.lines.resize(grown, Line([0.0; LANES]));
        }
    }

    /// Makes room for exactly `length` numbers if there is less.
    fn reserve_exact(&mut self, length: usize) {
        let lines = length.div_ceil(LANES);
        if lines > self.lines.len() {
            self.lines.reserve_exact(lines - self.lines.len());
            self.lines.resize(lines, Line([0.0; LANES]));
        }
    }

    pub(crate) fn slice(&self) -> &[f32] {
        // SAFETY: `Line` is `repr(C)` over `[f32; LANES]` without padding (64 bytes, aligned to 64), so the vector's
        // memory is `lines.len() * LANES` initialised f32.
        unsafe {
            std::slice::from_raw_parts(self.lines.as_ptr().cast::<f32>(), self.lines.len() * LANES)
        }
    }

    pub(crate) fn slice_mut(&mut self) -> &mut [f32] {
        // SAFETY: as in `slice`; the exclusive borrow of `self` makes the slice exclusive.
        unsafe {
            std::slice::from_raw_parts_mut(
                self.lines.as_mut_ptr().cast::<f32>(),
                self.lines.len() * LANES,
            )
        }
    }
}

/// A matrix of f32: rows (features) × cols (batch), column-major, contiguous, 64-byte aligned.
#[derive(Clone, Default)]
pub struct Tensor {
    buffer: Buffer,
    rows: usize,
    cols: usize,
}

impl Tensor {
    /// A rows × cols matrix of zeros.
    pub fn new(rows: usize, cols: usize) -> Self {
        let mut tensor = Self::default();
        tensor.resize_to(rows, cols);
        tensor
    }

    /// A rows × cols matrix from column-major numbers.
    ///
    /// # Panics
    /// If `data` does not hold rows · cols numbers.
    pub fn from_slice(rows: usize, cols: usize, data: &[f32]) -> Self {
        let mut tensor = Self::new(rows, cols);
        tensor.data_mut().copy_from_slice(data);
        tensor
    }

    /// Features.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Samples.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// All numbers, column after column.
    pub fn data(&self) -> &[f32] {
        &self.buffer.slice()[..self.rows * self.cols]
    }

    /// All numbers, column after column.
    pub fn data_mut(&mut self) -> &mut [f32] {
        let length = self.rows * self.cols;
        &mut self.buffer.slice_mut()[..length]
    }

    /// The features of sample `j`.
    pub fn column(&self, j: usize) -> &[f32] {
        &self.data()[j * self.rows..(j + 1) * self.rows]
    }

    /// The features of sample `j`.
    pub fn column_mut(&mut self, j: usize) -> &mut [f32] {
        let rows = self.rows;
        &mut self.data_mut()[j * rows..(j + 1) * rows]
    }

    /// Takes another shape; the contents are then unspecified. Memory is never given back, so that a tensor that goes
    /// back and forth between shapes allocates only the first time.
    pub fn resize_to(&mut self, rows: usize, cols: usize) {
        self.buffer.reserve_exact(rows * cols);
        self.rows = rows;
        self.cols = cols;
    }

    /// Takes another shape of as many numbers; the contents stay.
    ///
    /// # Panics
    /// If the number of elements differs.
    pub fn reshape_to(&mut self, rows: usize, cols: usize) {
        assert_eq!(
            self.rows * self.cols,
            rows * cols,
            "elements of a reshaped tensor"
        );
        self.rows = rows;
        self.cols = cols;
    }

    /// Sets every number to `value`.
    pub fn fill(&mut self, value: f32) {
        self.data_mut().fill(value);
    }

    /// Takes another tensor's shape and contents.
    pub fn copy_from(&mut self, other: &Tensor) {
        self.resize_to(other.rows, other.cols);
        self.data_mut().copy_from_slice(other.data());
    }
}

impl std::fmt::Debug for Tensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Tensor {}×{} {:?}", self.rows, self.cols, self.data())
    }
}

/// Equal shape and equal bytes (so that a NaN equals itself, and 0 differs from −0).
impl PartialEq for Tensor {
    fn eq(&self, other: &Self) -> bool {
        self.rows == other.rows
            && self.cols == other.cols
            && self
                .data()
                .iter()
                .zip(other.data())
                .all(|(a, b)| a.to_bits() == b.to_bits())
    }
}
