//! Convolution and transposed convolution of small images, batched over columns.
//!
//! An image is a column of channels · height · width numbers, channel after channel, row after row, as in PyTorch. A convolution
//! cuts the windows out of it (*unfold*), one column each, and applies one dense layer to all of them; what comes out is
//! a *feature map*: a column of channels for each window, window after window. A transposed convolution does the opposite:
//! it makes a window out of each place of a feature map, and windows are added into the image (*fold*). So both spend their
//! time in the matrix product.

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

    /// Calls `run(place in the image, place in the windows)` for every run of `kernel` numbers.
    #[inline(always)]
    fn runs(&self, mut run: impl FnMut(usize, usize)) {
        let (down, across) = self.grid();
        let mut to = 0;
        for y in 0..down {
            for x in 0..across {
                for channel in 0..self.channels {
                    for row in 0..self.kernel {
                        let y = channel * self.height + y * self.stride + row;
                        run(y * self.width + x * self.stride, to);
                        to += self.kernel;
                    }
                }
            }
        }
    }

    /// Windows of every image: image × batch → patch × (positions · batch).
    pub(crate) fn unfold(&self, first: bool, out: &mut [f32], images: &[f32]) {
        let length = self.kernel;
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
        let length = self.kernel;
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
    /// W (channels out × patch, a window's numbers channel after channel, row after row), b and f.
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

    /// Numbers of the feature map that comes out.
    pub fn output(&self) -> usize {
        self.channels * self.windows.positions()
    }

    /// The feature maps (output × batch) of x (image × batch), without a tape; `unfolded` is scratch.
    pub fn infer(&self, p: &Parameters, x: &Tensor, unfolded: &mut Tensor, out: &mut Tensor) {
        assert_eq!(x.rows(), self.windows.image(), "image of a convolution");
        let batch = x.cols();
        unfolded.resize_to(self.windows.patch(), self.windows.positions() * batch);
        self.windows.unfold(true, unfolded.data_mut(), x.data());
        self.layer.infer(p, unfolded, out);
        out.reshape_to(self.output(), batch);
    }
}

/// Transposed convolution: every place of a feature map makes a window of the image; windows are summed, b added.
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

    /// Numbers of the feature map that goes in.
    pub fn input(&self) -> usize {
        self.channels * self.windows.positions()
    }

    /// Channels of the feature map that goes in.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The images (image × batch) of x (input × batch), without a tape; `made` is scratch.
    pub fn infer(&self, p: &Parameters, x: &Tensor, made: &mut Tensor, out: &mut Tensor) {
        assert_eq!(
            x.rows(),
            self.input(),
            "feature map of a transposed convolution"
        );
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
        let plane = self.windows.height * self.windows.width;
        for (i, plane) in out.data_mut().chunks_exact_mut(plane).enumerate() {
            let b = bias[i % self.windows.channels];
            plane.iter_mut().for_each(|x| *x += b);
        }
    }
}
