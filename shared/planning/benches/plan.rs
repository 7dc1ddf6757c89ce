//! One highway plan with untrained weights of the paper's sizes: in one thread, and with the human model in a second thread,
//! as the planner and human processes share the work. `race`: cars all around, every candidate there is; where nothing that is
//! communicated gains anything the race ends with its first round, where costs are nothing it goes on as long as it can. `ce`:
//! 1000 futures × 3 iterations × 8 steps.
//!
//! Before the wall-clock figures it prints each side's processor time, which other programs on the machine hardly move.
//!
//! `cargo bench -p planning --bench plan`

use criterion::{Criterion, criterion_group, criterion_main};
use domains::highway::modalities::layout;
use models::imagined::ImaginedGroups;
use models::{Beliefs, Posterior, SelfHuman, SelfModel, Sizes};
use nn::Tensor;
use planning::planner::{From, GROUPS};
use planning::{Chooser, LocalPeople, Method, Settings, ThreadedPeople};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::sync::Arc;

/// Processor time so far, in ns: of this thread, and of all others, which is the human model's.
fn cpu_ns() -> [u64; 2] {
    let read = |clock| {
        let mut time = libc::timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        // SAFETY: `time` is a valid timespec; these clocks exist on every Linux.
        unsafe { libc::clock_gettime(clock, &mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    };
    let own = read(libc::CLOCK_THREAD_CPUTIME_ID);
    [
        own,
        read(libc::CLOCK_PROCESS_CPUTIME_ID).saturating_sub(own),
    ]
}

struct Setting {
    model: Arc<SelfModel>,
    mean: Tensor,
    deviation: Tensor,
    person: Beliefs,
}

impl Setting {
    fn new() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut model = SelfModel::new(Sizes::of(&layout()), layout(), &mut rng);
        // There are cars all around.
        let bias = model.visual.layers[2].bias;
        model.parameters.get_mut(bias).fill(0.5);
        let model = Arc::new(model);
        let latent = model.sizes.latent;
        let mut mean = Tensor::new(latent, 1);
        nn::noise::fill(mean.data_mut(), 5, 0);
        let mut deviation = Tensor::new(latent, 1);
        deviation.fill(0.3);
        let mut person = Beliefs::new(latent, 1);
        person.fresh = false;
        person.mean.copy_from(&mean);
        person.deviation.copy_from(&deviation);
        Self {
            model,
            mean,
            deviation,
            person,
        }
    }

    fn human(&self) -> SelfHuman {
        let implants = Posterior::neutral(&self.model, true);
        SelfHuman::new(self.model.clone(), Some(implants), 0)
    }

    fn from(&self, step: u32, speech_ready_steps: usize) -> From<'_> {
        From {
            mean: &self.mean,
            deviation: &self.deviation,
            known_action: Some([0.4, 0.0]),
            speech_ready_steps,
            seed: 1,
            episode: 0,
            step,
            until: None,
        }
    }
}

/// What is measured: how it is decided, with which settings, and when the next sentence may start.
struct Case {
    name: &'static str,
    method: Method,
    settings: Settings,
    ready: usize,
}

fn cases() -> [Case; 5] {
    let settings = Settings::default();
    let free = Settings {
        visual_cost: 0.0,
        verbal_cost: 0.0,
        ..settings
    };
    let case = |name, method, settings, ready| Case {
        name,
        method,
        settings,
        ready,
    };
    [
        case("race, nothing gains", Method::Race, settings, 0),
        case("race, to its end", Method::Race, free, 0),
        case("race, may not speak", Method::Race, free, 24),
        case("ce, may speak", Method::Ce, settings, 0),
        // While an utterance is running nothing can be said: fewer bits matter.
        case("ce, may not speak", Method::Ce, settings, 24),
    ]
}

/// Prints what a plan costs each side, on average over `PLANS` plans after one to warm up, and what was imagined for it.
fn processor_time(setting: &Setting, case: &Case) {
    const PLANS: u32 = 20;
    let mut planner = Chooser::new(case.method, case.settings, &setting.model);
    let shape = setting.model.sizes.shape;
    let rows = case.settings.most_rows();
    let mut people = ThreadedPeople::spawn(setting.human(), setting.person.clone(), rows, &shape);
    let mut before = [0; 2];
    let (mut imagined, mut futures) = (0, 0);
    for step in 0..=PLANS {
        let from = setting.from(step, case.ready);
        let plan = planner.plan(&setting.model, from, &mut people);
        let reasons = black_box(plan.expect("the other thread answers")).reasons;
        if step == 0 {
            before = cpu_ns();
        } else {
            imagined += reasons.rows;
            futures += reasons.futures;
        }
    }
    let ms = |now: u64, before: u64| (now - before) as f64 / 1e6 / f64::from(PLANS);
    let after = cpu_ns();
    let (planning, human) = (ms(after[0], before[0]), ms(after[1], before[1]));
    let name = case.name;
    println!(
        "processor time of a plan, {name}: planner {planning:.1} ms, human model {human:.1} ms; {} lives on {} futures",
        imagined / PLANS,
        futures / PLANS
    );
}

fn plan(c: &mut Criterion) {
    let setting = Setting::new();
    for case in &cases() {
        processor_time(&setting, case);
    }
    let mut group = c.benchmark_group("plan");
    group.sample_size(30);
    for case in &cases() {
        let rows = case.settings.most_rows();
        group.bench_function(format!("one thread, {}", case.name), |b| {
            let mut planner = Chooser::new(case.method, case.settings, &setting.model);
            let mut human = setting.human();
            let mut groups = ImaginedGroups::new(&human, GROUPS, rows);
            let mut pending = vec![Tensor::new(2, rows); GROUPS];
            let mut step = 0;
            b.iter(|| {
                step += 1;
                let mut people = LocalPeople {
                    model: &mut human,
                    person: &setting.person,
                    groups: &mut groups,
                    pending: &mut pending,
                };
                let from = setting.from(step, case.ready);
                black_box(
                    planner
                        .plan(&setting.model, from, &mut people)
                        .expect("local people answer"),
                )
            });
        });
        group.bench_function(format!("two threads, {}", case.name), |b| {
            let mut planner = Chooser::new(case.method, case.settings, &setting.model);
            let shape = setting.model.sizes.shape;
            let mut people =
                ThreadedPeople::spawn(setting.human(), setting.person.clone(), rows, &shape);
            let mut step = 0;
            b.iter(|| {
                step += 1;
                let from = setting.from(step, case.ready);
                black_box(
                    planner
                        .plan(&setting.model, from, &mut people)
                        .expect("the other thread answers"),
                )
            });
        });
    }
    group.finish();
}

criterion_group!(benches, plan);
criterion_main!(benches);
