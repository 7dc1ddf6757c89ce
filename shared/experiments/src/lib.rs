//! The paper's studies with simulated people, without processes: many episodes at once, one per core.

pub mod anova;
pub mod claims;
mod drawing_file;
pub mod drive;
pub mod drive_report;
pub mod foresight;
pub mod gridworld;
pub mod implants;
pub mod oracle;
pub mod plot;
pub mod real;
pub mod results;
pub mod statistics;
pub mod table;
pub mod unaided;
