//! What may depend on what (ARCHITECTURE.md), as cargo knows it: arrows between crates point down the table of libraries.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// Our crates: where each lies, and which of ours it is built from.
struct Crates(BTreeMap<String, Crate>);

struct Crate {
    folder: String,
    uses: BTreeSet<String>,
    /// Of others.
    others: BTreeSet<String>,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("launch lies in the workspace")
}

impl Crates {
    fn of_this_workspace() -> Self {
        let told = Command::new(env!("CARGO"))
            .args([
                "metadata",
                "--format-version",
                "1",
                "--no-deps",
                "--offline",
            ])
            .current_dir(root())
            .output()
            .expect("cargo runs");
        assert!(told.status.success(), "{told:?}");
        let told: serde_json::Value = serde_json::from_slice(&told.stdout).expect("JSON");
        let packages = told["packages"].as_array().expect("packages");
        let name = |package: &serde_json::Value| package["name"].as_str().unwrap_or("").to_owned();
        let ours: BTreeSet<String> = packages.iter().map(name).collect();
        let mut crates = BTreeMap::new();
        for package in packages {
            let manifest = Path::new(package["manifest_path"].as_str().expect("a path"));
            let folder = manifest.parent().and_then(|f| f.strip_prefix(root()).ok());
            let dependencies = package["dependencies"].as_array().expect("dependencies");
            // Tests may use what they like.
            let built = dependencies
                .iter()
                .filter(|d| d["kind"].as_str() != Some("dev"));
            let (uses, others) = built.map(name).partition(|name| ours.contains(name));
            let folder = folder.expect("inside the workspace").display().to_string();
            let this = Crate {
                folder,
                uses,
                others,
            };
            crates.insert(name(package), this);
        }
        Self(crates)
    }

    /// Everything that a crate is built from, ours and others'.
    fn reached(&self, from: &str) -> BTreeSet<&str> {
        let mut reached = BTreeSet::new();
        let mut left = vec![from];
        while let Some(name) = left.pop() {
            let Some(this) = self.0.get(name) else {
                continue;
            };
            for other in this.uses.iter().chain(&this.others) {
                if reached.insert(other.as_str()) {
                    left.push(other);
                }
            }
        }
        reached
    }
}

/// Rows of ARCHITECTURE.md's table of libraries, from the top: a library, and what it is said to use.
fn libraries() -> Vec<(String, BTreeSet<String>)> {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("is there");
    let rows = text.lines().filter(|line| line.starts_with("| `shared/"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let folder = cells[1].trim_matches('`').trim_start_matches("shared/");
        let uses = cells[3].split(", ").filter(|name| *name != "–");
        (folder.to_owned(), uses.map(str::to_owned).collect())
    })
    .collect()
}

#[test]
fn arrows_point_down_the_table_of_libraries() {
    let (crates, table) = (Crates::of_this_workspace(), libraries());
    let place: BTreeMap<&str, usize> = table
        .iter()
        .enumerate()
        .map(|(i, (name, _))| (name.as_str(), i))
        .collect();
    let mut found = 0;
    for (name, this) in &crates.0 {
        let Some(library) = this.folder.strip_prefix("shared/") else {
            continue;
        };
        found += 1;
        let at = *place
            .get(library)
            .unwrap_or_else(|| panic!("{name} is not in the table"));
        for used in &this.uses {
            let below = place.get(used.as_str()).is_some_and(|row| *row > at);
            assert!(below, "{name} uses {used}, which is not below it");
        }
        assert_eq!(this.uses, table[at].1, "what {name} uses");
    }
    assert!(found >= 13, "{found} libraries");
}

#[test]
fn processes_use_libraries_and_only_the_launcher_uses_processes() {
    let crates = Crates::of_this_workspace();
    let process = |name: &str| crates.0[name].folder.starts_with("processes/");
    for (name, this) in &crates.0 {
        if this.folder == "launch" {
            continue;
        }
        let may_read_recordings = ["replay", "view"].contains(&name.as_str());
        for used in this.uses.iter().filter(|used| process(used)) {
            assert!(
                may_read_recordings && used == "recorder",
                "{name} uses the process {used}"
            );
        }
    }
}

#[test]
fn mathematics_knows_no_process_and_transport_knows_no_model() {
    let crates = Crates::of_this_workspace();
    for name in [
        "nn",
        "domains",
        "models",
        "planning",
        "training",
        "experiments",
    ] {
        let reached = crates.reached(name);
        for foreign in ["messages", "runtime", "iceoryx2", "web"] {
            assert!(!reached.contains(foreign), "{name} reaches {foreign}");
        }
    }
    for name in ["messages", "runtime"] {
        let reached = crates.reached(name);
        for foreign in ["nn", "domains", "models", "planning", "training"] {
            assert!(!reached.contains(foreign), "{name} reaches {foreign}");
        }
    }
}
