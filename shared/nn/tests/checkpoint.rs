//! Checkpoints: round trips, atomic replacement, clear errors, and arbitrary damage.

use nn::checkpoint::{Checkpoint, CheckpointError, Extra, load, save, to_bytes};
use nn::{Parameters, Tensor};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn parameters(scale: f32) -> Parameters {
    let mut p = Parameters::new();
    let ramp: Vec<f32> = (0..12).map(|i| scale * i as f32).collect();
    p.add("w", Tensor::from_slice(3, 4, &ramp));
    p.add(
        "b",
        Tensor::from_slice(3, 1, &[1.0, f32::NEG_INFINITY, -0.0]),
    );
    p
}

fn metadata() -> BTreeMap<String, String> {
    [("domain", "highway"), ("words", "Ω \"quoted\"")]
        .map(|(k, v)| (k.to_string(), v.to_string()))
        .into()
}

const EXTRAS: [(&str, Extra); 3] = [
    ("replay.rewards", Extra::F32(&[0.5, -1.5, f32::NAN])),
    ("rng", Extra::U64(&[u64::MAX, 3])),
    ("note", Extra::U8(b"seven b")),
];

fn bytes() -> Vec<u8> {
    to_bytes(&[("net", &parameters(0.25))], &EXTRAS, &metadata()).unwrap()
}

#[test]
fn what_is_saved_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    let p = parameters(0.25);
    save(&path, &[("net", &p)], &EXTRAS, &metadata()).unwrap();
    let checkpoint = load(&path).unwrap();
    let mut read = parameters(9.0);
    checkpoint.read("net", &mut read).unwrap();
    assert_eq!(p, read);
    assert_eq!(checkpoint.u64s("rng", 2).unwrap(), [u64::MAX, 3]);
    assert_eq!(checkpoint.u8s("note").unwrap(), b"seven b");
    let rewards = checkpoint.f32s("replay.rewards").unwrap();
    assert_eq!(rewards[..2], [0.5, -1.5]);
    assert!(rewards[2].is_nan());
    assert_eq!(
        checkpoint.tensor("net.w").unwrap(),
        *p.get(p.id("w").unwrap())
    );
    assert_eq!(checkpoint.metadata_value("words").unwrap(), "Ω \"quoted\"");
    assert_eq!(
        checkpoint.names().collect::<Vec<_>>(),
        ["net.b", "net.w", "note", "replay.rewards", "rng"]
    );
    // Equal contents, equal bytes; nothing else is left in the folder.
    assert_eq!(std::fs::read(&path).unwrap(), bytes());
    save(&path, &[("net", &parameters(2.0))], &[], &metadata()).unwrap();
    load(&path).unwrap().read("net", &mut read).unwrap();
    assert_eq!(read, parameters(2.0));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn matrices_lie_row_by_row_as_in_pytorch() {
    let bytes = bytes();
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let view = tensors.tensor("net.w").unwrap();
    assert_eq!(view.shape(), [3, 4]);
    let first: Vec<f32> = view.data().as_chunks::<4>().0[..4]
        .iter()
        .map(|b| f32::from_le_bytes(*b))
        .collect();
    // Column-major ramp: row 0 holds every third number.
    assert_eq!(first, [0.0, 0.75, 1.5, 2.25]);
}

#[test]
fn errors_name_file_tensor_and_shapes() {
    let checkpoint = Checkpoint::from_bytes("a/model.safetensors", &bytes()).unwrap();
    let mut wrong = Parameters::new();
    wrong.add("w", Tensor::new(4, 3));
    let before = wrong.clone();
    let text = checkpoint.read("net", &mut wrong).unwrap_err().to_string();
    for part in ["a/model.safetensors", "net.w", "F32 [3, 4]", "F32 [4, 3]"] {
        assert!(text.contains(part), "{part} not in: {text}");
    }
    wrong.add("absent", Tensor::new(1, 1));
    let text = checkpoint
        .read("other", &mut wrong)
        .unwrap_err()
        .to_string();
    assert!(text.contains("\"other.w\""), "{text}");
    assert_eq!(
        wrong.get(wrong.id("w").unwrap()),
        before.get(before.id("w").unwrap())
    );
    assert!(
        checkpoint
            .u64s("rng", 3)
            .unwrap_err()
            .to_string()
            .contains("U64 [2]")
    );
    assert!(checkpoint.u8s("rng").is_err() && checkpoint.f32s("net.w").is_err());
    assert!(checkpoint.tensor("rng").is_err());
    assert!(checkpoint.metadata_value("nothing").is_err());
    let text = load("/nowhere/model".as_ref()).unwrap_err().to_string();
    assert!(text.contains("/nowhere/model"), "{text}");
    assert!(save("/nowhere/model".as_ref(), &[], &[], &metadata()).is_err());
    let p = parameters(1.0);
    let twice = to_bytes(&[("x", &p), ("x", &p)], &[], &metadata());
    assert!(matches!(twice, Err(CheckpointError::Duplicate { .. })));
}

#[test]
fn other_versions_are_refused() {
    let bytes = bytes();
    let mut other = bytes.clone();
    let key = b"mirror.checkpoint\":\"1";
    let at = other.windows(key.len()).position(|w| w == key).unwrap();
    other[at + key.len() - 1] = b'7';
    let error = Checkpoint::from_bytes("old", &other).unwrap_err();
    assert!(matches!(&error, CheckpointError::Version { found, .. } if found == "7"));
    let foreign = safetensors::serialize(
        Vec::<(String, safetensors::tensor::TensorView)>::new(),
        None,
    )
    .unwrap();
    let error = Checkpoint::from_bytes("foreign", &foreign).unwrap_err();
    assert!(matches!(&error, CheckpointError::Version { found, .. } if found == "none"));
}

#[test]
fn every_truncation_is_noticed() {
    let bytes = bytes();
    for length in 0..bytes.len() {
        assert!(
            Checkpoint::from_bytes("cut", &bytes[..length]).is_err(),
            "{length} bytes"
        );
    }
}

/// Reading may fail or, where only numbers were damaged, succeed; it never panics, and reads no other shape.
fn survive(bytes: &[u8]) {
    if let Ok(checkpoint) = Checkpoint::from_bytes("damaged", bytes) {
        let mut p = parameters(0.0);
        let _ = checkpoint.read("net", &mut p);
        for name in checkpoint.names() {
            let _ = checkpoint.tensor(name);
            let _ = checkpoint.f32s(name);
            let _ = checkpoint.u64s(name, 2);
            let _ = checkpoint.u8s(name);
        }
    }
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Checkpoint::from_bytes("random", &bytes).is_err());
    }

    #[test]
    fn damage_never_panics(changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut bytes = bytes();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        survive(&bytes);
    }

    #[test]
    fn damaged_headers_never_panic(
        digits in proptest::collection::vec((any::<prop::sample::Index>(), "[0-9\\[\\]{},:\"a-zA-Z]"), 1..4)
    ) {
        let mut bytes = bytes();
        let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        for (at, text) in digits {
            bytes[8 + at.index(header)] = text.as_bytes()[0];
        }
        survive(&bytes);
    }

    #[test]
    fn any_matrix_survives_the_trip(rows in 0_usize..9, cols in 0_usize..9, seed in any::<u64>()) {
        let mut p = Parameters::new();
        let mut t = Tensor::new(rows, cols);
        nn::noise::fill(t.data_mut(), seed, 0);
        p.add("x", t);
        let bytes = to_bytes(&[("", &p)], &[], &BTreeMap::new()).unwrap();
        let mut read = Parameters::new();
        read.add("x", Tensor::new(rows, cols));
        Checkpoint::from_bytes("memory", &bytes).unwrap().read("", &mut read).unwrap();
        prop_assert_eq!(p, read);
    }
}
