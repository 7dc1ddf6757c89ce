//! The pages: who is served, that nobody who watches holds the set up, and a person at the wheel in a real browser.
//!
//! This test program is also a planner, which points out and says everything that it can. Without a Chromium the tests
//! that need one say that they are skipped.

mod browser;
mod common;

use browser::Browser;
use common::{Bench, assert_nothing_left, instance, quick_scene, run, summary, told, until};
use messages::{
    Cockpit, CockpitEvent, CommAction, DecisionReason, DriverAction, Presence, RobotBelief, Scene,
    topic,
};
use recorder::parts::read_parts;
use recorder::topics::Recorded;
use runtime::{Node, Receive, RunArguments, Stamp, Wake};
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use testing::Stander;

testing::stand_in!(
    say_everything;
    what_cannot_be_is_refused,
    only_who_has_the_link_is_served,
    a_page_that_stops_reading_holds_nobody_up,
    a_view_that_dies_is_started_again,
    the_live_view_shows_a_run,
    a_recording_is_shown_with_what_is_decided_now,
    a_person_drives_with_the_keyboard,
    a_highlight_is_seen_and_a_sentence_heard,
    a_page_that_goes_away_pauses_the_round_and_voids_it,
    a_second_page_takes_the_wheel,
    a_steering_wheel_is_calibrated_and_drives,
    a_person_acts_in_a_gridworld,
);

/// The planner of these tests.
fn say_everything(_: &str, file: OsString) {
    let arguments = RunArguments::read(Path::new(&file)).unwrap();
    let mut node = Node::join(&arguments).unwrap();
    let mut robot = node
        .input::<RobotBelief>(topic::ROBOT_BELIEF, Receive::in_clock(arguments.clock))
        .unwrap();
    let decisions = node.output::<CommAction>(topic::COMM_ACTION).unwrap();
    node.needs_no_catching_up();
    node.ready().unwrap();
    while node.wait(&mut [&mut robot], None).unwrap() != Wake::Stop {
        robot.take().unwrap();
        let Some(header) = robot.header() else {
            continue;
        };
        let decided = decisions.send_with(Stamp::of(header).next(), |out| {
            (out.visual, out.verbal) = (0b11_1111, 1);
            out.verbal_probability[0] = 1.0;
            out.reason = DecisionReason::Planned.wire();
        });
        decided.unwrap();
        node.end_step();
    }
    node.finish().unwrap();
}

/// A run with pages.
struct Paged {
    child: Child,
    lines: BufReader<ChildStdout>,
    links: Vec<String>,
}

impl Paged {
    /// Starts it, and reads the links of so many pages.
    fn start(command: &mut Command, pages: usize) -> Self {
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        let mut links = Vec::new();
        let mut line = String::new();
        while links.len() < pages {
            line.clear();
            assert!(lines.read_line(&mut line).unwrap() > 0, "no link");
            if let Some((_, link)) = line.split_once(" at http://") {
                let link = link.split_whitespace().next().unwrap();
                links.push(format!("http://{link}"));
            }
        }
        Self {
            child,
            lines,
            links,
        }
    }

    /// Waits for its end; what it still printed.
    fn wait(&mut self) -> (bool, String) {
        let mut text = String::new();
        self.lines.read_to_string(&mut text).unwrap();
        (self.child.wait().unwrap().success(), text)
    }

    fn interrupt(&self) {
        // SAFETY: signals our own child, which was not waited for.
        unsafe { libc::kill(self.child.id() as libc::pid_t, libc::SIGINT) };
    }
}

impl Drop for Paged {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Begins the round, and goes on with it whenever a busy machine lets the page fall silent.
fn keep_driving(browser: &mut Browser) {
    browser.until("document.getElementById('start')");
    browser.press("Enter");
    browser.release("Enter");
    browser.value("setInterval(() => document.getElementById('start')?.click(), 50)");
    browser.until("window.mirror.page.presence === 'present'");
}

/// Host, token and the rest of a link.
fn parts(link: &str) -> (&str, &str) {
    let rest = link.strip_prefix("http://").unwrap();
    let (host, path) = rest.split_once('/').unwrap();
    (host, path.trim_end_matches('/'))
}

/// The answer to a request: its status, 0 where nobody listens yet, and everything.
fn ask(host: &str, path: &str, headers: &str) -> (u16, String) {
    let Ok(mut stream) = TcpStream::connect(host) else {
        return (0, String::new());
    };
    write!(stream, "GET {path} HTTP/1.1\r\n{headers}\r\n").unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let status = text.split(' ').nth(1).map(|status| status.parse().unwrap());
    (status.unwrap_or(0), text)
}

fn upgrade(host: &str) -> String {
    format!(
        "Host: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    )
}

/// What a recording holds.
fn recorded(path: &Path) -> Vec<Recorded> {
    let mut messages = Vec::new();
    read_parts(&[path.to_owned()], |message| messages.push(*message)).unwrap();
    messages
}

fn cockpits(messages: &[Recorded], event: CockpitEvent) -> Vec<Cockpit> {
    let told = messages.iter().filter_map(|message| match message {
        Recorded::Cockpit(cockpit) => Some(*cockpit),
        _ => None,
    });
    told.filter(|cockpit| cockpit.event() == Ok(event))
        .collect()
}

/// A person at the wheel of the highway in clear weather, with a car in either lane 20 m ahead.
fn at_the_wheel(bench: &Bench, name: &str, more: &str) -> Command {
    let extra = "[[traffic.extra]]\nlane = 0\nstart_s_m = 50.0\nspeed_kmh = 30.0\n\
                 [[traffic.extra]]\nlane = 1\nstart_s_m = 50.0\nspeed_kmh = 30.0\n";
    let scene = quick_scene(32, &format!("{more}\n{extra}"));
    let mut command = bench.up(name);
    command.args(["--driver", "browser", "--episodes", "1", "--scene"]);
    command.arg(bench.write("scene.toml", scene));
    command
}

fn what_cannot_be_is_refused() {
    let bench = Bench::new();
    let cases: [(&[&str], &str); 4] = [
        (
            &["--driver", "browser", "--clock", "lockstep"],
            "a person drives on the highway in real time",
        ),
        // A documentation address: no machine's own.
        (
            &["--view", "--listen", "192.0.2.1"],
            "cannot listen on 192.0.2.1",
        ),
        (
            &["--view", "--listen", "example.org"],
            "expected an address",
        ),
        (
            &["--driver", "browser", "--void-after", "-1"],
            "expected 0 to 86400",
        ),
    ];
    for (options, why) in cases {
        let name = instance("refused");
        let output = run(bench.up(&name).args(options));
        assert_eq!(output.status.code(), Some(2), "{}", told(&output));
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains(why), "{text}");
        assert_nothing_left(&name);
    }
}

fn only_who_has_the_link_is_served() {
    let bench = Bench::new();
    let name = instance("link");
    let mut command = bench.up(&name);
    let mut set = Paged::start(
        command.args(["--view", "--quiet", "--episodes", "100000"]),
        1,
    );
    let (host, token) = parts(&set.links[0]);
    assert!(host.starts_with("127.0.0.1:"), "{host}");
    let own = format!("Host: {host}\r\n");
    until("the page is served", || {
        ask(host, &format!("/{token}/"), &own).0 == 200
    });
    let (_, page) = ask(host, &format!("/{token}/"), &own);
    assert!(page.contains("live view") && page.contains("Content-Security-Policy"));
    assert_eq!(ask(host, "/", &own).0, 401);
    assert_eq!(ask(host, "/view.js", &own).0, 403);
    assert_eq!(ask(host, &format!("/{}0/", &token[1..]), &own).0, 403);
    let rebound = "Host: evil.example\r\n";
    assert_eq!(ask(host, &format!("/{token}/"), rebound).0, 403);
    let socket = format!("/{token}/socket");
    let foreign = format!("{}Origin: https://evil.example\r\n", upgrade(host));
    assert_eq!(ask(host, &socket, &foreign).0, 403);
    assert_eq!(ask(host, "/socket", &upgrade(host)).0, 403);
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET {socket} HTTP/1.1\r\n{}\r\n", upgrade(host)).unwrap();
    let mut status = [0; 12];
    stream.read_exact(&mut status).unwrap();
    assert_eq!(&status, b"HTTP/1.1 101");
    set.interrupt();
    set.wait();
    assert_nothing_left(&name);
}

/// A page that was opened and never reads again, while the set drives as it does without.
fn a_page_that_stops_reading_holds_nobody_up() {
    let bench = Bench::new();
    let digest = |pages: bool| {
        let name = instance(if pages { "stalled" } else { "alone" });
        let file = bench.path("summary.json");
        let mut command = bench.up(&name);
        command.args(["--episodes", "40", "--quiet", "--summary"]);
        command.arg(&file);
        if pages {
            let mut set = Paged::start(command.arg("--view"), 1);
            let (host, token) = parts(&set.links[0]);
            let mut stalled = None;
            until("the view is served", || {
                stalled = TcpStream::connect(host).ok();
                stalled.is_some()
            });
            let mut stalled = stalled.unwrap();
            let request = format!("GET /{token}/socket HTTP/1.1\r\n{}\r\n", upgrade(host));
            stalled.write_all(request.as_bytes()).unwrap();
            let (well, text) = set.wait();
            assert!(well, "{text}");
            drop(stalled);
        } else {
            let output = run(&mut command);
            assert!(output.status.success(), "{}", told(&output));
        }
        assert_nothing_left(&name);
        let summary = summary(&file);
        common::assert_no_message_lost(&summary);
        summary["digest"].as_str().unwrap().to_owned()
    };
    let alone = digest(false);
    assert!(!alone.is_empty());
    assert_eq!(digest(true), alone);
}

fn a_view_that_dies_is_started_again() {
    let bench = Bench::new();
    let name = instance("view-dies");
    let mut command = bench.up(&name);
    let mut set = Paged::start(
        command.args(["--view", "--quiet", "--episodes", "100000"]),
        1,
    );
    let (host, token) = parts(&set.links[0]);
    let own = format!("Host: {host}\r\n");
    let serves = || ask(host, &format!("/{token}/"), &own).0 == 200;
    until("the view is served", serves);
    let root = runtime::instance::root_for(&name);
    let pid = || {
        let nodes = runtime::instance::nodes(&root, &name).unwrap();
        let view = nodes
            .into_iter()
            .find(|node| node.process == "view" && node.alive);
        view.map(|view| view.pid)
    };
    let before = pid().unwrap();
    // SAFETY: signals a process that this test's run started.
    unsafe { libc::kill(before as libc::pid_t, libc::SIGKILL) };
    until("another view", || pid().is_some_and(|pid| pid != before));
    until("the link is the same", serves);
    set.interrupt();
    let (_, text) = set.wait();
    assert!(text.contains("interrupted"), "{text}");
    assert_nothing_left(&name);
}

fn the_live_view_shows_a_run() {
    let _alone = browser::alone();
    let test = "the_live_view_shows_a_run";
    let bench = Bench::new();
    let name = instance("live");
    let mut command = bench.planned(&name, &quick_scene(32, "[clock]\nrate = 20.0\n"));
    command.args([
        "--view",
        "--quiet",
        "--episodes",
        "100000",
        "--clock",
        "realtime",
    ]);
    let mut set = Paged::start(&mut command, 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    browser.until("window.mirror.store.frames.length > 30");
    browser.until("window.mirror.store.current.human.range.length === 108");
    browser.until("window.mirror.store.current.robot.range.length === 108");
    browser.until("window.mirror.hello.sight.length === 36");
    browser.until("window.mirror.store.frames.some(({ times }) => times.length >= 6)");
    // The road is drawn, and one can go back.
    browser.until(
        "document.getElementById('map').getContext('2d').getImageData(0, 0, 900, 700).data.some((byte) => byte > 60)",
    );
    browser.press("ArrowLeft");
    browser.until("window.mirror.store.chosen !== null");
    browser.press("Escape");
    browser.until("window.mirror.store.chosen === null");
    set.interrupt();
    set.wait();
    browser.until("document.getElementById('state').textContent === 'the run is over'");
    assert_nothing_left(&name);
}

fn a_recording_is_shown_with_what_is_decided_now() {
    let _alone = browser::alone();
    let test = "a_recording_is_shown_with_what_is_decided_now";
    let bench = Bench::new();
    let name = instance("recorded-view");
    let recording = bench.path("drive.mcap");
    let mut command = bench.up(&name);
    command.args(["--episodes", "2", "--quiet", "--record"]);
    let output = run(command.arg(&recording));
    assert!(output.status.success(), "{}", told(&output));
    let again = instance("replayed-view");
    let mut command = common::mirror();
    command.args(["replay", "--view", "--instance", &again]);
    let mut replay = Paged::start(command.arg(&recording), 1);
    let Some(mut browser) = Browser::open(test, &replay.links[0]) else {
        replay.interrupt();
        replay.wait();
        return;
    };
    // All of it, not only the last minute.
    browser.until("window.mirror.store.frames.length === window.mirror.hello.recorded");
    let frames = browser.value("window.mirror.store.frames.length");
    assert!(frames.as_u64().unwrap() > 100, "{frames}");
    let complete = "window.mirror.store.frames.filter(({ lidar, robot, human, action }) => lidar && robot && human && action)";
    let complete = browser.value(&format!("{complete}.length"));
    // An episode's last frame has an outcome alone.
    assert_eq!(complete.as_u64().unwrap() + 2, frames.as_u64().unwrap());
    let beside = browser.value("window.mirror.store.frames.filter(({ beside }) => beside).length");
    assert!(beside.as_u64().unwrap() > 100, "{beside}");
    browser.value("document.getElementById('live').click()");
    browser.until("window.mirror.store.chosen > 2");
    replay.interrupt();
    let (well, text) = replay.wait();
    assert!(well, "{text}");
    assert_nothing_left(&again);
}

fn a_person_drives_with_the_keyboard() {
    let _alone = browser::alone();
    let test = "a_person_drives_with_the_keyboard";
    let bench = Bench::new();
    let name = instance("keys");
    let recording = bench.path("drive.mcap");
    let mut command = at_the_wheel(&bench, &name, "");
    let mut set = Paged::start(command.arg("--record").arg(&recording), 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    keep_driving(&mut browser);
    browser.press("ArrowUp");
    browser.until("window.mirror.tracks.ego.speed > 4");
    browser.press("ArrowLeft");
    browser.until("window.mirror.driver.steer > 0.05");
    browser.until("window.mirror.world.frames > 3");
    // Off the road, or into a car: the round ends by itself.
    browser.until("window.mirror.page.end !== null || window.mirror.page.isOver");
    let (_, text) = set.wait();
    assert_nothing_left(&name);
    let messages = recorded(&recording);
    let actions: Vec<&DriverAction> = messages
        .iter()
        .filter_map(|message| match message {
            Recorded::DriverAction(action) => Some(action),
            _ => None,
        })
        .collect();
    assert!(actions.iter().any(|action| action.throttle > 0.9), "{text}");
    assert!(actions.iter().any(|action| action.steer > 0.05), "{text}");
    let moved_m = scenes(&messages)
        .map(|scene| (scene.ego.x_m, scene.ego.y_m))
        .collect::<Vec<_>>();
    let (first, last) = (moved_m[0], moved_m[moved_m.len() - 1]);
    assert!((last.0 - first.0).hypot(last.1 - first.1) > 3.0, "{text}");
    let (_, token) = parts(&set.links[0]);
    let file = std::fs::read(&recording).unwrap();
    let tokens = file
        .windows(token.len())
        .filter(|at| *at == token.as_bytes());
    assert_eq!(tokens.count(), 0, "a recording can be given away");
    let told = cockpits(&messages, CockpitEvent::Presence);
    let present = |cockpit: &&Cockpit| cockpit.presence() == Ok(Presence::Present);
    let present: Vec<_> = told.iter().filter(present).collect();
    assert!(present.iter().any(|cockpit| cockpit.round_trip_ns > 0));
    assert!(present.iter().any(|cockpit| cockpit.input_age_ns > 0));
}

fn scenes(messages: &[Recorded]) -> impl Iterator<Item = &Scene> {
    messages.iter().filter_map(|message| match message {
        Recorded::Scene(scene) => Some(scene),
        _ => None,
    })
}

fn a_highlight_is_seen_and_a_sentence_heard() {
    let _alone = browser::alone();
    let test = "a_highlight_is_seen_and_a_sentence_heard";
    let bench = Bench::new();
    let name = instance("shown");
    let recording = bench.path("drive.mcap");
    let mut command = at_the_wheel(&bench, &name, "");
    command
        .arg("--exec")
        .arg(format!("planner={}", Stander::new("planner").shell(&[])));
    let mut set = Paged::start(command.arg("--record").arg(&recording), 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    keep_driving(&mut browser);
    browser.until("window.mirror.world.drawn.length > 0");
    // Where the car is, the display has the box's colour.
    browser.until(
        "(() => {
            const { world } = window.mirror;
            const { ratio } = world.size;
            return world.drawn.some(({ left, top }) => {
                const pixels = world.pen.getImageData(left * ratio - 3, top * ratio - 3, 7, 7).data;
                for (let i = 0; i < pixels.length; i += 4) {
                    if (pixels[i] > 200 && pixels[i + 1] > 120 && pixels[i + 2] < 110 && pixels[i + 3] > 200) return true;
                }
                return false;
            });
        })()",
    );
    browser.until("window.mirror.page.heard.some(({ isHeard }) => isHeard)");
    let heard = browser.value("window.mirror.page.heard.find(({ isHeard }) => isHeard).text");
    // What the page says next comes after it.
    browser.value("window.mirror.ping()");
    browser.until("window.mirror.page.answered === window.mirror.page.pinged");
    set.interrupt();
    set.wait();
    assert_nothing_left(&name);
    let messages = recorded(&recording);
    let onsets = cockpits(&messages, CockpitEvent::Heard);
    let onset = onsets
        .iter()
        .find(|onset| runtime::text_of(&onset.text) == heard.as_str().unwrap())
        .expect("the sentence's onset");
    let said = messages.iter().find_map(|message| match message {
        Recorded::Display(display) if display.utterance_count > 0 => Some(display.header.sent_ns),
        _ => None,
    });
    assert!(said.unwrap() < onset.happened_ns);
    assert!(!cockpits(&messages, CockpitEvent::Seen).is_empty());
}

fn a_page_that_goes_away_pauses_the_round_and_voids_it() {
    let _alone = browser::alone();
    let test = "a_page_that_goes_away_pauses_the_round_and_voids_it";
    let bench = Bench::new();
    let name = instance("away");
    let (recording, file) = (bench.path("drive.mcap"), bench.path("summary.json"));
    let mut command = at_the_wheel(&bench, &name, "");
    command
        .args(["--void-after", "2", "--record"])
        .arg(&recording);
    let mut set = Paged::start(command.arg("--summary").arg(&file), 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    browser.until("document.getElementById('start')");
    browser.press("Enter");
    browser
        .until("window.mirror.page.presence === 'present' && window.mirror.page.motion.step > 1");
    browser.press("Escape");
    browser.until("window.mirror.page.presence === 'absent'");
    browser.until("document.getElementById('start')");
    browser.release("Enter");
    browser.press("Enter");
    browser.until("window.mirror.page.presence === 'present'");
    let paused_at = browser.value("window.mirror.page.motion.step");
    browser.until(&format!("window.mirror.page.motion.step > {paused_at} + 1"));
    browser.close_page();
    let (_, text) = set.wait();
    assert_nothing_left(&name);
    let summary = summary(&file);
    assert_eq!(summary["episode_list"][0]["end"], "void", "{text}");
    assert_eq!(summary["void_episodes"], 1);
    assert_eq!(summary["episodes"], 0, "it does not count");
    let messages = recorded(&recording);
    // While nobody was there, the world stood still: at most the step that had begun came to its end.
    let mut told = cockpits(&messages, CockpitEvent::Presence);
    told.sort_by_key(|cockpit| cockpit.header.sent_ns);
    let mut gaps = 0;
    for (before, after) in told.iter().zip(told.iter().skip(1)) {
        if before.presence() == Ok(Presence::Absent) && before.header.step > 0 {
            let between = before.header.sent_ns..after.header.sent_ns;
            let steps = scenes(&messages)
                .filter(|scene| between.contains(&scene.header.sent_ns))
                .count();
            assert!(steps <= 1, "{steps} steps while nobody was there");
            gaps += 1;
        }
    }
    assert!(gaps >= 2, "{gaps}");
    assert_eq!(
        told.last().unwrap().presence(),
        Ok(Presence::GivenUp),
        "{text}"
    );
}

fn a_second_page_takes_the_wheel() {
    let _alone = browser::alone();
    let test = "a_second_page_takes_the_wheel";
    let bench = Bench::new();
    let name = instance("second");
    let mut command = at_the_wheel(&bench, &name, "");
    let mut set = Paged::start(&mut command, 1);
    let link = set.links[0].clone();
    let Some(mut first) = Browser::open(test, &link) else {
        set.interrupt();
        set.wait();
        return;
    };
    first.until("document.getElementById('start')");
    first.press("Enter");
    first.until("window.mirror.page.presence === 'present'");
    let Some(mut second) = Browser::open(test, &link) else {
        return;
    };
    first.until("window.mirror.page.isReplaced");
    second.until("document.getElementById('start')");
    second.press("Enter");
    second.until("window.mirror.page.presence === 'present'");
    set.interrupt();
    set.wait();
    second.until("window.mirror.page.isOver || !window.mirror.page.isOpen");
    assert_nothing_left(&name);
}

/// A device as the browser reports it: a wheel, and two pedals that rest at 1 and go to −1.
fn a_steering_wheel_is_calibrated_and_drives() {
    let _alone = browser::alone();
    let test = "a_steering_wheel_is_calibrated_and_drives";
    let bench = Bench::new();
    let name = instance("wheel");
    let recording = bench.path("drive.mcap");
    let mut command = at_the_wheel(&bench, &name, "");
    let mut set = Paged::start(command.arg("--record").arg(&recording), 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    browser.until("document.getElementById('start')");
    browser.value(
        "(() => {
            window.pad = { id: 'Wheel (test)', index: 0, connected: true, mapping: '', axes: [0, 1, 1], buttons: [] };
            navigator.getGamepads = () => [window.pad];
            document.getElementById('controls').click();
        })()",
    );
    for axes in ["0, 1, 1", "-0.9, 1, 1", "0.9, 1, 1", "0, -1, 1", "0, 1, -1"] {
        browser.until("document.getElementById('next')");
        browser.value(&format!(
            "window.pad.axes = [{axes}]; document.getElementById('next').click()"
        ));
    }
    browser.until("document.getElementById('calibrated')");
    browser.value("window.pad.axes = [0, 1, 1]; document.getElementById('calibrated').click()");
    keep_driving(&mut browser);
    browser.value("window.pad.axes = [-0.09, 0, 1]");
    browser.until("window.mirror.tracks.ego.speed > 2");
    set.interrupt();
    set.wait();
    assert_nothing_left(&name);
    let messages = recorded(&recording);
    let half = messages.iter().any(|message| match message {
        Recorded::DriverAction(action) => {
            (action.throttle - 0.5).abs() < 0.01 && (action.steer - 0.1).abs() < 0.01
        }
        _ => false,
    });
    assert!(half, "half of the throttle, a tenth of the way to the left");
}

fn a_person_acts_in_a_gridworld() {
    let _alone = browser::alone();
    let test = "a_person_acts_in_a_gridworld";
    let bench = Bench::new();
    let name = instance("board");
    let recording = bench.path("board.mcap");
    let mut command = common::mirror();
    command
        .args(["up", "--scene", "search-smoke", "--driver", "browser"])
        .args(["--human", "self", "--planner", "none", "--episodes", "1"])
        .args(["--instance", &name, "--record"])
        .arg(&recording);
    let mut set = Paged::start(&mut command, 1);
    let Some(mut browser) = Browser::open(test, &set.links[0]) else {
        set.interrupt();
        set.wait();
        return;
    };
    browser.until("document.getElementById('start')");
    browser.press("Enter");
    browser.until("window.mirror.page.presence === 'present'");
    browser.until("document.getElementById('cover').hidden");
    browser.press("ArrowRight");
    browser.release("ArrowRight");
    browser.until("window.mirror.board.step.step === 1");
    browser.press("ArrowUp");
    browser.until("window.mirror.board.step.step === 2");
    set.interrupt();
    set.wait();
    assert_nothing_left(&name);
    let messages = recorded(&recording);
    let choices: Vec<_> = messages
        .iter()
        .filter_map(|message| match message {
            Recorded::DriverAction(action) => action.discrete(),
            _ => None,
        })
        .collect();
    assert_eq!(choices, [3, 0]);
}
