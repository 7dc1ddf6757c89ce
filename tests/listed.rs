//! What `mirror ls`, `mirror scenes` and `mirror people` list.

mod common;

use common::others::{Shared, can_be_two_users};
use common::{Bench, Live, assert_nothing_left, instance, mirror, run, told};
use serde_json::Value;

/// What a command prints as JSON.
fn listed(arguments: &[&str]) -> Value {
    let output = run(mirror().args(arguments).arg("--json"));
    assert!(output.status.success(), "{}", told(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What `mirror ls` tells of one set, if it runs.
fn of(name: &str) -> Option<Value> {
    let all = listed(&["ls"]);
    let mut all = all.as_array().unwrap().iter();
    all.find(|set| set["instance"] == name).cloned()
}

#[test]
fn a_set_that_runs_is_listed_with_what_it_is_and_how_far() {
    let (bench, name) = (Bench::new(), instance("listed"));
    let mut command = bench.up(&name);
    command.args(["--episodes", "1000000", "--driver", "sim:4", "--seed", "9"]);
    let mut live = Live::start(&mut command, &name);
    let first = of(&name).unwrap();
    for (key, value) in [
        ("state", "driving"),
        ("scene", "highway-fog"),
        ("human", "self"),
        ("planner", "none"),
        ("driver", "sim:4"),
        ("clock", "lockstep"),
    ] {
        assert_eq!(first[key], value, "{key}");
    }
    assert_eq!(first["seed"], 9);
    assert_eq!(first["episodes"], 1_000_000);
    assert_eq!(first["launcher"], live.pid("launcher"));
    let processes = first["processes"].as_array().unwrap();
    assert_eq!(processes.len(), 7);
    for process in processes {
        let pid = live.pid(process["process"].as_str().unwrap());
        assert_eq!(process["pid"], pid);
        assert_eq!(process["state"], "active", "{process}");
    }

    // It goes on, and a later look says so.
    let position = |set: &Value| (set["episode"].as_u64(), set["step"].as_u64());
    assert!(position(&first).1.is_some());
    while position(&of(&name).unwrap()) <= position(&first) {
        std::thread::yield_now();
    }

    // The whole set as text, in one line and a line for each process.
    let output = run(mirror().arg("ls"));
    let text = String::from_utf8(output.stdout).unwrap();
    let about = text
        .lines()
        .find(|line| line.starts_with(&format!("{name}:")));
    for part in ["driving", "highway-fog", "driver sim:4", "lockstep"] {
        assert!(about.unwrap().contains(part), "no {part:?} in {about:?}");
    }
    for (process, pid) in &live.processes {
        let has = |line: &str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            words.starts_with(&[process.as_str(), &pid.to_string(), "active"])
        };
        assert!(text.lines().any(has), "no {process} in {text}");
    }

    // A process that the system has stopped, and then a launcher that cannot answer.
    live.signal("recorder", libc::SIGSTOP);
    live.signal("launcher", libc::SIGSTOP);
    let stopped = of(&name).unwrap();
    live.signal("recorder", libc::SIGCONT);
    live.signal("launcher", libc::SIGCONT);
    assert_eq!(stopped["state"], "suspended");
    assert_eq!(stopped["scene"], Value::Null);
    let of_recorder = |process: &&Value| process["process"] == "recorder";
    let mut processes = stopped["processes"].as_array().unwrap().iter();
    assert_eq!(processes.find(of_recorder).unwrap()["state"], "suspended");

    live.interrupt();
    live.wait();
    assert_eq!(of(&name), None, "what ended is not listed");
    assert_nothing_left(&name);
}

#[test]
fn where_nothing_runs_it_is_said_plainly() {
    if !can_be_two_users("where_nothing_runs_it_is_said_plainly") {
        return;
    }
    // A user whom nobody has, and who therefore has no sets.
    let user = 4_100_000_000 + std::process::id() % 1_000_000;
    let shared = Shared::new();
    let ls = |arguments: &[&str]| {
        let output = run(shared.mirror_as(user).arg("ls").args(arguments));
        assert_eq!(output.status.code(), Some(0), "{}", told(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    assert_eq!(
        ls(&[]),
        "No process set is running; `mirror up` starts one.\n"
    );
    assert_eq!(ls(&["--json"]), "[]\n");
    assert!(!std::path::Path::new(&format!("/tmp/mirror-{user}")).exists());
}

#[test]
fn scenes_and_people_are_listed_as_text_and_as_json() {
    let scenes = listed(&["scenes"]);
    let text = run(mirror().arg("scenes")).stdout;
    let text = String::from_utf8(text).unwrap();
    for scene in scenes.as_array().unwrap() {
        let name = scene["name"].as_str().unwrap();
        let domain = scene["domain"].as_str().unwrap();
        let has = |line: &str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            words.starts_with(&[name, domain])
        };
        assert!(text.lines().any(has), "no {name} in {text}");
    }

    let everybody = listed(&["people"]);
    let everybody = everybody.as_array().unwrap();
    let mut counted = Vec::new();
    for domain in ["highway", "driving", "search_rescue", "bomb_defusal"] {
        let people = listed(&["people", "--domain", domain]);
        let people = people.as_array().unwrap();
        let of_domain = |person: &&Value| person["domain"] == domain;
        assert!(everybody.iter().filter(of_domain).eq(people.iter()));
        counted.push(people.len());
    }
    assert_eq!(counted, [21, 10, 10, 10]);
    assert_eq!(everybody.len(), counted.iter().sum::<usize>());
    let third = &everybody[2];
    assert_eq!(third["driver"], "sim:3");
    assert_eq!(third["parameters"]["reacting"]["delay_steps"], 2);
}
