//! Reverse-mode differentiation in f32, made for batches of small networks.
//!
//! Every matrix is features × batch, column-major and contiguous: one column is one sample.
//! Products go through a kernel of our own whose result for a column does not depend on the batch around it. Inference
//! ([`Mlp::infer`], [`Gru::infer`]) needs no tape. Learning records operations on a [`Tape`], whose memory (an [`Arena`]) is
//! reused from step to step, and reads gradients from [`Gradients`]. Everything inside is sequential and
//! deterministic; callers run shards of a batch in parallel, each with its own arena and gradients, and add those
//! in a fixed order.

mod adam;
pub mod checkpoint;
mod gru;
mod image;
mod in_place;
mod kernels;
mod layers;
mod math;
pub mod noise;
mod parameters;
mod product;
mod tape;
mod tensor;
pub mod vectors;

pub use adam::Adam;
pub use gru::{Gru, GruScratch};
pub use image::{Conv, Deconv, Windows};
pub use in_place::{log_softmax_in_place, sigmoid_in_place, softplus_in_place};
pub use layers::{Activation, Dense, Mlp, MlpScratch, SMALLEST_DEVIATION};
pub use parameters::{Gradients, ParamId, Parameters};
pub use tape::{Arena, Tape, Var};
pub use tensor::Tensor;
