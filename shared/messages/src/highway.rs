//! The messages of the highway alone: what is sensed there, and what is true.

use crate::Header;
use crate::message::message;

/// LIDAR azimuths, every 10°, counted anticlockwise from straight ahead.
pub const AZIMUTHS: usize = 36;
/// Height bands of the LIDAR: below 0.5 m, 0.5–1.0 m, 1.0–1.7 m.
pub const HEIGHT_BANDS: usize = 3;
/// LIDAR beams: azimuths × height bands.
pub const BEAMS: usize = AZIMUTHS * HEIGHT_BANDS;
/// Values that the ego car measures on itself.
pub const EGO_VALUES: usize = 5;
/// Most objects that a [`Scene`] carries; the nearest are kept.
pub const MAX_OBJECTS: usize = 64;

message! {
    /// What the car's semantic LIDAR and its own instruments measure at step k.
    pub struct LidarFrame, "1" {
        /// Header; `cause_ns` is the moment of sensing.
        pub header: Header,
        /// Range over 40 m, 1 where nothing is in range: `range[band · 36 + azimuth]`.
        pub range: [f32; BEAMS],
        /// Identity of the object that the azimuth's nearest return comes from; −1 for none.
        pub object: [i32; AZIMUTHS],
        /// Speed of that object over the road, in m/s; 0 for none.
        pub speed_mps: [f32; AZIMUTHS],
        /// Heading error/180°, speed/40 km/h, offset from lane centre/1.75 m, offset from road centre/7 m, road
        /// heading change 10 m ahead/180°.
        pub ego: [f32; EGO_VALUES],
        /// 1 once traffic moves; cars stand still until the driver first gives throttle.
        pub moving: u32,
    } header: yes
}

message! {
    /// A car as the world knows it.
    pub struct ObjectPose, "1" {
        /// Position of the box's centre, in metres in the world's frame.
        pub x_m: f64,
        /// See `x_m`.
        pub y_m: f64,
        /// Anticlockwise from the world's x axis.
        pub heading_rad: f32,
        /// Speed over ground.
        pub speed_mps: f32,
        /// Size of the box along its heading.
        pub length_m: f32,
        /// Size of the box across its heading.
        pub width_m: f32,
        /// Identity, as in [`LidarFrame::object`]; −1 for the ego car.
        pub id: i32,
        /// [`ObjectKind`](crate::ObjectKind): 0 car, 1 other.
        pub kind: u32,
    } header: no
}

message! {
    /// True poses, for display and scoring only: belief, human model and planner never read them.
    pub struct Scene, "1" {
        /// Header.
        pub header: Header,
        /// The ego car.
        pub ego: ObjectPose,
        /// The cars nearest to it, by identity.
        pub objects: [ObjectPose; MAX_OBJECTS],
        /// How many of `objects` are filled.
        pub count: u32,
        /// Cars that did not fit.
        pub left_out: u32,
    } header: yes
}
