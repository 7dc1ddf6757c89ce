//! Derives what Foxglove's 3D panel draws: LIDAR returns as scans, cars and utterances as markers, frames as
//! transforms.
//!
//! Frames: `map` is the world's; `base_link` lies on the road below the middle of the ego car, x ahead; `lidar` on its
//! roof; `lidar_low`, `lidar_mid` and `lidar_high` at the middle of the sensor's height bands.

use crate::cdr::Cdr;
use crate::highway_picture;
pub use crate::highway_picture::RoadLine;
use crate::picture;
use crate::qos::Qos;
use crate::ros::{
    CLOCK, Colour, LASER_SCAN, LaserScan, MARKER_ARRAY, Marker, MarkerPose, MarkerShape,
    MarkerStamp, Schema, TF_MESSAGE, Transform, write_markers, write_transforms,
};
use crate::topics::Recorded;
use messages::{AZIMUTHS, Display, HEIGHT_BANDS, LidarFrame, Message, Picture, Scene};
use runtime::text_of;

/// Reach of the LIDAR in metres.
const REACH_M: f32 = 40.0;
/// How long an utterance stays in the picture, in steps: about 3.5 s of the highway's 0.15 s.
const UTTERANCE_STEPS: u32 = 23;
/// Height of the LIDAR on the roof.
const LIDAR_HEIGHT_M: f64 = 1.7;
/// Frames of the height bands and the heights of their middles.
const BANDS: [(&str, f64); HEIGHT_BANDS] = [
    ("lidar_low", 0.25),
    ("lidar_mid", 0.75),
    ("lidar_high", 1.35),
];

const EGO: Colour = [0.15, 0.45, 0.95, 1.0];
const UNSEEN: Colour = [0.45, 0.45, 0.45, 0.5];
const SEEN: Colour = [0.85, 0.85, 0.85, 1.0];
const HIGHLIGHTED: Colour = [1.0, 0.65, 0.0, 1.0];
const TOUCHED: Colour = [0.9, 0.1, 0.1, 1.0];

/// Where derived messages go: an index into [`CHANNELS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Scan of the lowest height band; the others follow.
    Scan = 0,
    /// Cars and utterances.
    Markers = HEIGHT_BANDS as isize,
    /// Road lines, once.
    Road,
    /// Frames.
    Transforms,
    /// The drive's time, once a step.
    Clock,
}

/// Derived channels: topic, type, and how its messages reach those who listen.
pub const CHANNELS: [(&str, Schema, Qos); HEIGHT_BANDS + 4] = [
    ("/viz/scan_low", LASER_SCAN, Qos::Stream),
    ("/viz/scan_mid", LASER_SCAN, Qos::Stream),
    ("/viz/scan_high", LASER_SCAN, Qos::Stream),
    ("/viz/markers", MARKER_ARRAY, Qos::Stream),
    ("/viz/road", MARKER_ARRAY, Qos::Latched),
    ("/tf", TF_MESSAGE, Qos::Stream),
    ("/clock", CLOCK, Qos::Newest),
];

/// Follows the messages and derives from each what is to be drawn.
#[derive(Debug)]
pub struct Visuals {
    lidar: LidarFrame,
    scene: Scene,
    /// The newest picture of a gridworld; none on the highway.
    picture: Option<Box<Picture>>,
    display: Display,
    /// The car that the ego car touched in this episode, if any.
    touched: Option<i32>,
    /// Text of the last utterance, and the step at which it began.
    utterance: Option<(String, u32)>,
    cdr: Cdr,
}

impl Default for Visuals {
    fn default() -> Self {
        Self {
            lidar: LidarFrame::ZERO,
            scene: Scene::ZERO,
            picture: None,
            display: Display::ZERO,
            touched: None,
            utterance: None,
            cdr: Cdr::default(),
        }
    }
}

impl Visuals {
    /// Takes in `message`, which happened at `time_ns`, and hands every message derived from it to `emit` as channel
    /// and encapsulated body.
    pub fn derive(
        &mut self,
        message: &Recorded,
        time_ns: u64,
        emit: &mut impl FnMut(usize, &[u8]),
    ) {
        match message {
            Recorded::LidarFrame(frame) => {
                self.lidar = *frame;
                self.scans(time_ns, emit);
            }
            Recorded::Scene(scene) => {
                if scene.header.episode != self.scene.header.episode {
                    (self.touched, self.utterance) = (None, None);
                    self.display = Display::ZERO;
                }
                self.scene = *scene;
                self.transforms(time_ns, emit);
                self.markers(time_ns, emit);
            }
            Recorded::Picture(picture) => {
                match &mut self.picture {
                    Some(kept) => **kept = *picture,
                    kept => *kept = Some(Box::new(*picture)),
                }
                self.display = Display::ZERO;
                self.markers(time_ns, emit);
            }
            Recorded::Outcome(outcome) if outcome.collided != 0 => {
                self.touched = Some(outcome.other);
                self.markers(time_ns, emit);
            }
            Recorded::Display(display) => {
                if display.utterance_count > 0 {
                    let text = text_of(&display.utterances[0].text);
                    self.utterance = Some((text, display.header.step));
                }
                self.display = *display;
                self.markers(time_ns, emit);
            }
            _ => {}
        }
    }

    /// The road's lines, to be written once at the start of a recording.
    pub fn road(lines: &[RoadLine], time_ns: u64, cdr: &mut Cdr) {
        let stamp = MarkerStamp {
            time_ns,
            frame: "map",
        };
        let markers: Vec<Marker> = (0..)
            .zip(lines)
            .map(|(id, line)| highway_picture::road_line(stamp, id, line))
            .collect();
        write_markers(&markers, cdr);
    }

    fn scans(&mut self, time_ns: u64, emit: &mut impl FnMut(usize, &[u8])) {
        for (band, (frame, _)) in BANDS.into_iter().enumerate() {
            let normalised = &self.lidar.range[band * AZIMUTHS..][..AZIMUTHS];
            let mut ranges_m = [f32::INFINITY; AZIMUTHS];
            let mut intensities = [0.0; AZIMUTHS];
            for azimuth in 0..AZIMUTHS {
                if normalised[azimuth] < 1.0 {
                    ranges_m[azimuth] = normalised[azimuth] * REACH_M;
                    intensities[azimuth] = self.lidar.speed_mps[azimuth];
                }
            }
            LaserScan {
                stamp: MarkerStamp { time_ns, frame },
                increment_rad: core::f32::consts::TAU / AZIMUTHS as f32,
                range_max_m: REACH_M,
                ranges_m: &ranges_m,
                intensities: &intensities,
            }
            .write(&mut self.cdr);
            emit(Channel::Scan as usize + band, self.cdr.bytes());
        }
    }

    fn transforms(&mut self, time_ns: u64, emit: &mut impl FnMut(usize, &[u8])) {
        let link = |frame, child, position, heading_rad| Transform {
            stamp: MarkerStamp { time_ns, frame },
            child,
            pose: MarkerPose {
                position,
                heading_rad,
            },
        };
        let ego = &self.scene.ego;
        let band = |index: usize| {
            let (frame, height) = BANDS[index];
            link("lidar", frame, [0.0, 0.0, height - LIDAR_HEIGHT_M], 0.0)
        };
        let transforms = [
            link(
                "map",
                "base_link",
                [ego.x_m, ego.y_m, 0.0],
                f64::from(ego.heading_rad),
            ),
            link("base_link", "lidar", [0.0, 0.0, LIDAR_HEIGHT_M], 0.0),
            band(0),
            band(1),
            band(2),
        ];
        write_transforms(&transforms, &mut self.cdr);
        emit(Channel::Transforms as usize, self.cdr.bytes());
    }

    fn markers(&mut self, time_ns: u64, emit: &mut impl FnMut(usize, &[u8])) {
        let stamp = MarkerStamp {
            time_ns,
            frame: "map",
        };
        let markers = match &self.picture {
            None => self.marker_list(stamp),
            Some(picture) => picture::draw(picture, &self.display, stamp),
        };
        write_markers(&markers, &mut self.cdr);
        emit(Channel::Markers as usize, self.cdr.bytes());
    }

    /// Everything that moves, after a marker that clears what was drawn before.
    fn marker_list(&self, stamp: MarkerStamp) -> Vec<Marker> {
        let scene = &self.scene;
        let mut markers = vec![Marker::new(stamp, "", 0, MarkerShape::DeleteAll)];
        markers.push(highway_picture::car(stamp, "ego", &scene.ego, EGO));
        let count = (scene.count as usize).min(scene.objects.len());
        for object in &scene.objects[..count] {
            markers.push(highway_picture::car(
                stamp,
                "car",
                object,
                self.colour(object.id),
            ));
        }
        if let Some((said, step)) = &self.utterance
            && scene.header.step.saturating_sub(*step) < UTTERANCE_STEPS
        {
            let mut marker = Marker::new(stamp, "utterance", 0, MarkerShape::Text);
            marker.pose.position = [
                scene.ego.x_m,
                scene.ego.y_m,
                2.0 * highway_picture::CAR_HEIGHT_M,
            ];
            marker.scale = [1.0, 1.0, 1.0];
            marker.text.clone_from(said);
            markers.push(marker);
        }
        markers
    }

    fn colour(&self, id: i32) -> Colour {
        let highlighted = (self.display.object_count as usize).min(self.display.objects.len());
        if self.touched == Some(id) {
            TOUCHED
        } else if self.display.objects[..highlighted].contains(&id) {
            HIGHLIGHTED
        } else if self.lidar.object.contains(&id) {
            SEEN
        } else {
            UNSEEN
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAMP: MarkerStamp = MarkerStamp {
        time_ns: 7,
        frame: "map",
    };

    /// Two cars, of which the LIDAR sees number 5, at step `step`.
    fn drive(visuals: &mut Visuals, step: u32) {
        let mut lidar = LidarFrame::ZERO;
        lidar.object = [-1; AZIMUTHS];
        lidar.object[0] = 5;
        let mut scene = Scene::ZERO;
        (lidar.header.step, scene.header.step) = (step, step);
        (scene.ego.id, scene.ego.x_m, scene.ego.y_m) = (-1, 10.0, -2.0);
        (scene.objects[0].id, scene.objects[1].id, scene.count) = (5, 6, 2);
        scene.objects[1].length_m = 4.5;
        visuals.derive(&(&lidar).into(), 7, &mut |_, _| {});
        visuals.derive(&(&scene).into(), 7, &mut |_, _| {});
    }

    fn colours(visuals: &Visuals) -> Vec<(i32, Colour)> {
        let markers = visuals.marker_list(STAMP);
        let cubes = markers
            .iter()
            .filter(|marker| marker.shape == MarkerShape::Cube);
        cubes.map(|marker| (marker.id, marker.colour)).collect()
    }

    #[test]
    fn cars_are_coloured_by_what_is_known_of_them() {
        let mut visuals = Visuals::default();
        drive(&mut visuals, 0);
        assert_eq!(colours(&visuals), [(-1, EGO), (5, SEEN), (6, UNSEEN)]);
        let mut display = Display::ZERO;
        (display.objects[0], display.object_count) = (5, 1);
        visuals.derive(&(&display).into(), 7, &mut |_, _| {});
        assert_eq!(
            colours(&visuals),
            [(-1, EGO), (5, HIGHLIGHTED), (6, UNSEEN)]
        );
        let mut outcome = messages::Outcome::ZERO;
        (outcome.collided, outcome.other) = (1, 6);
        visuals.derive(&(&outcome).into(), 7, &mut |_, _| {});
        assert_eq!(colours(&visuals)[2], (6, TOUCHED));
        let markers = visuals.marker_list(STAMP);
        assert_eq!(markers[0].shape, MarkerShape::DeleteAll);
        assert_eq!(markers[1].pose.position, [10.0, -2.0, 0.75]);
        assert_eq!(markers[3].scale[0], 4.5);
    }

    #[test]
    fn an_utterance_stays_in_the_picture_for_a_while() {
        let mut visuals = Visuals::default();
        drive(&mut visuals, 10);
        let mut display = Display::ZERO;
        display.header.step = 10;
        display.utterance_count = 1;
        display.utterances[0].text[..4].copy_from_slice(b"Fast");
        visuals.derive(&(&display).into(), 7, &mut |_, _| {});
        let said = |visuals: &Visuals| {
            let markers = visuals.marker_list(STAMP);
            let text = markers
                .iter()
                .find(|marker| marker.shape == MarkerShape::Text);
            text.map(|marker| marker.text.clone())
        };
        assert_eq!(said(&visuals).as_deref(), Some("Fast"));
        drive(&mut visuals, 9 + UTTERANCE_STEPS);
        assert_eq!(said(&visuals).as_deref(), Some("Fast"));
        drive(&mut visuals, 10 + UTTERANCE_STEPS);
        assert_eq!(said(&visuals), None);
    }

    #[test]
    fn every_message_is_drawn_on_its_channels() {
        let mut visuals = Visuals::default();
        let mut channels = Vec::new();
        for message in [
            (&LidarFrame::ZERO).into(),
            (&Scene::ZERO).into(),
            (&Display::ZERO).into(),
        ] {
            visuals.derive(&message, 7, &mut |channel, body| {
                channels.push((channel, body.len()))
            });
        }
        let used: Vec<_> = channels
            .iter()
            .map(|(channel, _)| CHANNELS[*channel].0)
            .collect();
        let scans = ["/viz/scan_low", "/viz/scan_mid", "/viz/scan_high"];
        assert_eq!(used[..3], scans);
        assert_eq!(used[3..], ["/tf", "/viz/markers", "/viz/markers"]);
    }
}
