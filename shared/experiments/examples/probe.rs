//! Debugging aid: policy against expert.
use domains::highway::*;
use models::*;
use models::observation::*;
use std::sync::Arc;
fn main() -> anyhow::Result<()> {
    let a: Vec<String> = std::env::args().collect();
    let model = models::checkpoint::load_self_model(a[1].as_ref())?;
    let drive_self = a[2] == "self";
    let scene = Arc::new(Scene::builtin("highway-clear")?);
    let mut world = World::new(scene)?;
    let mut expert = Expert::new(&world);
    for episode in 0..6u32 {
        world.reset(99, episode);
        expert.reset(&world);
        let mut filter = Filter::new(128, 1);
        let mut enc = models::observation::Encoded::new(Shape::HIGHWAY, 1);
        let mut prev = nn::Tensor::new(2, 1);
        let mut dist = models::policy::ActionDistribution::new(2, 1);
        let mut dec = models::self_model::Decoder::default();
        let mut obs = Observations::new(&Shape::HIGHWAY, 1);
        let mut rew = nn::Tensor::new(1, 1);
        let mut last = 0.0;
        for k in 0..250 {
            let step = training::rollout::step_of(world.observation());
            enc.set(0, &step.visual, &[0.0; 120], &[1.0; 36], &[0.0; 6]);
            filter.update(&model, &prev, &enc);
            dist.infer(&model.policy, &model.parameters, &filter.mean);
            dec.observations(&model, &filter.mean, &mut obs);
            dec.reward(&model, &filter.mean, &mut rew);
            let e = expert.act(&world);
            let m = [dist.mean.data()[0].tanh(), dist.mean.data()[1].tanh()];
            if k % 8 == 0 {
                let err: f32 = step.visual.iter().zip(obs.visual.column(0)).map(|(a, b)| (a - b) * (a - b)).sum();
                println!("ep {episode} k {k} ego {:?} expert {e:.2?} policy {m:.2?} dev {:.2?} sse {err:.2} reward {last:.2} decoded {:.2}", step.visual[108..].iter().map(|x| (x*100.0).round()/100.0).collect::<Vec<_>>(), dist.deviation.data(), rew.data()[0]);
            }
            let act = if drive_self { m } else { e };
            prev.data_mut().copy_from_slice(&act);
            let o = world.step(act);
            last = o.reward;
            if o.end != End::Running { println!("end {:?} {} other {}", o.end, k, o.other); break; }
        }
    }
    Ok(())
}
