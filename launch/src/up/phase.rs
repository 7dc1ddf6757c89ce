//! What a process of a run is doing.

/// What a process is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// It reads its models and makes its ports.
    Starting,
    /// It reads what its predecessor reads, and is silent.
    Standby,
    /// It does its part.
    Active,
    /// It has handed over, or is to end.
    Leaving,
}

impl Phase {
    /// What a running set says of it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "Starting",
            Self::Standby => "StandingBy",
            Self::Active => "Speaking",
            Self::Leaving => "Leaving",
        }
    }
}
