//! What the launcher tells a process about the run that it joins.

use crate::error::InstanceError;
use crate::{instance, private};
use rustix::fs::OFlags;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// How time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClockMode {
    /// Everybody waits for what step k needs: a run is a pure function of scene, models and seed.
    Lockstep,
    /// The world ticks at its own rate and takes the newest action.
    RealTime,
}

/// A process's place in a run. The launcher makes one with [`RunArguments::new`], derives each process's from it with
/// [`RunArguments::for_process`] and passes it as a file ([`RunArguments::write`]) or as text
/// ([`RunArguments::to_json`]).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunArguments {
    /// Name of the instance: letters, digits, `-` and `_`, at most 32.
    pub instance: String,
    /// Directory that holds all instances, normally [`instance::root_for`] its name.
    pub root: PathBuf,
    /// Identity of the run, in every message's header.
    pub run_id: u64,
    /// How time passes.
    pub clock: ClockMode,
    /// The process's name, such as `world`; at most 16 bytes.
    pub process: String,
    /// The process's place in launch order, which `Control::process` addresses.
    pub index: u32,
    /// Operating-system process id of the launcher, whose end is the process's end; 0 for none.
    pub launcher_pid: u32,
    /// How long a wait polls before it blocks, in µs; 0 blocks at once. Worth it only where cores outnumber processes.
    pub spin_us: u32,
    /// Reads and computes, but says nothing until the launcher has it take over.
    #[serde(default)]
    pub standby: bool,
    /// The process's own options, which only the process itself understands; see [`RunArguments::options`].
    #[serde(default)]
    pub options: serde_json::Value,
}

impl RunArguments {
    /// Arguments of a launcher's own node in `instance` below `root`.
    ///
    /// # Errors
    /// [`InstanceError::Name`] if the name cannot be one.
    pub fn new(
        root: &Path,
        instance: &str,
        run_id: u64,
        clock: ClockMode,
    ) -> Result<Self, InstanceError> {
        instance::check_name(instance)?;
        Ok(Self {
            instance: instance.to_owned(),
            root: root.to_owned(),
            run_id,
            clock,
            process: "launcher".to_owned(),
            index: u32::MAX,
            launcher_pid: 0,
            spin_us: 0,
            standby: false,
            options: serde_json::Value::Null,
        })
    }

    /// The same run, seen from the child process `process` of this process.
    pub fn for_process(&self, process: &str, index: u32) -> Self {
        Self {
            process: process.to_owned(),
            index,
            launcher_pid: std::process::id(),
            ..self.clone()
        }
    }

    /// The same arguments with a process's own options.
    ///
    /// # Errors
    /// [`InstanceError::Arguments`] if they are not what JSON can hold.
    pub fn with_options(self, options: &impl Serialize) -> Result<Self, InstanceError> {
        let options =
            serde_json::to_value(options).map_err(|source| self.options_error(&source))?;
        Ok(Self { options, ..self })
    }

    /// The process's own options; where the launcher gave none, those that an empty table stands for.
    ///
    /// # Errors
    /// [`InstanceError::Arguments`] naming the process and the key.
    pub fn options<T: serde::de::DeserializeOwned>(&self) -> Result<T, InstanceError> {
        let options = match &self.options {
            serde_json::Value::Null => serde_json::Value::Object(serde_json::Map::new()),
            given => given.clone(),
        };
        serde_json::from_value(options).map_err(|source| self.options_error(&source))
    }

    fn options_error(&self, source: &serde_json::Error) -> InstanceError {
        InstanceError::Arguments {
            origin: format!("options of process `{}`", self.process),
            reason: source.to_string(),
        }
    }

    /// Directory of this instance.
    pub fn directory(&self) -> PathBuf {
        instance::directory(&self.root, &self.instance)
    }

    /// One line of JSON.
    pub fn to_json(&self) -> String {
        // Strings, numbers and a path: serialising fails only for a path that is not UTF-8, which `new` lets nobody
        // use.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Reads what [`RunArguments::to_json`] wrote; `origin` names where the text came from, for the error.
    ///
    /// # Errors
    /// [`InstanceError::Arguments`] with the place in the text.
    pub fn from_json(text: &str, origin: &str) -> Result<Self, InstanceError> {
        let arguments: Self =
            serde_json::from_str(text).map_err(|source| InstanceError::Arguments {
                origin: origin.to_owned(),
                reason: source.to_string(),
            })?;
        instance::check_name(&arguments.instance)?;
        if arguments.process.is_empty() || arguments.process.len() > 16 {
            return Err(InstanceError::Arguments {
                origin: origin.to_owned(),
                reason: format!(
                    "process name {:?} is not 1 to 16 bytes long",
                    arguments.process
                ),
            });
        }
        Ok(arguments)
    }

    /// Writes the arguments to a file of this instance's directory and returns its path.
    ///
    /// # Errors
    /// [`InstanceError::Io`] naming the file.
    pub fn write(&self) -> Result<PathBuf, InstanceError> {
        let directory = self.directory();
        let name = format!("{}.{}.json", self.process, self.index);
        let path = directory.join(&name);
        let io = |source| InstanceError::Io {
            path: path.clone(),
            source,
        };
        private::create(&self.root)?;
        let held = private::create(&directory)?;
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::TRUNC;
        let made = private::file(&held, &name, &path, flags)?;
        made.ok_or(std::io::ErrorKind::NotFound.into())
            .and_then(|mut file| file.write_all(self.to_json().as_bytes()))
            .map_err(io)?;
        Ok(path)
    }

    /// Reads a file that [`RunArguments::write`] wrote.
    ///
    /// # Errors
    /// [`InstanceError::Io`] or [`InstanceError::Arguments`], naming the file.
    pub fn read(path: &Path) -> Result<Self, InstanceError> {
        let text = std::fs::read_to_string(path).map_err(|source| InstanceError::Io {
            path: path.to_owned(),
            source,
        })?;
        Self::from_json(&text, &path.display().to_string())
    }
}
