//! Which vectors the kernels compute with: the widest that the machine has, or others, to check that no result depends on
//! them.

use pulp::Arch;
use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicU8, Ordering};

/// Vectors that kernels can compute with. Every choice gives the same bits; the widest is the fastest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Vectors {
    /// The widest that the machine has.
    #[default]
    Widest,
    /// One number at a time, as on a machine that has none of the instructions that the kernels know.
    Single,
    /// Four numbers; emulated with wider ones.
    Lanes4,
    /// Eight numbers, as with AVX2; emulated where the machine has none.
    Lanes8,
    /// Sixteen numbers, as with AVX-512; emulated where the machine has none.
    Lanes16,
}

impl Vectors {
    /// All choices.
    pub const ALL: [Self; 5] = [
        Self::Widest,
        Self::Single,
        Self::Lanes4,
        Self::Lanes8,
        Self::Lanes16,
    ];
}

impl fmt::Display for Vectors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Widest => "widest",
            Self::Single => "1",
            Self::Lanes4 => "4",
            Self::Lanes8 => "8",
            Self::Lanes16 => "16",
        })
    }
}

impl FromStr for Vectors {
    type Err = String;

    /// From the number of lanes: `1`, `4`, `8`, `16`, or `widest`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "widest" => Ok(Self::Widest),
            "1" => Ok(Self::Single),
            "4" => Ok(Self::Lanes4),
            "8" => Ok(Self::Lanes8),
            "16" => Ok(Self::Lanes16),
            _ => Err("expected 1, 4, 8, 16 or widest".to_owned()),
        }
    }
}

static CHOSEN: AtomicU8 = AtomicU8::new(0);

/// Has every kernel of this process compute with these vectors from now on.
pub fn choose(vectors: Vectors) {
    CHOSEN.store(vectors as u8, Ordering::Relaxed);
}

/// The vectors that kernels compute with.
#[inline]
pub fn chosen() -> Vectors {
    Vectors::ALL[usize::from(CHOSEN.load(Ordering::Relaxed))]
}

/// Whether the machine has vectors of so many numbers that the kernels know.
pub fn has_lanes(lanes: usize) -> bool {
    match lanes {
        #[cfg(target_arch = "x86_64")]
        8 => pulp::x86::V3::try_new().is_some(),
        #[cfg(target_arch = "x86_64")]
        16 => pulp::x86::V4::try_new().is_some(),
        _ => false,
    }
}

/// The instructions to compile a loop for. Emulated vectors are made of the widest real ones.
#[inline]
pub(crate) fn arch(vectors: Vectors) -> Arch {
    match vectors {
        Vectors::Single => Arch::Scalar,
        #[cfg(target_arch = "x86_64")]
        Vectors::Lanes8 => pulp::x86::V3::try_new().map_or(Arch::Scalar, Arch::V3),
        _ => Arch::new(),
    }
}
