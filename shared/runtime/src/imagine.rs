//! Imagination across a process border: the planner's questions, the human model's answers.
//!
//! Questions and answers are two topics, `human/imagine` and `human/imagine/answer`, of a publish-subscribe service
//! each, without history. iceoryx2 0.10 has a request-response pattern too, but it allocates a counter on the heap for
//! every request that a server receives (`Server::create_active_request`), cannot be listened to by a third, and would
//! need its own event service, sequence numbers and loss counts, which topics have. A question names its group and
//! phase, an answer repeats them; several groups may be on their way at once, so that one process imagines a group's
//! futures while the other thinks about the next group's people.

use crate::error::{NodeError, PortError};
use crate::input::{Input, Receive, Source};
use crate::node::Node;
use crate::output::{Loan, Output, Stamp};
use crate::wait::Wake;
use messages::{ImagineAnswer, ImagineRequest, ImagineStatus, topic};

impl Node {
    /// The asking side of imagination (`human/imagine`).
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn request_client(&self) -> Result<RequestClient, PortError> {
        RequestClient::new(self)
    }

    /// The answering side of imagination (`human/imagine`).
    ///
    /// # Errors
    /// As [`Node::output`].
    pub fn request_server(&self) -> Result<RequestServer, PortError> {
        RequestServer::new(self)
    }
}

/// The planner's side.
pub struct RequestClient {
    questions: Output<ImagineRequest>,
    answers: Input<ImagineAnswer>,
    open: u32,
}

impl RequestClient {
    pub(crate) fn new(node: &Node) -> Result<Self, PortError> {
        Ok(Self {
            answers: node.input(topic::IMAGINE_ANSWER, Receive::InOrder)?,
            questions: node.output(topic::IMAGINE)?,
            open: 0,
        })
    }

    /// A question in shared memory, to be written in place and sent with [`RequestClient::ask`]'s stamp. It still holds
    /// an older question's numbers: write every field, and the rows that are used.
    ///
    /// # Errors
    /// [`PortError::Loan`].
    pub fn loan(&self) -> Result<Loan<'_, ImagineRequest>, PortError> {
        self.questions.loan_uncleared()
    }

    /// Loans, lets `write` fill in the question, and sends it. At most four may be unanswered.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn ask(
        &mut self,
        stamp: Stamp,
        write: impl FnOnce(&mut ImagineRequest),
    ) -> Result<(), PortError> {
        let mut question = self.questions.loan_uncleared()?;
        write(&mut question);
        question.send(stamp)?;
        self.open += 1;
        Ok(())
    }

    /// Questions asked and not answered yet.
    pub fn unanswered(&self) -> u32 {
        self.open
    }

    /// Waits for the next answer; with [`Wake::Message`] it is at [`RequestClient::answer`].
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn wait_answer(
        &mut self,
        node: &mut Node,
        deadline_ns: Option<u64>,
    ) -> Result<Wake, NodeError> {
        let wake = node.wait(&mut [&mut self.answers], deadline_ns)?;
        if wake == Wake::Message && self.answers.take()? {
            self.open = self.open.saturating_sub(1);
        }
        Ok(wake)
    }

    /// As [`RequestClient::wait_answer`], ended too, with [`Wake::Passed`], by a message at `other`.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn wait_answer_or(
        &mut self,
        node: &mut Node,
        other: &mut dyn Source,
        deadline_ns: Option<u64>,
    ) -> Result<Wake, NodeError> {
        let wake = node.wait(&mut [&mut self.answers, &mut *other], deadline_ns)?;
        if wake == Wake::Message {
            if self.answers.take()? {
                self.open = self.open.saturating_sub(1);
            } else {
                return Ok(Wake::Passed);
            }
        }
        Ok(wake)
    }

    /// Passes over the answers that wait: they are somebody else's.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub fn pass_over(&mut self) -> Result<(), PortError> {
        while self.answers.take()? {}
        Ok(())
    }

    /// The answer taken last.
    pub fn answer(&self) -> Option<&ImagineAnswer> {
        self.answers.message()
    }

    /// Forgets what is unanswered: the answers that still come are to be told apart by their step and phase.
    pub fn give_up(&mut self) {
        self.open = 0;
    }

    /// What to wait for beside other inputs.
    pub fn source(&mut self) -> &mut dyn Source {
        &mut self.answers
    }
}

/// The human model's side.
pub struct RequestServer {
    questions: Input<ImagineRequest>,
    answers: Output<ImagineAnswer>,
}

impl RequestServer {
    pub(crate) fn new(node: &Node) -> Result<Self, PortError> {
        Ok(Self {
            questions: node.input(topic::IMAGINE, Receive::InOrder)?,
            answers: node.output(topic::IMAGINE_ANSWER)?,
        })
    }

    /// What to wait for beside other inputs.
    pub fn source(&mut self) -> &mut dyn Source {
        &mut self.questions
    }

    /// Takes every question that waits and answers it in place: `answer` gets the question and the answer, whose group,
    /// phase and rows are filled in and whose actions still hold older numbers. A question about a step that is not
    /// this process's turn is left to the process whose it is.
    ///
    /// # Errors
    /// [`PortError`].
    pub fn serve_all(
        &mut self,
        node: &Node,
        mut answer: impl FnMut(&ImagineRequest, &mut ImagineAnswer),
    ) -> Result<(), PortError> {
        while self.questions.take()? {
            if let Some(question) = self.questions.message()
                && node.is_active(question.header.episode, question.header.step)
            {
                self.answer_one(question, &mut answer)?;
            }
        }
        Ok(())
    }

    fn answer_one(
        &self,
        question: &ImagineRequest,
        answer: &mut impl FnMut(&ImagineRequest, &mut ImagineAnswer),
    ) -> Result<(), PortError> {
        let mut loan = self.answers.loan_uncleared()?;
        loan.group = question.group;
        loan.phase = question.phase;
        loan.rows = question.rows;
        loan.status = ImagineStatus::Answered.wire();
        answer(question, &mut loan);
        loan.send(Stamp::of(&question.header))
    }

    /// Questions that were lost.
    pub fn lost(&self) -> u64 {
        self.questions.lost()
    }
}
