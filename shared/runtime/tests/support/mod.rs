//! Children and messages of wrong layouts.
#![allow(dead_code)] // Each test program uses its own part.

pub mod roles;

use iceoryx2::prelude::ZeroCopySend;
use messages::{Field, Header, Message};
use runtime::RunArguments;
use std::os::fd::{AsRawFd, OwnedFd};
use std::process::{ExitStatus, Stdio};

const RUN: &str = "MIRROR_TEST_RUN";

/// The run that this child joins.
pub fn arguments() -> RunArguments {
    RunArguments::from_json(&std::env::var(RUN).expect("children have arguments"), RUN)
        .expect("valid arguments")
}

/// This test program once more, as another process.
pub struct Child {
    child: std::process::Child,
    descriptor: OwnedFd,
}

impl Child {
    pub fn spawn(role: &str, arguments: &RunArguments) -> Self {
        let child = testing::Stander::new(role)
            .command()
            .env(RUN, arguments.to_json())
            .stdout(if role == "launcher" {
                Stdio::piped()
            } else {
                Stdio::null()
            })
            .spawn()
            .expect("the test program starts");
        let descriptor = runtime::process_descriptor(child.id()).expect("the child exists");
        Self { child, descriptor }
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn descriptor(&self) -> i32 {
        self.descriptor.as_raw_fd()
    }

    pub fn stdout(&mut self) -> std::process::ChildStdout {
        self.child.stdout.take().expect("a piped output")
    }

    pub fn signal(&self, signal: i32) {
        // SAFETY: signals a child that was not waited for yet, so its id is its own.
        assert_eq!(unsafe { libc::kill(self.child.id() as i32, signal) }, 0);
    }

    pub fn wait(&mut self) -> ExitStatus {
        self.child.wait().expect("the child can be waited for")
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // A failed test leaves no strays.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits for the end of a process that is not our child.
pub fn wait_for_end(process: &OwnedFd) {
    let mut poll = libc::pollfd {
        fd: process.as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    };
    // SAFETY: one live structure.
    let ended = unsafe { libc::poll(&mut poll, 1, 60_000) };
    assert_eq!(ended, 1, "the process outlived its launcher");
}

macro_rules! stranger {
    ($name:ident, $type_name:literal, $first:ident, $second:ident) => {
        /// `DriverAction` as somebody else understands it.
        #[derive(Clone, Copy, Debug)]
        #[repr(C)]
        pub struct $name {
            header: Header,
            $first: f32,
            $second: f32,
        }

        // SAFETY: `repr(C)`, plain numbers.
        unsafe impl ZeroCopySend for $name {
            unsafe fn type_name() -> &'static str {
                $type_name
            }
        }

        impl Message for $name {
            const TYPE_NAME: &'static str = $type_name;
            const ROS_TYPE: &'static str = "mirror_msgs/DriverAction";
            const ZERO: Self = Self {
                header: Header::ZERO,
                $first: 0.0,
                $second: 0.0,
            };

            fn fields() -> &'static [Field] {
                const FLOAT: Field = Field {
                    name: "",
                    offset: 0,
                    element: "float32",
                    count: None,
                    nested: None,
                    size: 4,
                    align: 4,
                    is_text: false,
                    doc: "",
                };
                const FIELDS: &[Field] = &[
                    Field {
                        name: "header",
                        offset: 0,
                        element: Header::ROS_TYPE,
                        count: None,
                        nested: Some(Header::fields),
                        size: size_of::<Header>(),
                        align: 8,
                        ..FLOAT
                    },
                    Field {
                        name: stringify!($first),
                        offset: 48,
                        ..FLOAT
                    },
                    Field {
                        name: stringify!($second),
                        offset: 52,
                        ..FLOAT
                    },
                ];
                FIELDS
            }

            fn header(&self) -> Option<&Header> {
                Some(&self.header)
            }

            fn header_mut(&mut self) -> Option<&mut Header> {
                Some(&mut self.header)
            }
        }
    };
}

stranger!(SwappedAction, "mirror/DriverAction/2", steer, throttle);
stranger!(NextAction, "mirror/DriverAction/3", throttle, steer);
