//! Checkpoints as safetensors files, readable from Python: parameters, further tensors and metadata.
//!
//! Matrices are stored row by row with shape [rows, cols], as PyTorch's `Linear.weight` has them (outputs × inputs);
//! further tensors are flat. The same contents always give the same bytes.

use crate::{Parameters, Tensor};
use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Version of the layout, in the metadata under [`VERSION_KEY`].
pub const VERSION: &str = "1";
/// Metadata key of the layout's version.
pub const VERSION_KEY: &str = "mirror.checkpoint";

/// Why a checkpoint could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] files::FileError),
    /// The file could not be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a safetensors file, or cut short.
    #[error("{file}: not a whole safetensors file: {reason}")]
    Malformed {
        /// The file.
        file: String,
        /// What the reader found.
        reason: String,
    },
    /// Written by another version of this program, or not by it.
    #[error("{file}: checkpoint version {found}, this program reads version {VERSION}")]
    Version {
        /// The file.
        file: String,
        /// The version found, or "none".
        found: String,
    },
    /// A tensor is not there.
    #[error("{file}: no tensor \"{name}\"")]
    Missing {
        /// The file.
        file: String,
        /// The tensor sought.
        name: String,
    },
    /// A tensor has another shape or type of number.
    #[error("{file}: tensor \"{name}\" is {found}, expected {expected}")]
    Mismatch {
        /// The file.
        file: String,
        /// The tensor.
        name: String,
        /// What was expected.
        expected: String,
        /// What is there.
        found: String,
    },
    /// Metadata is not there.
    #[error("{file}: no metadata \"{key}\"")]
    MissingMetadata {
        /// The file.
        file: String,
        /// The key sought.
        key: String,
    },
    /// Two tensors of one name were to be saved.
    #[error("tensor \"{name}\" given twice")]
    Duplicate {
        /// The name.
        name: String,
    },
}

/// A flat tensor to be saved beside the parameters.
#[derive(Clone, Copy, Debug)]
pub enum Extra<'a> {
    /// 32-bit floating point.
    F32(&'a [f32]),
    /// 64-bit unsigned integers: counters, random states.
    U64(&'a [u64]),
    /// Bytes.
    U8(&'a [u8]),
}

/// The bytes of a checkpoint. Parameters are named `prefix.name`, or `name` under the empty prefix.
///
/// # Errors
/// If two tensors have the same name.
pub fn to_bytes(
    parameters: &[(&str, &Parameters)],
    extras: &[(&str, Extra)],
    metadata: &BTreeMap<String, String>,
) -> Result<Vec<u8>, CheckpointError> {
    let mut entries: BTreeMap<String, (&str, Vec<usize>, Vec<u8>)> = BTreeMap::new();
    let mut add = |name: String, kind, shape, bytes| {
        if entries.contains_key(&name) {
            return Err(CheckpointError::Duplicate { name });
        }
        entries.insert(name, (kind, shape, bytes));
        Ok(())
    };
    for (prefix, parameters) in parameters {
        for (_, name, tensor) in parameters.iter() {
            let mut bytes = Vec::with_capacity(4 * tensor.data().len());
            for i in 0..tensor.rows() {
                for j in 0..tensor.cols() {
                    bytes.extend_from_slice(&tensor.column(j)[i].to_le_bytes());
                }
            }
            let shape = vec![tensor.rows(), tensor.cols()];
            add(full_name(prefix, name), "F32", shape, bytes)?;
        }
    }
    for (name, extra) in extras {
        let (kind, length, bytes) = match extra {
            Extra::F32(x) => (
                "F32",
                x.len(),
                x.iter().flat_map(|v| v.to_le_bytes()).collect(),
            ),
            Extra::U64(x) => (
                "U64",
                x.len(),
                x.iter().flat_map(|v| v.to_le_bytes()).collect(),
            ),
            Extra::U8(x) => ("U8", x.len(), x.to_vec()),
        };
        add((*name).to_string(), kind, vec![length], bytes)?;
    }
    // The format wants wide numbers first, so that everything is aligned.
    let mut order: Vec<_> = entries.iter().collect();
    order.sort_by_key(|(name, (kind, _, _))| {
        let width = match *kind {
            "U64" => 0,
            "F32" => 1,
            _ => 2,
        };
        (width, name.as_str())
    });
    let mut header = serde_json::Map::new();
    let mut about = metadata.clone();
    about.insert(VERSION_KEY.into(), VERSION.into());
    header.insert("__metadata__".into(), serde_json::json!(about));
    let mut offset = 0;
    for (name, (kind, shape, bytes)) in &order {
        let end = offset + bytes.len();
        header.insert(
            (*name).clone(),
            serde_json::json!({"dtype": kind, "shape": shape, "data_offsets": [offset, end]}),
        );
        offset = end;
    }
    let mut text = serde_json::Value::Object(header).to_string();
    while !text.len().is_multiple_of(8) {
        text.push(' ');
    }
    let mut out = Vec::with_capacity(8 + text.len() + offset);
    out.extend_from_slice(&(text.len() as u64).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
    for (_, (_, _, bytes)) in order {
        out.extend_from_slice(bytes);
    }
    Ok(out)
}

/// Writes a checkpoint so that `path` holds either what it held before or all of the new contents: see
/// [`files::write`].
///
/// # Errors
/// If the folder cannot be written, or two tensors have the same name.
pub fn save(
    path: &Path,
    parameters: &[(&str, &Parameters)],
    extras: &[(&str, Extra)],
    metadata: &BTreeMap<String, String>,
) -> Result<(), CheckpointError> {
    let bytes = to_bytes(parameters, extras, metadata)?;
    Ok(files::write(path, &bytes)?)
}

/// A tensor as it stood in a checkpoint.
#[derive(Clone, Debug)]
struct Stored {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Stored {
    fn describe(&self) -> String {
        format!("{} {:?}", self.kind, self.shape)
    }
}

/// A checkpoint's contents.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    file: String,
    tensors: BTreeMap<String, Stored>,
    metadata: BTreeMap<String, String>,
}

/// Reads a checkpoint file.
///
/// # Errors
/// If the file is missing, cut short, not safetensors, or of another version.
pub fn load(path: &Path) -> Result<Checkpoint, CheckpointError> {
    let bytes = std::fs::read(path).map_err(|source| CheckpointError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    Checkpoint::from_bytes(&path.display().to_string(), &bytes)
}

impl Checkpoint {
    /// Reads a checkpoint from memory; `file` names it in errors.
    ///
    /// # Errors
    /// If the bytes are not a whole safetensors file of this version.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let malformed = |reason: String| CheckpointError::Malformed {
            file: file.to_string(),
            reason,
        };
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|error| malformed(error.to_string()))?;
        let metadata: BTreeMap<String, String> = header
            .metadata()
            .clone()
            .unwrap_or_default()
            .into_iter()
            .collect();
        let found = metadata.get(VERSION_KEY).map_or("none", String::as_str);
        if found != VERSION {
            return Err(CheckpointError::Version {
                file: file.to_string(),
                found: found.to_string(),
            });
        }
        let read = SafeTensors::deserialize(bytes).map_err(|error| malformed(error.to_string()))?;
        let tensors = read
            .iter()
            .map(|(name, view)| {
                let stored = Stored {
                    kind: view.dtype(),
                    shape: view.shape().to_vec(),
                    bytes: view.data().to_vec(),
                };
                (name.to_string(), stored)
            })
            .collect();
        Ok(Self {
            file: file.to_string(),
            tensors,
            metadata,
        })
    }

    /// The name given for errors: the file's path.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// All metadata.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// One metadata value.
    ///
    /// # Errors
    /// If it is not there.
    pub fn metadata_value(&self, key: &str) -> Result<&str, CheckpointError> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or_else(|| CheckpointError::MissingMetadata {
                file: self.file.clone(),
                key: key.to_string(),
            })
    }

    fn stored(&self, name: &str) -> Result<&Stored, CheckpointError> {
        self.tensors
            .get(name)
            .ok_or_else(|| CheckpointError::Missing {
                file: self.file.clone(),
                name: name.to_string(),
            })
    }

    fn mismatch(&self, name: &str, expected: String, stored: &Stored) -> CheckpointError {
        CheckpointError::Mismatch {
            file: self.file.clone(),
            name: name.to_string(),
            expected,
            found: stored.describe(),
        }
    }

    /// Reads every parameter, stored under `prefix`; all or none are changed. A column may also be stored flat.
    ///
    /// # Errors
    /// If one is missing, or of another shape or type.
    pub fn read(&self, prefix: &str, parameters: &mut Parameters) -> Result<(), CheckpointError> {
        for (_, name, tensor) in parameters.iter() {
            let name = full_name(prefix, name);
            let stored = self.stored(&name)?;
            let shape = [tensor.rows(), tensor.cols()];
            let flat = tensor.cols() == 1 && stored.shape == [tensor.rows()];
            if stored.kind != Dtype::F32 || !(stored.shape == shape || flat) {
                return Err(self.mismatch(&name, format!("F32 {shape:?}"), stored));
            }
        }
        for id in parameters.ids() {
            let name = full_name(prefix, parameters.name(id));
            let stored = self.stored(&name)?;
            transpose_from(&stored.bytes, parameters.get_mut(id));
        }
        Ok(())
    }

    /// A tensor of two dimensions as a matrix, one of one dimension as a column.
    ///
    /// # Errors
    /// If it is missing, or of another type or number of dimensions.
    pub fn tensor(&self, name: &str) -> Result<Tensor, CheckpointError> {
        let stored = self.stored(name)?;
        let (rows, cols) = match (stored.kind, stored.shape.as_slice()) {
            (Dtype::F32, [rows]) => (*rows, 1),
            (Dtype::F32, [rows, cols]) => (*rows, *cols),
            _ => return Err(self.mismatch(name, "F32 of one or two dimensions".into(), stored)),
        };
        let mut tensor = Tensor::new(rows, cols);
        transpose_from(&stored.bytes, &mut tensor);
        Ok(tensor)
    }

    fn flat(&self, name: &str, kind: Dtype) -> Result<&Stored, CheckpointError> {
        let stored = self.stored(name)?;
        if stored.kind != kind || stored.shape.len() != 1 {
            return Err(self.mismatch(name, format!("{kind} of one dimension"), stored));
        }
        Ok(stored)
    }

    /// A flat f32 tensor of any length.
    ///
    /// # Errors
    /// If it is missing or not flat f32.
    pub fn f32s(&self, name: &str) -> Result<Vec<f32>, CheckpointError> {
        let stored = self.flat(name, Dtype::F32)?;
        Ok(numbers(&stored.bytes, f32::from_le_bytes).collect())
    }

    /// A flat u64 tensor of a given length.
    ///
    /// # Errors
    /// If it is missing, not u64, or of another length.
    pub fn u64s(&self, name: &str, length: usize) -> Result<Vec<u64>, CheckpointError> {
        let stored = self.flat(name, Dtype::U64)?;
        if stored.shape != [length] {
            return Err(self.mismatch(name, format!("U64 [{length}]"), stored));
        }
        Ok(numbers(&stored.bytes, u64::from_le_bytes).collect())
    }

    /// A flat tensor of bytes of any length.
    ///
    /// # Errors
    /// If it is missing or not bytes.
    pub fn u8s(&self, name: &str) -> Result<&[u8], CheckpointError> {
        Ok(&self.flat(name, Dtype::U8)?.bytes)
    }
}

fn full_name(prefix: &str, name: &str) -> String {
    if prefix.is_empty() {
        name.to_string()
    } else {
        format!("{prefix}.{name}")
    }
}

/// Little-endian numbers of W bytes each.
fn numbers<const W: usize, T>(
    bytes: &[u8],
    read: impl Fn([u8; W]) -> T,
) -> impl Iterator<Item = T> {
    bytes.as_chunks::<W>().0.iter().map(move |b| read(*b))
}

/// Row by row to column by column.
fn transpose_from(bytes: &[u8], tensor: &mut Tensor) {
    let (rows, cols) = (tensor.rows(), tensor.cols());
    let data = tensor.data_mut();
    for (at, value) in numbers(bytes, f32::from_le_bytes).enumerate() {
        data[(at % cols) * rows + at / cols] = value;
    }
}
