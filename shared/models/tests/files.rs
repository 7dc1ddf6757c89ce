//! Model files and the utterance table: what is written comes back exactly, and what is broken is refused with its name.

mod support;

use domains::highway::SECTORS;
use domains::highway::modalities::{PER_SECTOR, VERBAL, layout};
use models::file::ModelFileError;
use models::human_file::{HumanError, PersonalPolicy, load_human};
use models::utterances::{Said, UtteranceTable};
use models::{Kind, Posterior, SelfModel};
use proptest::prelude::*;
use std::path::Path;
use std::sync::Arc;
use support::{Domain, follow, implants, posterior};

const KINDS: [Said; 3] = [Said::Nothing, Said::Slow, Said::Fast];

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary directory")
}

fn self_model(seed: u64) -> SelfModel {
    Domain::highway().self_model(seed)
}

#[test]
fn a_self_model_comes_back_bit_for_bit_and_in_its_domain_only() {
    let folder = folder();
    let path = folder.path().join("self.safetensors");
    for domain in Domain::all() {
        let model = domain.self_model(1);
        model.save(&path, "test").expect("written");
        let back = SelfModel::load(&path, Arc::clone(&domain.layout)).expect("read");
        assert_eq!(back.sizes, model.sizes);
        assert_eq!(back.parameters, model.parameters);
        assert_eq!(back.digest(), model.digest());
        assert_ne!(model.digest(), domain.self_model(2).digest());
        for other in Domain::all() {
            if other.name() != domain.name() {
                let error = SelfModel::load(&path, other.layout).expect_err("another domain");
                let error = error.to_string();
                let names = ["self.safetensors", domain.name()];
                assert!(names.iter().all(|name| error.contains(name)), "{error}");
            }
        }
    }
}

#[test]
fn implants_come_back_and_belong_to_one_self_model() {
    let folder = folder();
    let path = folder.path().join("implants.safetensors");
    for domain in Domain::all() {
        let model = domain.self_model(1);
        for with_policy in [true, false] {
            let ours = posterior(&model, with_policy, 5);
            ours.save(&path, &model, 1, "test").expect("written");
            let (back, heard) = Posterior::load(&path, &model).expect("read");
            assert_eq!((back.has_policy(), heard), (with_policy, 1));
            assert_eq!(back.hypotheses, ours.hypotheses);
            assert_eq!(back.weights, ours.weights);
            assert_eq!(back.features, ours.features);
            let stranger = domain.self_model(2);
            let error = Posterior::load(&path, &stranger).expect_err("another self-model");
            let is_said = matches!(error, ModelFileError::OtherSelfModel { .. });
            assert!(is_said, "{error}");
        }
    }
}

#[test]
fn a_file_of_the_other_sort_is_refused() {
    let folder = folder();
    let (one, other) = (folder.path().join("self"), folder.path().join("implants"));
    let model = self_model(1);
    model.save(&one, "test").expect("written");
    let ours = implants(&model, true);
    ours.save(&other, &model, 0, "test").expect("written");
    for error in [
        SelfModel::load(&other, layout()).expect_err("implants are no self-model"),
        Posterior::load(&one, &model).expect_err("a self-model is no implants"),
    ] {
        assert!(matches!(error, ModelFileError::Holds { .. }), "{error}");
    }
}

/// A policy of every kind that has one, of a person with these limits.
fn policy(domain: &Domain, limits: Vec<f32>) -> PersonalPolicy {
    PersonalPolicy {
        policy: domain.policy(2, 7),
        limits,
        heard: 0,
    }
}

/// What was learned of a person comes back as the model that it was, and nothing else does.
#[test]
fn learned_people_are_read_as_what_they_are() {
    let folder = folder();
    let path = |kind: Kind| folder.path().join(format!("{}.safetensors", kind.name()));
    for domain in Domain::all() {
        let model = Arc::new(domain.self_model(3));
        for (kind, with_policy) in [(Kind::Mirror, true), (Kind::MirrorP, false)] {
            let implants = implants(&model, with_policy);
            implants
                .save(&path(kind), &model, 0, "test")
                .expect("written");
        }
        let note = [("mirror.note", "x".into())];
        let person = policy(&domain, domain.limits());
        for kind in [Kind::Bc, Kind::Sqil] {
            let layout = &domain.layout;
            person
                .save(&path(kind), kind, layout, "test", &note)
                .expect("written");
            let back = PersonalPolicy::load(&path(kind), kind, layout).expect("read");
            assert_eq!(back.policy.parameters, person.policy.parameters);
            assert_eq!((&back.limits, back.heard), (&person.limits, person.heard));
            // The same person as before, step by step.
            let mut made = person.clone().human(kind, layout);
            let mut read = load_human(Some(&path(kind)), kind, &model).expect("read");
            let steps = domain.steps(&made, 2, 4, 3);
            assert_eq!(follow(&mut made, &steps), follow(&mut *read, &steps));
        }
        for kind in Kind::ALL {
            let file = path(kind);
            let file = kind.learns().then_some(file.as_path());
            match load_human(file, kind, &model) {
                Ok(human) => assert_eq!(human.kind(), kind.name()),
                // Made of the person, not of a file.
                Err(error) => assert!(matches!(error, HumanError::Nobody), "{error}"),
            }
            let others = Kind::ALL.into_iter().filter(|other| *other != kind);
            for other in others.filter(|other| file.is_some() || other.learns()) {
                let error = match load_human(file, other, &model) {
                    Err(error) => error.to_string(),
                    Ok(_) => panic!("{file:?} was read as {other:?}"),
                };
                let named = file.and_then(|f| f.file_name()?.to_str());
                assert!(error.contains(named.unwrap_or(other.name())), "{error}");
            }
        }
        for other in Domain::all() {
            if other.name() == domain.name() {
                continue;
            }
            let other = Arc::new(other.self_model(3));
            for kind in [Kind::Bc, Kind::Mirror] {
                let error = load_human(Some(&path(kind)), kind, &other).err();
                let error = error.expect("another domain").to_string();
                assert!(error.contains(domain.name()), "{error}");
            }
        }
    }
}

#[test]
fn a_damaged_policy_is_refused_with_its_place() {
    let folder = folder();
    for domain in Domain::all() {
        let load = |name: &str| {
            let read = PersonalPolicy::load(&folder.path().join(name), Kind::Bc, &domain.layout);
            read.map(drop).map_err(|error| error.to_string())
        };
        let save = |name: &str, limits: Vec<f32>| {
            let (path, person) = (folder.path().join(name), policy(&domain, limits));
            let saved = person.save(&path, Kind::Bc, &domain.layout, "test", &[]);
            saved.expect("written");
        };
        save("whole", domain.limits());
        let whole = std::fs::read(folder.path().join("whole")).expect("read");
        std::fs::write(folder.path().join("cut"), &whole[..whole.len() - 40]).expect("written");
        let error = load("cut").expect_err("cut");
        assert!(error.contains("cut"), "{error}");
        let many = domain.limits();
        let longer = [many.clone(), vec![1.0]].concat();
        for wrong in [longer, vec![-1.0; many.len()], vec![f32::NAN; many.len()]] {
            save("limits", wrong);
            let error = load("limits").expect_err("wrong limits");
            assert!(error.contains("\"limits\""), "{error}");
        }
    }
}

#[test]
fn a_number_that_is_none_is_refused_with_its_place() {
    let folder = folder();
    let path = folder.path().join("self.safetensors");
    let mut model = self_model(1);
    let (id, name) = model
        .parameters
        .iter()
        .nth(3)
        .map(|(id, name, _)| (id, name.to_owned()))
        .expect("parameters");
    model.parameters.get_mut(id).data_mut()[2] = f32::NAN;
    model.save(&path, "test").expect("written");
    match SelfModel::load(&path, layout()) {
        Err(ModelFileError::NotFinite {
            tensor, index: 2, ..
        }) => assert_eq!(tensor, name),
        other => panic!("{:?}", other.map(|_| ())),
    }
}

fn refused(path: &Path, bytes: &[u8]) -> String {
    std::fs::write(path, bytes).expect("written");
    let error = SelfModel::load(path, layout())
        .map(|_| ())
        .expect_err("refused")
        .to_string();
    assert!(error.contains("broken.safetensors"), "{error}");
    error
}

#[test]
fn missing_and_truncated_files_are_errors_that_name_them() {
    let folder = folder();
    let path = folder.path().join("broken.safetensors");
    let error = SelfModel::load(&path, layout())
        .map(|_| ())
        .expect_err("missing")
        .to_string();
    assert!(error.contains("broken.safetensors"), "{error}");
    let whole = folder.path().join("whole");
    self_model(1).save(&whole, "test").expect("written");
    let bytes = std::fs::read(&whole).expect("read");
    for length in [0, 1, 7, 8, 9, 100, bytes.len() / 2, bytes.len() - 1] {
        refused(&path, &bytes[..length]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let folder = folder();
        refused(&folder.path().join("broken.safetensors"), &bytes);
        prop_assert!(UtteranceTable::from_bytes(&bytes).is_err());
    }

    /// A damaged byte in the header is refused or harmless; it never panics.
    #[test]
    fn a_damaged_header_never_panics(place in 0_usize..2000, value in any::<u8>()) {
        let folder = folder();
        let path = folder.path().join("damaged.safetensors");
        self_model(1).save(&path, "test").expect("written");
        let mut bytes = std::fs::read(&path).expect("read");
        bytes[place] = value;
        std::fs::write(&path, &bytes).expect("written");
        let _ = SelfModel::load(&path, layout());
    }

    #[test]
    fn utterances_survive_a_little_noise(range_m in 0.0_f32..40.0, seed in any::<u64>()) {
        let table = UtteranceTable::shipped().expect("the table ships");
        let mut verbal = vec![0.0; VERBAL];
        let mut noise = vec![0.0; verbal.len()];
        nn::noise::fill(&mut noise, seed, 0);
        for sector in 0..SECTORS {
            for said in KINDS {
                table.encode(sector, said, range_m, &mut verbal);
                let (heard, heard_m) = table.decode(sector, &verbal);
                prop_assert_eq!(heard, said);
                prop_assert!((heard_m - range_m).abs() < 1e-4);
                let noisy: Vec<f32> = verbal.iter().zip(&noise).map(|(v, n)| v + 0.01 * n).collect();
                prop_assert_eq!(table.decode(sector, &noisy).0, said);
            }
        }
    }
}

#[test]
fn every_utterance_has_its_own_numbers_and_touches_its_own_sector_only() {
    let table = UtteranceTable::shipped().expect("the table ships");
    let mut seen: Vec<Vec<f32>> = Vec::new();
    for sector in 0..SECTORS {
        for said in KINDS {
            let mut verbal = vec![9.0; VERBAL];
            table.encode(sector, said, 20.0, &mut verbal);
            for (i, x) in verbal.iter().enumerate() {
                assert_eq!(
                    *x == 9.0,
                    i / PER_SECTOR != sector,
                    "number {i} of sector {sector}"
                );
            }
            let own = verbal[sector * PER_SECTOR..][..PER_SECTOR].to_vec();
            assert_eq!(own[PER_SECTOR - 1], 0.5);
            assert!(
                !seen.contains(&own),
                "{sector} {said:?} sounds like another"
            );
            seen.push(own);
        }
    }
    // Ranges beyond the LIDAR's are its end.
    let mut verbal = vec![0.0; VERBAL];
    table.encode(0, Said::Fast, 1e9, &mut verbal);
    assert_eq!(table.decode(0, &verbal).1, 40.0);
}
