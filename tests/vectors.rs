//! A run has the same digest with vectors of any width: what a machine computes does not depend on its instructions.

mod common;

use common::{instance, mirror, quick_scene, run, summary, told};
use std::path::Path;
use std::process::Command;

/// A run with the self-model that ships; what the human model knows of the person is learned at its start.
fn up(scene: &Path, vectors: &str, summary: &Path) -> Command {
    let mut command = mirror();
    command.args(["up", "--vectors", vectors, "--episodes", "1", "--quiet"]);
    let place = scene.file_stem().unwrap().to_string_lossy();
    command.args(["--instance", &instance(&format!("{place}-{vectors}"))]);
    command.arg("--scene").arg(scene);
    command.arg("--summary").arg(summary);
    command
}

/// The digests of a run with all widths.
fn digests(scene: &Path, folder: &Path) -> Vec<String> {
    let digest = |vectors: &str| {
        let file = folder.join(format!("{vectors}.json"));
        let output = run(&mut up(scene, vectors, &file));
        assert!(output.status.success(), "{}", told(&output));
        let summary = summary(&file);
        assert!(summary["steps"].as_u64().unwrap() > 0);
        summary["digest"].as_str().unwrap().to_owned()
    };
    ["widest", "4", "8", "16"].map(digest).to_vec()
}

fn all_the_same(scene: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let found = digests(scene, folder.path());
    assert_eq!(found[0].len(), 64);
    assert!(found.iter().all(|digest| *digest == found[0]), "{found:?}");
}

#[test]
fn on_the_highway() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("quick.toml");
    let text = quick_scene(40, "[episode]\nmax_steps = 40\n");
    std::fs::write(&scene, text).unwrap();
    all_the_same(&scene);
}

#[test]
fn in_gridworlds_without_and_with_images() {
    for scene in ["driving-fog", "search-smoke"] {
        all_the_same(Path::new(scene));
    }
}
