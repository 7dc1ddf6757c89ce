//! The runtime's promises over real processes: this test program starts itself again as world, echo, human and
//! launcher.

mod support;

use messages::{DriverAction, ImagineRequest, LidarFrame, Outcome, ProcessState, Report, topic};
use runtime::{
    HISTORY, Input, InputOptions, InstanceError, InstanceLock, Launcher, LauncherWake, Node,
    PortError, Receive, RunArguments, Stamp, Wake, instance, now_ns, text_of,
};
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use support::{Child, roles};
use tempfile::TempDir;

testing::stand_in!(
    roles::play;
    a_lockstep_run_crosses_processes_loses_nothing_and_allocates_nothing,
    gaps_are_counted,
    gaps_count_from_the_start_of_the_run,
    sigterm_is_a_clean_end,
    what_a_killed_process_leaves_is_cleaned_and_its_successor_works,
    children_end_with_a_killed_launcher_and_the_next_start_cleans,
    another_layout_or_version_is_refused_with_both_named,
    two_instances_never_meet,
    two_groups_of_questions_are_on_their_way_at_once,
    a_latecomer_gets_the_last_messages,
    what_a_successor_repeats_is_heard_once,
    a_lockstep_wait_notices_being_overtaken,
    bad_names_and_arguments_are_refused_in_words,
);

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

/// Generous: only a broken build gets here.
const PATIENCE_NS: u64 = 60_000_000_000;

fn launcher(scratch: &TempDir, instance: &str) -> Launcher {
    let lock = InstanceLock::acquire(scratch.path(), instance).expect("the instance is free");
    Launcher::open(lock, 7, runtime::ClockMode::Lockstep).expect("the launcher opens")
}

fn start(launcher: &mut Launcher, names: &[&str], children: &[Child]) {
    let descriptors: Vec<i32> = children.iter().map(Child::descriptor).collect();
    launcher
        .wait_ready(names, &descriptors, now_ns() + PATIENCE_NS)
        .expect("all are ready");
    launcher.start().expect("start is sent");
}

/// Waits for the last report of a process.
fn last_report(launcher: &mut Launcher, process: &str) -> Report {
    let deadline = now_ns() + PATIENCE_NS;
    loop {
        match launcher.wait(&[], Some(deadline)).expect("waiting works") {
            LauncherWake::Report => {
                while let Some(report) = launcher.next_report().expect("receiving works") {
                    if matches!(
                        report.state(),
                        Ok(ProcessState::Finished | ProcessState::Failed)
                    ) && text_of(&report.process) == process
                    {
                        return report;
                    }
                }
            }
            other => panic!("no last report of {process}: {other:?}"),
        }
    }
}

fn node(launcher: &Launcher, process: &str) -> Node {
    let mut arguments = launcher.arguments().for_process(process, 90);
    arguments.launcher_pid = 0;
    Node::join(&arguments).expect("the test's own node joins")
}

fn a_lockstep_run_crosses_processes_loses_nothing_and_allocates_nothing() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "lockstep");
    let world = Child::spawn("world", &launcher.arguments().for_process("world", 0));
    let echo = Child::spawn("echo", &launcher.arguments().for_process("echo", 1));
    let children = [world, echo];
    start(&mut launcher, &["world", "echo"], &children);
    let report = last_report(&mut launcher, "world");
    assert_eq!(
        report.state(),
        Ok(ProcessState::Finished),
        "{}",
        text_of(&report.text)
    );
    assert_eq!(report.steps, roles::STEPS as u64);
    assert_eq!(report.allocations, 0, "the world's loop allocated");
    assert_eq!(report.transport_allocations, 0, "loaning allocated");
    assert_eq!(report.port_count, 1);
    assert_eq!(text_of(&report.ports[0].topic), topic::DRIVER_ACTION);
    assert_eq!(
        (report.ports[0].received, report.ports[0].lost),
        (roles::STEPS as u64, 0)
    );
    assert!(report.compute_ns[0] > 0 && report.compute_ns[0] <= report.compute_ns[4]);
    launcher.stop().expect("stop is sent");
    let report = last_report(&mut launcher, "echo");
    assert_eq!(
        report.state(),
        Ok(ProcessState::Finished),
        "{}",
        text_of(&report.text)
    );
    assert_eq!(report.allocations, 0, "the echo's loop allocated");
    assert_eq!(
        (report.ports[0].received, report.ports[0].lost),
        (roles::STEPS as u64, 0)
    );
}

fn gaps_are_counted() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "gaps");
    let node = node(&launcher, "slow");
    let options = InputOptions {
        receive: Receive::InOrder,
        buffer: 8,
        wakes: true,
    };
    let mut slow: Input<Outcome> = node
        .input_with(topic::OUTCOME, options)
        .expect("the input opens");
    let mut recorder: Input<Outcome> = node
        .input_with(topic::OUTCOME, InputOptions::recorder())
        .expect("the input opens");
    let talker = Child::spawn("talker", &launcher.arguments().for_process("talker", 0));
    let children = [talker];
    launcher
        .wait_ready(
            &["talker"],
            &[children[0].descriptor()],
            now_ns() + PATIENCE_NS,
        )
        .expect("the talker is ready");
    node.connect();
    launcher.start().expect("start is sent");
    assert_eq!(
        last_report(&mut launcher, "talker").state(),
        Ok(ProcessState::Finished)
    );
    let mut received = Vec::new();
    while let Some(outcome) = slow.next().expect("receiving works") {
        received.push(outcome.reward as u64);
    }
    let first = roles::TALK - 8;
    assert_eq!(
        received,
        (first..roles::TALK).collect::<Vec<_>>(),
        "the newest eight, in order"
    );
    assert_eq!(
        (slow.received(), slow.lost()),
        (8, 0),
        "a first sight of a sender counts from there"
    );
    let mut count = 0;
    while recorder.take().expect("receiving works") {
        assert_eq!(
            recorder.message().map(|outcome| outcome.reward as u64),
            Some(count)
        );
        count += 1;
    }
    assert_eq!((count, recorder.lost()), (roles::TALK, 0));
}

fn gaps_count_from_the_start_of_the_run() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "early");
    // The gapper overflows its own input of eight between two looks at it.
    let gapper = Child::spawn("gapper", &launcher.arguments().for_process("gapper", 0));
    let children = [gapper];
    start(&mut launcher, &["gapper"], &children);
    let report = last_report(&mut launcher, "gapper");
    assert_eq!(
        report.state(),
        Ok(ProcessState::Finished),
        "{}",
        text_of(&report.text)
    );
    // 20 sent before the first look (12 lost), 30 before the second (22 lost).
    assert_eq!((report.ports[0].received, report.ports[0].lost), (16, 34));
}

fn sigterm_is_a_clean_end() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "term");
    let mut echo = Child::spawn("echo", &launcher.arguments().for_process("echo", 0));
    launcher
        .wait_ready(&["echo"], &[echo.descriptor()], now_ns() + PATIENCE_NS)
        .expect("the echo is ready");
    launcher.start().expect("start is sent");
    echo.signal(libc::SIGTERM);
    let status = echo.wait();
    assert!(status.success(), "{status}");
    assert_eq!(
        last_report(&mut launcher, "echo").state(),
        Ok(ProcessState::Finished)
    );
    let names: Vec<String> = nodes(&scratch, "term")
        .into_iter()
        .map(|node| node.process)
        .collect();
    assert_eq!(names, ["launcher"], "nothing of the echo is left");
}

fn nodes(scratch: &TempDir, name: &str) -> Vec<instance::NodeEntry> {
    instance::nodes(scratch.path(), name).expect("nodes can be listed")
}

fn what_a_killed_process_leaves_is_cleaned_and_its_successor_works() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "kill");
    // More often than a topic has places: what is not cleaned up would fill them.
    for index in 0..20 {
        let mut echo = Child::spawn("echo", &launcher.arguments().for_process("echo", index));
        launcher
            .wait_ready(&["echo"], &[echo.descriptor()], now_ns() + PATIENCE_NS)
            .expect("the echo is ready");
        launcher.start_process(index).expect("start is sent");
        echo.signal(libc::SIGKILL);
        assert_eq!(echo.wait().signal(), Some(libc::SIGKILL));
        let dead = nodes(&scratch, "kill")
            .into_iter()
            .filter(|node| !node.alive)
            .count();
        assert_eq!(dead, 1);
        let report = launcher.clean().expect("cleaning works");
        assert_eq!((report.nodes, report.failed), (1, 0));
    }
    let mut world = Child::spawn("world", &launcher.arguments().for_process("world", 30));
    let mut echo = Child::spawn("echo", &launcher.arguments().for_process("echo", 31));
    launcher
        .wait_ready(
            &["world", "echo"],
            &[world.descriptor(), echo.descriptor()],
            now_ns() + PATIENCE_NS,
        )
        .expect("both are ready");
    launcher.start().expect("start is sent");
    assert_eq!(
        last_report(&mut launcher, "world").state(),
        Ok(ProcessState::Finished)
    );
    assert!(world.wait().success());
    launcher.stop().expect("stop is sent");
    assert!(echo.wait().success());
    drop(launcher);
    assert_clean(&scratch, "kill");
}

fn assert_clean(scratch: &TempDir, name: &str) {
    let left = runtime::list_instances(scratch.path()).expect("instances can be listed");
    assert!(left.iter().all(|state| state.instance != name), "{left:?}");
    assert!(!instance::directory(scratch.path(), name).exists());
}

fn children_end_with_a_killed_launcher_and_the_next_start_cleans() {
    let scratch = testing::private_directory();
    let mut arguments =
        RunArguments::new(scratch.path(), "orphans", 7, runtime::ClockMode::Lockstep)
            .expect("a name");
    arguments.process = "launcher".to_owned();
    let mut first = Child::spawn("launcher", &arguments);
    let mut lines = BufReader::new(first.stdout()).lines();
    let grandchild: u32 = loop {
        let line = lines
            .next()
            .expect("the launcher speaks")
            .expect("in UTF-8");
        // libtest writes its own words on the same line.
        if let Some((_, pid)) = line.split_once("grandchild ") {
            break pid.trim().parse().expect("a process id");
        }
    };
    let grandchild = runtime::process_descriptor(grandchild).expect("the grandchild lives");
    match InstanceLock::acquire(scratch.path(), "orphans") {
        Err(InstanceError::InUse { instance, pid }) => {
            assert_eq!((instance.as_str(), pid), ("orphans", first.pid()));
        }
        other => panic!("a living instance was not noticed: {other:?}"),
    }
    let states = runtime::list_instances(scratch.path()).expect("instances can be listed");
    assert_eq!(states.len(), 1);
    assert_eq!(states[0].launcher, Some(first.pid()));
    first.signal(libc::SIGKILL);
    first.wait();
    support::wait_for_end(&grandchild);
    let states = runtime::list_instances(scratch.path()).expect("instances can be listed");
    assert_eq!(states[0].launcher, None, "{states:?}");
    let report = runtime::cleanup_dead(scratch.path(), "orphans").expect("cleaning works");
    assert!(
        report.nodes >= 1,
        "the launcher's node was left: {report:?}"
    );
    assert_clean(&scratch, "orphans");
    // And without anybody's `doctor`: a killed launcher's instance can be taken at once.
    let mut second = Child::spawn("launcher", &arguments);
    let mut lines = BufReader::new(second.stdout()).lines();
    while !lines
        .next()
        .expect("the launcher speaks")
        .expect("in UTF-8")
        .contains("grandchild ")
    {}
    second.signal(libc::SIGKILL);
    second.wait();
    let lock = InstanceLock::acquire(scratch.path(), "orphans").expect("the next start takes it");
    assert_eq!(nodes(&scratch, "orphans"), []);
    drop(lock);
    assert_clean(&scratch, "orphans");
}

fn another_layout_or_version_is_refused_with_both_named() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "layout");
    let node = node(&launcher, "stranger");
    match node
        .output::<support::SwappedAction>(topic::DRIVER_ACTION)
        .map(|_| ())
    {
        Err(PortError::Layout {
            topic: at,
            ours,
            theirs,
        }) => {
            assert_eq!(at, topic::DRIVER_ACTION);
            assert!(ours.starts_with("mirror/DriverAction/2 layout "), "{ours}");
            assert!(
                theirs.starts_with("mirror/DriverAction/2 layout "),
                "{theirs}"
            );
            assert_ne!(ours, theirs);
        }
        other => panic!("swapped fields were not refused: {other:?}"),
    }
    match node
        .input::<support::NextAction>(topic::DRIVER_ACTION, Receive::Newest)
        .map(|_| ())
    {
        Err(PortError::Layout { ours, theirs, .. }) => {
            assert!(ours.starts_with("mirror/DriverAction/3 "), "{ours}");
            assert!(theirs.starts_with("mirror/DriverAction/2 "), "{theirs}");
        }
        other => panic!("another version was not refused: {other:?}"),
    }
    node.output::<DriverAction>(topic::DRIVER_ACTION)
        .expect("the right one is let in");
}

fn two_instances_never_meet() {
    let scratch = testing::private_directory();
    let (a, b) = (launcher(&scratch, "a"), launcher(&scratch, "b"));
    let (node_a, node_b) = (node(&a, "one"), node(&b, "one"));
    let output = node_a
        .output::<DriverAction>(topic::DRIVER_ACTION)
        .expect("opens");
    let mut same = node_a
        .input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)
        .expect("opens");
    let mut other = node_b
        .input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder)
        .expect("opens");
    output
        .send_with(Stamp::default(), |action| action.steer = 0.5)
        .expect("sends");
    assert_eq!(
        same.next().expect("receives").map(|action| action.steer),
        Some(0.5)
    );
    assert!(other.next().expect("receives").is_none());
    assert_eq!(nodes(&scratch, "b").len(), 2);
}

fn two_groups_of_questions_are_on_their_way_at_once() {
    let scratch = testing::private_directory();
    let mut launcher = launcher(&scratch, "imagine");
    let human = Child::spawn("human", &launcher.arguments().for_process("human", 0));
    let planner = Child::spawn("planner", &launcher.arguments().for_process("planner", 1));
    let children = [human, planner];
    start(&mut launcher, &["human", "planner"], &children);
    let report = last_report(&mut launcher, "planner");
    assert_eq!(
        report.state(),
        Ok(ProcessState::Finished),
        "{}",
        text_of(&report.text)
    );
    assert_eq!(report.allocations, 0, "asking allocated");
    assert_eq!(report.ports[0].lost, 0);
    launcher.stop().expect("stop is sent");
    let report = last_report(&mut launcher, "human");
    assert_eq!(
        report.state(),
        Ok(ProcessState::Finished),
        "{}",
        text_of(&report.text)
    );
    assert_eq!(report.allocations, 0, "answering allocated");
    assert_eq!(report.ports[0].received, 2 * roles::STEPS as u64);
    assert!(
        size_of::<ImagineRequest>() > 400_000,
        "questions are large, so they are loaned"
    );
}

fn a_latecomer_gets_the_last_messages() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "late");
    let node = node(&launcher, "late");
    let output = node.output::<LidarFrame>(topic::LIDAR).expect("opens");
    let last = 2 * HISTORY as u32;
    for step in 0..last {
        output
            .send_with(Stamp::sensed(0, step), |_| {})
            .expect("sends");
    }
    let mut late = node
        .input::<LidarFrame>(topic::LIDAR, Receive::InOrder)
        .expect("opens");
    assert!(
        !late.take().expect("receives"),
        "history comes when the sender looks up"
    );
    output
        .send_with(Stamp::sensed(0, last), |_| {})
        .expect("sends");
    for step in last - HISTORY as u32..=last {
        assert!(late.take().expect("receives"));
        assert_eq!(late.header().map(|header| header.step), Some(step));
    }
    assert!(!late.take().expect("receives"));
    assert_eq!((late.received(), late.lost()), (HISTORY as u64 + 1, 0));
}

/// The successor of a process that died while it sent repeats its last words: some heard them, some did not. In real
/// time a second display of a step shows a decision that came late.
fn what_a_successor_repeats_is_heard_once() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "repeated");
    let node = node(&launcher, "repeated");
    let (first, second) = (
        node.output::<DriverAction>(topic::DRIVER_ACTION)
            .expect("opens"),
        node.output::<DriverAction>(topic::DRIVER_ACTION)
            .expect("opens"),
    );
    let open = || node.input::<DriverAction>(topic::DRIVER_ACTION, Receive::InOrder);
    let clocks = [runtime::ClockMode::RealTime, runtime::ClockMode::Lockstep];
    let mut inputs = clocks.map(|clock| open().expect("opens").once_in(clock));
    for (output, episode, step) in [
        (&first, 0, 7),
        (&first, 0, 8),
        (&second, 0, 8),
        (&second, 1, 0),
    ] {
        output
            .send_with(Stamp::sensed(episode, step), |_| {})
            .expect("sends");
    }
    let heard = inputs.each_mut().map(|input| {
        let mut heard = Vec::new();
        while let Some(action) = input.next().expect("receives") {
            heard.push((action.header.episode, action.header.step));
        }
        heard
    });
    assert_eq!(heard[0], [(0, 7), (0, 8), (0, 8), (1, 0)]);
    assert_eq!(heard[1], [(0, 7), (0, 8), (1, 0)]);
}

fn a_lockstep_wait_notices_being_overtaken() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "overtaken");
    let mut node = node(&launcher, "one");
    let mut input = node
        .input::<LidarFrame>(topic::LIDAR, Receive::InOrder)
        .expect("opens");
    let output = node.output::<LidarFrame>(topic::LIDAR).expect("opens");
    output
        .send_with(Stamp::sensed(0, 4), |_| {})
        .expect("sends");
    output
        .send_with(Stamp::sensed(0, 6), |_| {})
        .expect("sends");
    let past = Some(now_ns());
    assert_eq!(
        node.wait_step(&mut [&mut input], 0, 4, None)
            .expect("waits"),
        Wake::Message
    );
    assert_eq!(
        node.wait_step(&mut [&mut input], 0, 5, past)
            .expect("waits"),
        Wake::Passed,
        "step 6 is no step 5"
    );
    assert_eq!(input.header().map(|header| header.step), Some(6));
    assert_eq!(
        node.wait_step(&mut [&mut input], 0, 7, past)
            .expect("waits"),
        Wake::Deadline
    );
}

fn bad_names_and_arguments_are_refused_in_words() {
    let scratch = testing::private_directory();
    for name in [
        "",
        "a/b",
        "..",
        "with space",
        "ä",
        "-x",
        "--clean",
        "*",
        "a\nb",
        &"x".repeat(33),
    ] {
        let error = InstanceLock::acquire(scratch.path(), name)
            .map(|_| ())
            .expect_err("not a name");
        assert!(matches!(error, InstanceError::Name { .. }), "{error}");
    }
    let arguments =
        RunArguments::new(scratch.path(), "good", 1, runtime::ClockMode::RealTime).expect("a name");
    let path = arguments.write().expect("written");
    assert_eq!(RunArguments::read(&path).expect("read"), arguments);
    let text = arguments.to_json();
    for cut in 0..text.len() {
        let error = RunArguments::from_json(&text[..cut], "run.json").expect_err("truncated");
        assert!(error.to_string().starts_with("run.json: "), "{error}");
    }
    let absent = scratch.path().join("absent.json");
    let error = RunArguments::read(&absent).expect_err("no such file");
    assert!(error.to_string().contains("absent.json"), "{error}");
    let deep = scratch.path().join("d".repeat(90));
    let error = InstanceLock::acquire(&deep, "good")
        .map(|_| ())
        .expect_err("no socket fits");
    assert!(matches!(error, InstanceError::Root { .. }), "{error}");
}
