//! Convolution and transposed convolution of small images, batched over columns.
//!
//! An image is a column of height · width · channels numbers, channels nearest: pixel (y, x) of channel c lies at
//! (y · width + x) · channels + c. A convolution cuts the windows out of it (*unfold*), one column each, and applies one dense
//! layer to all of them; what comes out, one column of channels per window, already is the next image. A
//! transposed convolution does the opposite: a dense layer makes a window out of each pixel, and windows are added into
//! place (*fold*). So both spend their time in the matrix product.

use crate::layers::uniform;
use crate::{Activation, Dense, ParamId, Parameters, Tensor, product};
use rand_chacha::ChaCha8Rng;

/// Square windows over an image, without padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// Pixels from top to bottom.
    pub height: usize,
    /// Pixels from left to right.
    pub width: usize,
    /// Numbers per pixel.
    pub channels: usize,
    /// Pixels along a side of the window.
    pub kernel: usize,
    /// Pixels from one window to the next.
    pub stride: usize,
}

impl Windows {
    /// Windows from top to bottom, and from left to right.
    ///
    /// # Panics
    /// If kernel or stride is 0, or the kernel is larger than the image.
    pub fn grid(&self) -> (usize, usize) {
        assert!(self.kernel > 0 && self.stride > 0, "empty windows");
        assert!(
            self.kernel <= self.height && self.kernel <= self.width,
            "windows larger than the image"
        );
        let along = |side: usize| (side - self.kernel) / self.stride + 1;
        (along(self.height), along(self.width))
    }

    /// Windows in all.
    pub fn positions(&self) -> usize {
        let (down, across) = self.grid();
        down * across
    }

    /// Numbers of a window.
    pub fn patch(&self) -> usize {
        self.kernel * self.kernel * self.channels
    }

    /// Numbers of an image.
    pub fn image(&self) -> usize {
        self.height * self.width * self.channels
    }

    /// Calls `run(place in the image, place in the windows)` for every run of kernel · channels numbers.
    #[inline(always)]
    fn runs(&self, mut run: impl FnMut(usize, usize)) {
        let (down, across) = self.grid();
        let length = self.kernel * self.channels;
        let mut to = 0;
        for y in 0..down {
            for x in 0..across {
                for row in 0..self.kernel {
                    let from = (y * self.stride + row) * self.width + x * self.stride;
                    run(from * self.channels, to);
                    to += length;
                }
            }
        }
    }

    /// Windows of every image: image × batch → patch × (positions · batch).
    pub(crate) fn unfold(&self, first: bool, out: &mut [f32], images: &[f32]) {
        let length = self.kernel * self.channels;
        let windows = self.patch() * self.positions();
        let pairs = out
            .chunks_exact_mut(windows)
            .zip(images.chunks_exact(self.image()));
        for (out, image) in pairs {
            self.runs(|from, to| {
                let (out, image) = (&mut out[to..to + length], &image[from..from + length]);
                if first {
                    out.copy_from_slice(image);
                } else {
                    out.iter_mut().zip(image).for_each(|(o, i)| *o += i);
                }
            });
        }
    }

    /// Sum of windows in their places: patch × (positions · batch) → image × batch.
    pub(crate) fn fold(&self, first: bool, out: &mut [f32], windows: &[f32]) {
        if first {
            out.fill(0.0);
        }
        let length = self.kernel * self.channels;
        let size = self.patch() * self.positions();
        let pairs = out
            .chunks_exact_mut(self.image())
            .zip(windows.chunks_exact(size));
        for (image, windows) in pairs {
            self.runs(|to, from| {
                let windows = &windows[from..from + length];
                let image = &mut image[to..to + length];
                image.iter_mut().zip(windows).for_each(|(i, w)| *i += w);
            });
        }
    }
}

/// y = f(W ∗ x + b).
#[derive(Clone, Copy, Debug)]
pub struct Conv {
    /// Windows of the input image.
    pub windows: Windows,
    /// W (channels out × patch, a window's rows from top to bottom, its pixels from left to right, channels nearest), b and f.
    pub layer: Dense,
    channels: usize,
}

impl Conv {
    /// A layer with parameters `prefix.weight` and `prefix.bias`, both from U(±1/√patch).
    pub fn new(
        parameters: &mut Parameters,
        prefix: &str,
        windows: Windows,
        channels: usize,
        activation: Activation,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let layer = Dense::new(
            parameters,
            prefix,
            windows.patch(),
            channels,
            activation,
            rng,
        );
        Self {
            windows,
            layer,
            channels,
        }
    }

    /// Numbers of the image that comes out.
    pub fn output(&self) -> usize {
        self.channels * self.windows.positions()
    }

    /// The convolved images (output × batch) of x (image × batch), without a tape; `unfolded` is scratch.
    pub fn infer(&self, p: &Parameters, x: &Tensor, unfolded: &mut Tensor, out: &mut Tensor) {
        assert_eq!(x.rows(), self.windows.image(), "image of a convolution");
        let batch = x.cols();
        unfolded.resize_to(self.windows.patch(), self.windows.positions() * batch);
        self.windows.unfold(true, unfolded.data_mut(), x.data());
        self.layer.infer(p, unfolded, out);
        out.reshape_to(self.output(), batch);
    }
}

/// Transposed convolution: every pixel of the input makes a window of the output; windows are summed, b added.
#[derive(Clone, Copy, Debug)]
pub struct Deconv {
    /// Windows of the output image.
    pub windows: Windows,
    /// W, patch × channels in, a window's numbers in the order of [`Conv`]'s.
    pub weight: ParamId,
    /// b, channels out × 1.
    pub bias: ParamId,
    channels: usize,
}

impl Deconv {
    /// A layer with parameters `prefix.weight` and `prefix.bias`, both from U(±1/√patch), as PyTorch starts them; `channels`
    /// come in.
    pub fn new(
        parameters: &mut Parameters,
        prefix: &str,
        windows: Windows,
        channels: usize,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let patch = windows.patch();
        let weight = uniform(patch, channels, patch, rng);
        let bias = uniform(windows.channels, 1, patch, rng);
        Self {
            windows,
            weight: parameters.add(format!("{prefix}.weight"), weight),
            bias: parameters.add(format!("{prefix}.bias"), bias),
            channels,
        }
    }

    /// Numbers of the image that goes in.
    pub fn input(&self) -> usize {
        self.channels * self.windows.positions()
    }

    /// Channels of the image that goes in.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The images (image × batch) of x (input × batch), without a tape; `made` is scratch.
    pub fn infer(&self, p: &Parameters, x: &Tensor, made: &mut Tensor, out: &mut Tensor) {
        assert_eq!(x.rows(), self.input(), "image of a transposed convolution");
        let (batch, patch) = (x.cols(), self.windows.patch());
        let pixels = self.windows.positions() * batch;
        made.resize_to(patch, pixels);
        let weight = p.get(self.weight).data();
        product::weight_times(
            true,
            made.data_mut(),
            weight,
            x.data(),
            patch,
            self.channels,
            pixels,
        );
        out.resize_to(self.windows.image(), batch);
        self.windows.fold(true, out.data_mut(), made.data());
        let bias = p.get(self.bias).data();
        for pixel in out.data_mut().chunks_exact_mut(self.windows.channels) {
            pixel.iter_mut().zip(bias).for_each(|(x, b)| *x += b);
        }
    }
}
