//! Belief matching: what is chosen is nearest, deterministic, silent where nothing is gained, and free of allocation.

mod support;

use domains::Mask;
use domains::discrete::{Discrete, Domain, Scene as GridScene, Setting, World};
use domains::highway::modalities::layout;
use domains::highway::{AZIMUTHS, BEAMS};
use models::imagined::{Futures, ImaginedGroups, Moment};
use models::{
    Beliefs, Communicated, HumanModel, Kind, Observations, Posterior, RecurrentHuman,
    RecurrentPolicy, RecurrentSizes, SelfHuman, SelfModel, Sizes,
};
use nn::Tensor;
use planning::items::settings_of;
use planning::planner::GROUPS;
use planning::{
    Assistant, Decision, ImaginedPeople, Items, LocalPeople, Matcher, Method, PeopleError, Settings,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use support::{Start, allocations};

/// A robot, a person, and both beliefs after the same few moments: the road is full of cars.
struct Scene {
    model: Arc<SelfModel>,
    human: Box<dyn HumanModel>,
    person: Beliefs,
    robot: models::Filter,
    groups: ImaginedGroups,
    pending: Vec<Tensor>,
}

fn model() -> Arc<SelfModel> {
    let sizes = Sizes::of(&layout()).with_hidden(48);
    let rng = &mut ChaCha8Rng::seed_from_u64(9);
    Arc::new(SelfModel::new(sizes, layout(), rng))
}

/// Somebody who sees 5 m.
fn short_sighted(model: &Arc<SelfModel>) -> Box<dyn HumanModel> {
    let mut posterior = Posterior::neutral(model, true);
    posterior.hypotheses[0].limits.fill(5.0);
    Box::new(SelfHuman::new(model.clone(), Some(posterior), 0))
}

impl Scene {
    fn new(model: Arc<SelfModel>, mut human: Box<dyn HumanModel>) -> Self {
        let sizes = model.sizes;
        let mut observations = Observations::new(&sizes.shape, 1);
        let visual = observations.visual.column_mut(0);
        for (i, beam) in visual[..BEAMS].iter_mut().enumerate() {
            *beam = (i % 7) as f32 / 12.0;
        }
        let mut encoded = Tensor::new(model.view.rows(), 1);
        model.view.write(
            observations.visual.column(0),
            observations.verbal.column(0),
            Mask {
                visual: (1 << AZIMUTHS) - 1,
                verbal: 0,
            },
            encoded.column_mut(0),
        );
        let action = Tensor::from_slice(2, 1, &[0.3, -0.1]);
        let mut robot = models::Filter::new(sizes.latent, 1);
        let mut person = Beliefs::new(human.latent(), 1);
        for _ in 0..3 {
            robot.update(&model, &action, &encoded);
            let silent = [Communicated::default()];
            human.perceive(&mut person, &action, &observations, &silent, None);
        }
        Self {
            groups: ImaginedGroups::new(&*human, GROUPS, 64),
            pending: vec![Tensor::new(2, 64); GROUPS],
            model,
            human,
            person,
            robot,
        }
    }

    fn plan(&mut self, matcher: &mut Matcher, start: Start) -> Result<Decision, PeopleError> {
        let mut people = LocalPeople {
            model: &mut *self.human,
            person: &self.person,
            groups: &mut self.groups,
            pending: &mut self.pending,
        };
        let from = start.from(&self.robot.mean, &self.robot.deviation);
        matcher.plan(&self.model, from, &mut people)
    }
}

fn matcher(model: &SelfModel) -> Matcher {
    Matcher::new(Settings::default(), model)
}

/// A gridworld's robot, and somebody who sees nothing there by themselves.
fn gridworld(domain: Domain) -> (Arc<SelfModel>, Box<dyn HumanModel>) {
    let scene = GridScene::of(domain, Setting::Transfer);
    let layout = models::words::layout_of(&scene).expect("ships");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let model = Arc::new(SelfModel::new(Sizes::of(&layout), layout, &mut rng));
    let mut posterior = Posterior::neutral(&model, true);
    posterior.hypotheses[0].limits.fill(0.0);
    let human = SelfHuman::new(Arc::clone(&model), Some(posterior), 0);
    (model, Box::new(human))
}

/// Keeps what was asked and answers with a table of divergences.
struct Table(Vec<(Communicated, f32)>);

impl ImaginedPeople for Table {
    fn start(
        &mut self,
        _: usize,
        _: usize,
        _: Futures,
        _: u64,
        _: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        Ok(())
    }

    fn ask(
        &mut self,
        _: usize,
        _: &Observations,
        _: &[Communicated],
        _: u64,
    ) -> Result<(), PeopleError> {
        Ok(())
    }

    fn answer(&mut self, _: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        actions.resize_to(2, 1);
        actions.fill(0.5);
        Ok(())
    }

    fn compare(&mut self, moment: Moment, out: &mut [f32]) -> Result<(), PeopleError> {
        for (out, told) in out.iter_mut().zip(moment.communicated) {
            let known = self.0.iter().find(|(bits, _)| bits == told);
            *out = known.map_or(3.0, |(_, divergence)| *divergence);
        }
        Ok(())
    }
}

#[test]
fn the_nearest_belief_wins_whatever_it_costs_and_silence_wins_a_tie() {
    let scene = Scene::new(model(), short_sighted(&model()));
    let from = Start::default().from(&scene.robot.mean, &scene.robot.deviation);
    let choose = |table: Vec<(Communicated, f32)>| {
        matcher(&scene.model)
            .plan(&scene.model, from, &mut Table(table))
            .expect("answered")
    };
    let most = Communicated::new(0b10_0011, 1 << 4);
    let chosen = choose(vec![(most, 1.0), (Communicated::new(1, 0), 2.0)]);
    assert_eq!(chosen.communicated, most);
    assert_eq!((chosen.value, chosen.value_silent), (-1.0, -3.0));
    assert!(chosen.cost > 0.4);
    // Sector 2 lies behind the display's edge, and two sentences cannot be spoken at once: neither is asked about.
    let impossible = vec![
        (Communicated::new(0b100, 0), 1.0),
        (Communicated::new(0, 3), 0.5),
    ];
    assert_eq!(choose(impossible).communicated, Communicated::default());
}

#[test]
fn whoever_perceives_what_the_robot_does_is_told_nothing() {
    let model = model();
    let everything = Box::new(SelfHuman::new(model.clone(), None, 0));
    let mut scene = Scene::new(model.clone(), everything);
    let decision = scene
        .plan(&mut matcher(&model), Start::default())
        .expect("answered");
    assert_eq!(decision.communicated, Communicated::default());
    assert_eq!(decision.value, 0.0, "the same belief, bit for bit");
}

#[test]
fn whoever_sees_little_is_brought_nearer() {
    let model = model();
    let mut scene = Scene::new(model.clone(), short_sighted(&model));
    let mut matcher = matcher(&model);
    let told = scene
        .plan(&mut matcher, Start::default())
        .expect("answered");
    assert_ne!(told.communicated, Communicated::default());
    assert!(told.value > told.value_silent, "{told:?}");
    // While a sentence is running, only highlights are left.
    let busy = Start {
        speech_ready_steps: 3,
        ..Start::default()
    };
    let shown = scene.plan(&mut matcher, busy).expect("answered");
    assert_eq!(shown.communicated.verbal_bits(), 0);
    assert!(shown.value <= told.value);
}

#[test]
fn the_same_start_gives_the_same_decision_without_allocating() {
    let model = model();
    let mut scene = Scene::new(model.clone(), short_sighted(&model));
    let mut matcher = matcher(&model);
    let first = scene
        .plan(&mut matcher, Start::default())
        .expect("answered");
    let busy = Start {
        speech_ready_steps: 3,
        step: 8,
        ..Start::default()
    };
    scene.plan(&mut matcher, busy).expect("answered");
    let before = allocations();
    assert_eq!(
        scene
            .plan(&mut matcher, Start::default())
            .expect("answered"),
        first
    );
    scene.plan(&mut matcher, busy).expect("answered");
    assert_eq!(allocations() - before, 0);
}

#[test]
fn a_model_with_a_belief_of_its_own_kind_cannot_be_matched() {
    let layout = layout();
    let policy = RecurrentPolicy::new(
        RecurrentSizes::of(&layout, 3),
        &layout,
        &mut ChaCha8Rng::seed_from_u64(2),
    );
    let limits = vec![9.0; AZIMUTHS];
    let human = RecurrentHuman::new(Kind::Bc, Arc::new(policy), &layout, limits, 0);
    let model = model();
    let mut scene = Scene::new(model.clone(), Box::new(human));
    let refused = scene.plan(&mut matcher(&model), Start::default());
    assert!(matches!(refused, Err(PeopleError::Incomparable)));
}

/// In the gridworlds all versions are tried, each once; whoever sees nothing is told something.
#[test]
fn in_gridworlds_every_version_is_tried() {
    for (domain, versions) in [
        (Domain::Driving, 64),
        (Domain::SearchRescue, 16_384),
        (Domain::BombDefusal, 128),
    ] {
        let scene = GridScene::of(domain, Setting::Transfer);
        let words = models::words::shipped(domain).expect("ships");
        let mut world = World::new(&scene, &words).expect("a world");
        world.reset(3, 0, 0);
        let (model, human) = gridworld(domain);
        let layout = Arc::clone(&model.layout);
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        world.observe(&mut visual, &mut verbal);
        let settings = settings_of(scene.planning());
        let items = Arc::clone(&layout);
        let mut assistant = Assistant::new(model, human, settings, Method::Kl, items);
        let silent = Communicated::default();
        let mut action = vec![0.0; layout.actions.rows()];
        assistant.observe(&visual, &verbal, silent, &action, [1, 0, 0]);
        action[0] = 1.0;
        let moment = planning::PlanMoment {
            seed: 1,
            ..Default::default()
        };
        let all = layout.communicable;
        let mut asked = Counting::default();
        let from_all = assistant.search_with(&mut asked, Some(&action), moment);
        assert_eq!(asked.versions.len(), versions, "{domain:?}");
        let mut told = asked.versions.iter().map(|told| told.mask());
        assert!(told.all(|told| told & all == told));
        asked.versions.sort_unstable_by_key(|told| told.0);
        asked.versions.dedup();
        assert_eq!(asked.versions.len(), versions, "none twice");
        // The people of `Counting` are nearest when told everything.
        let most = from_all.expect("answered");
        assert_eq!(most.communicated.mask(), all);
        assert_eq!(
            most.cost,
            Items::cost(&layout, &settings, most.communicated)
        );

        let first = assistant.search(Some(&action), moment).expect("answered");
        assert!(first.value > first.value_silent, "{domain:?} {first:?}");
        assert!(first.communicated != Communicated::default());
        let again = assistant.search(Some(&action), moment).expect("answered");
        assert_eq!(first, again);
        for item in 0..Items::count(&layout) {
            let bit = match item.checked_sub(layout.regions) {
                None => first.communicated.visual(item),
                Some(utterance) => first.communicated.verbal(utterance),
            };
            assert_eq!(assistant.probability(item) == 1.0, bit);
        }
    }
}

/// People who believe the more like the robot the more they are told, and take down what they are asked.
#[derive(Default)]
struct Counting {
    versions: Vec<Communicated>,
}

impl ImaginedPeople for Counting {
    fn start(
        &mut self,
        _: usize,
        _: usize,
        _: Futures,
        _: u64,
        _: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        Ok(())
    }

    fn ask(
        &mut self,
        _: usize,
        _: &Observations,
        _: &[Communicated],
        _: u64,
    ) -> Result<(), PeopleError> {
        Ok(())
    }

    fn answer(&mut self, _: usize, _: &mut Tensor) -> Result<(), PeopleError> {
        Ok(())
    }

    fn compare(&mut self, moment: Moment, out: &mut [f32]) -> Result<(), PeopleError> {
        self.versions.extend_from_slice(moment.communicated);
        for (out, told) in out.iter_mut().zip(moment.communicated) {
            *out = 20.0 - told.0.count_ones() as f32;
        }
        Ok(())
    }
}
