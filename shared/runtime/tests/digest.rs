//! A run's digest: what it depends on, and what not.

use messages::{DriverAction, Header, LidarFrame, topic};
use runtime::Digest;

fn action(step: u32, steer: f32) -> DriverAction {
    DriverAction {
        header: Header {
            sequence: u64::from(step),
            step,
            ..Header::default()
        },
        steer,
        throttle: 1.0,
        ..DriverAction::default()
    }
}

fn frame(step: u32) -> LidarFrame {
    LidarFrame {
        header: Header {
            sequence: u64::from(step),
            step,
            ..Header::default()
        },
        moving: step,
        ..LidarFrame::default()
    }
}

fn digest(messages: impl FnOnce(&mut Digest)) -> String {
    let mut digest = Digest::new();
    messages(&mut digest);
    digest.hex()
}

#[test]
fn interleaving_and_times_do_not_matter() {
    let reference = digest(|digest| {
        for step in 0..5 {
            digest.add(topic::LIDAR, &frame(step));
            digest.add(topic::DRIVER_ACTION, &action(step, 0.25));
        }
    });
    let other = digest(|digest| {
        for step in 0..5 {
            let mut late = action(step, 0.25);
            late.header.run_id = 99;
            late.header.sent_ns = 12_345;
            late.header.cause_ns = 12_300;
            late.header.compute_ns = 45;
            digest.add(topic::DRIVER_ACTION, &late);
        }
        for step in 0..5 {
            digest.add(topic::LIDAR, &frame(step));
        }
    });
    assert_eq!(reference, other);
    assert_eq!(reference.len(), 64);
}

#[test]
fn content_order_place_and_number_matter() {
    let of = |actions: &[DriverAction], topic| {
        digest(|digest| actions.iter().for_each(|action| digest.add(topic, action)))
    };
    let (a, b) = (action(0, 0.1), action(1, 0.2));
    let mut later = a;
    later.header.episode = 1;
    let mut bit = a;
    bit.steer = f32::from_bits(a.steer.to_bits() ^ 1);
    let mut all = vec![
        of(&[], topic::DRIVER_ACTION),
        of(&[a], topic::DRIVER_ACTION),
        of(&[a, a], topic::DRIVER_ACTION),
        of(&[a, b], topic::DRIVER_ACTION),
        of(&[b, a], topic::DRIVER_ACTION),
        of(&[a, b], topic::LIDAR),
        of(&[later], topic::DRIVER_ACTION),
        of(&[bit], topic::DRIVER_ACTION),
    ];
    let count = all.len();
    all.sort();
    all.dedup();
    assert_eq!(all.len(), count, "two different runs have one digest");
}
