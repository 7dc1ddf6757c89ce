//! The person as the human model sees them: what they believe now, what they believed a moment ago, and groups of
//! imagined people that start from there. Allocates nothing once it is made.

use crate::senses::Senses;
use messages::{
    Display, DriverAction, HumanBelief, ImagineAnswer, ImaginePhase, ImagineRequest, ImagineStatus,
    MAX_GROUP, Message,
};
use models::imagined::{Futures, ImaginedGroups, Moment};
use models::{ActionDistribution, Beliefs, Communicated, FollowedPerson, HumanModel, Observations};
use nn::Tensor;

/// Groups of imagined people that a planner may keep at the same time.
pub const GROUPS: usize = 4;
/// Beliefs kept. A real-time plan starts several times from the same step while the person moves on.
const REMEMBERED: usize = 4;

/// The person, in the eyes of one human model.
pub struct ModelledPerson<S: Senses> {
    model: Box<dyn HumanModel>,
    senses: S,
    /// Seed of the run, for models by which it is chance what people perceive.
    seed: u64,
    person: FollowedPerson,
    observations: Observations,
    action: Tensor,
    position: Option<(u32, u32)>,
    remembered: [Remembered; REMEMBERED],
    next: usize,
    groups: ImaginedGroups,
    /// Size of each group; 0 for none.
    rows: [usize; GROUPS],
    imagined: Observations,
    communicated: Vec<Communicated>,
    actions: Tensor,
}

struct Remembered {
    position: Option<(u32, u32)>,
    beliefs: Beliefs,
}

impl<S: Senses> ModelledPerson<S> {
    /// A person who perceived nothing yet; `seed` is the run's.
    pub fn new(mut model: Box<dyn HumanModel>, senses: S, seed: u64) -> Self {
        let shape = senses.shape();
        let mut groups = ImaginedGroups::new(&*model, GROUPS, MAX_GROUP);
        groups.warm(&mut *model, &shape, MAX_GROUP);
        Self {
            seed,
            person: FollowedPerson::new(&*model, &shape),
            observations: Observations::new(&shape, 1),
            action: Tensor::new(shape.action, 1),
            position: None,
            remembered: core::array::from_fn(|_| Remembered {
                position: None,
                beliefs: Beliefs::of_person(&*model),
            }),
            next: 0,
            groups,
            rows: [0; GROUPS],
            imagined: Observations::new(&shape, MAX_GROUP),
            communicated: vec![Communicated::default(); MAX_GROUP],
            actions: Tensor::new(shape.action, MAX_GROUP),
            model,
            senses,
        }
    }

    /// What [`Sensed::measure`] must be for this model.
    pub fn measure(&self) -> [u32; 3] {
        self.senses.measure()
    }

    /// Whether there is a belief about this episode yet.
    pub fn follows(&self, episode: u32) -> bool {
        self.position.is_some_and(|(seen, _)| seen == episode)
    }

    /// Updates z^H with what the person could perceive in `sensed`, what `display` showed and said, and `taken`, what
    /// they did one step before (ignored at an episode's start); writes belief and prediction into `out`, all but the
    /// header.
    pub fn observe(
        &mut self,
        sensed: &S::Sensed,
        display: &Display,
        taken: Option<&DriverAction>,
        out: &mut HumanBelief,
    ) {
        let (episode, step) = sensed.header().map_or((0, 0), |h| (h.episode, h.step));
        self.write_action(taken);
        let starts = step == 0 || !self.follows(episode);
        if starts {
            self.person.reset(&*self.model);
        } else {
            out.log_likelihood = self.person.expected().log_density(0, self.action.column(0));
        }
        let communicated = self.senses.take_in(sensed, display, &mut self.observations);
        let at = [self.seed, u64::from(episode), u64::from(step)];
        let seen = &self.observations;
        self.person.perceive(
            &mut *self.model,
            (seen.visual.column(0), seen.verbal.column(0)),
            communicated,
            self.action.column(0),
            at,
        );
        self.position = Some((episode, step));
        self.remember();
        self.report(out);
    }

    /// What the person did, as the model takes it: throttle/brake and steer, or a 1 in the place of a choice.
    fn write_action(&mut self, taken: Option<&DriverAction>) {
        let column = self.action.column_mut(0);
        column.fill(0.0);
        let Some(taken) = taken else { return };
        match self.person.expected() {
            ActionDistribution::Gaussian { .. } => {
                column.copy_from_slice(&[taken.throttle, taken.steer]);
            }
            ActionDistribution::Categorical { .. } => {
                if let Some(place) = taken
                    .discrete()
                    .and_then(|choice| column.get_mut(choice as usize))
                {
                    *place = 1.0;
                }
            }
        }
    }

    fn remember(&mut self) {
        let place = &mut self.remembered[self.next];
        self.next = (self.next + 1) % REMEMBERED;
        place.position = self.position;
        place.beliefs.copy_from(&self.person.beliefs);
    }

    fn report(&self, out: &mut HumanBelief) {
        let latent = self.model.latent().min(out.mean.len());
        out.latent = latent as u32;
        self.person
            .moments(&mut out.mean[..latent], &mut out.deviation[..latent]);
        match self.person.expected() {
            ActionDistribution::Gaussian { mean, deviation } => {
                for (mean, u) in out.action_mean.iter_mut().zip(mean.column(0)) {
                    *mean = u.tanh();
                }
                out.action_deviation.copy_from_slice(deviation.column(0));
            }
            ActionDistribution::Categorical { log_probability } => {
                let log = log_probability.column(0);
                for (probability, log) in out.probability.iter_mut().zip(log) {
                    *probability = log.exp();
                }
            }
        }
        let kind = self.model.kind().as_bytes();
        let length = kind.len().min(out.kind.len());
        out.kind[..length].copy_from_slice(&kind[..length]);
    }

    /// Answers one question about a group of imagined people; `answer` comes with group, phase and rows filled in.
    pub fn answer(&mut self, question: &ImagineRequest, answer: &mut ImagineAnswer) {
        let group = question.group as usize;
        let rows = question.rows as usize;
        answer.status = ImagineStatus::NoGroup.wire();
        if group >= GROUPS {
            return;
        }
        let phase = question.phase();
        if phase == Ok(ImaginePhase::Compare) {
            self.compare(question, answer);
            return;
        }
        let actions = match phase {
            Ok(ImaginePhase::Start) if (1..=MAX_GROUP).contains(&rows) => {
                let position = Some((question.header.episode, question.header.step));
                let Some(start) = self
                    .remembered
                    .iter()
                    .find(|kept| kept.position == position)
                else {
                    answer.status = ImagineStatus::NoBelief.wire();
                    return;
                };
                self.rows[group] = rows;
                let futures = Futures {
                    first: question.first_future as usize,
                    count: question.futures as usize,
                };
                let actions = self.action.rows();
                let known = (question.action_known != 0).then_some(&question.action[..actions]);
                self.groups.start(
                    &mut *self.model,
                    &start.beliefs,
                    group,
                    rows,
                    futures,
                    question.seed,
                    known,
                )
            }
            Ok(ImaginePhase::Perceive) if self.may_be(group, rows) => {
                if !self.take_in(question, rows) {
                    return;
                }
                self.rows[group] = rows;
                let communicated = &self.communicated[..rows];
                self.groups.step(
                    &mut *self.model,
                    group,
                    &self.imagined,
                    communicated,
                    question.seed,
                )
            }
            Ok(ImaginePhase::Forget) => {
                self.groups.forget(group);
                self.rows[group] = 0;
                answer.status = ImagineStatus::Answered.wire();
                return;
            }
            _ => return,
        };
        let Ok(actions) = actions else { return };
        answer.action[..actions.data().len()].copy_from_slice(actions.data());
        answer.status = ImagineStatus::Answered.wire();
    }

    /// Whether a group may have so many people from now on: as many as until now, or more of the same futures.
    fn may_be(&self, group: usize, rows: usize) -> bool {
        self.rows[group] > 0 && (self.rows[group]..=MAX_GROUP).contains(&rows)
    }

    /// Answers how far the person's belief would be from the robot's in each version of the next step.
    fn compare(&mut self, question: &ImagineRequest, answer: &mut ImagineAnswer) {
        let rows = question.rows as usize;
        if !(1..=MAX_GROUP).contains(&rows) {
            return;
        }
        let position = Some((question.header.episode, question.header.step));
        let Some(start) = self
            .remembered
            .iter()
            .position(|kept| kept.position == position)
        else {
            answer.status = ImagineStatus::NoBelief.wire();
            return;
        };
        if !self.take_in(question, rows) {
            return;
        }
        let actions = self.action.rows();
        self.actions.resize_to(actions, rows);
        for j in 0..rows {
            let column = self.actions.column_mut(j);
            column.copy_from_slice(&question.action[..actions]);
        }
        let latent = self.model.latent().min(question.robot_mean.len());
        let moment = Moment {
            action: &self.actions,
            observations: &self.imagined,
            communicated: &self.communicated[..rows],
            robot_mean: &question.robot_mean[..latent],
            robot_deviation: &question.robot_deviation[..latent],
        };
        let compared = self.groups.compare(
            &mut *self.model,
            &self.remembered[start].beliefs,
            moment,
            &mut answer.divergence[..rows],
        );
        let status = match compared {
            Ok(()) => ImagineStatus::Answered,
            Err(_) => ImagineStatus::Incomparable,
        };
        answer.status = status.wire();
    }

    /// Copies what a question's imagined people see and are told; false if these are not modalities of ours.
    fn take_in(&mut self, question: &ImagineRequest, rows: usize) -> bool {
        let Observations { visual, verbal } = &self.imagined;
        if (question.visual_width, question.verbal_width)
            != (visual.rows() as u32, verbal.rows() as u32)
        {
            return false;
        }
        self.imagined.resize(rows);
        let Observations { visual, verbal } = &mut self.imagined;
        let numbers = visual.data().len();
        visual
            .data_mut()
            .copy_from_slice(&question.visual[..numbers]);
        for (bits, asked) in self
            .communicated
            .iter_mut()
            .zip(&question.communicated[..rows])
        {
            *bits = Communicated(*asked);
        }
        let width = verbal.rows();
        for (j, told) in self.communicated[..rows].iter().enumerate() {
            // What is said to nobody is masked, if people hear nobody else.
            if self.senses.hears() || told.verbal_bits() != 0 {
                let words = &question.verbal[j * width..(j + 1) * width];
                verbal.column_mut(j).copy_from_slice(words);
            }
        }
        true
    }
}
