//! What a recording's file held before the run: kept until the new recording is whole.

use super::plan::RunPlan;
use files::{Aside, FileError};
use recorder::parts::part_path;
use recorder::read::run_of;

/// Contents of the files that the run's recording takes the place of.
#[derive(Default)]
pub struct Before(Vec<Aside>);

impl Before {
    /// Sets aside what is at the recording's path, and the further parts of a recording there.
    ///
    /// # Errors
    /// Names the file; nothing is lost.
    pub fn set_aside(plan: &RunPlan) -> Result<Self, FileError> {
        let Some(path) = &plan.record else {
            return Ok(Self::default());
        };
        let run = run_of(path);
        let others = (2..)
            .map(|part| part_path(path, part))
            .take_while(|part| run.is_some() && run_of(part) == run);
        let files: Vec<_> = std::iter::once(path.clone()).chain(others).collect();
        let asides = files
            .iter()
            .filter_map(|file| files::set_aside(file).transpose());
        Ok(Self(asides.collect::<Result<_, _>>()?))
    }

    /// After the run: removed if the new recording is whole. Else put back where nothing was written, or kept, which is
    /// then said: one line for each file.
    pub fn settle(self, is_whole: bool) -> Vec<String> {
        let settled = self.0.into_iter().filter_map(|aside| match is_whole {
            true => aside.remove().err().map(|error| error.to_string()),
            false if aside.restore() => None,
            false => Some(format!(
                "what {} held before is kept: {}",
                aside.path().display(),
                aside.kept().display()
            )),
        });
        settled.collect()
    }
}
