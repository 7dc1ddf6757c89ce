//! Where other commands reach a running set: a socket in the instance's directory. One line of JSON asks, one answers.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

/// Longest question.
const MOST_BYTES: usize = 64 << 10;

/// What can be asked of a running set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Question {
    /// Replace a process.
    Swap(Replacement),
    /// Which processes run.
    Status,
}

/// What is to take a process's place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replacement {
    /// The process.
    pub process: String,
    /// What kind of it; `same` for another of the same kind.
    pub kind: Option<String>,
    /// Another program, in place of our own.
    pub exec: Option<String>,
    /// What the new human model learned of the person.
    pub implants: Option<PathBuf>,
}

/// The answer to a question.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// Done; with what was asked for.
    Done(serde_json::Value),
    /// Not done, and why; everything is as it was before.
    Refused(String),
}

/// The socket of an instance.
pub fn path(directory: &Path) -> PathBuf {
    directory.join("launcher.sock")
}

/// The launcher's side.
pub struct Door {
    listener: UnixListener,
    visitors: Vec<Visitor>,
}

/// Somebody who asked, or is about to.
pub struct Visitor {
    stream: UnixStream,
    heard: Vec<u8>,
}

impl Visitor {
    /// Tells them, who may have left.
    pub fn tell(mut self, answer: &Answer) {
        if let Ok(mut text) = serde_json::to_string(answer) {
            text.push('\n');
            let _ = self.stream.set_nonblocking(false);
            let _ = self
                .stream
                .set_write_timeout(Some(std::time::Duration::from_millis(200)));
            let _ = self.stream.write_all(text.as_bytes());
        }
    }
}

impl Door {
    /// Opens the door of an instance that is ours.
    ///
    /// # Errors
    /// Names the socket.
    pub fn open(directory: &Path) -> Result<Self> {
        let path = path(directory);
        let _ = std::fs::remove_file(&path); // a dead launcher's
        let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
        let listener = UnixListener::bind(&path)
            .and_then(|listener| {
                std::fs::set_permissions(&path, private)?;
                listener.set_nonblocking(true)?;
                Ok(listener)
            })
            .with_context(|| path.display().to_string())?;
        Ok(Self {
            listener,
            visitors: Vec::new(),
        })
    }

    /// What to poll.
    pub fn descriptors(&self) -> impl Iterator<Item = RawFd> {
        let visitors = self.visitors.iter().map(|v| v.stream.as_raw_fd());
        std::iter::once(self.listener.as_raw_fd()).chain(visitors)
    }

    /// Lets in who knocks, and returns the next complete question.
    pub fn next(&mut self) -> Option<(Visitor, Result<Question, String>)> {
        while let Ok((stream, _)) = self.listener.accept() {
            if stream.set_nonblocking(true).is_ok() {
                let heard = Vec::new();
                self.visitors.push(Visitor { stream, heard });
            }
        }
        let mut at = 0;
        while at < self.visitors.len() {
            match self.visitors[at].hear() {
                Heard::Nothing => at += 1,
                Heard::Gone => drop(self.visitors.swap_remove(at)),
                Heard::Question(question) => {
                    return Some((self.visitors.swap_remove(at), question));
                }
            }
        }
        None
    }
}

enum Heard {
    Nothing,
    Gone,
    Question(Result<Question, String>),
}

impl Visitor {
    fn hear(&mut self) -> Heard {
        let mut bytes = [0; 4096];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Heard::Gone,
                Ok(count) => self.heard.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Heard::Nothing,
                Err(_) => return Heard::Gone,
            }
            if let Some(end) = self.heard.iter().position(|byte| *byte == b'\n') {
                let question = serde_json::from_slice(&self.heard[..end]);
                return Heard::Question(question.map_err(|error| error.to_string()));
            }
            if self.heard.len() > MOST_BYTES {
                return Heard::Question(Err("a question of more than 64 KiB".to_owned()));
            }
        }
    }
}

/// Asks a running set and waits for its answer.
///
/// # Errors
/// When there is nobody, when they leave, or when they refuse.
pub fn ask(directory: &Path, question: &Question) -> Result<serde_json::Value> {
    let path = path(directory);
    let mut stream = UnixStream::connect(&path).with_context(|| path.display().to_string())?;
    let mut text = serde_json::to_string(question)?;
    text.push('\n');
    stream.write_all(text.as_bytes())?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line)?;
    if line.is_empty() {
        bail!("the run ended before it answered");
    }
    match serde_json::from_str(&line).with_context(|| format!("the run answered {line:?}"))? {
        Answer::Done(value) => Ok(value),
        Answer::Refused(why) => bail!("{why}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn visit(bytes: &[u8]) -> Option<Result<Question, String>> {
        let directory = tempfile::tempdir().unwrap();
        let mut door = Door::open(directory.path()).unwrap();
        let mut stream = UnixStream::connect(path(directory.path())).unwrap();
        stream.write_all(bytes).unwrap();
        drop(stream);
        door.next().map(|(_, question)| question)
    }

    #[test]
    fn a_question_arrives_and_its_answer_too() {
        let directory = tempfile::tempdir().unwrap();
        let mut door = Door::open(directory.path()).unwrap();
        let asked = Question::Swap(Replacement {
            process: "human".to_owned(),
            kind: Some("self".to_owned()),
            exec: None,
            implants: None,
        });
        std::thread::scope(|scope| {
            let client = scope.spawn(|| ask(directory.path(), &asked));
            let (visitor, question) = loop {
                if let Some(heard) = door.next() {
                    break heard;
                }
                std::thread::yield_now();
            };
            assert_eq!(question, Ok(asked.clone()));
            visitor.tell(&Answer::Refused("not now".to_owned()));
            let error = client.join().unwrap().unwrap_err();
            assert_eq!(error.to_string(), "not now");
        });
    }

    #[test]
    fn a_torn_question_is_none() {
        assert!(visit(b"{\"command\":\"status\"").is_none());
        assert_eq!(
            visit(b"{\"command\":\"status\"}\n"),
            Some(Ok(Question::Status))
        );
        assert!(matches!(
            visit(&[b'x'; MOST_BYTES + 5000]),
            Some(Err(_)) | None
        ));
    }

    proptest! {
        #[test]
        fn whatever_is_said_at_the_door_nobody_panics(mut bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
            bytes.push(b'\n');
            let heard = visit(&bytes);
            prop_assert!(heard.is_some_and(|question| question.is_err()));
        }
    }
}
