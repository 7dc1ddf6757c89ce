//! The paper's studies with simulated people, without processes: many episodes at once, one per core.

pub mod drive;
pub mod implants;
pub mod statistics;
pub mod table;
