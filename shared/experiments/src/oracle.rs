//! The race with nothing learned in it: the simulator is the world, and the simulated driver themselves the human model. What it
//! achieves is the ceiling of what planning can do with these people; what a learned model falls short of it is the model's.

use domains::highway::display::Presenter;
use domains::highway::modalities::{VISUAL, write_visual};
use domains::highway::{End, SECTORS, SimulatedDriver, World};
use models::Communicated;
use planning::candidates::Candidate;
use planning::items::{Items, Sectors};
use planning::planner::{Plan, mix};
use planning::race::{Race, Round, Simulation, Start};
use planning::{Decision, PeopleError, PlanMoment, Settings};

/// Candidates × futures in one round.
const MOST_ROWS: usize = 4096;

/// Plans with the truth.
pub struct Oracle {
    settings: Settings,
    race: Race<Sectors>,
    /// Silent futures at the beginning of each decision.
    silent: Vec<Life>,
}

/// A future that somebody lives in.
#[derive(Clone)]
struct Life {
    world: World,
    driver: SimulatedDriver,
    /// What the driver does next.
    action: [f32; 2],
    value: f32,
}

impl Oracle {
    /// A planner that has planned nothing yet.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            race: Race::new(settings, Sectors),
            silent: Vec::new(),
        }
    }

    /// Decides what to communicate at the next step; `driver` has just decided on `action`.
    ///
    /// # Errors
    /// None: nobody is asked.
    pub fn decide(
        &mut self,
        world: &World,
        driver: &SimulatedDriver,
        action: [f32; 2],
        moment: PlanMoment,
    ) -> Result<Decision, PeopleError> {
        let mut visual = [0.0; VISUAL];
        let observation = world.observation();
        write_visual(&observation.range, &observation.ego, &mut visual);
        let start = Start {
            held: Sectors.held(&visual),
            speech_ready_steps: moment.speech_ready_steps,
            seed: mix(&[
                moment.seed,
                u64::from(moment.episode),
                u64::from(moment.step),
            ]),
        };
        let mut truth = Truth {
            settings: &self.settings,
            now: Life {
                world: world.clone(),
                driver: driver.clone(),
                action,
                value: 0.0,
            },
            silent: &mut self.silent,
        };
        let plan = self.race.decide(&mut truth, start)?;
        let is_sent = |item| self.race.chosen().decision(item) == Some(0);
        let probability = core::array::from_fn(|item| f32::from(u8::from(is_sent(item))));
        let Plan {
            communicated,
            value,
            value_silent,
            cost,
            reasons,
        } = plan;
        Ok(Decision {
            communicated,
            probability,
            value,
            value_silent,
            cost,
            reasons,
        })
    }
}

struct Truth<'a> {
    settings: &'a Settings,
    now: Life,
    silent: &'a mut Vec<Life>,
}

impl Simulation for Truth<'_> {
    fn live(
        &mut self,
        candidates: &[Candidate],
        round: Round,
        values: &mut [f32],
    ) -> Result<bool, PeopleError> {
        let Settings { hold, race, .. } = *self.settings;
        let last = candidates.iter().filter_map(Candidate::begins).max();
        for future in 0..round.count {
            let mut life = self.now.clone();
            life.driver.reseed(round.seed, 0, future as u64);
            self.silent.clear();
            for t in 1..=race.steps {
                if (t - 1) % hold == 0 && last.is_some_and(|last| (t - 1) / hold <= last) {
                    self.silent.push(life.clone());
                }
                life.step(self.settings, t, Communicated::default());
            }
            values[future] = life.value;
            for (c, candidate) in candidates.iter().enumerate().skip(1) {
                let begins = candidate.begins().unwrap_or(0);
                life.clone_from(&self.silent[begins]);
                for t in begins * hold + 1..=race.steps {
                    let told = candidate.told((t - 1) / hold, SECTORS);
                    let told = match (t - 1) % hold {
                        0 => told,
                        _ => Communicated::new(told.visual_bits(), 0),
                    };
                    life.step(self.settings, t, told);
                }
                values[c * round.count + future] = life.value;
            }
        }
        Ok(true)
    }

    fn most_rows(&self) -> usize {
        MOST_ROWS
    }
}

impl Life {
    /// Step t, in which the driver is told something.
    fn step(&mut self, settings: &Settings, t: usize, told: Communicated) {
        if self.world.end() != End::Running {
            return;
        }
        let outcome = self.world.step(self.action);
        self.value +=
            settings.discount.powi(t as i32 - 1) * settings.reward_weight * outcome.reward;
        let observation = self.world.observation();
        // Of what the candidate says the channel is free for: it says one thing in a horizon.
        let mut presenter = Presenter::new(0.0, 1.0);
        let (visual, verbal) = told.bits();
        let shown = presenter.present(0, visual, verbal, &[1.0; SECTORS], observation);
        self.action = self.driver.act(observation, &shown);
    }
}
