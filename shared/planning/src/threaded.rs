//! A human model that answers from a thread of its own, as the human process does in a process set: two cores share a
//! plan.

use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::GROUPS;
use models::imagined::{Futures, ImaginedGroups};
use models::{Beliefs, Communicated, HumanModel, Observations, Shape};
use nn::Tensor;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// A human model in another thread, which ends when this is dropped. Asking allocates nothing.
pub struct ThreadedPeople {
    to: SyncSender<Box<Parcel>>,
    back: Receiver<Box<Parcel>>,
    /// One per group, here or on its way.
    idle: [Option<Box<Parcel>>; GROUPS],
}

/// A question on its way to the other thread, or its answer on its way back; made once per group.
struct Parcel {
    group: usize,
    rows: usize,
    futures: Futures,
    seed: u64,
    /// Numbers of `known_action` that are used; 0 where the action is not known.
    known: usize,
    known_action: Vec<f32>,
    starts: bool,
    observations: Observations,
    communicated: Vec<Communicated>,
    actions: Tensor,
}

impl ThreadedPeople {
    /// Starts the thread. `person`: what the person believes; `rows`: the most people in a group; `shape`: the domain's.
    pub fn spawn(
        mut model: impl HumanModel + 'static,
        person: Beliefs,
        rows: usize,
        shape: &Shape,
    ) -> Self {
        let (to, questions) = sync_channel::<Box<Parcel>>(GROUPS);
        let (answers, back) = sync_channel::<Box<Parcel>>(GROUPS);
        let mut groups = ImaginedGroups::new(&model, GROUPS, rows);
        std::thread::spawn(move || {
            while let Ok(mut p) = questions.recv() {
                let model = &mut model;
                let known = (p.known > 0).then_some(&p.known_action[..p.known]);
                let actions = match p.starts {
                    true => {
                        let (group, rows, futures) = (p.group, p.rows, p.futures);
                        groups.start(model, &person, group, rows, futures, p.seed, known)
                    }
                    false => groups.step(model, p.group, &p.observations, &p.communicated, p.seed),
                };
                // Without an answer the other side hears that nobody is there.
                let Ok(actions) = actions else { return };
                p.actions.copy_from(actions);
                if answers.send(p).is_err() {
                    return;
                }
            }
        });
        let idle = std::array::from_fn(|group| {
            Some(Box::new(Parcel {
                group,
                rows,
                futures: Futures::each_their_own(rows),
                seed: 0,
                known: 0,
                known_action: vec![0.0; shape.action],
                starts: true,
                observations: Observations::new(shape, rows),
                communicated: vec![Communicated::default(); rows],
                actions: Tensor::new(shape.action, rows),
            }))
        });
        Self { to, back, idle }
    }

    fn send(&mut self, group: usize, fill: impl FnOnce(&mut Parcel)) -> Result<(), PeopleError> {
        let mut parcel = self.idle[group].take().ok_or_else(gone)?;
        fill(&mut parcel);
        self.to.send(parcel).map_err(|_| gone())
    }
}

fn gone() -> PeopleError {
    PeopleError::Unreachable("its thread has ended".to_owned())
}

impl ImaginedPeople for ThreadedPeople {
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        self.send(group, |p| {
            (p.starts, p.rows, p.futures, p.seed) = (true, rows, futures, seed);
            let known = known_action.unwrap_or_default();
            p.known = known.len();
            p.known_action[..known.len()].copy_from_slice(known);
        })
    }

    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError> {
        self.send(group, |p| {
            (p.starts, p.seed) = (false, seed);
            p.observations.visual.copy_from(&observations.visual);
            p.observations.verbal.copy_from(&observations.verbal);
            p.communicated.clear();
            p.communicated.extend_from_slice(communicated);
        })
    }

    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        while self.idle[group].is_none() {
            let parcel = self.back.recv().map_err(|_| gone())?;
            let place = parcel.group;
            self.idle[place] = Some(parcel);
        }
        if let Some(parcel) = &self.idle[group] {
            actions.copy_from(&parcel.actions);
        }
        Ok(())
    }
}
