//! The worlds that people and robots act in: state, reward, sensing and simulated people.
//!
//! A pure library: it knows nothing of processes or messages. [`highway`] is the continuous driving domain;
//! [`commonroad`] turns recorded traffic into a road and cars for it.

pub mod commonroad;
pub mod highway;
