//! Where other commands reach a running set: a socket in the instance's directory. One line of JSON asks, one answers;
//! before the answer to a swap, others may say what it waits for.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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
    /// Not done yet: another answer follows.
    WaitNotice(WaitNotice),
}

/// What is still to come before a question is answered.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WaitNotice {
    /// What is waited for.
    pub what: String,
    /// How far that is, where it can be told.
    pub so_far: String,
}

/// The socket of an instance.
pub fn path(directory: &Path) -> PathBuf {
    directory.join("launcher.sock")
}

/// The launcher's side.
pub struct ControlSocket {
    listener: UnixListener,
    callers: Vec<Caller>,
    /// Those whose question cannot be answered yet.
    held: VecDeque<(Caller, Question)>,
}

/// Somebody who asked, or is about to.
pub struct Caller {
    stream: UnixStream,
    heard: Vec<u8>,
}

impl Caller {
    /// Tells them, who may have left, the answer.
    pub fn tell(mut self, answer: &Answer) {
        self.write(answer);
    }

    /// Tells them what is waited for.
    pub fn tell_waiting(&mut self, waiting: WaitNotice) {
        self.write(&Answer::WaitNotice(waiting));
    }

    fn write(&mut self, answer: &Answer) {
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

impl ControlSocket {
    /// Opens the socket of an instance that is ours.
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
            callers: Vec::new(),
            held: VecDeque::new(),
        })
    }

    /// What to poll.
    pub fn descriptors(&self) -> impl Iterator<Item = RawFd> {
        let callers = self.callers.iter().map(|v| v.stream.as_raw_fd());
        std::iter::once(self.listener.as_raw_fd()).chain(callers)
    }

    /// Answers while the set is not there yet: who wants to swap is held until it is, and told `why` they have to wait.
    pub fn answer_early(&mut self, status: impl Fn() -> serde_json::Value, why: &str) {
        while let Some((mut caller, question)) = self.ask() {
            match question {
                Err(why) => caller.tell(&Answer::Refused(why)),
                Ok(Question::Status) => caller.tell(&Answer::Done(status())),
                Ok(question @ Question::Swap(_)) => {
                    caller.tell_waiting(WaitNotice {
                        what: why.to_owned(),
                        ..WaitNotice::default()
                    });
                    self.held.push_back((caller, question));
                }
            }
        }
    }

    /// The next complete question; those that were held come first.
    pub fn next(&mut self) -> Option<(Caller, Result<Question, String>)> {
        match self.held.pop_front() {
            Some((caller, question)) => Some((caller, Ok(question))),
            None => self.ask(),
        }
    }

    /// Accepts who connects, and returns the next complete question.
    fn ask(&mut self) -> Option<(Caller, Result<Question, String>)> {
        while let Ok((stream, _)) = self.listener.accept() {
            if stream.set_nonblocking(true).is_ok() {
                let heard = Vec::new();
                self.callers.push(Caller { stream, heard });
            }
        }
        let mut at = 0;
        while at < self.callers.len() {
            match self.callers[at].hear() {
                CallerInput::Nothing => at += 1,
                CallerInput::Gone => drop(self.callers.swap_remove(at)),
                CallerInput::Question(question) => {
                    return Some((self.callers.swap_remove(at), question));
                }
            }
        }
        None
    }
}

enum CallerInput {
    Nothing,
    Gone,
    Question(Result<Question, String>),
}

impl Caller {
    fn hear(&mut self) -> CallerInput {
        let mut bytes = [0; 4096];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return CallerInput::Gone,
                Ok(count) => self.heard.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return CallerInput::Nothing,
                Err(_) => return CallerInput::Gone,
            }
            if let Some(end) = self.heard.iter().position(|byte| *byte == b'\n') {
                let question = serde_json::from_slice(&self.heard[..end]);
                return CallerInput::Question(question.map_err(|error| error.to_string()));
            }
            if self.heard.len() > MOST_BYTES {
                return CallerInput::Question(Err("a question of more than 64 KiB".to_owned()));
            }
        }
    }
}

/// How long a set that runs may take to open its socket.
const OPEN: Duration = Duration::from_secs(60);
/// A set that does not answer for so long is said to be waited for.
const SILENCE: Duration = Duration::from_secs(1);

/// Asks a running set and waits for its answer; `wait` hears what is waited for meanwhile.
///
/// # Errors
/// When there is nobody, when they leave, or when they refuse.
pub fn ask(
    directory: &Path,
    question: &Question,
    mut wait: impl FnMut(&WaitNotice),
) -> Result<serde_json::Value> {
    let name = directory.file_name().unwrap_or_default().to_string_lossy();
    let mut stream = connect(directory, &name, &mut wait)?;
    let ended = || format!("instance {name} ended before it answered");
    let mut text = serde_json::to_string(question)?;
    text.push('\n');
    stream.write_all(text.as_bytes()).with_context(ended)?;
    stream.set_read_timeout(Some(SILENCE))?;
    let (mut stream, mut line, mut heard) = (BufReader::new(stream), Vec::new(), false);
    loop {
        match stream.read_until(b'\n', &mut line) {
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                if !std::mem::replace(&mut heard, true) {
                    wait(&WaitNotice {
                        what: format!("instance {name} is busy: waiting for its answer"),
                        ..WaitNotice::default()
                    });
                }
                continue;
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            read => read.with_context(ended)?,
        };
        if line.is_empty() {
            bail!("{}", ended());
        }
        let said = || {
            format!(
                "instance {name} answered {:?}",
                String::from_utf8_lossy(&line)
            )
        };
        match serde_json::from_slice(&line).with_context(said)? {
            Answer::Done(value) => return Ok(value),
            Answer::Refused(why) => bail!("{why}"),
            Answer::WaitNotice(waiting) => wait(&waiting),
        }
        heard = true;
        line.clear();
    }
}

/// Asks a set that may not answer: one that is suspended, has no socket yet, or was not started by `mirror up`. None if it
/// has not answered within `patience`.
pub fn ask_within(
    directory: &Path,
    question: &Question,
    patience: Duration,
) -> Option<serde_json::Value> {
    let deadline = Instant::now() + patience;
    let mut stream = UnixStream::connect(path(directory)).ok()?;
    let text = serde_json::to_string(question).ok()? + "\n";
    stream.set_write_timeout(Some(patience)).ok()?;
    stream.write_all(text.as_bytes()).ok()?;
    let (mut bytes, mut line) = ([0; 4096], Vec::new());
    loop {
        let left = deadline.checked_duration_since(Instant::now())?;
        // A timeout of zero would be none.
        let left = left.max(Duration::from_millis(1));
        stream.set_read_timeout(Some(left)).ok()?;
        match stream.read(&mut bytes) {
            Ok(0) => return None,
            Ok(count) => line.extend_from_slice(&bytes[..count]),
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => return None,
        }
        if let Some(end) = line.iter().position(|byte| *byte == b'\n') {
            return match serde_json::from_slice(&line[..end]) {
                Ok(Answer::Done(value)) => Some(value),
                _ => None,
            };
        }
    }
}

/// Connects to a set that runs, and may have to open its socket first.
fn connect(directory: &Path, name: &str, wait: &mut impl FnMut(&WaitNotice)) -> Result<UnixStream> {
    let path = path(directory);
    let root = directory.parent().unwrap_or(directory);
    let (since, mut said) = (Instant::now(), false);
    loop {
        let error = match UnixStream::connect(&path) {
            Ok(stream) => return Ok(stream),
            Err(error) => error,
        };
        let is_early = matches!(
            error.kind(),
            ErrorKind::NotFound | ErrorKind::ConnectionRefused
        );
        if !is_early || since.elapsed() > OPEN {
            return Err(error).with_context(|| path.display().to_string());
        }
        if runtime::instance::launcher(root, name).is_none() {
            bail!("instance {name} does not run any more");
        }
        if !std::mem::replace(&mut said, true) {
            wait(&WaitNotice {
                what: format!("instance {name} has only just been started: waiting for it"),
                ..WaitNotice::default()
            });
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn visit(bytes: &[u8]) -> Option<Result<Question, String>> {
        let directory = tempfile::tempdir().unwrap();
        let mut socket = ControlSocket::open(directory.path()).unwrap();
        let mut stream = UnixStream::connect(path(directory.path())).unwrap();
        stream.write_all(bytes).unwrap();
        drop(stream);
        socket.next().map(|(_, question)| question)
    }

    #[test]
    fn a_question_arrives_and_its_answer_too() {
        let directory = tempfile::tempdir().unwrap();
        let mut socket = ControlSocket::open(directory.path()).unwrap();
        let asked = Question::Swap(Replacement {
            process: "human".to_owned(),
            kind: Some("self".to_owned()),
            exec: None,
            implants: None,
        });
        std::thread::scope(|scope| {
            let client = scope.spawn(|| ask(directory.path(), &asked, |_| ()));
            let (caller, question) = loop {
                if let Some(heard) = socket.next() {
                    break heard;
                }
                std::thread::yield_now();
            };
            assert_eq!(question, Ok(asked.clone()));
            caller.tell(&Answer::Refused("not now".to_owned()));
            let error = client.join().unwrap().unwrap_err();
            assert_eq!(error.to_string(), "not now");
        });
    }

    #[test]
    fn who_does_not_answer_is_waited_for_no_longer_than_one_says() {
        let directory = tempfile::tempdir().unwrap();
        let patience = Duration::from_millis(20);
        let ask = || ask_within(directory.path(), &Question::Status, patience);
        assert_eq!(ask(), None, "no socket");
        let mut socket = ControlSocket::open(directory.path()).unwrap();
        let asked = Instant::now();
        assert_eq!(ask(), None, "nobody at the socket");
        assert!(asked.elapsed() >= patience);
        std::thread::scope(|scope| {
            let patience = Duration::from_secs(60);
            let client =
                scope.spawn(move || ask_within(directory.path(), &Question::Status, patience));
            // The first of the two left before the socket was answered.
            while !client.is_finished() {
                socket.answer_early(|| serde_json::json!({ "steps": 7 }), "");
                std::thread::yield_now();
            }
            assert_eq!(client.join().unwrap().unwrap()["steps"], 7);
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
