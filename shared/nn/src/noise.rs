//! Standard normal numbers in bulk: ChaCha8 and Box–Muller with vectorised logarithm, sine and cosine.
//!
//! The number at a place depends only on (seed, stream, place): a longer fill begins with a shorter one's bytes.

use crate::kernels::vectorised;
use crate::math::{larger, ln, sin_cos_turns};
use pulp::{Simd, WithSimd};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Numbers made at a time: half from cosines, half from sines.
const BLOCK: usize = 256;
const HALF: usize = BLOCK / 2;

/// Fills `out` with independent standard normal numbers, determined by the seed and the stream.
pub fn fill(out: &mut [f32], seed: u64, stream: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    let mut bytes = [0_u8; 4 * BLOCK];
    for chunk in out.chunks_mut(BLOCK) {
        rng.fill_bytes(&mut bytes);
        if let Ok(whole) = <&mut [f32; BLOCK]>::try_from(&mut *chunk) {
            vectorised(BoxMuller(&bytes, whole));
        } else {
            let mut block = [0.0; BLOCK];
            vectorised(BoxMuller(&bytes, &mut block));
            chunk.copy_from_slice(&block[..chunk.len()]);
        }
    }
}

/// One seed out of several numbers (splitmix64), so that every step's noise is its own.
pub fn mix(numbers: &[u64]) -> u64 {
    numbers.iter().fold(0x6d69_7272_6f72, |state, number| {
        let mut x = (state ^ number).wrapping_add(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    })
}

/// √(−2 ln u₁) (cos 2πu₂, sin 2πu₂), from the words of a block: the first half gives u₁, the second u₂.
struct BoxMuller<'a>(&'a [u8; 4 * BLOCK], &'a mut [f32; BLOCK]);

impl WithSimd for BoxMuller<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self(bytes, out) = self;
        let mut words = [0_u32; BLOCK];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks::<4>().0) {
            *word = u32::from_le_bytes(*bytes);
        }
        const UNIT: f32 = 1.0 / 4_294_967_296.0; // 2⁻³²
        let (cosines, sines) = out.split_at_mut(HALF);
        for i in 0..HALF {
            // In (0, 1]: all 32 bits, so that the tail reaches 6.7 standard deviations.
            let u = (words[i] as f32).mul_add(UNIT, 0.5 * UNIT);
            // 24 bits, exactly representable.
            let turns = (words[HALF + i] >> 8) as f32 * (256.0 * UNIT);
            let radius = larger(0.0, -2.0 * ln(u)).sqrt();
            let (sine, cosine) = sin_cos_turns(turns);
            cosines[i] = radius * cosine;
            sines[i] = radius * sine;
        }
    }
}
