//! The ideal model (the paper's IM): imagined people who are clones of the simulated person themselves. An upper bound, since in
//! practice nobody has it.

use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{GROUPS, mix};
use domains::Layout;
use domains::discrete::{Mind, SimulatedPerson};
use models::imagined::Futures;
use models::{Communicated, Observations};
use nn::Tensor;

/// Groups of clones of one person, who know and remember what the person does.
pub struct IdealPeople {
    person: SimulatedPerson,
    actions: usize,
    groups: [Vec<SimulatedPerson>; GROUPS],
    futures: [Futures; GROUPS],
    /// What each of a group did last: an answer that was not fetched yet.
    done: [Vec<usize>; GROUPS],
}

impl IdealPeople {
    /// Clones of `person`.
    pub fn new(person: &SimulatedPerson, layout: &Layout) -> Self {
        Self {
            person: person.clone(),
            actions: layout.actions.rows(),
            groups: Default::default(),
            futures: [Futures::each_their_own(1); GROUPS],
            done: Default::default(),
        }
    }

    /// The person as they are now, having perceived the present step and acted.
    pub fn follow(&mut self, person: &SimulatedPerson) {
        self.person.clone_from(person);
    }
}

impl ImaginedPeople for IdealPeople {
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        self.futures[group] = futures;
        let (people, done) = (&mut self.groups[group], &mut self.done[group]);
        people.resize(rows, self.person.clone());
        done.resize(rows, 0);
        let known = known_action.map(models::policy::largest);
        for (j, (person, done)) in people.iter_mut().zip(done).enumerate() {
            person.clone_from(&self.person);
            person.reseed(mix(&[seed, group as u64]), 0, futures.of(j) as u64);
            // Where their action is known, they have acted already.
            *done = known.unwrap_or_else(|| person.act());
        }
        Ok(())
    }

    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError> {
        let futures = self.futures[group];
        let (people, done) = (&mut self.groups[group], &mut self.done[group]);
        for j in people.len()..communicated.len() {
            people.push(people[j % futures.count].clone());
            done.push(done[j % futures.count]);
        }
        for (j, (person, done)) in people.iter_mut().zip(done).enumerate() {
            // What they have drawn so far depends on what they were told; what they draw next shall not.
            person.reseed(mix(&[seed, group as u64]), 0, futures.of(j) as u64);
            let (visual, verbal) = (observations.visual.column(j), observations.verbal.column(j));
            let seen = person.look(visual);
            person.perceive(visual, verbal, seen | communicated[j].mask());
            *done = person.act();
        }
        Ok(())
    }

    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        let done = &self.done[group];
        actions.resize_to(self.actions, done.len());
        actions.fill(0.0);
        for (j, action) in done.iter().enumerate() {
            actions.column_mut(j)[*action] = 1.0;
        }
        Ok(())
    }
}
