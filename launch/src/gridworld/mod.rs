//! The gridworlds on the command line: what users name, what is learned of people, the self-models, the studies.

pub mod inputs;
pub mod learn;
pub mod train_self;
