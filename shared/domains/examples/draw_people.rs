//! Draws the 21 simulated people of the highway: `cargo run --release -p domains --example draw_people`.
//!
//! Writes `people/highway/01.toml` … `21.toml`. Everybody's every parameter comes from the distribution stated in the
//! file's head; nobody is tuned singly.

use std::fmt::Write as _;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Table, key, lowest, highest (uniform); whole numbers where the last is true.
const DISTRIBUTIONS: [(&str, &str, f64, f64, bool); 20] = [
    ("sight", "fog_front_factor", 0.85, 1.15, false),
    ("sight", "fog_side_factor", 0.8, 1.2, false),
    ("sight", "fog_rear_factor", 0.7, 1.3, false),
    ("sight", "mirror_m", 30.0, 40.0, false),
    ("sight", "shoulder_m", 15.0, 30.0, false),
    ("following", "desired_kmh", 36.0, 42.0, false),
    ("following", "caution", 0.0, 0.15, false),
    ("following", "headway_s", 0.8, 1.6, false),
    ("following", "standstill_m", 1.5, 3.0, false),
    ("following", "acceleration_mps2", 2.2, 3.4, false),
    ("following", "deceleration_mps2", 2.0, 4.0, false),
    ("changing", "politeness", 0.4, 1.0, false),
    ("changing", "threshold_mps2", 0.1, 0.6, false),
    ("changing", "safe_s", 2.5, 4.0, false),
    ("changing", "slant_rad", 0.15, 0.22, false),
    ("reacting", "delay_steps", 2.0, 5.0, true),
    ("reacting", "pedal_noise", 0.02, 0.08, false),
    ("reacting", "steer_noise", 0.005, 0.02, false),
    ("reacting", "noise_memory", 0.5, 0.8, false),
    ("reacting", "turn_s", 0.35, 0.6, false),
];

const SEED: u64 = 21;

fn main() -> std::io::Result<()> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("people/highway");
    std::fs::create_dir_all(&folder)?;
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    for id in 1..=21 {
        let mut text = format!(
            "# Simulated person {id} of the highway: an IDM and MOBIL driver, drawn by examples/draw_people.rs (seed {SEED}),\n\
             # not modelled on any human being. Each value is uniform on the range beside it.\nid = {id}\n"
        );
        let mut table = "";
        for (name, key, low, high, whole) in DISTRIBUTIONS {
            if name != table {
                let _ = writeln!(text, "\n[{name}]");
                table = name;
            }
            let _ = if whole {
                let value = random.random_range(low as u32..=high as u32);
                writeln!(text, "{key} = {value} # {low} to {high}")
            } else {
                let value = low + (high - low) * random.random::<f64>();
                writeln!(text, "{key} = {value:.3} # {low} to {high}")
            };
        }
        std::fs::write(folder.join(format!("{id:02}.toml")), text)?;
    }
    Ok(())
}
