//! Model files and the utterance table: what is written comes back exactly, and what is broken is refused with its name.

mod support;

use models::checkpoint::{
    ModelFileError, digest, load_implants, load_self_model, save_implants, save_self_model,
};
use models::observation::{PER_SECTOR, SECTORS, Shape};
use models::utterances::{Said, UtteranceTable};
use proptest::prelude::*;
use std::path::Path;
use support::{implants, self_model};

const KINDS: [Said; 3] = [Said::Nothing, Said::Slow, Said::Fast];

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary directory")
}

#[test]
fn a_self_model_comes_back_bit_for_bit() {
    let folder = folder();
    let path = folder.path().join("self.safetensors");
    let model = self_model(1);
    save_self_model(&path, &model, "test").expect("written");
    let back = load_self_model(&path).expect("read");
    assert_eq!(back.sizes, model.sizes);
    assert_eq!(digest(&back), digest(&model));
    for ((_, name, a), (_, same, b)) in model.parameters.iter().zip(back.parameters.iter()) {
        assert_eq!((name, a), (same, b));
    }
    assert_ne!(digest(&model), digest(&self_model(2)));
}

#[test]
fn implants_come_back_and_belong_to_one_self_model() {
    let folder = folder();
    let model = self_model(1);
    for with_policy in [true, false] {
        let path = folder.path().join("implants.safetensors");
        let ours = implants(&model, with_policy);
        save_implants(&path, &ours, &model, "test").expect("written");
        let back = load_implants(&path, &model).expect("read");
        assert_eq!(back.has_policy(), with_policy);
        assert_eq!(back.thresholds_m(), ours.thresholds_m());
        for ((_, name, a), (_, same, b)) in ours.parameters.iter().zip(back.parameters.iter()) {
            assert_eq!((name, a), (same, b));
        }
        let error = load_implants(&path, &self_model(2)).expect_err("another self-model");
        assert!(
            matches!(error, ModelFileError::OtherSelfModel { .. }),
            "{error}"
        );
    }
}

#[test]
fn a_file_of_the_other_sort_is_refused() {
    let folder = folder();
    let (one, other) = (folder.path().join("self"), folder.path().join("implants"));
    let model = self_model(1);
    save_self_model(&one, &model, "test").expect("written");
    save_implants(&other, &implants(&model, true), &model, "test").expect("written");
    for error in [
        load_self_model(&other).expect_err("implants are no self-model"),
        load_implants(&one, &model).expect_err("a self-model is no implants"),
    ] {
        assert!(matches!(error, ModelFileError::Holds { .. }), "{error}");
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
    save_self_model(&path, &model, "test").expect("written");
    match load_self_model(&path) {
        Err(ModelFileError::NotFinite {
            tensor, index: 2, ..
        }) => assert_eq!(tensor, name),
        other => panic!("{:?}", other.map(|_| ())),
    }
}

fn refused(path: &Path, bytes: &[u8]) -> String {
    std::fs::write(path, bytes).expect("written");
    let error = load_self_model(path)
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
    let error = load_self_model(&path)
        .map(|_| ())
        .expect_err("missing")
        .to_string();
    assert!(error.contains("broken.safetensors"), "{error}");
    let whole = folder.path().join("whole");
    save_self_model(&whole, &self_model(1), "test").expect("written");
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
        save_self_model(&path, &self_model(1), "test").expect("written");
        let mut bytes = std::fs::read(&path).expect("read");
        bytes[place] = value;
        std::fs::write(&path, &bytes).expect("written");
        let _ = load_self_model(&path);
    }

    #[test]
    fn utterances_survive_a_little_noise(range_m in 0.0_f32..40.0, seed in any::<u64>()) {
        let table = UtteranceTable::shipped().expect("the table ships");
        let mut verbal = vec![0.0; Shape::HIGHWAY.verbal];
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
            let mut verbal = vec![9.0; Shape::HIGHWAY.verbal];
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
    let mut verbal = vec![0.0; Shape::HIGHWAY.verbal];
    table.encode(0, Said::Fast, 1e9, &mut verbal);
    assert_eq!(table.decode(0, &verbal).1, 40.0);
}
