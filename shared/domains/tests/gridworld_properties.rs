//! What every gridworld promises, whatever is done in it: rewards by term, ends, masks, determinism.

use domains::Mask;
use domains::discrete::{
    Discrete, Domain, End, MAX_TERMS, Mind, Scene, Setting, SimulatedPerson, Words, World,
};
use domains::driving::{self, Car, Reward, SWITCH, advance, reward_terms, visible};
use domains::{bomb_defusal, search_rescue};
use proptest::prelude::*;

fn words_of(scene: &Scene) -> Words {
    Words::indicator(scene.sentences().len())
}

fn world_of(scene: &Scene) -> World {
    World::new(scene, &words_of(scene)).unwrap()
}

fn observed(world: &World) -> (Vec<f32>, Vec<f32>) {
    let layout = world.layout();
    let (mut visual, mut verbal) = (vec![f32::NAN; layout.visual], vec![f32::NAN; layout.verbal]);
    world.observe(&mut visual, &mut verbal);
    (visual, verbal)
}

fn any_scene() -> impl Strategy<Value = Scene> {
    let settings = prop_oneof![Just(Setting::Original), Just(Setting::Transfer)];
    (0usize..3, settings).prop_map(|(domain, setting)| Scene::of(Domain::ALL[domain], setting))
}

/// What the paper's appendix says that a step is worth, computed from what can be seen before and after.
fn expected_terms(before: &World, action: usize, after: &World) -> [f32; MAX_TERMS] {
    let mut terms = [0.0; MAX_TERMS];
    match (before, after) {
        (World::Driving(before), World::Driving(after)) => {
            let lane = before.lane() ^ usize::from(action == SWITCH);
            let here = |car: &Car, slot: usize| slot % 2 == lane && car.cell == 0;
            let near = after.cars().iter().enumerate();
            if near
                .clone()
                .any(|(s, c)| s % 2 == lane && c.cell.abs() <= 2)
            {
                terms[0] = -2.0;
            }
            let hit = near.clone().any(|(s, c)| here(c, s))
                || (action == SWITCH && before.cars().iter().enumerate().any(|(s, c)| here(c, s)));
            if hit {
                terms[1] = -5.0;
            }
            if action == SWITCH {
                terms[2] = -1.0;
            }
        }
        (World::SearchRescue(before), World::SearchRescue(after)) => {
            terms[3] = -0.1;
            let ahead = search_rescue::neighbour(before.person(), action);
            if ahead.is_some() && ahead == before.obstacle().cell() {
                terms[2] = -10.0;
                assert_eq!(
                    before.person(),
                    after.person(),
                    "an obstacle cannot be entered"
                );
            }
            if after.found() && !before.found() {
                terms[0] = 1.0;
                assert_eq!(
                    search_rescue::subgoal_at(after.person()),
                    Some(3 + after.place())
                );
            }
            if after.found() && after.person() == search_rescue::Cell::ENTRANCE {
                terms[1] = 15.0;
            }
        }
        (World::BombDefusal(before), World::BombDefusal(after)) => {
            terms[2] = -1.0;
            if action == before.button() {
                terms[0] = 5.0;
                assert_eq!(after.stage(), before.stage() + 1);
            } else if action < bomb_defusal::BUTTONS {
                terms[1] = -5.0;
                assert_eq!(after.stage(), before.stage());
            } else {
                assert_eq!(
                    after.glyphs(),
                    before.glyphs(),
                    "waiting changes no terminal"
                );
            }
            let live = after
                .glyphs()
                .iter()
                .filter(|g| **g as usize == bomb_defusal::LIVE);
            assert_eq!(live.count(), 1);
        }
        _ => unreachable!("a world keeps its domain"),
    }
    terms
}

proptest! {
    #[test]
    fn any_round_keeps_its_promises(
        scene in any_scene(),
        seed in any::<u64>(),
        episode in any::<u32>(),
        scenario in any::<u32>(),
        actions in prop::collection::vec(0usize..6, 80),
    ) {
        let mut world = world_of(&scene);
        let mut twin = world_of(&scene);
        twin.reset(seed ^ 1, episode.wrapping_add(1), scenario.wrapping_add(1));
        twin.step(0);
        world.reset(seed, episode, scenario);
        twin.reset(seed, episode, scenario);
        prop_assert_eq!(world.scenario(), scenario % world.scenarios());
        for (step, &action) in actions.iter().enumerate() {
            let (visual, verbal) = observed(&world);
            prop_assert_eq!((&visual, &verbal), (&observed(&twin).0, &observed(&twin).1), "same seed, same bytes");
            prop_assert!(visual.iter().chain(&verbal).all(|x| x.abs() <= 1.0), "finite and within [−1, 1]");
            let running = world.end().is_running();
            let action = action.min(world.layout().actions.rows() - 1);
            let before = world.clone();
            let legal = world.legal(action);
            let outcome = world.step(action);
            prop_assert_eq!(outcome, twin.step(action));
            prop_assert_eq!(outcome.end, world.end());
            prop_assert_eq!(outcome.reward, outcome.terms.iter().sum::<f32>());
            if running {
                prop_assert_eq!(outcome.terms, expected_terms(&before, action, &world));
                prop_assert_eq!(world.steps() as usize, step + 1);
                if !legal {
                    let stayed = matches!((&before, &world), (World::SearchRescue(a), World::SearchRescue(b)) if a.person() == b.person());
                    prop_assert!(stayed, "what is not legal moves nobody");
                }
                let names_collision = match scene.domain() {
                    Domain::Driving => outcome.terms[1] < 0.0,
                    Domain::SearchRescue => outcome.terms[2] < 0.0,
                    Domain::BombDefusal => false,
                };
                prop_assert_eq!(outcome.collided, names_collision);
            } else {
                prop_assert_eq!(outcome.reward, 0.0, "nothing happens after the end");
                prop_assert_eq!(world.steps(), before.steps());
            }
            prop_assert!(world.steps() <= scene.max_steps());
            prop_assert_eq!(world.end().is_running(), world.end() == End::Running);
            let mut picture = String::new();
            world.render(&mut picture);
            prop_assert!(picture.ends_with('\n') && picture.lines().count() >= 3);
        }
        prop_assert!(!world.end().is_running(), "every round ends");
    }

    /// A person's choice depends on nothing that they do not perceive: neither on hidden pixels nor on unsaid words.
    #[test]
    fn what_is_hidden_changes_nothing(
        scene in any_scene(),
        seed in any::<u64>(),
        scenario in 0u32..9,
        id in 1u32..=10,
        masks in prop::collection::vec((any::<u64>(), any::<u32>()), 12),
        noise in -3.0f32..3.0,
    ) {
        let words = words_of(&scene);
        let mut world = world_of(&scene);
        let layout = world.layout().clone();
        let mut person = SimulatedPerson::builtin(&scene, id, &words).unwrap();
        world.reset(seed, 0, scenario);
        person.reset(seed, 0);
        let mut other = person.clone();
        for (visual_bits, verbal_bits) in masks {
            let (visual, verbal) = observed(&world);
            let perceived = Mask { visual: visual_bits, verbal: verbal_bits } & layout.everything();
            let (mut hidden, mut unsaid) = (visual.clone(), verbal.clone());
            layout.hide(perceived, &mut hidden, &mut unsaid);
            for (number, value) in hidden.iter_mut().enumerate() {
                let seen = layout.is_seen(number, perceived);
                prop_assert_eq!(*value, if seen { visual[number] } else { 0.0 });
                if !seen {
                    *value = noise;
                }
            }
            for (number, value) in unsaid.iter_mut().enumerate() {
                if !perceived.hears(layout.verbal_utterance[number] as usize) {
                    prop_assert_eq!(*value, 0.0);
                    *value = noise;
                }
            }
            person.perceive(&visual, &verbal, perceived);
            other.perceive(&hidden, &unsaid, perceived);
            let (mut p, mut q) = (vec![0.0; layout.actions.rows()], vec![0.0; layout.actions.rows()]);
            person.clone().probabilities(&mut p);
            other.clone().probabilities(&mut q);
            prop_assert_eq!(&p, &q);
            prop_assert!(p.iter().all(|p| (0.0..=1.0).contains(p)));
            prop_assert!((p.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            let action = person.act();
            prop_assert!(p[action] > 0.0, "what is done was possible");
            prop_assert_eq!(action, other.act());
            world.step(action);
        }
    }

    #[test]
    fn cars_never_overlap_and_only_the_dangerous_one_comes_near(
        seed in any::<u64>(),
        scenario in 0u32..8,
        actions in prop::collection::vec(0usize..2, 14),
    ) {
        let scene = Scene::of(Domain::Driving, Setting::Original);
        let World::Driving(mut world) = world_of(&scene) else { unreachable!() };
        world.reset(seed, 0, scenario);
        for action in actions {
            let before = *world.cars();
            world.step(action);
            for lane in 0..2 {
                let (a, b) = (world.cars()[lane], world.cars()[lane + 2]);
                prop_assert_ne!(a.cell, b.cell);
            }
            for slot in 0..4 {
                let moved = world.cars()[slot].cell - before[slot].cell;
                prop_assert!(moved.abs() <= 1 || slot % 2 == world.dangerous() % 2, "a cell a step");
                if slot != world.dangerous() {
                    prop_assert!(world.cars()[slot].cell.abs() >= 3);
                }
            }
        }
    }

    #[test]
    fn fog_hides_by_lane_and_direction(
        cells in prop::array::uniform4(-10i32..=10),
        limits in prop::array::uniform4(0u32..=10),
    ) {
        let visual: Vec<f32> = std::iter::once(-1.0).chain(cells.iter().map(|c| *c as f32 / 10.0)).collect();
        let bits = visible(&limits.map(|l| l as f32), &visual);
        for slot in 0..4 {
            let limit = limits[slot % 2 + if cells[slot] < 0 { 2 } else { 0 }];
            prop_assert_eq!(bits >> slot & 1 == 1, cells[slot].unsigned_abs() <= limit);
        }
    }

    #[test]
    fn smoke_hides_portions_by_their_centre(row in 0usize..9, column in 0usize..9, radius in 0.0f32..13.0) {
        let mut visual = vec![0.0; search_rescue::VISUAL];
        visual[search_rescue::IMAGE] = (row as f32 - 4.0) / 4.0;
        visual[search_rescue::IMAGE + 1] = (column as f32 - 4.0) / 4.0;
        prop_assert_eq!(search_rescue::position_in(&visual), search_rescue::Cell::new(row, column));
        let bits = search_rescue::visible(radius, &visual);
        for portion in 0..9 {
            let (r, c) = (portion / 3 * 3 + 1, portion % 3 * 3 + 1);
            let squared = row.abs_diff(r).pow(2) + column.abs_diff(c).pow(2);
            if (radius * radius - squared as f32).abs() > 1e-3 {
                prop_assert_eq!(bits >> portion & 1 == 1, squared as f32 <= radius * radius);
            }
        }
        let own = row / 3 * 3 + column / 3;
        prop_assert_eq!(search_rescue::visible(1.5, &visual), 1 << own, "the paper's radius is the portion that one stands in");
    }
}

#[test]
fn collisions_are_cells_shared() {
    let reward = Reward::default();
    let far = Car { cell: 9, speed: 0 };
    let hits = |lane: usize, action: usize, slot: usize, car: Car| {
        let mut before = [far; 4];
        before[2].cell = -9;
        before[3].cell = -9;
        before[slot] = car;
        let mut after = before;
        advance(&mut after);
        reward_terms(&reward, lane, action, &before, &after)
    };
    let at = |cell, speed| Car { cell, speed };
    // A car ahead in the own lane that loses a cell: hit when staying, passed when switching.
    assert!(hits(0, driving::STAY, 0, at(1, -1)).1);
    assert!(!hits(0, SWITCH, 0, at(1, -1)).1);
    // A car behind that gains one.
    assert!(hits(1, driving::STAY, 3, at(-1, 1)).1);
    // Into a car alongside, though it would be gone a step later.
    assert!(hits(1, SWITCH, 0, at(0, -1)).1);
    assert!(!hits(1, driving::STAY, 0, at(0, -1)).1);
    // Within two cells: the proximity penalty alone, whichever side.
    for (cell, near) in [(2, true), (3, false), (-2, true), (-3, false)] {
        let (terms, collided) = hits(0, driving::STAY, 0, at(cell, 0));
        assert_eq!(terms, [if near { -2.0 } else { 0.0 }, 0.0, 0.0, 0.0]);
        assert!(!collided);
    }
}

#[test]
fn layouts_are_consistent() {
    for domain in Domain::ALL {
        let world = world_of(&Scene::of(domain, Setting::Transfer));
        let layout = world.layout();
        assert_eq!(layout.domain, domain.name());
        assert_eq!(layout.number, domain.number());
        assert_eq!(layout.visual_region.len(), layout.visual);
        assert_eq!(layout.verbal_utterance.len(), layout.verbal);
        assert_eq!(layout.action_names.len(), layout.actions.rows());
        assert_eq!(layout.region_names.len(), layout.regions);
        assert_eq!(layout.utterance_names.len(), layout.utterances);
        for region in 0..layout.regions {
            let governed = layout
                .visual_region
                .iter()
                .filter(|r| **r == Some(region as u8));
            let expected = match domain {
                Domain::Driving => 1,
                Domain::SearchRescue => 27,
                Domain::BombDefusal => 25,
            };
            assert_eq!(governed.count(), expected);
        }
        assert_eq!(
            layout.communicable & layout.everything(),
            layout.communicable
        );
        if let Some(image) = layout.image {
            for size in [image.height, image.width] {
                assert_eq!(
                    (size - image.kernel) % image.stride,
                    0,
                    "every pixel is convolved"
                );
            }
            assert!(image.len() < layout.visual);
        }
        let three = Mask {
            visual: 0b11,
            verbal: 0b1,
        };
        let (visual, verbal) = match domain {
            Domain::Driving => (0.01, 0.03),
            Domain::SearchRescue => (0.02, 0.1),
            Domain::BombDefusal => (0.3, 0.5),
        };
        assert!((layout.cost(three) - (4.0 * visual + verbal)).abs() < 1e-6);
    }
}

/// A portion of the map is exactly a window of the convolution.
#[test]
fn a_portion_is_a_window() {
    let world = world_of(&Scene::of(Domain::SearchRescue, Setting::Transfer));
    let layout = world.layout();
    let image = layout.image.unwrap();
    assert_eq!(image.convolved(), (3, 3));
    for (pixel, region) in layout.visual_region.iter().take(image.len()).enumerate() {
        let (row, column) = (pixel % 81 / 9, pixel % 9);
        let window = row / image.stride * 3 + column / image.stride;
        assert_eq!(*region, Some(window as u8));
    }
}
