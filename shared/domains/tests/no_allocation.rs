//! Neither stepping nor observing a world allocates, nor do the people in it.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use domains::discrete::{self, Discrete, Domain, Mind, Setting, SimulatedPerson, Words};
use domains::highway::{
    Case, Cockpit, End, Expert, Observation, Person, Scene, Shown, SimulatedDriver, World,
};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is passed on to the system allocator unchanged; counting touches a constant-initialised thread-local
// that needs no allocation itself.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps GlobalAlloc's contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps GlobalAlloc's contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations() -> u64 {
    ALLOCATIONS.with(Cell::get)
}

#[test]
fn a_round_allocates_nothing() {
    let scene = Arc::new(Scene::builtin("highway-fog").unwrap());
    let mut world = World::new(Arc::clone(&scene)).unwrap();
    let mut expert = Expert::new(&world);
    let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
    let mut driver = SimulatedDriver::new(&Person::builtin(1).unwrap(), &scene.fog(), cockpit);
    let mut observation = Observation::default();
    let before = allocations();
    drop(std::hint::black_box(Box::new(1)));
    assert_eq!(allocations(), before + 1, "the counter counts");
    for case in Case::ALL {
        world.reset_case(1, 0, case);
        driver.reset(1, 0);
        let before = allocations();
        let mut steps = 0;
        while world.end() == End::Running {
            world.observe(&mut observation);
            let silent = driver.act(&observation, &Shown::default());
            let action = expert.act(&world);
            std::hint::black_box((silent, world.step(action)));
            steps += 1;
        }
        assert!(steps > 100);
        assert_eq!(allocations(), before, "case {}", case.number());
    }
}

#[test]
fn a_round_of_a_gridworld_allocates_nothing() {
    for domain in Domain::ALL {
        for setting in [Setting::Original, Setting::Transfer] {
            let scene = discrete::Scene::of(domain, setting);
            let words = Words::indicator(scene.sentences().len());
            let mut world = discrete::World::new(&scene, &words).unwrap();
            let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
            let layout = world.layout().clone();
            let mut visual = vec![0.0; layout.visual];
            let mut verbal = vec![0.0; layout.verbal];
            let mut probabilities = vec![0.0; layout.actions.rows()];
            let before = allocations();
            for scenario in 0..world.scenarios() {
                world.reset(1, 0, scenario);
                person.reset(1, 0);
                while world.end().is_running() {
                    world.observe(&mut visual, &mut verbal);
                    let seen = person.look(&visual);
                    person.perceive(&visual, &verbal, seen | layout.communicable);
                    // Imagination: copies of person and world.
                    let (mut imagined, mut future) = (person.clone(), world.clone());
                    imagined.reseed(1, 0, 2);
                    imagined.probabilities(&mut probabilities);
                    std::hint::black_box(future.step(imagined.act()));
                    std::hint::black_box(world.expert());
                    world.step(person.act());
                }
            }
            assert_eq!(allocations(), before, "{domain:?} {setting:?}");
        }
    }
}
