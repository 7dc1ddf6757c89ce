//! A wake-up that iceoryx2 0.10 loses (see `src/sleeper.rs`): its listener says that it was notified, over a socket
//! without a datagram, so that nobody sends one any more. Here the datagram is taken out of the socket by hand, which
//! leaves exactly that state.

use iceoryx2::prelude::*;
use messages::{LidarFrame, topic};
use runtime::{
    ClockMode, Input, InstanceLock, Launcher, Node, Receive, RunArguments, Source, Stamp, Wake,
    instance,
};
use std::os::fd::RawFd;
use std::sync::mpsc;
use tempfile::TempDir;

fn is_readable(fd: RawFd) -> bool {
    let mut poll = libc::pollfd {
        fd,
        events: libc::POLLIN,
        revents: 0,
    };
    // SAFETY: one live structure.
    unsafe { libc::poll(&mut poll, 1, 0) == 1 }
}

/// Takes one datagram out of the listener's socket; the listener's own state stays as it is.
fn swallow(fd: RawFd) {
    let mut byte = 0u8;
    // SAFETY: room for the one byte that is asked for.
    let read = unsafe { libc::recv(fd, (&raw mut byte).cast(), 1, libc::MSG_DONTWAIT) };
    assert_eq!(read, 1, "a datagram was there");
    assert!(!is_readable(fd), "it was the only one");
}

/// iceoryx2's configuration for an instance, as the runtime makes it.
fn config(scratch: &TempDir, name: &str) -> Config {
    let mut config = Config::default();
    let directory = instance::directory(scratch.path(), name);
    let prefix = instance::prefix(scratch.path(), name);
    config
        .global
        .set_root_path(&Path::new(directory.to_str().unwrap().as_bytes()).unwrap());
    config.global.prefix = FileName::new(prefix.as_bytes()).unwrap();
    config
}

fn launcher(scratch: &TempDir, name: &str) -> Launcher {
    let lock = InstanceLock::acquire(scratch.path(), name).unwrap();
    Launcher::open(lock, 7, ClockMode::Lockstep).unwrap()
}

/// A node of this process, no child of a launcher.
fn join(launcher: &RunArguments, process: &str) -> Node {
    let mut arguments = launcher.for_process(process, 90);
    arguments.launcher_pid = 0;
    Node::join(&arguments).unwrap()
}

/// Waits until a thread of this process sleeps in `ppoll`.
fn wait_until_asleep(thread: libc::pid_t) {
    let ppoll = format!("{} ", libc::SYS_ppoll);
    let path = format!("/proc/self/task/{thread}");
    loop {
        // Where the system hides calls, it still tells who sleeps.
        let asleep = match std::fs::read_to_string(format!("{path}/syscall")) {
            Ok(call) => call.starts_with(&ppoll),
            Err(_) => std::fs::read_to_string(format!("{path}/stat"))
                .unwrap()
                .contains(") S "),
        };
        if asleep {
            return;
        }
        std::thread::yield_now();
    }
}

/// A frame is sent by a node of its own as soon as the calling thread sleeps.
fn send_when_asleep<T>(launcher: &RunArguments, step: u32, sleep: impl FnOnce() -> T) -> T {
    // SAFETY: a plain system call.
    let sleeper = unsafe { libc::gettid() };
    let (tell, told) = mpsc::channel();
    std::thread::scope(|scope| {
        let sender = scope.spawn(move || {
            let node = join(launcher, "sender");
            let frames = node.output::<LidarFrame>(topic::LIDAR).unwrap();
            tell.send(()).unwrap();
            wait_until_asleep(sleeper);
            frames.send_with(Stamp::sensed(0, step), |_| {}).unwrap();
            std::thread::park(); // its message lives as long as its port
        });
        told.recv().unwrap();
        let done = sleep();
        sender.thread().unpark();
        sender.join().unwrap();
        done
    })
}

#[test]
fn polling_alone_never_gets_out_of_it() {
    let scratch = testing::private_directory();
    let _launcher = launcher(&scratch, "bare");
    let config = config(&scratch, "bare");
    let node = NodeBuilder::new()
        .config(&config)
        .create::<ipc::Service>()
        .unwrap();
    let name: ServiceName = "bare".try_into().unwrap();
    let service = node.service_builder(&name).event().create().unwrap();
    let listener = service.listener_builder().create().unwrap();
    let notifier = service.notifier_builder().create().unwrap();
    // SAFETY: the descriptor is used only while the listener lives.
    let fd = unsafe { listener.file_descriptor().native_handle() };
    notifier.notify().unwrap();
    swallow(fd);
    for _ in 0..3 {
        notifier.notify().unwrap();
        assert!(
            !is_readable(fd),
            "nobody sends where a listener is said to be notified"
        );
    }
    assert_eq!(listener.try_wait(|_| {}).unwrap(), 4, "all were counted");
    notifier.notify().unwrap();
    assert!(is_readable(fd), "emptied once, the listener is in order");
}

#[test]
fn a_process_is_woken_by_the_next_notification_after_one_was_swallowed() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "swallowed");
    let mut node = join(launcher.arguments(), "sleeper");
    let mut frames: Input<LidarFrame> = node.input(topic::LIDAR, Receive::InOrder).unwrap();
    let sender = join(launcher.arguments(), "earlier");
    let output = sender.output::<LidarFrame>(topic::LIDAR).unwrap();
    for round in 0..3 {
        let step = 2 * round;
        output.send_with(Stamp::sensed(0, step), |_| {}).unwrap();
        swallow(frames.descriptor());
        let wake = node.wait_step(&mut [&mut frames], 0, step, None).unwrap();
        assert_eq!(wake, Wake::Message);
        let wake = send_when_asleep(launcher.arguments(), step + 1, || {
            node.wait_step(&mut [&mut frames], 0, step + 1, None)
                .unwrap()
        });
        assert_eq!(wake, Wake::Message);
        assert!(is_readable(frames.descriptor()), "a datagram woke it");
        assert_eq!(node.lost_wakeups(), 0);
    }
}

#[test]
fn what_nothing_wakes_a_process_for_is_found_by_looking_up_and_counted() {
    let scratch = testing::private_directory();
    let launcher = launcher(&scratch, "lookup");
    let mut node = join(launcher.arguments(), "sleeper");
    let mut frames: Input<LidarFrame> = node.input(topic::LIDAR, Receive::InOrder).unwrap();
    // A notification without a message, swallowed after the process had last emptied its listener.
    let other = NodeBuilder::new()
        .config(&config(&scratch, "lookup"))
        .create::<ipc::Service>()
        .unwrap();
    let name: ServiceName = topic::LIDAR.try_into().unwrap();
    let service = other.service_builder(&name).event().open().unwrap();
    let notifier = service.notifier_builder().create().unwrap();
    // What the process has not emptied yet it empties once more after its first nap.
    let soon = runtime::now_ns() + 5_000_000;
    assert_eq!(node.wait(&mut [], Some(soon)).unwrap(), Wake::Deadline);
    assert!(frames.drain().is_some());
    notifier.notify().unwrap();
    swallow(frames.descriptor());

    let wake = send_when_asleep(launcher.arguments(), 0, || {
        node.wait_step(&mut [&mut frames], 0, 0, None).unwrap()
    });
    assert_eq!(wake, Wake::Message);
    assert!(!is_readable(frames.descriptor()), "no datagram woke it");
    assert_eq!(node.lost_wakeups(), 1);

    let wake = send_when_asleep(launcher.arguments(), 1, || {
        node.wait_step(&mut [&mut frames], 0, 1, None).unwrap()
    });
    assert_eq!(wake, Wake::Message);
    assert_eq!(node.lost_wakeups(), 1, "from then on all is in order");
}
