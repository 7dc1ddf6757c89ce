//! A launcher's hold on an instance.

use crate::cleanup::{nodes, remove_everything};
use crate::error::InstanceError;
use crate::held::{launcher, try_lock};
use crate::paths::{check_name, config, directory, prefix};
use crate::roots::{lookup_roots, root_for};
use crate::{orphans, private};
use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long a start waits for somebody who just cleans up.
const CLEANING: Duration = Duration::from_secs(5);

/// A launcher's hold on an instance; released when dropped, or by the kernel when the launcher ends in any way.
#[derive(Debug)]
pub struct InstanceLock {
    root: PathBuf,
    instance: String,
    _file: File,
}

impl InstanceLock {
    /// Takes an instance where [`root_for`] puts it, unless one of that name runs in another of this user's roots.
    ///
    /// # Errors
    /// As [`InstanceLock::acquire`].
    pub fn take(instance: &str) -> Result<Self, InstanceError> {
        check_name(instance)?;
        let root = root_for(instance);
        for other in lookup_roots().iter().filter(|other| **other != root) {
            if let Some(pid) = launcher(other, instance) {
                let instance = instance.to_owned();
                return Err(InstanceError::InUse { instance, pid });
            }
        }
        Self::acquire(&root, instance)
    }

    /// Takes the instance, and removes what an earlier run of it left: processes that outlived their launcher get a
    /// second to end and are then killed.
    ///
    /// # Errors
    /// [`InstanceError::InUse`] while another launcher lives, [`InstanceError::Untrusted`] where others could reach into
    /// it.
    pub fn acquire(root: &Path, instance: &str) -> Result<Self, InstanceError> {
        check_name(instance)?;
        config(root, instance)?;
        let end = Instant::now() + CLEANING;
        let mut file = loop {
            match try_lock(root, instance)? {
                Ok(file) => break file,
                // Who holds it without a word is removing what a dead run left.
                Err(0) if Instant::now() < end => std::thread::sleep(Duration::from_millis(5)),
                Err(pid) => {
                    let instance = instance.to_owned();
                    return Err(InstanceError::InUse { instance, pid });
                }
            }
        };
        let written = file
            .rewind()
            .and_then(|()| writeln!(file, "{}", std::process::id()));
        written.map_err(|source| InstanceError::Io {
            path: root.join(format!("{instance}.lock")),
            source,
        })?;
        orphans::end(root, instance)?;
        remove_everything(root, instance)?;
        private::check_shared(&prefix(root, instance))?;
        private::create(&directory(root, instance))?;
        Ok(Self {
            root: root.to_owned(),
            instance: instance.to_owned(),
            _file: file,
        })
    }

    /// The root.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The instance.
    pub fn instance(&self) -> &str {
        &self.instance
    }
}

impl Drop for InstanceLock {
    fn drop(&mut self) {
        // With processes still alive in it, the next `acquire` or `cleanup_dead` finishes the work.
        if let Ok(nodes) = nodes(&self.root, &self.instance)
            && !nodes
                .iter()
                .any(|node| node.alive && node.pid != std::process::id())
        {
            let _ = remove_everything(&self.root, &self.instance);
        }
    }
}
