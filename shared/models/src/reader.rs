//! The networks that read masked observations (paper, appendix, "Search and Rescue"): a convolution and dense layers over the
//! image, one dense layer over the words, side by side. Without an image, observations are read as they are.

use crate::sizes::Sizes;
use crate::view::View;
use nn::{Activation, Conv, Dense, Mlp, MlpScratch, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;

/// Reads encoded observations, as [`View`] writes them.
#[derive(Clone, Debug)]
pub struct Reader {
    image: Option<ImageReader>,
    rows: usize,
}

#[derive(Clone, Debug)]
struct ImageReader {
    /// Over the masked image.
    conv: Conv,
    /// `[feature map; other visual numbers; mask] → features`.
    look: Mlp,
    /// `[words; mask] → features`.
    listen: Dense,
    /// Rows of the image.
    pixels: usize,
    /// Rows of the visual modality and its mask.
    seen: usize,
    rows: usize,
}

/// One caller's memory.
#[derive(Clone, Debug, Default)]
pub struct ReaderScratch {
    mlp: MlpScratch,
    image: Tensor,
    others: Tensor,
    words: Tensor,
    unfolded: Tensor,
    map: Tensor,
    looked: Tensor,
    listened: Tensor,
}

impl Reader {
    /// A reader with parameters `conv`, `look` and `listen`, where there is an image.
    pub fn new(sizes: &Sizes, view: &View, p: &mut Parameters, rng: &mut ChaCha8Rng) -> Self {
        let shape = sizes.shape;
        let image = sizes.image.map(|image| {
            let pixels = sizes.image_numbers();
            let elu = Activation::Elu;
            let conv = Conv::new(p, "conv", image.windows(), image.channels, elu, rng);
            let others = shape.visual - pixels + shape.visual_mask;
            let (hidden, features) = (image.hidden, image.features);
            let widths = [conv.output() + others, hidden, hidden, features];
            let look = Mlp::new(p, "look", &widths, elu, rng);
            let words = shape.verbal + shape.verbal_mask;
            ImageReader {
                conv,
                look,
                listen: Dense::new(p, "listen", words, features, elu, rng),
                pixels,
                seen: pixels + others,
                rows: 2 * features,
            }
        });
        Self {
            rows: image.as_ref().map_or(view.rows(), |image| image.rows),
            image,
        }
    }

    /// Numbers that an observation is read to.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Features of encoded observations (`view rows × batch`) on a tape.
    pub fn on_tape(&self, tape: &mut Tape, observed: Var) -> Var {
        let Some(image) = &self.image else {
            return observed;
        };
        let rows = tape.shape(observed).0;
        let pixels = tape.rows(observed, 0..image.pixels);
        let others = tape.rows(observed, image.pixels..image.seen);
        let words = tape.rows(observed, image.seen..rows);
        let map = tape.conv(&image.conv, pixels);
        let both = tape.concat(&[map, others]);
        let looked = tape.mlp(&image.look, both);
        let listened = tape.dense(&image.listen, words);
        tape.concat(&[looked, listened])
    }

    /// Hands the features, as one or two blocks of rows, to `next`.
    pub(crate) fn infer<R>(
        &self,
        p: &Parameters,
        s: &mut ReaderScratch,
        observed: &Tensor,
        next: impl FnOnce(&[&Tensor]) -> R,
    ) -> R {
        let Some(image) = &self.image else {
            return next(&[observed]);
        };
        copy_rows(observed, 0, image.pixels, &mut s.image);
        copy_rows(observed, image.pixels, image.seen, &mut s.others);
        copy_rows(observed, image.seen, observed.rows(), &mut s.words);
        image.conv.infer(p, &s.image, &mut s.unfolded, &mut s.map);
        let blocks = [&s.map, &s.others];
        image
            .look
            .infer_stacked(p, &blocks, &mut s.mlp, &mut s.looked);
        image.listen.infer(p, &s.words, &mut s.listened);
        next(&[&s.looked, &s.listened])
    }
}

/// `out` ← rows from..to of `x`.
pub(crate) fn copy_rows(x: &Tensor, from: usize, to: usize, out: &mut Tensor) {
    out.resize_to(to - from, x.cols());
    for j in 0..x.cols() {
        out.column_mut(j).copy_from_slice(&x.column(j)[from..to]);
    }
}
