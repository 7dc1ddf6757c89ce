//! What every process does around its work: it joins the run, and tells the launcher how it ended.

use crate::arguments::RunArguments;
use crate::error::NodeError;
use crate::node::Node;
use core::fmt::Display;

/// Joins the run, does `work` until the run ends, and tells the launcher that it ended well, or why it did not. An
/// error's alternate form (`{:#}`), which names its causes, is what the launcher hears.
///
/// # Errors
/// When the run cannot be joined; what `work` gives; or, after work that ended well, when the launcher cannot be told.
pub fn run_process<E: From<NodeError> + Display>(
    arguments: &RunArguments,
    work: impl FnOnce(&mut Node) -> Result<(), E>,
) -> Result<(), E> {
    let mut node = Node::join(arguments)?;
    let result = work(&mut node);
    let told = match &result {
        Ok(()) => node.finish(),
        Err(error) => node.fail(&format!("{error:#}")),
    };
    // Why the process failed matters more than that the launcher could not be told.
    result.and(told.map_err(|error| NodeError::from(error).into()))
}
