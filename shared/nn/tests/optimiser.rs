//! Adam and gradient bookkeeping against plain f64 arithmetic.

use nn::{Adam, Gradients, Parameters, Tensor, checkpoint};
use std::collections::BTreeMap;

fn parameters() -> Parameters {
    let mut p = Parameters::new();
    let ramp: Vec<f32> = (0..35).map(|i| 0.1 * i as f32 - 1.0).collect();
    p.add("a", Tensor::from_slice(5, 7, &ramp));
    p.add("b", Tensor::from_slice(3, 1, &[1.0, -2.0, 0.5]));
    p.add("frozen", Tensor::from_slice(2, 1, &[7.0, 8.0]));
    p
}

/// Some gradient of step `t`.
fn set(gradients: &mut Gradients, p: &Parameters, t: usize) {
    for id in p.ids() {
        for (i, g) in gradients.get_mut(id).data_mut().iter_mut().enumerate() {
            *g = ((t * 13 + i * 7) as f32 * 0.37).sin() * (1.0 + i as f32);
        }
    }
}

#[test]
fn adam_follows_its_equations() {
    let mut p = parameters();
    let start = p.clone();
    let ids = vec![p.id("a").unwrap(), p.id("b").unwrap()];
    let mut adam = Adam::new(&p, ids.clone(), 0.01);
    let mut gradients = Gradients::for_params(&p);
    for t in 1..=50 {
        set(&mut gradients, &p, t);
        adam.step(&mut p, &gradients);
    }
    assert_eq!(adam.step, 50);
    for &id in &ids {
        for i in 0..p.get(id).data().len() {
            let (mut x, mut m, mut v) = (f64::from(start.get(id).data()[i]), 0.0_f64, 0.0_f64);
            for t in 1..=50_usize {
                let g = f64::from(((t * 13 + i * 7) as f32 * 0.37).sin() * (1.0 + i as f32));
                m = 0.9 * m + 0.1 * g;
                v = 0.999 * v + 0.001 * g * g;
                let (mh, vh) = (
                    m / (1.0 - 0.9_f64.powi(t as i32)),
                    v / (1.0 - 0.999_f64.powi(t as i32)),
                );
                x -= 0.01 * mh / (vh.sqrt() + 1e-8);
            }
            let found = f64::from(p.get(id).data()[i]);
            assert!((found - x).abs() < 1e-5, "{found} against {x}");
        }
    }
    let frozen = p.id("frozen").unwrap();
    assert_eq!(p.get(frozen), start.get(frozen));
}

#[test]
fn a_saved_optimiser_goes_on_exactly() {
    let mut p = parameters();
    let ids: Vec<_> = p.ids().take(2).collect();
    let mut adam = Adam::new(&p, ids.clone(), 0.01);
    let mut gradients = Gradients::for_params(&p);
    for t in 1..=5 {
        set(&mut gradients, &p, t);
        adam.step(&mut p, &gradients);
    }
    let bytes = checkpoint::to_bytes(
        &[("model", &p), ("adam", adam.moments())],
        &[("adam.step", checkpoint::Extra::U64(&[adam.step]))],
        &BTreeMap::new(),
    )
    .unwrap();
    let read = checkpoint::Checkpoint::from_bytes("memory", &bytes).unwrap();
    let mut p2 = parameters();
    let mut adam2 = Adam::new(&p2, ids, 0.01);
    read.read("model", &mut p2).unwrap();
    adam2.load(&read, "adam").unwrap();
    assert_eq!((&p, &adam), (&p2, &adam2));
    for t in 6..=9 {
        set(&mut gradients, &p, t);
        adam.step(&mut p, &gradients);
        adam2.step(&mut p2, &gradients);
    }
    assert_eq!((&p, &adam), (&p2, &adam2));
    assert!(adam2.load(&read, "elsewhere").is_err());
    assert_eq!(adam, adam2);
}

#[test]
fn gradients_add_up_and_are_clipped() {
    let p = parameters();
    let ids: Vec<_> = p.ids().take(2).collect();
    let (mut a, mut b) = (Gradients::for_params(&p), Gradients::for_params(&p));
    set(&mut a, &p, 1);
    set(&mut b, &p, 2);
    let first = a.clone();
    a.add(&b);
    for id in p.ids() {
        for i in 0..p.get(id).data().len() {
            let sum = first.get(id).data()[i] + b.get(id).data()[i];
            assert_eq!(a.get(id).data()[i], sum);
        }
    }
    let squares: f64 = ids
        .iter()
        .flat_map(|id| a.get(*id).data())
        .map(|g| f64::from(*g).powi(2))
        .sum();
    let norm = a.clip(&ids, 3.0);
    assert!((f64::from(norm) - squares.sqrt()).abs() < 1e-4);
    assert!((a.global_norm(&ids) - 3.0).abs() < 1e-5);
    let unchanged = a.clone();
    assert!(a.clip(&ids, 10.0) <= 3.0001);
    assert_eq!(a, unchanged);
    // The frozen parameter was not among those clipped.
    let frozen = p.id("frozen").unwrap();
    let sum = first.get(frozen).data()[1] + b.get(frozen).data()[1];
    assert_eq!(a.get(frozen).data()[1], sum);
    a.zero_only(&ids);
    assert_eq!(a.global_norm(&ids), 0.0);
    assert_eq!(a.get(frozen).data()[1], sum);
    a.zero();
    assert_eq!(a, Gradients::for_params(&p));
}
