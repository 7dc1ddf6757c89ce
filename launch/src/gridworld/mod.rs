//! The gridworlds on the command line: what users name, what is learned of people, the self-models, the studies.

pub mod evaluate;
pub mod train_self;
