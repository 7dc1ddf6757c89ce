//! Settings from files: what is printed gives the same bytes, what is changed is used, and what nobody understands is
//! refused with its place.

mod common;

use common::{Bench, mirror, run, told};
use models::SelfModel;
use models::words::layout_of;
use std::path::Path;
use std::process::Output;

fn train(domain: &str, out: &Path, config: Option<&Path>) -> Output {
    let mut command = mirror();
    command.args(["train", "self", "--domain", domain, "--seed", "5"]);
    let count = match domain {
        "highway" => "--episodes",
        _ => "--phases",
    };
    command.args([count, "1", "--out"]).arg(out);
    if let Some(config) = config {
        command.arg("--config").arg(config);
    }
    run(&mut command)
}

fn printed(words: &[&str]) -> String {
    let output = run(mirror().args(words).arg("--print-config"));
    assert!(output.status.success(), "{}", told(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// A model's tensors, without the metadata, in which the command stands.
fn tensors(path: &Path) -> Vec<u8> {
    let bytes = std::fs::read(path).unwrap();
    let head = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    bytes[8 + head..].to_vec()
}

#[test]
fn what_is_printed_gives_the_same_bytes() {
    let bench = Bench::new();
    for domain in ["driving", "bomb_defusal"] {
        let text = printed(&["train", "self", "--domain", domain]);
        let config = bench.write(&format!("{domain}.toml"), &text);
        let (plain, own) = (bench.path("plain"), bench.path("own"));
        for (out, config) in [(&plain, None), (&own, Some(config.as_path()))] {
            let output = train(domain, out, config);
            assert!(output.status.success(), "{}", told(&output));
        }
        assert!(tensors(&plain) == tensors(&own), "{domain}");
        let again = printed(&[
            "train",
            "self",
            "--domain",
            domain,
            "--config",
            config.to_str().unwrap(),
        ]);
        assert_eq!(again, text);
    }
}

#[test]
fn what_a_file_changes_is_used() {
    let bench = Bench::new();
    let plain = bench.path("plain");
    assert!(train("driving", &plain, None).status.success());
    let config = bench.write("rate.toml", "[self_model]\nlearning_rate = 1e-3\n");
    let other = bench.path("rate");
    let output = train("driving", &other, Some(&config));
    assert!(output.status.success(), "{}", told(&output));
    assert!(tensors(&plain) != tensors(&other), "the rate was not used");

    let config = bench.write("size.toml", "[network]\nlatent = 20\nencoder_hidden = 30\n");
    let small = bench.path("size");
    let output = train("driving", &small, Some(&config));
    assert!(output.status.success(), "{}", told(&output));
    let scene = domains::discrete::Scene::builtin("driving-fog").unwrap();
    let model = SelfModel::load(&small, layout_of(&scene).unwrap()).unwrap();
    assert_eq!((model.sizes.latent, model.sizes.encoder_hidden), (20, 30));
    // It goes on as it began, and drives.
    let mut more = mirror();
    more.args(["train", "self", "--domain", "driving", "--resume"]);
    let output = run(more.args(["--phases", "2", "--out"]).arg(&small));
    assert!(output.status.success(), "{}", told(&output));
    let mut up = mirror();
    up.args(["up", "--scene", "driving-fog", "--episodes", "1", "--human"]);
    up.args(["self", "--instance", &common::instance("config")]);
    let output = run(up.arg("--self-model").arg(&small));
    assert!(output.status.success(), "{}", told(&output));
}

/// A highway model whose z is smaller than what ships, and than what messages hold, is learned and planned with.
#[test]
fn a_smaller_model_of_the_highway_plans() {
    let bench = Bench::new();
    let config = bench.write(
        "small.toml",
        "[network]\nlatent = 24\n[self_model]\ngradient_steps = 4\n",
    );
    let small = bench.path("small");
    let output = train("highway", &small, Some(&config));
    assert!(output.status.success(), "{}", told(&output));
    let scene = bench.write(
        "short.toml",
        "name = \"short\"\n[episode]\nmax_steps = 4\n[planning]\nsamples = 40\nelites = 8\nrace_first = 4\nrace_futures = 16\n",
    );
    for planner in ["race", "ce", "kl"] {
        let mut up = mirror();
        up.args(["up", "--episodes", "2", "--human", "self", "--planner"]);
        up.args([planner, "--instance", &common::instance("small")]);
        let output = run(up
            .arg("--self-model")
            .arg(&small)
            .arg("--scene")
            .arg(&scene));
        assert!(output.status.success(), "{planner}: {}", told(&output));
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.contains("2 whole episodes, 8 steps"), "{said}");
    }
}

#[test]
fn what_is_learned_of_people_has_settings_too() {
    let bench = Bench::new();
    let demos = bench.path("demos");
    let mut record = mirror();
    record.args(["demos", "--domain", "driving", "--person", "2"]);
    let output = run(record.args(["--rounds", "8", "--out"]).arg(&demos));
    assert!(output.status.success(), "{}", told(&output));
    let learn = |kind: &str, text: &str| {
        let config = bench.write("mine.toml", text);
        let out = bench.path("learned");
        let mut command = mirror();
        command.args(["train", "human", "--domain", "driving", "--kind", kind]);
        command
            .arg("--demos")
            .arg(&demos)
            .arg("--config")
            .arg(config);
        let output = run(command.arg("--out").arg(&out));
        assert!(output.status.success(), "{}", told(&output));
        tensors(&out)
    };
    for (kind, change) in [
        ("mirror", "[implants]\npoints = 5\n"),
        ("bc", "[policy]\nhidden = 20\n"),
        ("bc", "[cloning]\nlearning_rate = 0.01\n"),
    ] {
        assert!(learn(kind, "") != learn(kind, change), "{change}");
    }
}

#[test]
fn what_nobody_understands_is_refused_with_its_place() {
    let bench = Bench::new();
    for (domain, text, place) in [
        (
            "driving",
            "[self_model]\n  lerning_rate = 1\n",
            "mine.toml:2:3",
        ),
        ("highway", "[self_model.sac]\ngamma = 1\n", "mine.toml:2:1"),
        (
            "search_rescue",
            "[network.image]\nfeatures = 1.5\n",
            "mine.toml:2:12",
        ),
        (
            "driving",
            "[network]\nlatent = 500\n",
            "mine.toml: [network]",
        ),
        ("highway", "[implants]\npoints = 0\n", "[implants]"),
    ] {
        let config = bench.write("mine.toml", text);
        let out = bench.path("none");
        let output = train(domain, &out, Some(&config));
        assert_eq!(output.status.code(), Some(2), "{text}: {}", told(&output));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(place), "{text}: {said}");
        assert!(!out.exists());
    }
    let missing = train(
        "driving",
        &bench.path("none"),
        Some(Path::new("/nowhere.toml")),
    );
    assert_eq!(missing.status.code(), Some(2));
    assert!(told(&missing).contains("/nowhere.toml"));
}
