//! Keeps the disk off the recorder's receiving loop: blocks made beforehand travel to a writer thread and back.

use crate::recording::{Lost, Recording, Written};
use crate::topics::{PerTopic, Recorded, TOPICS};
use crossbeam_channel::{Receiver, Sender, bounded};
use messages::{Message, Report};
use std::io;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

/// Blocks made beforehand, 16 MB: about a minute of a highway run in real time.
pub const BLOCKS: usize = 4096;
/// Blocks in flight at most where the queue may grow, 250 MB.
const MOST_BLOCKS: usize = 16 * BLOCKS;

/// What to do with a message when the writer has not given back a block yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Real time: drop the message and count it.
    Drop,
    /// Lockstep: make more blocks, so that the ports are emptied in time however slow the disk; wait only when memory
    /// would run short.
    Grow,
}

enum Item {
    Message(Box<Recorded>),
    End(Box<Lost>),
}

/// A recording that is written by a thread of its own.
pub struct Queue {
    free: Receiver<Box<Recorded>>,
    full: Sender<Item>,
    writer: JoinHandle<Written>,
    when_full: WhenFull,
    blocks: usize,
    most: usize,
    error: Arc<OnceLock<String>>,
    dropped: PerTopic,
}

impl Queue {
    /// Starts the writer thread and makes `blocks` blocks; unless the queue may grow, [`Self::push`] allocates nothing.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(recording: Recording, when_full: WhenFull, blocks: usize) -> io::Result<Self> {
        let most = match when_full {
            WhenFull::Drop => blocks,
            WhenFull::Grow => blocks.max(MOST_BLOCKS),
        };
        let (give_back, free) = bounded(most);
        let (full, items) = bounded(most + 1);
        for _ in 0..blocks {
            // Cannot fail: the channel has that much room, and its receiver lives.
            let _ = give_back.send(Box::new(Recorded::Report(Report::ZERO)));
        }
        let error = Arc::new(OnceLock::new());
        let seen = Arc::clone(&error);
        let writer = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn(move || write_all(recording, &items, &give_back, &seen))?;
        Ok(Self {
            free,
            full,
            writer,
            when_full,
            blocks,
            most,
            error,
            dropped: [0; TOPICS.len()],
        })
    }

    /// Hands a message to the writer, or counts it as lost.
    pub fn push(&mut self, message: &Recorded) {
        let block = match self.free.try_recv() {
            Ok(block) => Some(block),
            Err(_) if self.when_full == WhenFull::Drop => None,
            Err(_) if self.blocks < self.most => {
                self.blocks += 1;
                Some(Box::new(*message))
            }
            Err(_) => self.free.recv().ok(),
        };
        match block {
            Some(mut block) => {
                *block = *message;
                if self.full.send(Item::Message(block)).is_err() {
                    self.dropped[message.topic()] += 1;
                }
            }
            None => self.dropped[message.topic()] += 1,
        }
    }

    /// Whether so many messages can be pushed without waiting for the writer.
    pub fn has_room(&self, messages: usize) -> bool {
        self.when_full == WhenFull::Drop || self.free.len() + self.most - self.blocks >= messages
    }

    /// Why the writer has stopped writing, once it has.
    pub fn error(&self) -> Option<&str> {
        self.error.get().map(String::as_str)
    }

    /// Messages that found no free block.
    pub fn dropped(&self) -> &PerTopic {
        &self.dropped
    }

    /// Waits until everything is on disk. `ports` are the losses at the recorder's ports, `restart` those before it
    /// took the place of one that was killed.
    pub fn finish(self, ports: &PerTopic, restart: &PerTopic) -> Written {
        let lost = Lost {
            ports: *ports,
            queue: self.dropped,
            disk: [0; TOPICS.len()],
            restart: *restart,
        };
        let ended = self.full.send(Item::End(Box::new(lost))).is_ok();
        match self.writer.join() {
            Ok(written) if ended => written,
            _ => Written {
                lost,
                error: Some("the recording's writer thread ended unexpectedly".to_owned()),
                ..Written::default()
            },
        }
    }
}

fn write_all(
    mut recording: Recording,
    items: &Receiver<Item>,
    give_back: &Sender<Box<Recorded>>,
    error: &OnceLock<String>,
) -> Written {
    for item in items {
        match item {
            Item::Message(block) => {
                recording.write(&block);
                if let Some(text) = recording.error() {
                    error.get_or_init(|| text.to_owned());
                }
                // Nobody waits for the block when the queue has gone.
                let _ = give_back.send(block);
            }
            Item::End(lost) => return recording.finish(&lost),
        }
    }
    // The queue went away without a word, as in a panic: what is here can still be closed, as incomplete.
    recording.interrupt("the recorder ended unexpectedly");
    recording.finish(&Lost::default())
}
