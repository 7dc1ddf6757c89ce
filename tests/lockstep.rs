//! Lockstep across real processes: a run is a pure function of scene, models and seed.

mod common;

use common::{
    Bench, assert_no_message_lost, assert_nothing_left, instance, quick_scene, run, summary, told,
};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

fn up(bench: &Bench, name: &str, seed: &str) -> (Command, PathBuf) {
    let file = bench.path(&format!("{name}.json"));
    let mut command = bench.up(&instance(name));
    command
        .args(["--episodes", "2", "--seed", seed, "--quiet", "--summary"])
        .arg(&file);
    (command, file)
}

/// Has the command, and all that it starts, run on the first of the cores that this test may use.
fn on_one_core(command: &mut Command) {
    // SAFETY: between fork and exec only plain system calls on the stack's own memory are made.
    unsafe {
        command.pre_exec(|| {
            let mut allowed: libc::cpu_set_t = core::mem::zeroed();
            if libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &mut allowed) != 0 {
                return Err(std::io::Error::last_os_error());
            }
            let mut one: libc::cpu_set_t = core::mem::zeroed();
            if let Some(core) =
                (0..libc::CPU_SETSIZE as usize).find(|core| libc::CPU_ISSET(*core, &allowed))
            {
                libc::CPU_SET(core, &mut one);
            }
            if libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &one) != 0 {
                return Err(std::io::Error::last_os_error());
            }
            Ok(())
        });
    }
}

#[test]
fn equal_seeds_give_equal_digests_however_fast_the_machine() {
    let bench = Bench::new();
    // Two sets at the same time, one of them on a single core: they share the machine and never meet.
    let (mut free, free_file) = up(&bench, "free", "7");
    let (mut confined, confined_file) = up(&bench, "confined", "7");
    on_one_core(&mut confined);
    let beside = confined
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let free = run(&mut free);
    let confined = beside.wait_with_output().unwrap();
    assert!(free.status.success(), "{}", told(&free));
    assert!(confined.status.success(), "{}", told(&confined));

    let (mut other, other_file) = up(&bench, "other", "8");
    let other = run(&mut other);
    assert!(other.status.success(), "{}", told(&other));

    let [free, confined, other] = [free_file, confined_file, other_file].map(|file| summary(&file));
    let digest = |summary: &serde_json::Value| summary["digest"].as_str().unwrap().to_owned();
    assert_eq!(digest(&free).len(), 64);
    assert_eq!(digest(&free), digest(&confined));
    assert_ne!(digest(&free), digest(&other));
    for name in ["free", "confined", "other"] {
        assert_nothing_left(&instance(name));
    }

    // What the launcher counted agrees, and nothing was lost on the way.
    for key in ["steps", "collisions", "reward_mean", "episode_list"] {
        assert_eq!(free[key], confined[key], "{key}");
    }
    assert_eq!(free["episodes"], 2);
    assert_eq!(free["completed"], true);
    assert!(free["steps"].as_u64().unwrap() > 20);
    assert_no_message_lost(&free);
    // Steady-state loops allocate nothing; the renderer and the recorder print and write.
    for process in ["world", "driver", "belief", "human", "planner"] {
        assert_eq!(free["allocations"][process], 0, "{process}");
    }
}

#[test]
fn the_real_time_clock_runs_to_the_end_too() {
    let bench = Bench::new();
    // Sixty simulated seconds in one.
    let scene = bench.write(
        "fast.toml",
        "name = \"fast\"\n[clock]\nrate = 60.0\n[episode]\nmax_steps = 100\n",
    );
    let file = bench.path("summary.json");
    let name = instance("realtime");
    let mut command = bench.up(&name);
    command
        .args(["--clock", "realtime", "--episodes", "1", "--scene"])
        .arg(scene)
        .arg("--summary")
        .arg(&file);
    let output = run(&mut command);
    assert!(output.status.success(), "{}", told(&output));
    let summary = summary(&file);
    assert_eq!(summary["clock"], "realtime");
    assert_eq!(summary["digest"], serde_json::Value::Null);
    assert_eq!(summary["completed"], true);
    // The world waits for nobody, and never runs ahead of its own clock: in lockstep this would take a tenth of the
    // time.
    let steps = summary["steps"].as_f64().unwrap();
    assert!(steps > 20.0, "{steps}");
    let least_s = (steps - 1.0) * 0.15 / 60.0;
    let took_s = summary["wall_seconds"].as_f64().unwrap();
    assert!(took_s >= least_s, "{steps} steps in {took_s} s");
    // A step can be late, and a beat can pass by unserved: there were no more of either.
    let missed = |process: &serde_json::Value| process["missed_deadlines"].as_u64().unwrap();
    let processes = summary["processes"].as_object().unwrap();
    let by_world = missed(&processes["world"]) as f64;
    assert!(
        by_world <= steps + took_s * 60.0 / 0.15,
        "{by_world} of {steps} steps in {took_s} s"
    );
    assert_eq!(
        missed(&summary),
        processes.values().map(missed).sum::<u64>()
    );
    assert_nothing_left(&name);
}

#[test]
fn planned_runs_are_deterministic_and_allocate_nothing() {
    let bench = Bench::new();
    let up = |name: &str, seed: &str| {
        let file = bench.path(&format!("{name}.json"));
        let scene = quick_scene(24, "[episode]\nmax_steps = 60\n");
        let mut command = bench.planned(&instance(name), &scene);
        command
            .args(["--episodes", "2", "--quiet", "--seed", seed, "--summary"])
            .arg(&file);
        (command, file)
    };
    let (mut first, first_file) = up("planned-1", "3");
    let (mut second, second_file) = up("planned-2", "3");
    on_one_core(&mut second);
    for command in [&mut first, &mut second] {
        let output = run(command);
        assert!(output.status.success(), "{}", told(&output));
    }
    let [first, second] = [first_file, second_file].map(|file| summary(&file));
    assert_eq!(first["digest"].as_str().unwrap().len(), 64);
    assert_eq!(first["digest"], second["digest"]);
    assert_eq!(first["episode_list"], second["episode_list"]);
    assert_eq!(first["planner"], "race");
    assert_eq!(first["human"], "mirror");
    for process in ["world", "driver", "belief", "human", "planner"] {
        assert_eq!(first["allocations"][process], 0, "{process}");
    }
    for name in ["planned-1", "planned-2"] {
        assert_nothing_left(&instance(name));
    }
}
