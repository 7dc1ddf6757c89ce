//! How a command ends when it cannot do what it was asked to.

/// An error and the exit status that goes with it.
#[derive(Debug)]
pub struct Failure {
    /// 2: what was asked for cannot be used, nothing was started. 1: something went wrong later.
    pub status: u8,
    /// What to tell the user.
    pub error: anyhow::Error,
}

impl Failure {
    /// What was asked for cannot be used.
    pub fn refused(error: impl Into<anyhow::Error>) -> Self {
        Self {
            status: 2,
            error: error.into(),
        }
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self { status: 1, error }
    }
}

impl From<runtime::NodeError> for Failure {
    fn from(error: runtime::NodeError) -> Self {
        Self {
            status: 1,
            error: error.into(),
        }
    }
}
